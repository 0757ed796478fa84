"""One record through the observer, as ``identify --skip-predictor`` runs it, with verdicts."""

from __future__ import annotations

import json
import math
import time
import traceback
import warnings
from bisect import bisect_right
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from common.trust.records import Record
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.identify import offline_run
from gray_box_observer.identify.result import describe, warnings_of
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.settings.configuration import Configuration

MOTOR = 'motor'
STDS = 3.0
RELATIVE = 0.02
LONGEST_FALSE_S = 1.0
NEGLIGIBLE_VOLTAGE = 0.01
"""Share of the voltage that a parameter called negligible may truly move: twice what the verdict
promises."""

ROUNDING = 1e-9
"""Eigenvalue of a correlation matrix below zero that rounding may explain."""

KNOWN = ('identified', 'negligible')

FIRST_SAMPLES = 5000
"""Samples of every record whose costs are compared: a long record spreads its start over more."""

YARDSTICK_EVERY = 200
"""Samples after which a fixed piece of work is timed: clocks of processors change by a half."""


@dataclass
class Trial:
    """What came of one record.

    Attributes:
        name: of its scenario.
        seed: of the record.
        values, stds, verdicts: at the end, by parameter; a value that is not finite is None.
        errors: relative to the truth, by parameter; where that is zero, the estimate itself.
        deviations: of the truth from the estimate in standard deviations, by parameter.
        false_at_end: parameters that are believed at the end and wrong.
        false_longest_s: longest time without a break in which any parameter was believed and wrong.
        identified_s: when each parameter that is known at the end came to be known for the first
            time.
        right_shares: share of the record in which each parameter was known and right.
        fit: what the result says of the fit; empty where it says nothing.
        effects: that the data have added.
        warnings: what the user is told.
        cost_ms: mean CPU time of the first FIRST_SAMPLES samples.
        cost_share: the same over that of a fixed piece of work along these.
        whole_cost_share: the same of the whole record.
        worst_ms: largest CPU time of a sample.
        end_ms: CPU time of what is left to be done behind the last sample.
        samples: how many came.
        non_finite: estimates with a value, a standard deviation or a covariance that is not finite.
        indefinite: estimates whose covariance is not positive definite.
        failure: traceback, where there was one.
    """

    name: str
    seed: int
    values: dict[str, float | None] = field(default_factory=dict)
    stds: dict[str, float | None] = field(default_factory=dict)
    verdicts: dict[str, str] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    deviations: dict[str, float] = field(default_factory=dict)
    false_at_end: list[str] = field(default_factory=list)
    false_longest_s: float = 0.0
    identified_s: dict[str, float] = field(default_factory=dict)
    right_shares: dict[str, float] = field(default_factory=dict)
    fit: dict[str, Any] = field(default_factory=dict)
    effects: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    cost_ms: float = math.nan
    cost_share: float = math.nan
    whole_cost_share: float = math.nan
    worst_ms: float = math.nan
    end_ms: float = math.nan
    samples: int = 0
    non_finite: int = 0
    indefinite: int = 0
    failure: str = ''

    @property
    def is_misfit(self) -> bool:
        """Whether the motor is called a misfit."""
        return self.fit.get('verdict') == 'misfit' or 'misfit' in self.verdicts.values()

    @property
    def suspects(self) -> list[str]:
        """Effects that are suspected, the likeliest first."""
        return [suspect['effect'] for suspect in self.fit.get('suspects') or []]

    @property
    def messages(self) -> str:
        """Everything that the user is told in words."""
        suspects = self.fit.get('suspects') or []
        remedies = [f'{suspect["effect"]} {suspect.get("remedy", "")}' for suspect in suspects]
        return '\n'.join([*self.warnings, *remedies])

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


