"""What the verdicts of a motor ask its user to do, as one line."""

from __future__ import annotations

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.rotor.window_fit import RESOLVED, is_resolved
from gray_box_observer.observer.motor_view import MOST_JUDGED, MotorView
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import INTERVAL
from gray_box_observer.settings.motor_configuration import is_mechanical

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}
"""By verdict, what matters most first."""

SAMPLE_FASTER = f'L/R is shorter than {RESOLVED:g} samples: sample faster'

FEW_SAMPLES_ADVICE = f'{SAMPLE_FASTER}, or set stamps_exact where stamps are those of the driver'

LOAD_ADVICE = 'a load that varies hides it, whatever the voltage does: publish the speed'
"""Of what acts on the shaft beside a load that varies."""


def verdict_advice(motor: MotorView) -> str | None:
    """Return what to do about the verdicts of a motor; None where nothing is asked for.

    More voltage does not help an inductance behind a filter of the current, which is left out, or
    one of which few samples tell. Nor does it help a rotor whose load varies.
    """
    estimate = motor.estimate
    names = [parameter.name for parameter in estimate.parameters]
    for verdict, advice in ADVICE.items():
        at = [j for j, own_verdict in enumerate(estimate.verdicts[0]) if own_verdict is verdict]
        shaft_advice = []
        if verdict is Verdict.UNEXCITED:
            if motor.filter_remedy is not None:
                at = [j for j in at if names[j] != 'inductance']
            if motor.white_box.load_varies:
                on_shaft = [j for j in at if is_mechanical(names[j])]
                at = [j for j in at if j not in on_shaft]
                shaft_advice = [_advice(motor, on_shaft, LOAD_ADVICE)] if on_shaft else []
            if [names[j] for j in at] == ['inductance'] and _is_unresolved(motor):
                faster = SAMPLE_FASTER if motor.white_box.load_varies else FEW_SAMPLES_ADVICE
                return '; '.join([f'inductance: {faster}', *shaft_advice])
        sentences = [*([_advice(motor, at, advice)] if at else []), *shaft_advice]
        if sentences:
            return '; '.join(sentences)
    return None


def _advice(motor: MotorView, places: list[int], advice: str) -> str:
    """Say what to do about some parameters.

    Args:
        motor: its estimate, too.
        places: of the parameters.
        advice: of all of them.
    """
    estimate = motor.estimate
    names = [f'{estimate.parameters[j].name} {estimate.bound_met(0, j)}'.rstrip() for j in places]
    return f'{", ".join(names)}: {advice}'


def _is_unresolved(motor: MotorView) -> bool:
    """Tell whether few samples come in L/R; of exact stamps they tell it, but beside a load."""
    if motor.configuration.values['stamps_exact'] and not motor.white_box.load_varies:
        return False
    interval_s = usual_interval(motor.newest(MOST_JUDGED)[INTERVAL])
    return not is_resolved(motor.white_box, interval_s, motor.estimate.value[0])
