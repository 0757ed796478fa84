"""Collects what a report draws while the observer runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gray_box_observer.context_nodes import Estimate
from gray_box_observer.context_nodes.sensitivity import sensitivity
from gray_box_observer.motor_view import MotorView
from gray_box_observer.observer import Observer, Result
from gray_box_observer.predictor.alarm import REMEDY
from gray_box_observer.report.history import MotorHistory, ParameterHistory, Truth
from gray_box_observer.white_box import TERMS

MOST_TIMES = 10
"""Alarms that are named one by one."""


@dataclass
class _Course:
    """The course of one motor so far; one row a sample, and one entry an estimate."""

    start_ns: int
    shift_ns: int = 0
    samples: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    estimates: list[tuple[float, Estimate]] = field(default_factory=list)
    alarms_s: list[float] = field(default_factory=list)
    alarmed: bool = False


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
        if course.samples and time_s < course.samples[-1][0]:  # the clock jumped back: go on where we were
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
            )
        )
        if result.estimate is not None:
            course.estimates.append((time_s, result.estimate))
        if result.alarm and not course.alarmed:
            course.alarms_s.append(time_s)
        course.alarmed = result.alarm

    def histories(self, observer: Observer, rejected: Mapping[str, Mapping[str, int]]) -> tuple[MotorHistory, ...]:
        """Return the history of every motor; ``rejected`` counts by motor and reason."""
        return tuple(self._history(name, observer, rejected.get(name, {})) for name in self._courses)

    def _history(self, name: str, observer: Observer, rejected: Mapping[str, int]) -> MotorHistory:
        course = self._courses[name]
        columns = np.array(course.samples).T
        skill = observer.skill(name)
        scores = {} if skill is None else skill.to_dict()
        return MotorHistory(
            name=name,
            time_s=columns[0],
            voltage_v=columns[1],
            torque_nm=columns[2],
            predicted_torque_nm=columns[3],
            white_box_torque_nm=columns[4],
            parameters=self._parameters(name, course),
            speed_rad_s=columns[5] if np.any(np.isfinite(columns[5])) else None,
            rejected=dict(rejected),
            scores={key: float(v) for key, v in scores.items() if v is not None and key != 'samples'},
            notes=(*_alarm_notes(course.alarms_s), *notes(name, observer)),
            sensitivity=_sensitivity(observer.motors[name]),
        )

    def _parameters(self, name: str, course: _Course) -> tuple[ParameterHistory, ...]:
        if not course.estimates:
            return ()
        time_s = np.array([t for t, _ in course.estimates])
        value = np.array([e.value[0] for _, e in course.estimates])
        std = np.array([e.std[0] for _, e in course.estimates])
        return tuple(
            ParameterHistory(
                p.name,
                p.unit,
                time_s,
                value[:, j],
                std[:, j],
                [e.verdicts[0][j].value for _, e in course.estimates],
                self._truth.get(name, {}).get(p.name),
            )
            for j, p in enumerate(course.estimates[-1][1].parameters)
        )


def _sensitivity(motor: MotorView) -> dict[str, dict[str, float]] | None:
    """How an error of the known constants goes into the estimate, from what the rule remembers."""
    return sensitivity(motor.white_box, motor.remembered(), motor.theta)


def _alarm_notes(times_s: list[float]) -> list[str]:
    """Say when the alarm on the residual was raised."""
    if not times_s:
        return []
    when = ', '.join(f'{time_s:.2f} s' for time_s in times_s[:MOST_TIMES])
    more = f' and {len(times_s) - MOST_TIMES} times more' if len(times_s) > MOST_TIMES else ''
    return [f'Alarm at {when}{more}: {REMEDY}']


def notes(name: str, observer: Observer) -> list[str]:
    """Say in plain words what a reader of one motor's result has to keep in mind."""
    values = observer.configuration.motors[name].values
    motor = observer.motors[name]
    others = [term for term in motor.white_box.known if term != 'back_emf_constant']
    scaling = '' if others else ': every parameter scales with it (1 % more of it, 1 % more of each)'
    said = [f'Kt = {values["torque_constant"]:g} N m/A is taken as known{scaling}.']
    if 'back_emf_constant' not in values['context_nodes']:
        kind = 'measured speed' if motor.white_box.speed_measured else 'w = Kt i'
        where = 'R' if 'resistance' in values['context_nodes'] else 'the estimates'
        said.append(
            f'Kb = {values["back_emf_constant"]:g} V s/rad is taken as known, with {kind}: its error goes into {where}.'
        )
    for term in others:
        what = f'{term.replace("_", " ")} = {float(motor.white_box.known[term]):g} {TERMS[term].parameter.unit}'
        said.append(f'{what} is taken as known: its error goes into the estimates.')
    delay = motor.delay
    complaint = delay.complaint(name)
    if complaint is not None:
        said.append(f'{complaint[0].upper()}{complaint[1:]}. Until then L is not to be trusted.')
    elif delay.asked:
        found = (
            'the data do not tell it'
            if math.isnan(delay.value_s)
            else (f'{1e3 * delay.value_s:.4g} ms ± {1e3 * delay.std_s:.2g} ms in the newest data')
        )
        said.append(
            f'The delay from voltage to torque is estimated: {found}; {1e3 * delay.applied_s:.4g} ms are taken off.'
        )
    elif delay.applied_s:
        said.append(f'Voltage is taken to act on torque {1e3 * delay.applied_s:.4g} ms later than it is stamped.')
    pairing = observer.counts(name)
    if pairing.restarts:
        said.append(
            f'The clock jumped back {pairing.restarts} times; the signal history started anew, estimates stayed.'
        )
    training = motor.training
    if training is not None and training.jobs_late:
        said.append(f'{training.jobs_late} training jobs were late; the running network stayed in service meanwhile.')
    return said