class Watch:
    """Follows what is believed along a record."""

    def __init__(self, record: Record) -> None:
        self._record = record
        self._first_ns = int(record.readings.torque_stamp_ns[0])
        self._false_since_ns: int | None = None
        self._estimate: Estimate | None = None
        self._change_count = 0
        self._last_ns = self._first_ns
        self._known_since_ns: dict[str, int] = {}
        self._right_ns: dict[str, int] = {}
        self._right_names: set[str] = set()
        self.longest_ns = 0
        self.non_finite = 0
        self.indefinite = 0

    def add(self, result: Result) -> None:
        """Go on by one result."""
        self.believe(result.estimate, result.sample.stamp_ns)

    def believe(self, estimate: Estimate | None, stamp_ns: int) -> None:
        """Judge what is believed from an instant on.

        Args:
            estimate: that goes out then; None: the one before stands, of a motor that may be
                another by now.
            stamp_ns: the instant.
        """
        change_count = bisect_right(self._record.change_ns, stamp_ns)
        if estimate is not None:
            self._check(estimate)
            self._estimate = estimate
        elif self._estimate is None or change_count == self._change_count:
            return
        self._change_count = change_count
        self._judge(self._estimate, stamp_ns)

    def _judge(self, estimate: Estimate, stamp_ns: int) -> None:
        """Count how long the beliefs before stood, and whether these are false."""
        self._count_false(stamp_ns)
        self._count_right(stamp_ns)
        false_names = false_parameters(self._record, estimate, stamp_ns)
        if not false_names:
            self._false_since_ns = None
        elif self._false_since_ns is None:
            self._false_since_ns = stamp_ns
        verdicts = zip(estimate.parameters, estimate.verdicts[0], strict=True)
        names = {one.name for one, verdict in verdicts if verdict.value in KNOWN}
        self._right_names = names.difference(false_names)
        for name in names:
            self._known_since_ns.setdefault(name, stamp_ns)

    def _check(self, estimate: Estimate) -> None:
        value = estimate.value[0]
        covariance = estimate.covariance[0]
        if not (np.isfinite(value).all() and np.isfinite(covariance).all()):
            self.non_finite += 1
            return
        spread = np.sqrt(np.abs(np.diagonal(covariance)))
        scale = np.where(spread > 0.0, spread, 1.0)
        smallest = np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0]
        self.indefinite += bool(smallest < -ROUNDING or (np.diagonal(covariance) < 0.0).any())

    def _count_false(self, stamp_ns: int) -> None:
        if self._false_since_ns is not None:
            self.longest_ns = max(self.longest_ns, stamp_ns - self._false_since_ns)

    def _count_right(self, stamp_ns: int) -> None:
        for name in self._right_names:
            self._right_ns[name] = self._right_ns.get(name, 0) + stamp_ns - self._last_ns
        self._last_ns = stamp_ns

    def close(self) -> None:
        """End the record."""
        last_ns = int(self._record.readings.torque_stamp_ns[-1])
        self._count_false(last_ns)
        self._count_right(last_ns)

    def known_since_s(self, parameter: str) -> float:
        """When a parameter came to be known for the first time, in s since the first sample."""
        since_ns = self._known_since_ns.get(parameter)
        return math.nan if since_ns is None else (since_ns - self._first_ns) / 1e9

    def right_share(self, parameter: str) -> float:
        """Share of the record in which it was known and right."""
        return self._right_ns.get(parameter, 0) / max(self._last_ns - self._first_ns, 1)


def run_trial(record: Record) -> Trial:
    """Run one record; a traceback is part of the result."""
    trial = Trial(record.scenario.name, record.seed)
    watch = Watch(record)
    try:
        with warnings.catch_warnings(), np.errstate(all='ignore'):
            warnings.simplefilter('ignore')
            outcome = observe(record, watch, trial)
            watch.close()
            trial.warnings = warnings_of(outcome)
            estimates = outcome.observer.estimates()
            if MOTOR in estimates:
                _judge(record, estimates[MOTOR], watch, trial)
                result = describe(outcome)
                trial.fit = dict(result['motors'][MOTOR].get('fit') or {})
                trial.effects = list(result['motors'][MOTOR].get('effects') or [])
                json.dumps(result, allow_nan=False)  # as `identify --json` does
    except Exception:  # whatever it is, it is what the benchmark looks for
        trial.failure = traceback.format_exc(limit=-3)
    trial.false_longest_s = watch.longest_ns / 1e9
    trial.non_finite = watch.non_finite
    trial.indefinite = watch.indefinite
    return trial


