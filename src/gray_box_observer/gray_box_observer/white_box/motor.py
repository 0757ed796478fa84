"""The DC motor as a white box: any choice of its terms unknown, the others known.

Source: thesis equations 4.1 to 4.4 and 4.17; docs/METHOD.md, The form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gray_box_observer.errors import ConfigurationError, brief
from gray_box_observer.white_box.base import Array, Parameter
from gray_box_observer.white_box.terms import INDUCTANCE, TERMS, Term


@dataclass(frozen=True)
class MotorWhiteBox:
    """Voltage balance of one or many DC motors that share their unknown terms.

    Attributes:
        context_nodes: names of the unknown terms; the inductance is always among them and comes first.
        torque_constant: Kt in N m/A, a scalar or shape (motor,).
        known: values of the known terms in SI units, scalars or shape (motor,); terms left out are zero.
        speed_measured: true where speed is a signal; else ``w = Kt i`` (thesis, 4.1.1).

    Raises:
        ConfigurationError: an unknown name, no inductance, or a term that only a measured speed could tell apart.
    """

    context_nodes: tuple[str, ...]
    torque_constant: Any
    known: Mapping[str, Any] = field(default_factory=dict)
    speed_measured: bool = False

    def __post_init__(self) -> None:
        unknown = [name for name in (*self.context_nodes, *self.known) if name not in TERMS]
        if unknown:
            raise ConfigurationError(
                f'no term named {brief(unknown[0])} in the white box; there are {", ".join(TERMS)}'
            )
        if self.context_nodes[:1] != (INDUCTANCE.parameter.name,):
            raise ConfigurationError(
                f'context_nodes must begin with inductance, got {list(self.context_nodes)}: '
                'without L nothing tells how fast torque follows voltage'
            )
        if len(set(self.context_nodes)) != len(self.context_nodes):
            raise ConfigurationError(f'context_nodes names a parameter twice: {list(self.context_nodes)}')
        blind = [n for n in self.context_nodes if TERMS[n].needs_speed and not self.speed_measured]
        if blind:
            raise ConfigurationError(
                f'{blind[0]} cannot be told from resistance without measured speed: publish speed in '
                "motor/torque's velocity or remove it from context_nodes"
            )
        try:
            positive = self.torque_constant > 0.0  # a number, an array, or a tensor on whatever device
        except TypeError as error:
            raise ConfigurationError(
                f'torque_constant must be a number or an array of shape (motor,), got {self.torque_constant!r}: '
                'of several motors give numpy.array'
            ) from error
        if not (positive if isinstance(positive, bool) else bool(positive.all())):
            raise ConfigurationError(f'torque_constant must be positive, got {self.torque_constant}')

    def to_dict(self) -> dict[str, Any]:
        """Describe the white box in plain values, for a checkpoint or another process."""
        return {
            'context_nodes': list(self.context_nodes),
            'torque_constant': np.asarray(self.torque_constant, dtype=float).tolist(),
            'known': {name: np.asarray(value, dtype=float).tolist() for name, value in self.known.items()},
            'speed_measured': self.speed_measured,
        }

    @classmethod
    def from_dict(cls, description: Mapping[str, Any], convert: Callable[[Any], Any] = np.asarray) -> MotorWhiteBox:
        """Build the white box that :meth:`to_dict` described; ``convert`` makes its constants arrays or tensors."""
        return cls(
            tuple(description['context_nodes']),
            convert(description['torque_constant']),
            {name: convert(value) for name, value in description['known'].items()},
            bool(description['speed_measured']),
        )

    def of_motors(self, index: Any) -> MotorWhiteBox:
        """Return the white box of the chosen motors, one for each entry of ``index`` (repetition allowed)."""
        known = {name: _take(value, index) for name, value in self.known.items()}
        return replace(self, torque_constant=_take(self.torque_constant, index), known=known)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown parameters in the order of ``context_nodes``."""
        return tuple(TERMS[name].parameter for name in self.context_nodes)

    @cached_property
    def _unknown_terms(self) -> Sequence[Term]:
        return [TERMS[name] for name in self.context_nodes[1:]]

    @cached_property
    def given(self) -> tuple[str, ...]:
        """Names of the terms whose values are known and not identified."""
        return tuple(name for name in self.known if name not in self.context_nodes)

    @cached_property
    def _known_terms(self) -> Sequence[tuple[Term, Any]]:
        return [(TERMS[name], self.known[name]) for name in self.given]

    def state(self, torque_nm: Array) -> Array:
        """Current in A from torque, ``i = T / Kt`` (thesis 4.3)."""
        return torque_nm / _spread(self.torque_constant, torque_nm)  # type: ignore[no-any-return]

    def output(self, state: Array) -> Array:
        """Torque in N m from current, ``T = Kt i`` (thesis 4.3)."""
        return _spread(self.torque_constant, state) * state  # type: ignore[no-any-return]

    def speed(self, state: Array, measured_rad_s: Array) -> Array:
        """Speed in rad/s: the measured one, or ``Kt i`` in the mode of the thesis."""
        return measured_rad_s if self.speed_measured else self.output(state)

    def drive(self, voltage_v: Array, state: Array, speed_rad_s: Array) -> Array:
        """Voltage less every known drop, in V."""
        result = voltage_v
        for term, value in self._known_terms:
            result = result - _spread(value, state) * _call(term.value, state, speed_rad_s)
        return result

    def drive_slope(self, state: Array, speed_rad_s: Array) -> Array:
        """Derivative of :meth:`drive` by the current, in ohm; total in the mode of the thesis, where w follows i."""
        result = 0.0 * state
        for term, value in self._known_terms:
            result = result - _spread(value, state) * self._slope(term, state, speed_rad_s)
        return result

    def basis(self, state: Array, speed_rad_s: Array) -> list[Any]:
        """Basis functions of every unknown term but the inductance."""
        return [_call(term.value, state, speed_rad_s) for term in self._unknown_terms]

    def basis_slope(self, state: Array, speed_rad_s: Array) -> list[Any]:
        """Derivatives of :meth:`basis` by the current; total in the mode of the thesis, where w follows i."""
        return [self._slope(term, state, speed_rad_s) for term in self._unknown_terms]

    def _slope(self, term: Term, state: Array, speed_rad_s: Array) -> Any:
        slope = _call(term.by_current, state, speed_rad_s)
        if self.speed_measured:
            return slope
        return slope + _spread(self.torque_constant, state) * _call(term.by_speed, state, speed_rad_s)


def _spread(constant: Any, like: Any) -> Any:
    """Line a constant of shape (motor,) up with a signal of shape (motor, ...)."""
    if isinstance(constant, float) or np.ndim(constant) == 0:
        return constant
    return constant.reshape((-1,) + (1,) * (like.ndim - 1))


def _take(constant: Any, index: Any) -> Any:
    return constant if np.ndim(constant) == 0 else constant[index]


def _call(function: Any, state: Any, speed_rad_s: Any) -> Any:
    if function is None:
        raise ConfigurationError(
            'the derivative term has no basis function: inductance cannot be a known constant here'
        )
    return function(state, speed_rad_s)
