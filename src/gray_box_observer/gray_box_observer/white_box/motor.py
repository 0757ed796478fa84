"""The DC motor as a white box: any choice of its effects unknown, the others known.

Source: thesis equations 4.1 to 4.4 and 4.17; docs/METHOD.md, The form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gray_box_observer.errors import ConfigurationError, brief
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.balance import Balance, Form
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array, Parameter

STORAGES = {term.state: name for name, term in TERMS.items() if not term.formula}
"""Name of the parameter that stands before the derivative of every state."""


@dataclass(frozen=True)
class MotorWhiteBox:
    """One or many DC motors that share their unknown effects.

    Attributes:
        context_nodes: names of the unknown parameters; the inductance is always among them and
            comes first.
        torque_constant: Kt in N m/A, a scalar or shape (motor,).
        known: values of the known parameters in SI units, scalars or shape (motor,); effects left
            out are zero. Of a context node with a known part it is that part.
        speed_measured: true where speed is a signal; else ``w = Kt i`` (thesis, 4.1.1).
        load_varies: whether a load acts on the rotor that no term describes.

    Raises:
        ConfigurationError: an unknown name, no inductance, a term or a load of the rotor without
            its inertia, or a term that only a measured speed could tell apart.
    """

    context_nodes: tuple[str, ...]
    torque_constant: Any
    known: Mapping[str, Any] = field(default_factory=dict)
    speed_measured: bool = False
    load_varies: bool = False

    def __post_init__(self) -> None:
        unknown = [name for name in (*self.context_nodes, *self.known) if name not in TERMS]
        if unknown:
            raise ConfigurationError(
                f'no term named {brief(unknown[0])} in the white box; there are {", ".join(TERMS)}'
            )
        if self.context_nodes[:1] != (STORAGES[State.CURRENT],):
            raise ConfigurationError(
                f'context_nodes must begin with inductance, got {list(self.context_nodes)}: '
                'without L nothing tells how fast torque follows voltage'
            )
        if len(set(self.context_nodes)) != len(self.context_nodes):
            raise ConfigurationError(
                f'context_nodes names a parameter twice: {list(self.context_nodes)}'
            )
        still = [
            name
            for name in (*self.context_nodes, *self.known)
            if TERMS[name].state not in self.states
        ]
        if still:
            raise ConfigurationError(
                f'{still[0]} belongs to the rotor, which is a state only with its inertia among '
                'context_nodes: set speed_source: rotor, or measured with inertia among them'
            )
        if self.load_varies and not self.has_rotor:
            raise ConfigurationError('a load that varies needs the inertia among context_nodes')
        blind = [n for n in self.context_nodes if TERMS[n].needs_speed and not self.speed_measured]
        if blind:
            raise ConfigurationError(
                f'{blind[0]} cannot be told from resistance without measured speed: publish speed '
                'in '
                "motor/torque's velocity or remove it from context_nodes"
            )
        try:
            positive = (
                self.torque_constant > 0.0
            )  # a number, an array, or a tensor on whatever device
        except TypeError as error:
            raise ConfigurationError(
                'torque_constant must be a number or an array of shape (motor,), got '
                f'{self.torque_constant!r}: '
                'of several motors give numpy.array'
            ) from error
        if not (positive if isinstance(positive, bool) else bool(positive.all())):
            raise ConfigurationError(
                f'torque_constant must be positive, got {self.torque_constant}'
            )

    def to_dict(self) -> dict[str, Any]:
        """Describe the white box in plain values, for a checkpoint or another process."""
        description = {
            'context_nodes': list(self.context_nodes),
            'torque_constant': np.asarray(self.torque_constant, dtype=float).tolist(),
            'known': {
                name: np.asarray(value, dtype=float).tolist() for name, value in self.known.items()
            },
            'speed_measured': self.speed_measured,
        }
        # early releases knew none, and what is saved of the others stays as it was
        return description | ({'load_varies': True} if self.load_varies else {})

    @classmethod
    def from_dict(
        cls, description: Mapping[str, Any], convert: Callable[[Any], Any] = np.asarray
    ) -> MotorWhiteBox:
        """Build the white box of :meth:`to_dict`; ``convert`` makes arrays or tensors."""
        return cls(
            tuple(description['context_nodes']),
            convert(description['torque_constant']),
            {name: convert(value) for name, value in description['known'].items()},
            bool(description['speed_measured']),
            bool(description.get('load_varies', False)),
        )

    def of_motors(self, index: Any) -> MotorWhiteBox:
        """Return the white box of chosen motors, one per entry of ``index``, repeats allowed."""
        known_values = {name: _take(value, index) for name, value in self.known.items()}
        return replace(self, torque_constant=_take(self.torque_constant, index), known=known_values)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown parameters in the order of ``context_nodes``."""
        return tuple(TERMS[name].parameter for name in self.context_nodes)

    @cached_property
    def given(self) -> tuple[str, ...]:
        """Names of the terms whose values are known, or known in part."""
        return tuple(
            name for name in self.known if name not in self.context_nodes or TERMS[name].known_part
        )

    @cached_property
    def known_parts(self) -> Array:
        """What is known of every unknown parameter, shape (parameter,): 0 of nearly all."""
        parts = [self.known[n] if n in self.given else 0.0 for n in self.context_nodes]
        return np.array([float(np.ravel(part)[0]) for part in parts])

    def values(self, theta: Array) -> dict[str, float]:
        """Return the value of every term of one motor, known or unknown, by its name.

        Args:
            theta: shape (parameter,).
        """
        values = {name: float(value) for name, value in self.known.items()}
        values |= dict(zip(self.context_nodes, (theta + self.known_parts).tolist(), strict=True))
        return values

    @cached_property
    def codes(self) -> tuple[int, ...]:
        """Places in TERMS of the unknown terms without inductance, then of the known ones.

        Compiled code calls terms by these.
        """
        places = list(TERMS)
        return tuple(places.index(name) for name in (*self.context_nodes[1:], *self.given))

    @cached_property
    def states(self) -> tuple[State, ...]:
        """The states of this motor in order: those whose storage is a context node."""
        return tuple(
            state for state, name in sorted(STORAGES.items()) if name in self.context_nodes
        )

    @cached_property
    def has_rotor(self) -> bool:
        """Whether the speed is a state of its own, which nobody measures."""
        return State.SPEED in self.states

    @property
    def speed_follows(self) -> bool:
        """Whether the speed is Kt i: it is neither measured nor a state."""
        return not self.speed_measured and not self.has_rotor

    @property
    def effect_forms(self) -> dict[str, Form]:
        """Forms of the effects by the names of their coefficients."""
        return forms.EFFECTS if self.speed_follows else forms.SHARP_EFFECTS

    @cached_property
    def holds_current(self) -> bool:
        """Whether brushes may hold its current, beside a measured speed."""
        names = (*self.context_nodes, *self.given)
        is_alone = self.speed_measured and not self.has_rotor
        return is_alone and any(TERMS[name].holds_current for name in names)

    @property
    def speed_source(self) -> str:
        """Where the speed comes from: ``rotor``, ``measured`` or ``torque_constant``."""
        if self.has_rotor:
            return 'rotor'
        return 'measured' if self.speed_measured else 'torque_constant'

    @cached_property
    def _lined_up(self) -> dict[int, tuple[Balance, ...]]:
        return {}

    def balances(self, signal: Any) -> tuple[Balance, ...]:
        """Return every state's balance, with constants shaped for such a signal."""
        axes = getattr(signal, 'ndim', 0)
        balances = self._lined_up.get(axes)
        if balances is None:
            balances = self._lined_up[axes] = tuple(
                self._balance(state, signal) for state in self.states
            )
        return balances

    def _balance(self, state: State, signal: Any) -> Balance:
        places = tuple(
            place for place, name in enumerate(self.context_nodes) if _acts_on(state, name)
        )
        names = [name for name in self.given if _acts_on(state, name)]
        constants = [_spread(self.known[name], signal) for name in names]
        follows = self.speed_follows
        effects = self.effect_forms
        unknown_forms = [effects[self.context_nodes[place]] for place in places]
        known_forms = [effects[name] for name in names]

        def slope(form: Form, by: State) -> Callable[..., Any]:
            return form.total_slope if follows else form.partial[by]

        return Balance(
            storage=self.context_nodes.index(STORAGES[state]),
            places=places,
            unknown_effects=tuple(form.value for form in unknown_forms),
            unknown_slopes=tuple(
                tuple(slope(form, by) for form in unknown_forms) for by in self.states
            ),
            known_effects=tuple(zip(constants, (form.value for form in known_forms), strict=True)),
            known_slopes=tuple(
                tuple(zip(constants, (slope(form, by) for form in known_forms), strict=True))
                for by in self.states
            ),
            drive_form=forms.DRIVES[state],
            torque_constant=_spread(self.torque_constant, signal),
            speed_measured=self.speed_measured,
            following_speed=forms.following_speed if follows else None,
        )

    def drive(self, voltage_v: Any, state: Any, speed_rad_s: Any) -> Any:
        """Voltage less every known drop, in V."""
        balance = self.balances(state)[State.CURRENT]
        return balance.drive((state, speed_rad_s, balance.torque_constant, voltage_v))

    def basis(self, voltage_v: Any, state: Any, speed_rad_s: Any) -> list[Any]:
        """Values of every unknown effect of the current, in the order of the context nodes."""
        balance = self.balances(state)[State.CURRENT]
        return balance.basis((state, speed_rad_s, balance.torque_constant, voltage_v))

    def state(self, torque_nm: Array) -> Array:
        """Current in A from torque (thesis 4.3)."""
        torque_constant = _spread(self.torque_constant, torque_nm)
        current_a: Array = forms.current_of_torque(torque_nm, torque_constant)
        return current_a

    def output(self, state: Array) -> Array:
        """Torque in N m from current (thesis 4.3)."""
        torque_constant = _spread(self.torque_constant, state)
        torque_nm: Array = forms.torque_of_current(state, torque_constant)
        return torque_nm

    def speed(self, state: Any, measured_rad_s: Any) -> Any:
        """Speed in rad/s: the measured one, or that of the thesis, which follows the current."""
        if self.speed_measured:
            return measured_rad_s
        return forms.following_speed(state, _spread(self.torque_constant, state))


def _spread(constant: Any, like: Any) -> Any:
    """Line a constant of shape (motor,) up with a signal of shape (motor, ...)."""
    if isinstance(constant, float) or np.ndim(constant) == 0:
        return constant
    return constant.reshape((-1,) + (1,) * (like.ndim - 1))


def _take(constant: Any, index: Any) -> Any:
    return constant if np.ndim(constant) == 0 else constant[index]


def _acts_on(state: State, name: str) -> bool:
    return bool(TERMS[name].formula) and TERMS[name].state is state
