"""Everything that diagnostics tell of a motor beside level and advice, as key-value pairs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.safe_io.finite import words_of

if TYPE_CHECKING:
    from gray_box_observer.ros.observer.diagnostics import Situation


def values_of(motor: str, now: Situation, assumption_texts: Mapping[str, str]) -> dict[str, str]:
    """Return everything that is known of a motor, as text.

    Args:
        motor: its name.
        now: what there is to be told about.
        assumption_texts: what is taken for granted of it, by short name.
    """
    values = {**_counts(motor, now), **_balance(motor, now)}
    view = now.observer.motors.get(motor)
    if view is None:
        return values
    values.update(_estimates(view.estimate))
    values.update(_fit(view.fit))
    values['speed source'] = f'{view.white_box.speed_source}: {view.speed_reason}'
    effect_names = ', '.join(view.added_effects) or 'none'
    values['effects added'] = f'{effect_names}: {view.effects_reason}'
    if view.current_lag_s is not None:
        values['current lag [s]'] = _text(view.current_lag_s)
    if view.speed is not None:
        values['speed [rad/s]'] = _text(view.speed.speed_rad_s)
        values['speed std [rad/s]'] = _text(view.speed.std_rad_s)
    if view.stall is not None:
        values['stalls'] = str(view.stall.count)
    values['assumptions'] = '; '.join(assumption_texts.values()) or 'none'
    delay = view.delay
    values['delay in words'] = delay.words
    values['delay [s]'] = _text(delay.value_s)
    values['delay std [s]'] = _text(delay.std_s)
    values['delay applied [s]'] = f'{delay.applied_s:.6g}'
    values['delay verdict'] = delay.verdict.value
    values.update({name: str(count) for name, count in view.counters.items()})
    alarm = view.alarm
    training = view.training
    if alarm is not None:
        alarm_state = (
            'raised' if alarm.is_raised else 'armed' if alarm.is_armed else 'learning the residual'
        )
        values['residual alarm'] = alarm_state
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
    pairing = now.observer.counts(motor)
    rhythm = now.meter.rhythms.get(motor)
    rejections: Counter[str] = Counter({reason.value: n for reason, n in pairing.rejected.items()})
    for counts in now.message_input.rejection_counts.values():
        rejections.update({reason.value: n for reason, n in counts.items()})
    newest_ns = now.meter.newest_ns.get(motor)
    return {
        'samples used': str(pairing.used_count),
        'samples waiting for voltage': str(pairing.waiting_count),
        'voltage messages': str(pairing.received_voltage),
        'torque messages': str(pairing.received_torque),
        'signal restarts': str(pairing.restarts),
        'samples with voltage held': str(pairing.held_count),
        'samples missing': str(0 if rhythm is None else rhythm.missing_count),
        'pauses': str(0 if rhythm is None else max(0, rhythm.pauses)),
        'sample rate [1/s]': f'{now.traffic.motors[motor].samples / now.traffic.period_s:.1f}',
        'age of newest sample [s]': _text(
            None if newest_ns is None else (now.now_ns - newest_ns) * 1e-9
        ),
        'rejected': ', '.join(f'{reason}: {n}' for reason, n in sorted(rejections.items()))
        or 'none',
        'changes since last identified': str(now.traffic.motors[motor].changes),
        'CPU of this process [%]': f'{100 * now.traffic.cpu:.1f}',
        'time spent on messages [%]': f'{100 * now.traffic.busy:.1f}',
        'age of checkpoint [s]': _text(now.checkpoint_age_s),
    }


def _balance(motor: str, now: Situation) -> dict[str, str]:
    """Where every message went: nothing may be lost without a trace (docs/FAULTS.md)."""
    pairing = now.observer.counts(motor)
    message_input = now.message_input
    values = {'voltages taken': str(pairing.taken_voltage)}
    for name in ('voltage', 'torque'):
        values[f'{name} topic: messages'] = str(message_input.message_counts[name])
        values[f'{name} topic: unreadable'] = str(message_input.rejection_counts[name].total())
        values[f'{name} topic: of no motor here'] = str(message_input.others[name])
        refusals = sorted((reason.value, n) for reason, n in pairing.refusal_counts[name].items())
        values[f'{name} messages refused'] = (
            ', '.join(f'{reason}: {n}' for reason, n in refusals) or 'none'
        )
    return values


def _estimates(estimate: Estimate) -> dict[str, str]:
    values = {}
    for j, parameter in enumerate(estimate.parameters):
        value, std = estimate.value[0, j], estimate.std[0, j]
        values[f'{parameter.name} [{parameter.unit}]'] = (
            f'{words_of(value)} +- {words_of(std, ".2g")}'
        )
        values[f'{parameter.name} verdict'] = (
            f'{estimate.verdicts[0][j].value} {estimate.bound_met(0, j)}'.rstrip()
        )
    return values


def _fit(fit: FitAssessment) -> dict[str, str]:
    suspects = [f'{suspect.effect} ({suspect.remedy})' for suspect in fit.suspects]
    return {
        'fit verdict': fit.verdict.value,
        'fit ratio': _text(fit.ratio),
        'fit whiteness': _text(fit.whiteness),
        'suspects': '; '.join(suspects) or 'none',
    }


def _text(value: float | int | None) -> str:
    return words_of(value, '.4g', 'unknown')
