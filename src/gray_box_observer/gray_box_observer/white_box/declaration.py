"""The motor, declared here and nowhere else: its states, its signals, and one entry for every effect.

``V = L di/dt + R i + K_HS |w| i + Kb w + V_b sign(i)``, thesis equations 4.1, 4.2 and 4.4 with ``|w| i`` instead
of ``w i``, so that hysteresis takes energy in all four quadrants, and a brush drop beside them
(docs/METHOD.md, The form).

A formula is text, in the names of :data:`SIGNALS` and :data:`CONSTANTS`; it may use operators, numbers, ``abs`` and
``sign``. ``make physics`` differentiates the formulas and writes the forms that numpy, torch and compiled code use.
Parameters and documentation read this file itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from gray_box_observer.white_box.base import Parameter


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
class KnownValue:
    """Where the value of a parameter stands that is known instead of identified.

    Attributes:
        parameter: its name among the parameters of a motor.
        default: the value where nothing is said; 0 leaves the effect out.
        upper: the largest value.
    """

    parameter: str
    default: float
    upper: float


@dataclass(frozen=True, slots=True)
class Term:
    """One effect: coefficient times ``formula``, or the storage of a state, coefficient of its derivative.

    Attributes:
        parameter: the coefficient.
        formula: of the signals; empty for a storage.
        state: in whose balance it is.
        needs_speed: whether the coefficient can be told from the others only where speed is measured.
        stated: where a known value stands; ``None``: at ``known.NAME``, 0 unless stated.
    """

    parameter: Parameter
    formula: str = ''
    state: State = State.CURRENT
    needs_speed: bool = False
    stated: KnownValue | None = None

    @property
    def known(self) -> KnownValue:
        """Where its value stands where it is known instead of identified."""
        return self.stated or KnownValue(f'known.{self.parameter.name}', 0.0, self.parameter.upper)


_DECLARED = (
    Term(Parameter('inductance', 'H', 1.5, 1e-7, 1e2, 'Armature inductance L, coefficient of di/dt.')),
    Term(
        Parameter('resistance', 'ohm', 3.0, 1e-4, 1e4, 'Armature resistance R, coefficient of i.', heats=True),
        'current',
    ),
    Term(
        Parameter(
            'hysteresis', 'V s/(rad A)', 1.0, 1e-8, 1e6, 'Magnetic hysteresis constant K_HS, coefficient of |w| i.'
        ),
        'abs(speed) * current',
    ),
    Term(
        Parameter('back_emf_constant', 'V s/rad', 0.01, 1e-7, 1e2, 'Back-EMF constant Kb, coefficient of w.'),
        'speed',
        needs_speed=True,
        stated=KnownValue('back_emf_constant', 0.01, 1e6),
    ),
    Term(
        Parameter('brush_drop', 'V', 0.2, 1e-4, 1e1, 'Voltage drop V_b of the brushes, coefficient of sign(i).'),
        'current / (abs(current) + 0.02)',  # half of it is there at 0.02 A
        stated=KnownValue('brush_drop', 0.0, 1e3),
    ),
)

TERMS: dict[str, Term] = {term.parameter.name: term for term in _DECLARED}
"""Every term by the name of its coefficient; the storage of a state stands before its effects."""
