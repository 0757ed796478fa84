"""What the verdicts of a motor ask its user to do, as one line."""

from __future__ import annotations

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.rotor.window_fit import RESOLVED, is_resolved
from gray_box_observer.observer.motor_view import MOST_JUDGED, MotorView
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import INTERVAL

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}
"""By verdict, what matters most first."""

FEW_SAMPLES_ADVICE = (
    'L/R is shorter than {samples:g} samples: sample faster, or set stamps_exact where stamps are '
    'those of the driver'
)


def verdict_advice(motor: MotorView) -> str | None:
    """Return what to do about the verdicts of a motor; None where nothing is asked for.

    More voltage does not help an inductance behind a filter of the current, which is left out, or
    one of which few samples tell.
    """
    estimate = motor.estimate
    names = [parameter.name for parameter in estimate.parameters]
    for verdict, advice in ADVICE.items():
        at = [j for j, own_verdict in enumerate(estimate.verdicts[0]) if own_verdict is verdict]
        if motor.filter_remedy is not None and verdict is Verdict.UNEXCITED:
            at = [j for j in at if names[j] != 'inductance']
        is_inductance = [names[j] for j in at] == ['inductance']
        if verdict is Verdict.UNEXCITED and is_inductance and _is_unresolved(motor):
            return f'inductance: {FEW_SAMPLES_ADVICE.format(samples=RESOLVED)}'
        if at:
            own_names = [f'{names[j]} {estimate.bound_met(0, j)}'.rstrip() for j in at]
            return f'{", ".join(own_names)}: {advice}'
    return None


def _is_unresolved(motor: MotorView) -> bool:
    """Tell whether few samples come in L/R, and their stamps need not be exact."""
    if motor.configuration.values['stamps_exact']:
        return False
    interval_s = usual_interval(motor.newest(MOST_JUDGED)[INTERVAL])
    return not is_resolved(motor.white_box, interval_s, motor.estimate.value[0])
