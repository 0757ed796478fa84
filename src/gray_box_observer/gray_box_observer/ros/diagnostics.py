"""Diagnostics of every motor in the shape operators know: level, one line of advice, key-value pairs.

As diagnostic_updater gives it: ``NODE: MOTOR``, the motor as hardware. OK: nothing to do. WARN: estimates come, and
something spoils them. ERROR: it will not mend by itself. STALE: nothing comes.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.data_sheet import contradiction
from gray_box_observer.intake import Intake
from gray_box_observer.observer import Observer
from gray_box_observer.predictor.alarm import REMEDY
from gray_box_observer.ros.inputs import Inputs
from gray_box_observer.ros.traffic import Traffic, TrafficMeter
from gray_box_observer.samples import Rejection

OVERLOAD = 0.9
"""Share of its time that a process may spend on messages; beyond, they queue up."""

REFUSED = 0.05
"""Share of refused messages that is worth a warning."""

Judgement = tuple[bytes, str]

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}


REJECTIONS = {
    Rejection.NON_FINITE: 'NaN or infinity: is the sensor connected?',
    Rejection.DUPLICATE: 'the same stamp twice: do two publishers share the topic?',
    Rejection.OUT_OF_ORDER: 'stamps that go back: do two publishers share the topic?',
    Rejection.NO_VOLTAGE: 'torque before any voltage: have both stamps of the same clock?',
    Rejection.NO_SPEED: 'torque without speed, which came at first: does the encoder run?',
    Rejection.ABSURD: 'beyond 1e9 in SI units: check field and scale',
    Rejection.MALFORMED: 'names and values differ in number, the field is missing, or the bytes are no such message',
}
"""What to look at, by the reason that most messages were refused for."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What there is to be told about.

    Attributes:
        node: fully qualified name.
        state: of the life cycle.
        observer, intake, inputs: of the node.
        meter: what it has measured since it began.
        traffic: what came in during the last period.
        checkpoint_failure: why the newest checkpoint could not be written; None where it could.
        checkpoint_age_s: time since one was taken; None where none was.
        now_ns: the node's clock.
        simulated: whether that is ``/clock``.
    """

    node: str
    state: str
    observer: Observer
    intake: Intake
    inputs: Inputs
    meter: TrafficMeter
    traffic: Traffic
    checkpoint_failure: str | None
    checkpoint_age_s: float | None
    now_ns: int
    simulated: bool


def status_of(motor: str, situation: Situation) -> DiagnosticStatus:
    """Describe one motor."""
    if situation.state != 'active':
        return idle_status(motor, situation.node, situation.state, values_of(motor, situation))
    return _status(motor, _judge(motor, situation), values_of(motor, situation))


def idle_status(motor: str, node: str, state: str, values: dict[str, str]) -> DiagnosticStatus:
    """Describe one motor of a node that does not listen.

    Args:
        motor: its name.
        node: fully qualified name of the node.
        state: of its life cycle.
        values: what can be told all the same.
    """
    verb = {'unconfigured': 'configure', 'inactive': 'activate'}.get(state)
    remedy = f'{verb} the node (ros2 lifecycle set {node} {verb})' if verb else 'start the node anew'
    return _status(motor, (DiagnosticStatus.STALE, f'{state}: {remedy}'), values)


def _status(motor: str, judgement: Judgement, values: dict[str, str]) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=judgement[0],
        name=f'gray_box_observer: {motor}',
        message=judgement[1],
        hardware_id=motor,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _judge(motor: str, now: Situation) -> Judgement:
    """Find the first thing that an operator has to know."""
    return (
        _nothing_yet(motor, now)
        or _failed_training(motor, now)
        or _nothing_new(motor, now)
        or _something_spoilt(motor, now)
        or _verdicts(motor, now)
    )


def _nothing_yet(motor: str, now: Situation) -> Judgement | None:
    """Why a motor has never been heard of."""
    pairing = now.observer.counts(motor)
    silent = [n for n in ('voltage', 'torque') if getattr(pairing, f'received_{n}') == 0]
    if not silent:
        return None
    trouble = now.inputs.trouble(n for n in silent if not now.intake.received[n])
    if trouble is not None:
        level = DiagnosticStatus.ERROR if trouble.broken else DiagnosticStatus.STALE
        return level, f'nothing received for this motor: {trouble.message}'
    if any(now.intake.rejected[n] for n in silent):
        return _refused(motor, now) or (DiagnosticStatus.STALE, 'no message so far could be read: see rejected')
    topics = ' and '.join(now.intake.signals[n].topic for n in silent)
    strangers = sorted({name for n in silent for name in now.intake.signals[n].unknown})
    remedy = f'; names there: {", ".join(strangers[:5])}; see the parameter motors' if strangers else ''
    return DiagnosticStatus.STALE, f'nothing received for this motor: is {topics} published with its name?{remedy}'


def _failed_training(motor: str, now: Situation) -> Judgement | None:
    """What stays true whether samples come or not."""
    seen = now.observer.motors.get(motor)
    if seen is None or seen.training is None or seen.training.failure is None:
        return None
    return DiagnosticStatus.ERROR, seen.training.failure


def _nothing_new(motor: str, now: Situation) -> Judgement | None:
    """Why no sample came of late, or too many were refused."""
    traffic = now.traffic.motors[motor]
    refused = _refused(motor, now)
    if refused is not None:
        return refused
    if traffic.used:
        return None
    silent = [name for name, count in traffic.received.items() if count == 0]
    if not silent:
        return DiagnosticStatus.STALE, 'no new sample: do voltage and torque have stamps of the same clock?'
    trouble = now.inputs.trouble(n for n in silent if not now.traffic.messages[n])
    if trouble is not None:
        level = DiagnosticStatus.ERROR if trouble.broken else DiagnosticStatus.STALE
        return level, f'no new sample: {trouble.message}'
    topics = [
        f'{now.intake.signals[n].topic} {"speaks of it no more" if now.traffic.messages[n] else "has fallen silent"}'
        for n in silent
    ]
    return DiagnosticStatus.STALE, f'no new sample: {" and ".join(topics)}: does its driver run?'


def _refused(motor: str, now: Situation) -> Judgement | None:
    """Why too many messages were refused of late, if they were."""
    traffic = now.traffic.motors[motor]
    count = traffic.rejected.total()
    if count <= REFUSED * (traffic.used + count):
        return None
    reason = traffic.rejected.most_common(1)[0][0]
    period = f'{max(1.0, now.traffic.period_s):.0f} s'
    return DiagnosticStatus.WARN, f'{count} messages refused in {period}: see rejected ({REJECTIONS[reason]})'


def _something_spoilt(motor: str, now: Situation) -> Judgement | None:
    """What makes estimates worse than they could be, or will be missed later."""
    observer = now.observer
    if observer.alarm(motor):
        changed = now.traffic.motors[motor].changes
        followed = f'; the motor was found changed ({changed} times) and is being followed' if changed else ''
        return DiagnosticStatus.WARN, REMEDY + followed
    undeclared = observer.motors[motor].delay.complaint(motor)
    if undeclared is not None:  # before the verdicts: it may be what spoils them
        return DiagnosticStatus.WARN, undeclared
    if now.traffic.busy > OVERLOAD:
        return (
            DiagnosticStatus.WARN,
            f'messages take {100 * now.traffic.busy:.0f} % of the time there is and queue up: send fewer, '
            'or start with predictor:=false or one observer a motor',
        )
    if now.checkpoint_failure is not None:
        return DiagnosticStatus.WARN, f'the checkpoint was not written: {now.checkpoint_failure}'
    if now.simulated and now.now_ns == 0:
        return DiagnosticStatus.WARN, 'use_sim_time is true, but nothing comes on /clock: publish it, or set it false'
    return None


def _verdicts(motor: str, now: Situation) -> Judgement:
    """What the estimates themselves say."""
    estimate = now.observer.motors[motor].estimate
    for verdict, advice in ADVICE.items():
        at = [j for j, given in enumerate(estimate.verdicts[0]) if given is verdict]
        if at:
            names = [f'{estimate.parameters[j].name} {estimate.bound_met(0, j)}'.rstrip() for j in at]
            return DiagnosticStatus.WARN, f'{", ".join(names)}: {advice}'
    doubt = contradiction(now.observer.configuration.motors[motor], estimate)
    if doubt is not None:
        return DiagnosticStatus.WARN, doubt
    changed = now.traffic.motors[motor].changes
    if estimate.identified(0):
        followed = ': the motor has changed and was followed' if changed else ''
        return DiagnosticStatus.OK, f'every parameter identified{followed}'
    if now.observer.frozen:
        return DiagnosticStatus.OK, 'frozen'
    return DiagnosticStatus.OK, 'converging: the motor has changed and is being followed' if changed else 'converging'


def values_of(motor: str, now: Situation) -> dict[str, str]:
    """Everything that is known of a motor, as text."""
    values = {**_counts(motor, now), **_balance(motor, now)}
    seen = now.observer.motors.get(motor)
    if seen is None:
        return values
    values.update(_estimates(seen.estimate))
    delay = seen.delay
    values['delay [s]'] = _text(delay.value_s)
    values['delay std [s]'] = _text(delay.std_s)
    values['delay applied [s]'] = f'{delay.applied_s:.6g}'
    values['delay verdict'] = delay.verdict.value
    values.update({name: str(count) for name, count in seen.counters.items()})
    alarm, training = seen.alarm, seen.training
    if alarm is not None:
        armed = 'raised' if alarm.raised else 'armed' if alarm.armed else 'learning the residual'
        values['residual alarm'] = armed
        values['residual std [N m]'] = _text(alarm.std_nm)
        values['alarms raised'] = str(alarm.count)
    skill = now.observer.skill(motor)
    if skill is not None and training is not None:
        values.update({name: _text(value) for name, value in skill.to_dict().items()})
        values['training jobs done'] = str(training.jobs_done)
        values['learnt residual, rms [N m]'] = f'{training.residual_nm:.3g}'
        values['training jobs late'] = str(training.jobs_late)
    return values


def _counts(motor: str, now: Situation) -> dict[str, str]:
    pairing, rhythm = now.observer.counts(motor), now.meter.rhythms.get(motor)
    rejected: Counter[str] = Counter({reason.value: n for reason, n in pairing.rejected.items()})
    for counts in now.intake.rejected.values():
        rejected.update({reason.value: n for reason, n in counts.items()})
    newest_ns = now.meter.newest_ns.get(motor)
    return {
        'samples used': str(pairing.used),
        'samples waiting for voltage': str(pairing.waiting),
        'voltage messages': str(pairing.received_voltage),
        'torque messages': str(pairing.received_torque),
        'signal restarts': str(pairing.restarts),
        'samples with voltage held': str(pairing.held),
        'samples missing': str(0 if rhythm is None else rhythm.missing),
        'pauses': str(0 if rhythm is None else max(0, rhythm.pauses)),
        'sample rate [1/s]': f'{now.traffic.motors[motor].used / now.traffic.period_s:.1f}',
        'age of newest sample [s]': _text(None if newest_ns is None else (now.now_ns - newest_ns) * 1e-9),
        'rejected': ', '.join(f'{reason}: {n}' for reason, n in sorted(rejected.items())) or 'none',
        'changes since last identified': str(now.traffic.motors[motor].changes),
        'CPU of this process [%]': f'{100 * now.traffic.cpu:.1f}',
        'time spent on messages [%]': f'{100 * now.traffic.busy:.1f}',
        'age of checkpoint [s]': _text(now.checkpoint_age_s),
    }


def _balance(motor: str, now: Situation) -> dict[str, str]:
    """Where every message went: nothing may be lost without a trace (docs/FAULTS.md)."""
    pairing, intake = now.observer.counts(motor), now.intake
    values = {'voltages taken': str(pairing.taken_voltage)}
    for name in ('voltage', 'torque'):
        values[f'{name} topic: messages'] = str(intake.received[name])
        values[f'{name} topic: unreadable'] = str(intake.rejected[name].total())
        values[f'{name} topic: of no motor here'] = str(intake.others[name])
        refused = sorted((reason.value, n) for reason, n in pairing.refused[name].items())
        values[f'{name} messages refused'] = ', '.join(f'{reason}: {n}' for reason, n in refused) or 'none'
    return values


def _estimates(estimate: Estimate) -> dict[str, str]:
    values = {}
    for j, parameter in enumerate(estimate.parameters):
        value, std = estimate.value[0, j], estimate.std[0, j]
        values[f'{parameter.name} [{parameter.unit}]'] = f'{value:.6g} +- {std:.2g}'
        values[f'{parameter.name} verdict'] = f'{estimate.verdicts[0][j].value} {estimate.bound_met(0, j)}'.rstrip()
    return values


def _text(value: float | int | None) -> str:
    return 'unknown' if value is None or math.isnan(value) else f'{value:.4g}'
