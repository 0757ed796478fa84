"""What the verdicts of a motor ask its user to do, as one line."""

from __future__ import annotations

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.rotor.window_fit import RESOLVED, is_resolved
from gray_box_observer.observer.motor_view import MOST_JUDGED, MotorView
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import INTERVAL
from gray_box_observer.white_box.declaration import TERMS, State

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}
"""By verdict, what matters most first."""

SAMPLE_FASTER = f'L/R is shorter than {RESOLVED:g} samples: sample faster'

FEW_SAMPLES_ADVICE = f'{SAMPLE_FASTER}, or set stamps_exact where stamps are those of the driver'

LOAD_ADVICE = 'a load that varies hides it, whatever the voltage does: publish the speed'
"""Of what acts on the shaft beside a load that varies."""


def acts_on_shaft(parameter: str) -> bool:
    """Tell whether a parameter is one of the rotor."""
    term = TERMS.get(parameter)
    return term is not None and term.state is State.SPEED


def verdict_advice(motor: MotorView) -> str | None:
    """Return what to do about the verdicts of a motor; None where nothing is asked for.

    More voltage does not help an inductance behind a filter of the current, which is left out, or
    one of which few samples tell. Nor does it help a rotor whose load varies.
    """
    estimate = motor.estimate
    names = [parameter.name for parameter in estimate.parameters]
    for verdict, advice in ADVICE.items():
        at = [j for j, own_verdict in enumerate(estimate.verdicts[0]) if own_verdict is verdict]
        if motor.filter_remedy is not None and verdict is Verdict.UNEXCITED:
            at = [j for j in at if names[j] != 'inductance']
        if verdict is Verdict.UNEXCITED and motor.white_box.load_varies:
            other_places = [j for j in at if not acts_on_shaft(names[j])]
            advice = advice if other_places else LOAD_ADVICE
            at = other_places or at
        is_inductance = [names[j] for j in at] == ['inductance']
        if verdict is Verdict.UNEXCITED and is_inductance and _is_unresolved(motor):
            is_exact = motor.configuration.values['stamps_exact'] or motor.white_box.load_varies
            return f'inductance: {SAMPLE_FASTER if is_exact else FEW_SAMPLES_ADVICE}'
        if at:
            own_names = [f'{names[j]} {estimate.bound_met(0, j)}'.rstrip() for j in at]
            return f'{", ".join(own_names)}: {advice}'
    return None


def _is_unresolved(motor: MotorView) -> bool:
    """Tell whether few samples come in L/R; of exact stamps they tell it, but beside a load."""
    if motor.configuration.values['stamps_exact'] and not motor.white_box.load_varies:
        return False
    interval_s = usual_interval(motor.newest(MOST_JUDGED)[INTERVAL])
    return not is_resolved(motor.white_box, interval_s, motor.estimate.value[0])
