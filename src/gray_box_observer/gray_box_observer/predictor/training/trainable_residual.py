"""The residual's network under training. Torch; imported when there is a residual to learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.residual_model import WARM
from gray_box_observer.predictor.training.torch_network import (
    TorchNetwork,
    give_moments,
    moments_of,
)
from gray_box_observer.settings.device import CPU
from gray_box_observer.white_box.interface import Array

LENGTH = 512
"""Samples of a window. Long: the network streams without end and must not have learnt to count on a
blank start."""

WINDOWS = 8
"""Windows of a step."""

LEARNING_RATE = 0.01
ROBUST = 0.1
"""Error, in units of the mean residual, above which it counts by its size, not its square:
commutation has spikes."""

DECAY = 1e-3
"""Pull of the weights towards zero: what data do not ask for is not said."""


class TrainableResidual:
    """A network that begins by correcting nothing.

    Args:
        inputs: number of inputs.
        hidden: number of hidden units.
        seed: of its first weights.
        device: torch's, on which it is taught.
    """

    def __init__(self, inputs: int, hidden: int, seed: int, device: str = CPU) -> None:
        torch.set_num_threads(1)
        fresh = Weights.initial(inputs, hidden, seed)
        mute = replace(fresh, output=np.zeros_like(fresh.output), output_bias=np.zeros(1))
        self._network = TorchNetwork.from_weights(mute, device)
        self._optimiser = torch.optim.AdamW(
            self._network.trainable(), LEARNING_RATE, weight_decay=DECAY
        )

    @property
    def weights(self) -> Weights:
        """What it knows now."""
        return self._network.export()

    def state(self) -> dict[str, Array]:
        """The network and the moments of Adam, as arrays."""
        return {**self.weights.arrays(), **moments_of(self._optimiser)}

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Go on from what :meth:`state` gave."""
        self._network.load(Weights.from_arrays(arrays))
        give_moments(self._optimiser, arrays)

    def learn(
        self,
        random: np.random.Generator,
        inputs: Array,
        residual: Array,
        is_training: NDArray[np.bool_],
        anew: NDArray[np.bool_],
        steps: int,
    ) -> None:
        """Take Adam steps on windows drawn from signal histories.

        Args:
            random: draws the windows.
            inputs: shape (motor, time, input): histories one after another.
            residual: shape (motor, time), in units of the largest correction.
            is_training: shape (time,): samples whose error counts.
            anew: shape (time,): where a history begins, the first among them.
            steps: number of steps.
        """
        x, y, counts = (self._network.single(array) for array in (inputs, residual, is_training))
        size = float(np.mean(np.abs(residual))) + 1e-12
        for _ in range(steps):
            motor = torch.as_tensor(
                random.integers(inputs.shape[0], size=WINDOWS)[:, None], device=x.device
            )
            at, is_warm = (
                torch.as_tensor(array, device=x.device) for array in windows(random, anew)
            )
            error = (torch.tanh(self._network(x[motor, at])) - y[motor, at]) / size
            weight = counts[at] * is_warm
            zero = torch.zeros_like(error)
            loss = (
                torch.nn.functional.smooth_l1_loss(error, zero, reduction='none', beta=ROBUST)
                * weight
            ).sum()
            self._optimiser.zero_grad()
            (loss / weight.sum().clamp_min(1.0)).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
            self._optimiser.step()


def windows(
    random: np.random.Generator, anew: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Draw windows, none of them across the beginning of a history.

    Args:
        random: draws.
        anew: shape (time,): where a history begins, the first among them.

    Returns:
        Samples, and whether their error counts, each of shape (WINDOWS, time). It does not behind
        the end of a history that is shorter than a window, nor while the memory fills; at the
        beginning of a history it does, for there the network that streams starts with a blank
        memory too.
    """
    first = np.flatnonzero(anew)
    end = np.append(first[1:], anew.size)
    places = random.integers(anew.size, size=WINDOWS)
    own = np.searchsorted(first, places, side='right') - 1
    length = min(LENGTH, int(np.max(end - first)))
    start = np.maximum(
        first[own], np.minimum(places - random.integers(length, size=WINDOWS), end[own] - length)
    )
    offset = np.arange(length)
    at = start[:, None] + offset
    is_warm = (at < end[own, None]) & ((offset >= WARM) | (start == first[own])[:, None])
    return np.minimum(at, anew.size - 1), is_warm
