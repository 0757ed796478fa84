"""What the verdicts of a motor ask its user to do, as one line."""

from __future__ import annotations

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.observer.motor_view import MotorView

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}
"""By verdict, what matters most first."""


def verdict_advice(motor: MotorView) -> str | None:
    """Return what to do about the verdicts of a motor; None where nothing is asked for.

    An inductance behind a filter of the current is left out: more voltage does not help.
    """
    estimate = motor.estimate
    names = [parameter.name for parameter in estimate.parameters]
    for verdict, advice in ADVICE.items():
        at = [j for j, own_verdict in enumerate(estimate.verdicts[0]) if own_verdict is verdict]
        if motor.filter_remedy is not None and verdict is Verdict.UNEXCITED:
            at = [j for j in at if names[j] != 'inductance']
        if at:
            own_names = [f'{names[j]} {estimate.bound_met(0, j)}'.rstrip() for j in at]
            return f'{", ".join(own_names)}: {advice}'
    return None
