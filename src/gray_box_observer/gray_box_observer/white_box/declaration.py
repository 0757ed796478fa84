"""The motor, declared only here: its states, its signals, and one entry for every effect.

``V = L di/dt + R i + K_HS |w| i + Kb w + V_b sign(i)``, thesis equations 4.1, 4.2 and 4.4 with
``|w| i`` instead of ``w i``, so that hysteresis takes energy in all four quadrants, and a brush
drop beside them (docs/METHOD.md, The form).

A formula is text, in the names of :data:`SIGNALS` and :data:`CONSTANTS`; it may use operators,
numbers, ``abs`` and ``sign``. ``make physics`` differentiates the formulas and writes the forms
that numpy, torch and compiled code use. Parameters and documentation read this file itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from gray_box_observer.white_box.interface import Parameter


class State(IntEnum):
    """What a motor remembers, by its number along every axis of states."""

    CURRENT = 0


COMPILED = (State.CURRENT,)
"""The states that compiled code moves; a motor with further ones is left to numpy."""

SIGNALS = ('current', 'speed')
"""What effects are functions of, in A and rad/s: states first, in the order of their numbers."""

CONSTANTS = ('torque_constant',)
"""Constants of the motor that are always known."""

FOLLOWING_SPEED = 'torque_constant * current'
"""The speed where it is neither a state nor measured (thesis 4.1.1)."""

TORQUE = 'torque_constant * current'
"""The measured output, in N m (thesis 4.3)."""

DRIVES = {State.CURRENT: 'voltage'}
"""What drives every state: ``storage d state / dt = drive - sum of the effects``, in V."""


@dataclass(frozen=True, slots=True)
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
    """

    parameter: Parameter
    formula: str = ''
    state: State = State.CURRENT
    needs_speed: bool = False
    known_as: str = ''
    known_value: float = 0.0
    known_upper: float | None = None


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
        'current / (abs(current) + 0.02)',  # half of it is there at 0.02 A
        known_as='brush_drop',
        known_upper=1e3,
    ),
)

TERMS: dict[str, Term] = {term.parameter.name: term for term in _DECLARED}
"""Every term by the name of its coefficient; the storage of a state stands before its effects."""
