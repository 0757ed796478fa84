"""The motor, declared only here: its states, its signals, and one entry for every effect.

``V = L di/dt + R i + K_HS |w| i + Kb w + V_b sign(i) + V_0 + V_d sign(V)``, thesis equations 4.1,
4.2 and 4.4 with ``|w| i`` instead of ``w i``, so that hysteresis takes energy in all four
quadrants. A brush drop, an offset and a dead zone stand beside them (docs/METHOD.md, The form). A
motor whose inertia is a context node has a second balance,
``Kt i = J dw/dt + B w + T_c sign(w) + C |w| w + T_load`` (docs/METHOD.md, The whole motor).

A formula is text, in the names of :data:`SIGNALS` and :data:`CONSTANTS`, and ``voltage``, which is
held over an interval. It may use operators, numbers, ``abs`` and ``sign``. ``make physics``
differentiates the formulas and writes the forms that numpy, torch and compiled code use. Parameters
and documentation read this file itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from gray_box_observer.white_box.interface import Parameter


class State(IntEnum):
    """What a motor remembers, by its number along every axis of states."""

    CURRENT = 0
    SPEED = 1


COMPILED = (State.CURRENT,)
"""The states that compiled blocks move; those of a motor with a rotor have compiled code of their
own."""

SIGNALS = ('current', 'speed')
"""What effects are functions of, in A and rad/s: states first, in the order of their numbers."""

CONSTANTS = ('torque_constant',)
"""Constants of the motor that are always known."""

FOLLOWING_SPEED = 'torque_constant * current'
"""The speed where it is neither a state nor measured (thesis 4.1.1)."""

TORQUE = 'torque_constant * current'
"""The measured output, in N m (thesis 4.3)."""

DRIVES = {State.CURRENT: 'voltage', State.SPEED: 'torque_constant * current'}
"""What drives every state: ``storage d state / dt = drive - sum of the effects``, in V and N m."""


@dataclass(frozen=True)
class Term:
    """One effect: coefficient times ``formula``, or the storage of a state.

    Attributes:
        parameter: the coefficient.
        formula: of the signals; empty for a storage.
        state: in whose balance it is.
        needs_speed: whether the coefficient can be told from the others only where speed is
            measured.
        known_as: the parameter of a motor that holds the value where it is known; empty:
            ``known.NAME``.
        known_value: what that is unless it is stated; 0 leaves the effect out.
        known_upper: the largest that it may be; ``None``: as for the coefficient.
        holds_current: whether it bends so sharply where the current changes its sign that it may
            hold the current there.
        known_part: what is known of the coefficient though it is among the context nodes; the
            unknown rest is positive. Negative for a coefficient that may have either sign. Of a
            torque it is that of so many amperes.
        sharp_formula: what stands for the formula where the speed is a signal or a state, and steps
            resolve it; empty: the same.
    """

    parameter: Parameter
    formula: str = ''
    state: State = State.CURRENT
    needs_speed: bool = False
    known_as: str = ''
    known_value: float = 0.0
    known_upper: float | None = None
    known_part: float = 0.0
    holds_current: bool = False
    sharp_formula: str = ''

    @property
    def whole_motor_formula(self) -> str:
        """The formula where the speed is a state."""
        return self.sharp_formula or self.formula

    @property
    def has_either_sign(self) -> bool:
        """Whether the coefficient may be negative."""
        return self.known_part < 0.0

    def known_part_of(self, torque_constant: float) -> float:
        """Return what is known of the coefficient of a motor, in its unit.

        Args:
            torque_constant: Kt of the motor, in N m/A.
        """
        return self.known_part * (torque_constant if self.state is State.SPEED else 1.0)


_DECLARED = (
    Term(
        Parameter('inductance', 'H', 1.5, 1e-7, 1e2, 'Armature inductance L, coefficient of di/dt.')
    ),
    Term(
        Parameter(
            'resistance',
            'ohm',
            3.0,
            1e-4,
            1e4,
            'Armature resistance R, coefficient of i.',
            heats=True,
        ),
        'current',
    ),
    Term(
        Parameter(
            'hysteresis',
            'V s/(rad A)',
            1.0,
            1e-8,
            1e6,
            'Magnetic hysteresis constant K_HS, coefficient of |w| i.',
        ),
        'abs(speed) * current',
    ),
    Term(
        Parameter(
            'back_emf_constant',
            'V s/rad',
            0.01,
            1e-7,
            1e2,
            'Back-EMF constant Kb, coefficient of w.',
        ),
        'speed',
        needs_speed=True,
        known_as='back_emf_constant',
        known_value=0.01,
        known_upper=1e6,
    ),
    Term(
        Parameter(
            'brush_drop',
            'V',
            0.2,
            1e-4,
            1e1,
            'Voltage drop V_b of the brushes, coefficient of sign(i).',
        ),
        # sign(i) to 1 % beyond 0.1 A, and half of it at 0.006 A: finite in slope
        'current * (0.01 + abs(current)) / (0.0001 + 0.01 * abs(current) + current * current)',
        known_as='brush_drop',
        known_upper=1e3,
        holds_current=True,
        # a twentieth of that, for small motors draw tenths of an ampere
        sharp_formula='current * (0.0005 + abs(current)) / '
        '(2.5e-7 + 0.0005 * abs(current) + current * current)',
    ),
    Term(
        Parameter(
            'voltage_offset',
            'V',
            5.0,
            1e-2,
            1e1,
            'Voltage V_0 that is missing whatever the current: by so much the voltage reads too '
            'high, or the current too low by V_0 / R.',
        ),
        '1',
        known_part=-5.0,
    ),
    Term(
        Parameter(
            'dead_zone',
            'V',
            0.5,
            1e-3,
            1e2,
            'Voltage V_d that the driver takes off its command, coefficient of sign(V).',
        ),
        # sign(V) to 1 % beyond 0.1 V: a command of next to nothing is not turned round
        'voltage * (0.01 + abs(voltage)) / (0.0001 + 0.01 * abs(voltage) + voltage * voltage)',
    ),
    Term(
        Parameter(
            'inertia', 'kg m2', 1e-5, 1e-12, 1e4, 'Inertia J of the rotor, coefficient of dw/dt.'
        ),
        state=State.SPEED,
    ),
    Term(
        Parameter(
            'viscous_friction',
            'N m s/rad',
            1e-5,
            1e-12,
            1e4,
            'Viscous friction B, coefficient of w.',
        ),
        'speed',
        State.SPEED,
    ),
    Term(
        Parameter(
            'coulomb_friction',
            'N m',
            1e-3,
            1e-10,
            1e4,
            'Dry friction T_c, coefficient of sign(w).',
        ),
        # sign(w) to 1 % beyond 0.3 rad/s and finite in slope, so that a rotor at rest creeps and
        # does not chatter
        'speed * (0.03 + abs(speed)) / (0.0009 + 0.03 * abs(speed) + speed * speed)',
        State.SPEED,
    ),
    Term(
        Parameter(
            'quadratic_friction',
            'N m s2/rad2',
            1e-7,
            1e-15,
            1e2,
            'Quadratic friction C of a fan or a pump, coefficient of |w| w.',
        ),
        'abs(speed) * speed',
        State.SPEED,
    ),
    Term(
        Parameter(
            'load_torque', 'N m', 1.0, 1e-10, 1e6, 'Load torque T_load, against positive speed.'
        ),
        '1',
        State.SPEED,
        known_part=-100.0,
    ),
)

TERMS: dict[str, Term] = {term.parameter.name: term for term in _DECLARED}
"""Every term by the name of its coefficient; the storage of a state stands before its effects."""
