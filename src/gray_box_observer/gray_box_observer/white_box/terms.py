"""The terms of the voltage balance: one entry a physical effect, declared here and nowhere else.

``V = L di/dt + R i + K_HS |w| i + Kb w + V_b sign(i)``, thesis equations 4.1, 4.2 and 4.4 with ``|w| i`` instead
of ``w i``, so that hysteresis takes energy in all four quadrants, and a brush drop beside them
(docs/METHOD.md, The form).
Functions are elementwise and use operators only, so they take numpy arrays and torch tensors alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gray_box_observer.white_box.base import Parameter

BRUSH_KNEE_A = 0.02
"""Current at which the brush drop has reached half of its value: ``i / (|i| + knee)`` stands for ``sign(i)``."""

Function = Callable[[Any, Any], Any]


@dataclass(frozen=True, slots=True)
class Term:
    """One effect: coefficient times ``value(current, speed)``.

    Attributes:
        parameter: the coefficient.
        value: basis function of current in A and speed in rad/s; ``None`` for the derivative term.
        by_current: its partial derivative by the current; a plain number where it is constant.
        by_speed: its partial derivative by the speed; likewise.
        needs_speed: whether the coefficient can be told from the others only where speed is measured.
    """

    parameter: Parameter
    value: Function | None
    by_current: Function | None
    by_speed: Function | None
    needs_speed: bool = False


def _sign(x: Any) -> Any:
    return x / (abs(x) + 1e-300)


INDUCTANCE = Term(
    Parameter('inductance', 'H', 1.5, 1e-7, 1e2, 'Armature inductance L, coefficient of di/dt.'),
    None,
    None,
    None,
)
RESISTANCE = Term(
    Parameter('resistance', 'ohm', 3.0, 1e-4, 1e4, 'Armature resistance R, coefficient of i.', heats=True),
    value=lambda i, w: i,
    by_current=lambda i, w: 1.0,
    by_speed=lambda i, w: 0.0,
)
HYSTERESIS = Term(
    Parameter(
        'hysteresis',
        'V s/(rad A)',
        1.0,
        1e-8,
        1e6,
        'Magnetic hysteresis constant K_HS, coefficient of |w| i.',
    ),
    value=lambda i, w: abs(w) * i,
    by_current=lambda i, w: abs(w),
    by_speed=lambda i, w: _sign(w) * i,
)
BACK_EMF = Term(
    Parameter('back_emf_constant', 'V s/rad', 0.01, 1e-7, 1e2, 'Back-EMF constant Kb, coefficient of w.'),
    value=lambda i, w: w,
    by_current=lambda i, w: 0.0,
    by_speed=lambda i, w: 1.0,
    needs_speed=True,
)
BRUSH_DROP = Term(
    Parameter('brush_drop', 'V', 0.2, 1e-4, 1e1, 'Voltage drop V_b of the brushes, coefficient of sign(i).'),
    value=lambda i, w: i / (abs(i) + BRUSH_KNEE_A),
    by_current=lambda i, w: BRUSH_KNEE_A / (abs(i) + BRUSH_KNEE_A) ** 2,
    by_speed=lambda i, w: 0.0,
)

TERMS: dict[str, Term] = {
    term.parameter.name: term for term in (INDUCTANCE, RESISTANCE, HYSTERESIS, BACK_EMF, BRUSH_DROP)
}
"""Every term by the name of its coefficient, the derivative term first."""
