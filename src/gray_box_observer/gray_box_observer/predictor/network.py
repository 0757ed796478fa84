"""The predictor's network: one LSTM layer and a linear output, as plain arrays (thesis 4.3, 5.1.2).

Streaming inference needs no torch: one step is two small matrix products. Training lives in the
trainer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.safe_io.saved_state import (
    LARGEST_WEIGHT,
    SINGLE,
    ArrayRule,
    check_array,
    check_arrays,
)
from gray_box_observer.white_box.interface import Array

Mask = NDArray[np.bool_]
"""Which motors, shape (motor,)."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of the network; gates stand in the order input, forget, cell, output.

    Attributes:
        input: shape (4 hidden, input).
        recurrent: shape (4 hidden, hidden).
        bias: shape (4 hidden,).
        output: shape (hidden,).
        output_bias: shape (1,).
    """

    input: Array
    recurrent: Array
    bias: Array
    output: Array
    output_bias: Array

    @classmethod
    def initial(cls, inputs: int, hidden: int, seed: int) -> Weights:
        """Draw a fresh network: uniform by the root of the hidden size, forget gates open."""
        random = np.random.default_rng(seed)
        bound = hidden**-0.5
        bias = random.uniform(-bound, bound, 4 * hidden)
        bias[hidden : 2 * hidden] += 1.0
        return cls(
            random.uniform(-bound, bound, (4 * hidden, inputs)),
            random.uniform(-bound, bound, (4 * hidden, hidden)),
            bias,
            random.uniform(-bound, bound, hidden),
            np.full(1, 0.5),
        )

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, Any], hidden: int | None = None, inputs: int | None = None
    ) -> Weights:
        """Take the network's arrays out of others.

        Raises:
            ConfigurationError: it is of another size than expected.
        """
        weights = cls(**{f.name: arrays[f.name] for f in fields(cls)})
        if hidden is not None and weights.input.shape != (4 * hidden, inputs):
            raise ConfigurationError(
                f'the checkpoint holds a network of {weights.hidden} hidden units and '
                f'{weights.input.shape[1]} inputs, '
                f'expected {hidden} and {inputs}'
            )
        return weights

    @cached_property
    def hidden(self) -> int:
        """Number of hidden units."""
        return int(self.recurrent.shape[1])

    @cached_property
    def matrices(self) -> tuple[Array, ...]:
        """The matrices of :func:`advance`: two for the gates (the cell's doubled), two for output.

        The first makes gates of inputs and hidden units below each other, the second is their bias,
        a column. The logistic function of a gate is ``(1 + tanh(gate / 2)) / 2``: so one call
        squashes all of them.
        """
        factor = np.full((4 * self.hidden, 1), 0.5)
        factor[2 * self.hidden : 3 * self.hidden] = 1.0
        gates = np.concatenate((self.input, self.recurrent), axis=1) * factor
        return gates, self.bias[:, None] * factor, self.output, self.output_bias

    @property
    def finite(self) -> bool:
        """Whether every weight is a finite number."""
        return all(bool(np.isfinite(array).all()) for array in self.arrays().values())

    def arrays(self) -> dict[str, Array]:
        """Return every array by its name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


MOST_HIDDEN = 4096
"""Hidden units of a saved network, at most."""

LONGEST_STEP = 8.0
"""Mean of the gradient that Adam remembers, in units of the root of its mean square, at most: 7.3
by its two paces."""

_UNDERFLOW = 1e-12
"""Of a mean whose square single precision cannot hold."""


def has_weights(arrays: Mapping[str, Any]) -> bool:
    """Tell whether some arrays hold a network, or a part of one: :func:`check_weights` tells."""
    return not _shapes(1, 1).keys().isdisjoint(arrays)


def check_weights(
    arrays: Mapping[str, Any], inputs: int | None = None, prefix: str = ''
) -> tuple[int, int]:
    """Refuse arrays that are no network.

    Args:
        arrays: its arrays among others.
        inputs: how many it must have; None: any number.
        prefix: that their names begin with.

    Returns:
        Hidden units and inputs.

    Raises:
        CheckpointError: one is missing, does not fit the others, or is out of range.
    """
    every = ArrayRule((None, inputs), -LARGEST_WEIGHT, LARGEST_WEIGHT)
    check_array(f'{prefix}input', arrays.get(f'{prefix}input'), every)
    rows, width = arrays[f'{prefix}input'].shape
    hidden = min(max(1, rows // 4), MOST_HIDDEN)
    check_arrays(
        arrays,
        {name: replace(every, shape=shape) for name, shape in _shapes(hidden, width).items()},
        prefix,
    )
    return hidden, width


def check_moments(arrays: Mapping[str, Any], hidden: int, inputs: int, prefix: str = '') -> None:
    """Refuse arrays that are not Adam's memory of every weight of a trained network.

    Args:
        arrays: its arrays among others, by ``adam_<place>_<name>``.
        hidden: units of the network.
        inputs: of the network.
        prefix: that their names begin with.

    Raises:
        CheckpointError: one is missing, does not fit the network, or is out of range.
    """
    of_torch = {**_shapes(hidden, inputs), 'output': (1, hidden)}
    for place, shape in enumerate(of_torch.values()):
        rules = {
            'step': ArrayRule((), 0.0, 1e9, SINGLE),
            'exp_avg': ArrayRule(shape, -LARGEST_WEIGHT, LARGEST_WEIGHT, SINGLE),
            'exp_avg_sq': ArrayRule(shape, 0.0, LARGEST_WEIGHT, SINGLE),
        }
        own = f'{prefix}adam_{place}_'
        check_arrays(arrays, rules, own)
        size = np.sqrt(arrays[f'{own}exp_avg_sq'].astype(float))
        if (np.abs(arrays[f'{own}exp_avg']) > LONGEST_STEP * size + _UNDERFLOW).any():
            raise CheckpointError(f'{own}exp_avg is larger than any mean of gradients of that size')
    places = {
        name.removeprefix(f'{prefix}adam_').partition('_')[0]
        for name in arrays
        if name.startswith(f'{prefix}adam_')
    }
    if len(places) != len(of_torch):
        raise CheckpointError(
            f'{prefix}adam_ is of {len(places)} weights, expected {len(of_torch)}'
        )


def _shapes(hidden: int, inputs: int) -> dict[str, tuple[int, ...]]:
    return {
        'input': (4 * hidden, inputs),
        'recurrent': (4 * hidden, hidden),
        'bias': (4 * hidden,),
        'output': (hidden,),
        'output_bias': (1,),
    }


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """The network's memory: hidden and cell state, each (motor, hidden), in either order."""

    hidden: Array
    cell: Array

    @classmethod
    def blank(cls, motors: int, hidden: int) -> Memory:
        """Return the memory of a network that has seen nothing."""
        return cls(np.zeros((motors, hidden)), np.zeros((motors, hidden)))

    def where(self, motors: Mask, other: Memory, ops: Any = np) -> Memory:
        """Return this memory for motors in a mask of shape (motor,), another for the rest."""
        mask = motors[:, None]
        return Memory(
            ops.where(mask, self.hidden, other.hidden), ops.where(mask, self.cell, other.cell)
        )

    def cleared(self, motors: Mask, ops: Any = np) -> Memory:
        """Return this memory, blank for the motors that a mask of shape (motor,) marks."""
        if not motors.any():
            return self
        return Memory(*(ops.where(motors[:, None], 0.0, part) for part in (self.hidden, self.cell)))


def step(weights: Weights, memory: Memory, inputs: Array) -> tuple[Array, Memory]:
    """Run the network one sample on.

    Args:
        weights: the network.
        memory: its memory before the sample.
        inputs: shape (motor, input), normalised.

    Returns:
        The output, shape (motor,), normalised, and the new memory.
    """
    return advance(np, weights.matrices, memory, inputs)


def advance(ops: Any, matrices: Sequence[Any], memory: Memory, inputs: Any) -> tuple[Any, Memory]:
    """As :func:`step` by numpy or torch functions ``ops``, with :attr:`Weights.matrices`.

    Motors stand beside each other here, gates below each other: so that every gate of all motors is
    one piece of memory. What need not be kept is overwritten, for new memory costs more than
    arithmetic where motors are many.
    """
    weights, bias, output, output_bias = matrices
    n = output.shape[0]
    gates = weights @ ops.concatenate((inputs.T, memory.hidden.T))
    gates += bias
    ops.tanh(gates, out=gates)
    candidate = (
        1.0 * gates[2 * n : 3 * n]
    )  # a copy, by numpy and torch alike: gates are overwritten
    gates *= 0.5  # now the logistic function, safe at both ends
    gates += 0.5
    candidate *= gates[:n]
    cell = gates[n : 2 * n] * memory.cell.T
    cell += candidate
    hidden = ops.tanh(cell)
    hidden *= gates[3 * n :]
    return output @ hidden + output_bias, Memory(hidden.T, cell.T)
