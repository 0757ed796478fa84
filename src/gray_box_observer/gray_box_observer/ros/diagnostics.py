"""Diagnostics of every motor in the shape operators know: level, one line of advice, key-value pairs."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.intake import Intake
from gray_box_observer.observer import Observer
from gray_box_observer.predictor.alarm import REMEDY


@dataclass(frozen=True, slots=True)
class Traffic:
    """What came in during the last period.

    Attributes:
        period_s: length of the period.
        used: samples learnt in it, by motor.
        rejected: messages refused in it, by motor.
    """

    period_s: float
    used: dict[str, int]
    rejected: dict[str, int]


def status_of(motor: str, observer: Observer, intake: Intake, traffic: Traffic, active: bool) -> DiagnosticStatus:
    """Describe one motor."""
    values = _values(motor, observer, intake, traffic)
    level, message = _judge(motor, observer, intake, traffic, active)
    return DiagnosticStatus(
        level=level,
        name=f'gray_box_observer: {motor}',
        message=message,
        hardware_id=motor,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _judge(motor: str, observer: Observer, intake: Intake, traffic: Traffic, active: bool) -> tuple[bytes, str]:
    if not active:
        return (
            DiagnosticStatus.STALE,
            'inactive: activate the node (ros2 lifecycle set /gray_box_observer activate)',
        )
    pairing = observer.pairing[motor]
    silent = [n for n in ('voltage', 'torque') if getattr(pairing, f'received_{n}') == 0]
    if silent:
        topics = ' and '.join(intake.signals[n].topic for n in silent)
        return DiagnosticStatus.STALE, f'nothing received for this motor: is {topics} published with its name?'
    seen = observer.motors.get(motor)
    if seen is not None and seen.predictor is not None and seen.predictor.failure is not None:
        return DiagnosticStatus.ERROR, seen.predictor.failure  # stays true whether samples come or not
    refused = traffic.rejected[motor] > 0.05 * (traffic.used[motor] + traffic.rejected[motor])
    complaint = f'{traffic.rejected[motor]} messages refused in {traffic.period_s:.0f} s: see rejected'
    if traffic.used[motor] == 0:
        if refused:
            return DiagnosticStatus.WARN, complaint
        return DiagnosticStatus.STALE, 'no new sample: have voltage and torque stopped, or do their stamps differ?'
    if refused:
        return DiagnosticStatus.WARN, complaint
    if observer.alarm(motor):
        return DiagnosticStatus.WARN, REMEDY
    undeclared = observer.motors[motor].delay.estimate.complaint(motor)
    if undeclared is not None:  # before the verdicts: it may be what spoils them
        return DiagnosticStatus.WARN, undeclared
    estimate = observer.motors[motor].context_nodes.estimate()
    for verdict, advice in ADVICE.items():
        at = [j for j, given in enumerate(estimate.verdicts[0]) if given is verdict]
        if at:
            names = [f'{estimate.parameters[j].name} {estimate.bound_met(0, j)}'.rstrip() for j in at]
            return DiagnosticStatus.WARN, f'{", ".join(names)}: {advice}'
    if estimate.identified(0):
        return DiagnosticStatus.OK, 'every parameter identified'
    return DiagnosticStatus.OK, 'frozen' if observer.frozen else 'converging'


ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}


def _values(motor: str, observer: Observer, intake: Intake, traffic: Traffic) -> dict[str, str]:
    pairing = observer.pairing[motor]
    rejected: Counter[str] = Counter({reason.value: n for reason, n in pairing.rejected.items()})
    for counts in intake.rejected.values():
        rejected.update({reason.value: n for reason, n in counts.items()})
    values = {
        'samples used': str(pairing.used),
        'samples waiting for voltage': str(pairing.waiting),
        'voltage messages': str(pairing.received_voltage),
        'torque messages': str(pairing.received_torque),
        'signal restarts': str(pairing.restarts),
        'samples with voltage held': str(pairing.held),
        'sample rate [1/s]': f'{traffic.used[motor] / traffic.period_s:.1f}',
        'rejected': ', '.join(f'{reason}: {n}' for reason, n in sorted(rejected.items())) or 'none',
    }
    seen = observer.motors.get(motor)
    if seen is None:
        return values
    estimate = seen.context_nodes.estimate()
    for j, parameter in enumerate(estimate.parameters):
        value, std = estimate.value[0, j], estimate.std[0, j]
        values[f'{parameter.name} [{parameter.unit}]'] = f'{value:.6g} +- {std:.2g}'
        values[f'{parameter.name} verdict'] = f'{estimate.verdicts[0][j].value} {estimate.bound_met(0, j)}'.rstrip()
    delay = seen.delay.estimate
    values['delay [s]'] = _text(delay.value_s)
    values['delay std [s]'] = _text(delay.std_s)
    values['delay applied [s]'] = f'{delay.applied_s:.6g}'
    values['delay verdict'] = delay.verdict.value
    values.update({name: str(count) for name, count in seen.context_nodes.counters().items()})
    if seen.alarm is not None:
        armed = 'raised' if observer.alarm(motor) else 'armed' if seen.alarm.armed[0] else 'learning the residual'
        values['residual alarm'] = armed
        values['residual std [N m]'] = _text(float(seen.alarm.spread[0]))
        values['alarms raised'] = str(seen.alarm.count[0])
    skill = observer.skill(motor)
    if skill is not None and seen.predictor is not None:
        values.update({name: _text(value) for name, value in skill.to_dict().items()})
        values['training jobs done'] = str(seen.predictor.jobs_done)
        values['learnt residual, rms [N m]'] = f'{seen.predictor.residual.size_nm[0]:.3g}'
        values['training jobs late'] = str(seen.predictor.jobs_late)
    return values


def _text(value: float | int | None) -> str:
    return 'unknown' if value is None or math.isnan(value) else f'{value:.4g}'
