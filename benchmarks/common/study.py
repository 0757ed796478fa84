"""The runs behind the figures, one unit of work per seed and case, for two processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from common import changes
from common.cases import CASES, Case, Clean, Record, simulate
from common.cramer_rao import bound_over_time
from common.estimator import OWN_RULES, Online, OwnRule
from common.motion import FloatArray
from common.trace import Trace, follow, grow, marks_of
from common.tuning import estimators

OUTLIERS = ('torque', 'voltage')
HORIZON_SLOW = 'mhe'
ROBUSTNESS = (*OWN_RULES, 'ekf')
"""Methods that are also run with outliers and with a step of R; the filter beside the rules, for
information."""

BATCH = 'batch'

Key = tuple[str, str, float, bool]
"""Method, case name, noise, whether the starts lie either way."""


@dataclass(frozen=True, slots=True)
class Work:
    """What to run on one seed of one case.

    Attributes:
        case: which data.
        seed: of excitation and noise.
        methods: online methods by name, besides ``batch``.
        noises: standard deviations of the torque noise, as fractions of the torque's.
        either_way: kinds of start: all too large (False), either way (True).
        part: fraction of the recording that is used.
        marks: number of instants that are kept.
        robustness: also run :data:`ROBUSTNESS` with outliers and with a step of R.
    """

    case: Case
    seed: int
    methods: tuple[str, ...]
    noises: tuple[float, ...]
    either_way: tuple[bool, ...] = (False,)
    part: float = 1.0
    marks: int = 240
    robustness: bool = False


@dataclass(slots=True)
class Outcome:
    """What came of it.

    Attributes:
        seed: of the data.
        case: its name.
        traces: by method, case, noise and kind of start.
        bounds: by noise, shape (mark, parameter): the Cramer-Rao bound as a fraction of the value.
        time_s: shape (mark,).
        moved: by rule and kind of outlier, shape (parameter,): how far outliers moved the estimate,
            a fraction.
        steps: by rule and step, how it was followed.
        climbs: by rule, how a slow climb of R was followed.
    """

    seed: int
    case: str
    traces: dict[Key, Trace] = field(default_factory=dict)
    bounds: dict[float, FloatArray] = field(default_factory=dict)
    time_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    moved: dict[tuple[str, str], FloatArray] = field(default_factory=dict)
    steps: dict[tuple[str, str], changes.Followed] = field(default_factory=dict)
    climbs: dict[str, changes.Climbed] = field(default_factory=dict)


def carry_out(work: Work) -> Outcome:
    """Simulate once, then run every method at every noise from every kind of start."""
    case = work.case
    clean = simulate(case, [work.seed], work.part * case.duration_s)
    outcome = Outcome(work.seed, case.name)
    for noise in work.noises:
        for either_way in work.either_way:
            record = clean.record(work.seed, noise, either_way=either_way)
            marks = marks_of(record, work.marks)
            outcome.time_s = record.time_s[marks]
            outcome.bounds[noise] = bound_over_time(record, marks)
            builders = estimators(case)
            for method in work.methods:
                run = (
                    grow(record, marks)
                    if method == BATCH
                    else follow(builders[method], record, marks)
                )
                outcome.traces[method, case.name, noise, either_way] = run
    if work.robustness:
        for rule in [name for name in ROBUSTNESS if name in work.methods]:
            _hit_with_outliers(outcome, clean, rule)
            outcome.climbs[rule] = changes.climb(case, work.seed, estimators(case)[rule])
            for step in changes.STEPS if case.name == 'short holds' else ():
                outcome.steps[rule, step.title] = changes.watch(
                    step, case, work.seed, estimators(case)[rule]
                )
    return outcome


def _hit_with_outliers(outcome: Outcome, clean: Clean, rule: str) -> None:
    noise = 0.01
    undisturbed = clean.record(outcome.seed, noise)
    marks = np.array([undisturbed.stamp_ns.size - 1])
    before = follow(estimators(clean.case)[rule], undisturbed, marks).error[-1]
    for kind in OUTLIERS:
        record = clean.record(outcome.seed, noise, outliers=kind)
        after = follow(estimators(clean.case)[rule], record, marks).error[-1]
        outcome.moved[rule, kind] = after - before


def microseconds_per_sample(
    record: Record, builders: dict[str, Callable[[Record], Online]], repeats: int = 3
) -> dict[str, float]:
    """Mean time to learn one sample: the least of some repeats, the methods taking turns."""
    spent: dict[str, list[float]] = {name: [] for name in builders}
    for _ in range(repeats):
        for name, build in builders.items():
            count = record.stamp_ns.size if name != HORIZON_SLOW else min(150, record.stamp_ns.size)
            estimator = build(record)
            begin = time.perf_counter()
            for k in range(count):
                estimator.learn(k)
            spent[name].append(1e6 * (time.perf_counter() - begin) / count)
    return {name: min(values) for name, values in spent.items()}


def false_alarms_in_an_hour(case: Case, rule: str, seed: int) -> int:
    """Let a motor run unchanged for an hour at 1 % noise and count the drifts announced."""
    record = simulate(case, [seed], 3600.0).record(seed, 0.01)
    estimator = OwnRule(rule, record)
    for k in range(record.stamp_ns.size):
        estimator.learn(k)
    return estimator.alarms


def constant_hour(case: Case, rule: str, seed: int) -> FloatArray:
    """Learn a recording, then an hour of its last voltage; return the least ratios of std."""
    record = simulate(case, [seed]).record(seed, 0.01)
    estimator = OwnRule(rule, record)
    for k in range(record.stamp_ns.size):
        estimator.learn(k)
    return changes.hold(estimator, record, 3600.0)


def gather(
    outcomes: Sequence[Outcome],
    method: str,
    case: str,
    noise: float,
    either_way: bool,
    seeds: int | None = None,
) -> list[tuple[Trace, FloatArray, FloatArray]]:
    """Traces of one method on one case with their bounds and times, in the order of the seeds."""
    key = (method, case, noise, either_way)
    chosen = sorted(
        (o for o in outcomes if o.case == case and key in o.traces), key=lambda o: o.seed
    )
    return [(o.traces[key], o.bounds[noise], o.time_s) for o in chosen[:seeds]]


def timing(methods: Sequence[str], part: float) -> dict[str, float]:
    """Microseconds a sample of every method, on short holds at 1 % noise."""
    case = next(case for case in CASES if case.name == 'short holds')
    record = simulate(case, [0], part * case.duration_s).record(0, 0.01)
    builders = {name: build for name, build in estimators(case).items() if name in methods}
    return microseconds_per_sample(record, builders)
