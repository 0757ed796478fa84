"""Diagnostics of every motor as operators know them: level, one line of advice, key values.

As diagnostic_updater gives it: ``NODE: MOTOR``, the motor as hardware, both with their namespace.
OK: nothing to do.
WARN: estimates come, and something spoils them. ERROR: it will not mend by itself. STALE: nothing
comes.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.data_sheet import contradiction
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.motor_view import ALARM_REMEDY
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.verdict_advice import verdict_advice
from gray_box_observer.ros.observer.diagnostic_values import values_of
from gray_box_observer.ros.observer.topic_inputs import Inputs
from gray_box_observer.ros.observer.traffic import Traffic, TrafficMeter
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.samples import Rejection

OVERLOAD = 0.9
"""Share of its time that a process may spend on messages; beyond, they queue up."""

REFUSED = 0.05
"""Share of refused messages that is worth a warning."""

Judgement = tuple[bytes, str]

NAMESAKE = (
    'another node is called {} too: what both publish is mixed up; end one, or give it a name, -r '
    '__node:=NAME'
)
"""What is wrong where somebody has started a second observer of the same name."""

DOUBTS = (
    'units_of_current',
    'units_of_voltage',
    'units_of_time',
    'units_of_speed',
    'angle_for_speed',
    'speed_sign',
    'voltage_sign',
    'torque_sign',
    'data_sheet',
)
"""Suspects that say more than a bound that is met."""

REJECTIONS = {
    Rejection.NON_FINITE: 'NaN or infinity: is the sensor connected?',
    Rejection.DUPLICATE: 'the same stamp twice: do two publishers share the topic?',
    Rejection.OUT_OF_ORDER: 'stamps that go back: do two publishers share the topic?',
    Rejection.NO_VOLTAGE: 'torque without voltage: does its driver pause, and have both stamps of '
    'the same clock?',
    Rejection.NO_SPEED: 'torque without speed, which came at first or is needed: does the encoder '
    'run?',
    Rejection.ABSURD: 'beyond 1e9 in SI units: check field and scale',
    Rejection.OVERSIZED: 'larger than max_message_mb: who sends it, or raise that parameter',
    Rejection.STALE_INPUT: 'an input of the expression is silent: does its driver run?',
    Rejection.STOPPED: 'the observer of this motor has stopped: see the log, then call ~/reset',
    Rejection.MALFORMED: 'names and values differ in number, the array is too short, or the bytes '
    'are no such message',
}
"""What to look at, by the reason that most messages were refused for."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What there is to be told about.

    Attributes:
        node: fully qualified name.
        state: of the life cycle.
        observer, message_input, inputs: of the node.
        meter: what it has measured since it began.
        traffic: what came in during the last period.
        checkpoint_failure: why the newest checkpoint could not be written; None where it could.
        checkpoint_age_s: time since one was taken; None where none was.
        now_ns: the node's clock.
        is_simulated: whether that is ``/clock``.
        has_namesake: whether another node has the same name.
    """

    node: str
    state: str
    observer: Observer
    message_input: MessageInput
    inputs: Inputs
    meter: TrafficMeter
    traffic: Traffic
    checkpoint_failure: str | None
    checkpoint_age_s: float | None
    now_ns: int
    is_simulated: bool
    has_namesake: bool


def status_of(motor: str, situation: Situation) -> DiagnosticStatus:
    """Describe one motor."""
    view = situation.observer.motors.get(motor)
    assumption_texts = {} if view is None else view.assumptions
    values = values_of(motor, situation, assumption_texts)
    if situation.state != 'active':
        return idle_status(motor, situation.node, situation.state, values)
    judgement = _judge(motor, situation, assumption_texts)
    return _status(motor, situation.node, judgement, values)


def idle_status(motor: str, node: str, state: str, values: dict[str, str]) -> DiagnosticStatus:
    """Describe one motor of a node that does not listen.

    Args:
        motor: its name.
        node: fully qualified name of the node.
        state: of its life cycle.
        values: what can be told all the same.
    """
    verb = {'unconfigured': 'configure', 'inactive': 'activate'}.get(state)
    remedy = (
        f'{verb} the node (ros2 lifecycle set {node} {verb})' if verb else 'start the node anew'
    )
    return _status(motor, node, (DiagnosticStatus.STALE, f'{state}: {remedy}'), values)


def _status(
    motor: str, node: str, judgement: Judgement, values: dict[str, str]
) -> DiagnosticStatus:
    name = node.lstrip(
        '/'
    )  # /diagnostics is one topic for every robot: what stands on it must tell them apart
    return DiagnosticStatus(
        level=judgement[0],
        name=f'{name}: {motor}',
        message=judgement[1],
        hardware_id=''.join(name.rpartition('/')[:2]) + motor,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def _judge(motor: str, now: Situation, assumption_names: Collection[str]) -> Judgement:
    """Find the first thing that an operator has to know."""
    return (
        _judge_stopped(motor, now)
        or _namesake(now)
        or _nothing_yet(motor, now)
        or _failed_training(motor, now)
        or _nothing_new(motor, now)
        or _something_spoilt(motor, now)
        or _verdicts(motor, now, assumption_names)
    )


def _judge_stopped(motor: str, now: Situation) -> Judgement | None:
    """Why a motor is observed no more."""
    incident = now.observer.incidents.get(motor)
    if incident is None:
        return None
    remedy = f'call {now.node}/reset to start anew, and report it: the log says more'
    return DiagnosticStatus.ERROR, f'stopped by a defect: {incident.reason}; {remedy}'


def _namesake(now: Situation) -> Judgement | None:
    """Whether what is read here may be of another node."""
    return (DiagnosticStatus.WARN, NAMESAKE.format(now.node)) if now.has_namesake else None


def _nothing_yet(motor: str, now: Situation) -> Judgement | None:
    """Why a motor has never been heard of."""
    pairing = now.observer.counts(motor)
    silent = [n for n in ('voltage', 'torque') if getattr(pairing, f'received_{n}') == 0]
    if not silent:
        return None
    trouble = now.inputs.trouble(n for n in silent if not now.message_input.message_counts[n])
    if trouble is not None:
        level = DiagnosticStatus.ERROR if trouble.is_broken else DiagnosticStatus.STALE
        return level, f'nothing received for this motor: {trouble.message}'
    if any(now.message_input.rejection_counts[n] for n in silent):
        complaint = next(
            (
                f' ({now.message_input.complaints[n]})'
                for n in silent
                if n in now.message_input.complaints
            ),
            '',
        )
        return _judge_refusals(motor, now) or (
            DiagnosticStatus.ERROR if complaint else DiagnosticStatus.STALE,
            f'no message so far could be read: see rejected{printable(complaint)}',
        )
    topics = ' and '.join(now.message_input.signals[n].topic for n in silent)
    strangers = sorted(
        {name for n in silent for name in now.message_input.signals[n].unknown_names}
    )
    remedy = (
        f'; names there: {printable(", ".join(strangers[:5]))}; see the parameters motors and joint'
        if strangers
        else ''
    )
    return (
        DiagnosticStatus.STALE,
        f'nothing received for this motor: is {topics} published with its name?{remedy}',
    )


def _failed_training(motor: str, now: Situation) -> Judgement | None:
    """What stays true whether samples come or not."""
    view = now.observer.motors.get(motor)
    if view is None or view.training is None or view.training.failure is None:
        return None
    return DiagnosticStatus.ERROR, view.training.failure


def _nothing_new(motor: str, now: Situation) -> Judgement | None:
    """Why no sample came of late, or too many were refused."""
    traffic = now.traffic.motors[motor]
    judgement = _judge_refusals(motor, now)
    if judgement is not None:
        return judgement
    if traffic.samples:
        return None
    silent = [name for name, count in traffic.messages.items() if count == 0]
    if not silent:
        return (
            DiagnosticStatus.STALE,
            'no new sample: do voltage and torque have stamps of the same clock?',
        )
    trouble = now.inputs.trouble(n for n in silent if not now.traffic.messages[n])
    if trouble is not None:
        level = DiagnosticStatus.ERROR if trouble.is_broken else DiagnosticStatus.STALE
        return level, f'no new sample: {trouble.message}'
    topics = [
        f'{now.message_input.signals[n].topic} '
        f'{"speaks of it no more" if now.traffic.messages[n] else "has fallen silent"}'
        for n in silent
    ]
    return DiagnosticStatus.STALE, f'no new sample: {" and ".join(topics)}: does its driver run?'


def _judge_refusals(motor: str, now: Situation) -> Judgement | None:
    """Why too many messages were refused of late, if they were."""
    traffic = now.traffic.motors[motor]
    count = traffic.rejections.total()
    if count <= REFUSED * (traffic.samples + count):
        return None
    reason, most = traffic.rejections.most_common(1)[0]
    if (
        2 * traffic.rejections[Rejection.STALE_INPUT] >= most
    ):  # torque without voltage follows from it
        reason = Rejection.STALE_INPUT
    period = f'{max(1.0, now.traffic.period_s):.0f} s'
    cause = REJECTIONS[reason]
    complains = reason in (Rejection.STALE_INPUT, Rejection.MALFORMED)
    if complains and now.message_input.complaints:  # which of them, how old, what does not fit
        cause = f'{printable("; ".join(now.message_input.complaints.values()))}: {cause}'
    return DiagnosticStatus.WARN, f'{count} messages refused in {period}: see rejected ({cause})'


def _something_spoilt(motor: str, now: Situation) -> Judgement | None:
    """What makes estimates worse than they could be, or will be missed later."""
    observer = now.observer
    if observer.alarm(motor):
        change_count = now.traffic.motors[motor].changes
        change_note = (
            f'; the motor was found changed ({change_count} times) and is being followed'
            if change_count
            else ''
        )
        return DiagnosticStatus.WARN, ALARM_REMEDY + change_note
    stall = observer.motors[motor].stall
    if stall is not None and stall.sentence is not None:
        return DiagnosticStatus.WARN, stall.sentence
    complaint = observer.motors[motor].delay_complaint
    if complaint is not None:  # before the verdicts: it may be what spoils them
        return DiagnosticStatus.WARN, complaint
    fit = observer.fit(motor)
    pair = observer.mix_up(motor)
    if pair is not None:
        return DiagnosticStatus.WARN, pair.sentence
    is_doubted = any(suspect.effect in DOUBTS for suspect in fit.suspects)
    if fit.verdict is FitVerdict.MISFIT and (is_doubted or _advice(motor, now) is None):
        return DiagnosticStatus.WARN, fit.sentence  # it ends with the likeliest remedy
    if now.traffic.busy > OVERLOAD:
        return (
            DiagnosticStatus.WARN,
            f'messages take {100 * now.traffic.busy:.0f} % of the time there is and queue up: '
            'send fewer, '
            'or start with predictor:=false or one observer a motor',
        )
    if now.checkpoint_failure is not None:
        return DiagnosticStatus.WARN, f'the checkpoint was not written: {now.checkpoint_failure}'
    if now.is_simulated and now.now_ns == 0:
        return (
            DiagnosticStatus.WARN,
            'use_sim_time is true, but nothing comes on /clock: publish it, or set it false',
        )
    return None


def _verdicts(motor: str, now: Situation, assumption_names: Collection[str]) -> Judgement:
    """What the estimates themselves say."""
    estimate = now.observer.motors[motor].estimate
    advice = _advice(motor, now)
    if advice is not None:
        return advice
    fit = now.observer.fit(motor)
    if fit.verdict is FitVerdict.WARNING:
        return DiagnosticStatus.WARN, fit.sentence
    quantity = now.observer.configuration['torque.quantity']
    doubt = contradiction(now.observer.motors[motor].configuration, estimate, quantity)
    if doubt is not None:
        return DiagnosticStatus.WARN, doubt
    if fit.withheld is not None:
        return DiagnosticStatus.WARN, fit.sentence
    remedy = now.observer.motors[motor].filter_remedy
    if remedy is not None:
        return DiagnosticStatus.WARN, remedy
    change_count = now.traffic.motors[motor].changes
    if estimate.identified(0):
        change_note = ': the motor has changed and was followed' if change_count else ''
        small_print = _small_print(estimate, assumption_names)
        return DiagnosticStatus.OK, f'every parameter identified{change_note}{small_print}'
    if now.observer.frozen:
        return DiagnosticStatus.OK, 'frozen'
    return (
        DiagnosticStatus.OK,
        'converging: the motor has changed and is being followed' if change_count else 'converging',
    )


def _advice(motor: str, now: Situation) -> Judgement | None:
    """What verdicts ask for; a bound comes before a residual, for it names the parameter."""
    advice = verdict_advice(now.observer.motors[motor])
    return None if advice is None else (DiagnosticStatus.WARN, advice)


def _small_print(estimate: Estimate, assumption_names: Collection[str]) -> str:
    """What an identified motor leans on: nearly zero parameters, and unstated assumptions."""
    note = ''
    names = [
        parameter.name
        for parameter, verdict in zip(estimate.parameters, estimate.verdicts[0], strict=True)
        if verdict is Verdict.NEGLIGIBLE
    ]
    if names:
        note += f'; {", ".join(names)} negligible: too small to matter, and known to be'
    if assumption_names:
        note += f'; assumed: {", ".join(assumption_names)}, see assumptions'
    return note
