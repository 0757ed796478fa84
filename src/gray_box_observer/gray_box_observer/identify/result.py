"""What a run over bags has found, as plain values: the same words wherever it is told."""

from __future__ import annotations

from functools import partial
from typing import Any

from gray_box_observer.fit_test.data_sheet import contradiction
from gray_box_observer.identify.offline_run import Outcome
from gray_box_observer.observer.incident import in_words
from gray_box_observer.observer.motor_view import ALARM_REMEDY
from gray_box_observer.observer.observer import Observer
from gray_box_observer.safe_io.finite import plain
from gray_box_observer.samples import Rejection


def warnings_of(outcome: Outcome, *, with_fits: bool = True) -> list[str]:
    """Return everything that the user should know of a run, one sentence each.

    Args:
        outcome: of the run.
        with_fits: also what the fit tests say, which the text of a result begins with.
    """
    observer = outcome.observer
    seen_motors = {*observer.motors, *observer.incidents}
    unseen_motors = [name for name in observer.configuration.motors if name not in seen_motors]
    motors = observer.motors
    gap_s = observer.configuration['gap_s']
    doubts = {
        name: contradiction(
            motors[name].configuration, estimate, observer.configuration['torque.quantity']
        )
        for name, estimate in observer.estimates().items()
    }
    complaints = [motor.delay_complaint for motor in motors.values()]
    mix_ups = [observer.mix_up(name) for name in observer.motors]
    fits = {name: motor.fit for name, motor in observer.motors.items()} if with_fits else {}
    return [
        *outcome.warnings,
        *(f'motor {name}: {fit.sentence}' for name, fit in fits.items() if fit.has_advice),
        *(one.sentence for one in mix_ups if one is not None),
        *_stops(outcome.observer),
        *(f'no usable sample of motor {name}; it is not in the result' for name in unseen_motors),
        *(
            f'{counts.total()} messages of {name} could not be read'
            for name, counts in outcome.message_input.rejection_counts.items()
            if counts
        ),
        *(
            f'motor {name}: alarm at {course.alarms_s[0]:.2f} s, {len(course.alarms_s)} in all: '
            f'{ALARM_REMEDY}'
            for name, course in outcome.courses.items()
            if course.alarms_s
        ),
        *(
            f'motor {name}: no sample follows another within {gap_s:g} s: are its stamps in s? if '
            'they are, set gap_s to more than the time between two'
            for name, course in outcome.courses.items()
            if course.duration_s == 0.0 and course.last_ns - course.first_ns > gap_s * 1e9
        ),
        *(complaint for complaint in complaints if complaint is not None),
        *(f'motor {name}: {doubt}' for name, doubt in doubts.items() if doubt is not None),
    ]


def assumptions_of(outcome: Outcome) -> list[str]:
    """Return what is assumed of every motor for want of a statement, one sentence each."""
    return [
        f'motor {name}: {text}'
        for name, motor in outcome.observer.motors.items()
        for text in motor.assumptions.values()
    ]


def _stops(observer: Observer) -> list[str]:
    """Say which motors have stopped, those that were computed together in one sentence."""
    incidents = {id(incident): incident for incident in observer.incidents.values()}.values()
    return [
        f'{in_words(incident.motors)} stopped by a defect, nothing is known of it: '
        f'{incident.reason}; '
        'report it with the field stopped of --json'
        for incident in incidents
    ]


def describe(outcome: Outcome) -> dict[str, Any]:
    """Return the result as plain values for ``--json``; numbers that are not finite are None."""
    observer = outcome.observer
    descriptions = {
        name: observer.contain(observer.group_of(name), partial(_motor, outcome, name))
        for name in [*observer.motors]
    }
    motors = {name: values for name, values in descriptions.items() if values is not None}
    incidents = observer.incidents.items()
    stopped_motors = {
        name: {'reason': incident.reason, 'traceback': incident.trace}
        for name, incident in incidents
    }
    result: dict[str, Any] = plain(
        {
            'motors': motors,
            **({'stopped': stopped_motors} if stopped_motors else {}),
            'digest': outcome.digest,
        }
    )
    return result


def _motor(outcome: Outcome, name: str) -> dict[str, Any]:
    """Return what was found of one motor."""
    motor = outcome.observer.motors[name]
    course = outcome.courses[name]
    estimate = motor.estimate
    delay = motor.delay
    counts = outcome.observer.counts(name)
    skill = outcome.observer.skill(name)
    alarms_s = [round(time_s, 6) for time_s in course.alarms_s]
    values: dict[str, Any] = {
        'samples': counts.used_count,
        'duration_s': round(course.duration_s, 6),
        'rejected': {reason.value: counts.rejected[reason] for reason in Rejection},
        'parameters': {
            parameter.name: {
                'value': float(estimate.value[0, j]),
                'std': float(estimate.std[0, j]),
                'unit': parameter.unit,
                'verdict': estimate.verdicts[0][j].value,
            }
            for j, parameter in enumerate(estimate.parameters)
        },
        'derived': {
            constant.name: {
                'value': constant.value,
                'std': constant.std,
                'unit': constant.unit,
                'verdict': constant.verdict.value,
            }
            for constant in motor.derived_constants
        },
        'covariance': estimate.covariance[0].tolist(),
        'fit': motor.fit.to_dict(),
        'fit_percent': motor.fit_percent(),
        'speed_source': motor.white_box.speed_source,
        'speed_source_reason': motor.speed_reason,
        'effects': list(motor.added_effects),
        'effects_reason': motor.effects_reason,
        'current_lag_s': motor.current_lag_s,
        'predictor': None if skill is None else skill.to_dict(),
        'alarms': None,
        'changes_s': [round(time_s, 6) for time_s in course.changes_s],
    }
    if motor.alarm is not None:
        values['alarms'] = {'raised': len(alarms_s), 'first_s': alarms_s[0] if alarms_s else None}
    if delay.is_estimated or motor.delay_complaint is not None:
        values['delay_s'] = {'value': delay.value_s, 'std': delay.std_s, 'applied': delay.applied_s}
    return values
