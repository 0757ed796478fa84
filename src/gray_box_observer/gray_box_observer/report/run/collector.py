"""Collects what a report draws while the observer runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.recursive.sensitivity import sensitivity
from gray_box_observer.fit_test.whole_run import autocorrelation, white_box_torque
from gray_box_observer.observer.motor_view import ALARM_REMEDY, MotorView
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.report.run.history import (
    DerivedFigure,
    FitHistory,
    FloatArray,
    MotorHistory,
    ParameterHistory,
    Truth,
)
from gray_box_observer.white_box import TERMS

MOST_TIMES = 10
"""Alarms and changes that are named one by one."""


@dataclass(eq=False)
class _Course:
    """The course of one motor so far; one row a sample, and one entry an estimate."""

    start_ns: int
    shift_ns: int = 0
    samples: list[tuple[float, float, float, float, float, float, float]] = field(
        default_factory=list
    )
    estimates: list[tuple[float, Estimate]] = field(default_factory=list)
    alarms_s: list[float] = field(default_factory=list)
    has_alarm: bool = False


class Collector:
    """Listens to results and turns them into histories.

    Args:
        truth: true parameters by motor and name, where they are known.
    """

    def __init__(self, truth: Mapping[str, Mapping[str, Truth]] | None = None) -> None:
        self._truth = truth or {}
        self._courses: dict[str, _Course] = {}

    def __call__(self, result: Result) -> None:
        """Take one result."""
        sample = result.sample
        course = self._courses.setdefault(result.motor, _Course(sample.stamp_ns))
        time_s = (sample.stamp_ns - course.start_ns + course.shift_ns) / 1e9
        if (
            course.samples and time_s < course.samples[-1][0]
        ):  # the clock jumped back: go on where we were
            course.shift_ns += round((course.samples[-1][0] - time_s) * 1e9)
            time_s = course.samples[-1][0]
        prediction = result.prediction
        course.samples.append(
            (
                time_s,
                float(sample.voltage_v[0]),
                float(sample.torque_nm[0]),
                float(prediction.torque_nm[0]) if prediction is not None else np.nan,
                float(prediction.white_box_torque_nm[0]) if prediction is not None else np.nan,
                float(sample.speed_rad_s[0]),
                float(sample.interval_s[0]),
            )
        )
        if result.estimate is not None:
            course.estimates.append((time_s, result.estimate))
        if result.alarm and not course.has_alarm:
            course.alarms_s.append(time_s)
        course.has_alarm = result.alarm

    def histories(
        self,
        observer: Observer,
        rejections: Mapping[str, Mapping[str, int]],
        changes_s: Mapping[str, Sequence[float]] | None = None,
    ) -> tuple[MotorHistory, ...]:
        """Return the history of every motor that has not stopped.

        Args:
            observer: at the end of the run.
            rejections: counts by motor and reason.
            changes_s: when each motor was found changed, in s of the time that its samples cover.
        """
        changes = changes_s or {}
        return tuple(
            self._history(name, observer, rejections.get(name, {}), changes.get(name, ()))
            for name in self._courses
            if name in observer.motors
        )

    def _history(
        self,
        name: str,
        observer: Observer,
        rejections: Mapping[str, int],
        changes_s: Sequence[float],
    ) -> MotorHistory:
        course = self._courses[name]
        columns = np.array(course.samples).T
        motor = observer.motors[name]
        run_nm = white_box_torque(
            motor.white_box,
            motor.theta[0],
            columns[6],
            columns[1],
            columns[2],
            np.nan_to_num(columns[5]),
        )
        found_s = _on_axis(changes_s, columns[6], columns[0])
        skill = observer.skill(name)
        scores = {} if skill is None else skill.to_dict()
        return MotorHistory(
            name=name,
            time_s=columns[0],
            voltage_v=columns[1],
            torque_nm=columns[2],
            predicted_torque_nm=columns[3],
            white_box_torque_nm=columns[4],
            parameters=self._parameters(name, course, motor.estimate),
            speed_rad_s=columns[5] if np.any(np.isfinite(columns[5])) else None,
            rejection_counts=dict(rejections),
            scores={
                key: float(v) for key, v in scores.items() if v is not None and key != 'samples'
            },
            notes=(*_alarm_notes(course.alarms_s), *_change_notes(found_s), *notes(name, observer)),
            sensitivity=_sensitivity(motor),
            current_a=np.asarray(motor.white_box.state(columns[2])),
            free_run_torque_nm=run_nm,
            changes_s=found_s,
            derived_figures=_derived(motor),
            fit=_fit(motor, columns[2], run_nm),
        )

    def _parameters(
        self, name: str, course: _Course, last: Estimate
    ) -> tuple[ParameterHistory, ...]:
        """Return the course of the parameters that the motor has at the end."""
        if not course.estimates:
            return ()
        estimates = [(t, e) for t, e in course.estimates if e.parameters == last.parameters]
        if not estimates or not _is_same(estimates[-1][1], last):  # `identify` ends with a last fit
            estimates.append((course.samples[-1][0], last))
        time_s = np.array([t for t, _ in estimates])
        value = np.array([e.value[0] for _, e in estimates])
        std = np.array([e.std[0] for _, e in estimates])
        return tuple(
            ParameterHistory(
                p.name,
                p.unit,
                time_s,
                value[:, j],
                std[:, j],
                [e.verdicts[0][j].value for _, e in estimates],
                self._truth.get(name, {}).get(p.name),
            )
            for j, p in enumerate(last.parameters)
        )


def _is_same(one: Estimate, other: Estimate) -> bool:
    return (
        np.array_equal(one.value, other.value)
        and np.array_equal(one.covariance, other.covariance)
        and one.verdicts == other.verdicts
    )


def _fit(motor: MotorView, torque_nm: FloatArray, run_nm: FloatArray) -> FitHistory:
    """Return whether the white box explains the data, with the newest residual correlation."""
    correlation = autocorrelation(torque_nm - run_nm)
    lag_values, band = (None, 0.0) if correlation is None else correlation
    return FitHistory(
        motor.fit.verdict.value, motor.fit.sentence, motor.fit_percent(), lag_values, band
    )


def _on_axis(
    covered_s: Sequence[float], interval_s: FloatArray, time_s: FloatArray
) -> tuple[float, ...]:
    """Return the position on the report's axis of what happened at a covered time."""
    elapsed_s = np.cumsum(interval_s)
    at = np.minimum(np.searchsorted(elapsed_s, covered_s), len(time_s) - 1)
    return tuple(float(time_s[place]) for place in at)