def observe(record: Record, watch: Watch, trial: Trial) -> offline_run.Outcome:
    """Feed a record to an observer of its own; note what it cost."""
    configuration = Configuration.from_flat(record.parameters)
    observer = Observer(configuration)
    outcome = offline_run.Outcome(observer, MessageInput(observer, configuration))
    costs_ns = []
    yardsticks_ns = []
    log = record.readings
    torques = log.torque_stamp_ns.tolist(), record.torque_nm.tolist(), log.speed_rad_s.tolist()
    voltages = log.voltage_stamp_ns.tolist(), log.voltage_v.tolist()
    for voltage_ns, volt, torque_ns, torque, speed in zip(*voltages, *torques, strict=True):
        begun_ns = time.thread_time_ns()
        results = [
            *observer.voltage(MOTOR, voltage_ns, volt),
            *observer.torque(MOTOR, torque_ns, torque, speed),
        ]
        news = _retested(observer)
        costs_ns.append(time.thread_time_ns() - begun_ns)
        if len(costs_ns) % YARDSTICK_EVERY == 0:
            yardsticks_ns.append(_yardstick_ns())
        _note(results, outcome, watch)
        watch.believe(news, torque_ns)
    begun_ns = time.thread_time_ns()
    results = observer.flush()
    observer.finish()
    trial.end_ms = (time.thread_time_ns() - begun_ns) / 1e6
    _note(results, outcome, watch)
    if MOTOR in observer.motors:
        watch.believe(observer.estimates().get(MOTOR), torque_ns)
    observer.close()
    trial.samples = len(costs_ns)
    first_ns = costs_ns[:FIRST_SAMPLES]
    yardsticks_ns = yardsticks_ns or [_yardstick_ns()]
    first_yardsticks_ns = yardsticks_ns[: max(FIRST_SAMPLES // YARDSTICK_EVERY, 1)]
    trial.cost_ms = float(np.mean(first_ns)) / 1e6
    trial.worst_ms = max(costs_ns) / 1e6
    trial.cost_share = float(np.mean(first_ns) / np.median(first_yardsticks_ns))
    trial.whole_cost_share = float(np.mean(costs_ns) / np.median(yardsticks_ns))
    return outcome


def _yardstick_ns() -> int:
    """Time a fixed piece of work, half of it Python's and half numpy's."""
    matrix = np.eye(8) + 0.1
    numbers = dict.fromkeys(range(64), 0)
    begun_ns = time.thread_time_ns()
    for k in range(2500):
        numbers[k & 63] = (numbers[k & 63] * 31 + k) % 1_000_003
    for _ in range(60):
        np.linalg.solve(matrix, matrix[0])
        np.where(matrix > 1.0, matrix, 0.0).sum()
    return time.thread_time_ns() - begun_ns


def _retested(observer: Observer) -> Estimate | None:
    """Return the estimate where a test has changed what is believed of it, as nodes publish it."""
    group = observer.group_of(MOTOR) if MOTOR in observer.motors else None
    if group is None or group.observer is None or not any(group.observer.retested().values()):
        return None
    estimate: Estimate = observer.estimates()[MOTOR]
    return estimate


def _note(results: list[Result], outcome: offline_run.Outcome, watch: Watch) -> None:
    for result in results:
        course = outcome.courses.get(result.motor)
        if course is None:
            course = outcome.courses[result.motor] = offline_run.Course(result.sample.stamp_ns)
        course.update(result)
        watch.add(result)


def _judge(record: Record, estimate: Estimate, watch: Watch, trial: Trial) -> None:
    """Compare the last estimate with the truth."""
    truth = truth_at(record, int(record.readings.torque_stamp_ns[-1]))
    for j, parameter in enumerate(estimate.parameters):
        name = parameter.name
        value = float(estimate.value[0, j])
        std = float(estimate.std[0, j])
        trial.values[name] = value if math.isfinite(value) else None
        trial.stds[name] = std if math.isfinite(std) else None
        trial.verdicts[name] = estimate.verdicts[0][j].value
        if name in truth:
            trial.errors[name] = value / truth[name] - 1.0 if truth[name] else value
            trial.deviations[name] = (value - truth[name]) / std if std > 0.0 else math.nan
        if trial.verdicts[name] in KNOWN:
            trial.identified_s[name] = watch.known_since_s(name)
        trial.right_shares[name] = watch.right_share(name)
    trial.false_at_end = false_parameters(
        record, estimate, int(record.readings.torque_stamp_ns[-1])
    )


def truth_at(record: Record, stamp_ns: int) -> dict[str, float]:
    """True values at an instant."""
    return record.truths[bisect_right(record.change_ns, stamp_ns)]


def false_parameters(record: Record, estimate: Estimate, stamp_ns: int) -> list[str]:
    """Return the parameters that are believed and wrong."""
    truth = truth_at(record, stamp_ns)
    false = []
    for j, parameter in enumerate(estimate.parameters):
        verdict = estimate.verdicts[0][j].value
        if verdict not in KNOWN or parameter.name not in truth:
            continue
        true = truth[parameter.name]
        if verdict == 'negligible':
            is_false = _voltage_share(record, parameter.name, true, stamp_ns) > NEGLIGIBLE_VOLTAGE
        else:
            error = abs(float(estimate.value[0, j]) - true)
            is_false = not (
                error <= STDS * float(estimate.std[0, j]) or error <= RELATIVE * abs(true)
            )
        if is_false:
            false.append(parameter.name)
    return false


def _voltage_share(record: Record, parameter: str, true: float, stamp_ns: int) -> float:
    """Share of the root mean square voltage that a parameter truly moves."""
    log = record.readings
    speed = log.speed_rad_s
    if not record.scenario.speed:
        speed = record.torque_nm
    # a friction is the voltage that the resistance takes of the current which overcomes it
    opposes = truth_at(record, stamp_ns)['resistance'] / record.parameters['motor.torque_constant']
    signals = {
        'hysteresis': np.abs(speed) * log.current_a,
        'resistance': log.current_a,
        'back_emf_constant': speed,
        'brush_drop': np.sign(log.current_a),
        'voltage_offset': np.ones_like(log.current_a),
        'inductance': np.gradient(log.current_a) * record.scenario.rate_hz,
        'coulomb_friction': np.sign(speed) * opposes,
        'load_torque': np.full_like(log.current_a, opposes),
        'viscous_friction': speed * opposes,
        'quadratic_friction': np.abs(speed) * speed * opposes,
    }
    voltage = float(np.sqrt(np.mean(log.voltage_v**2)))
    return abs(true) * float(np.sqrt(np.mean(signals[parameter] ** 2))) / max(voltage, 1e-12)