def _change_notes(times_s: Sequence[float]) -> list[str]:
    """Say when the motor was found changed."""
    if not times_s:
        return []
    return [
        f'The motor was found changed at {_times(times_s)}: what changed was learnt anew, the '
        'rest was kept.'
    ]


def _times(times_s: Sequence[float]) -> str:
    when = ', '.join(f'{time_s:.2f} s' for time_s in times_s[:MOST_TIMES])
    return when + (
        f' and {len(times_s) - MOST_TIMES} times more' if len(times_s) > MOST_TIMES else ''
    )


def _derived(motor: MotorView) -> tuple[DerivedFigure, ...]:
    """Return the constants that follow from the parameters."""
    return tuple(
        DerivedFigure(one.name, one.value, one.std, one.unit, one.verdict.value)
        for one in motor.derived_constants
    )


def _sensitivity(motor: MotorView) -> dict[str, dict[str, float]] | None:
    """How an error of the known constants goes into the estimate, from what the rule remembers."""
    return sensitivity(
        motor.white_box,
        motor.remembered(),
        motor.theta,
        reads_current=motor.configuration.reads_current,
    )


def _on_the_constant(motor: MotorView) -> str:
    """Say what depends on Kt where a current is read."""
    if motor.white_box.has_rotor or motor.configuration.mechanical_nodes:
        return 'inertia, frictions and load scale with it, L and R do not'
    if motor.white_box.speed_measured:
        return 'no estimate depends on it'
    return 'it scales the speed w = Kt i alone'


def _alarm_notes(times_s: list[float]) -> list[str]:
    """Say when the alarm on the residual was raised."""
    if not times_s:
        return []
    return [f'Alarm at {_times(times_s)}: {ALARM_REMEDY}']


def notes(name: str, observer: Observer) -> list[str]:
    """Say in plain words what a reader of one motor's result has to keep in mind."""
    motor = observer.motors[name]
    values = motor.configuration.values
    white_box = motor.white_box
    other_constants = [
        term
        for term in white_box.known
        if term != 'back_emf_constant' and term not in white_box.context_nodes
    ]
    scaling = ': every parameter scales with it (1 % more of it, 1 % more of each)'
    if other_constants:
        scaling = ''
    elif motor.configuration.reads_current:
        scaling = f'. The current is read, so that {_on_the_constant(motor)}'
    sentences = [f'Kt = {values["torque_constant"]:g} N m/A is taken as known{scaling}.']
    if 'back_emf_constant' not in values['context_nodes']:
        kind = 'measured speed' if motor.white_box.speed_measured else 'w = Kt i'
        where = 'R' if 'resistance' in values['context_nodes'] else 'the estimates'
        if motor.white_box.has_rotor:
            kind = 'the speed a hidden state'
            where = 'inertia and frictions'
        back_emf = float(motor.white_box.known.get('back_emf_constant', 0.0))
        sentences.append(
            f'Kb = {back_emf:g} V s/rad is taken as known, with {kind}: its error goes into '
            f'{where}.'
        )
    for term in other_constants:
        constant_text = (
            f'{term.replace("_", " ")} = {float(motor.white_box.known[term]):g} '
            f'{TERMS[term].parameter.unit}'
        )
        sentences.append(f'{constant_text} is taken as known: its error goes into the estimates.')
    sentences.append(f'Speed from {motor.white_box.speed_source}: {motor.speed_reason}.')
    if motor.added_effects:
        names = ' and '.join(name.replace('_', ' ') for name in motor.added_effects)
        sentences.append(f'Added to the white box: {names}: {motor.effects_reason}.')
    assumption_texts = motor.assumptions
    sentences += [f'{text[0].upper()}{text[1:]}.' for text in assumption_texts.values()]
    delay = motor.delay
    complaint = motor.delay_complaint
    if complaint is not None:
        sentences.append(
            f'{complaint[0].upper()}{complaint[1:]}. Until then L is not to be trusted.'
        )
    elif delay.is_estimated:
        delay_text = (
            'the data do not tell it'
            if math.isnan(delay.value_s)
            else (f'{1e3 * delay.value_s:.4g} ms ± {1e3 * delay.std_s:.2g} ms in the newest data')
        )
        sentences.append(
            f'The delay from voltage to torque is estimated: {delay_text}; '
            f'{1e3 * delay.applied_s:.4g} '
            'ms are taken off.'
        )
    elif delay.applied_s:
        sentences.append(
            f'Voltage is taken to act on torque {1e3 * delay.applied_s:.4g} ms later than it is '
            'stamped.'
        )
    pairing = observer.counts(name)
    if pairing.restarts:
        sentences.append(
            f'The clock jumped back {pairing.restarts} times; the signal history started anew, '
            'estimates stayed.'
        )
    training = motor.training
    if training is not None and training.jobs_late:
        sentences.append(
            f'{training.jobs_late} training jobs were late; the running network stayed in service '
            'meanwhile.'
        )
    return sentences
