"""Motors that change while they are identified: a step, a slow climb of R, and a quiet hour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from common.cases import Case, Record, simulate
from common.cramer_rao import bound
from common.estimator import Online, OwnRule
from common.motion import FloatArray, Inputs, solve
from common.settling import settled_s
from gray_box_observer.samples import Sample

NOISE = 0.01
WATCHED_S = 10.0
CLIMB = 1.2

Build = Callable[[Record], Online]


@dataclass(frozen=True, slots=True)
class Step:
    """A sudden change of one parameter."""

    title: str
    parameter: str
    factor: float


STEPS = (Step('R + 30 %', 'resistance', 1.3), Step('L - 30 %', 'inductance', 0.7))


@dataclass(frozen=True, slots=True)
class Followed:
    """How a step was followed.

    Attributes:
        settled_s: from the step until the parameter stays within 2 % of its new value; inf if it
            does not.
        multiple: shape (parameter,): error at the end, in units of the bound of what was recorded
            since the step.
    """

    settled_s: float
    multiple: FloatArray


def watch(step: Step, case: Case, seed: int, build: Build) -> Followed:
    """Change a parameter at an instant that the seed draws, so that no method is in step."""
    at_s = 20.0 + float(np.random.default_rng([seed, 30]).uniform(0.0, 4.0))
    value = step.factor * float(getattr(case.plant, step.parameter))
    schedule = [f'motor.{step.parameter}={value:g}@{at_s:.4f}']
    record = simulate(case, [seed], at_s + WATCHED_S, schedule).record(seed, NOISE)
    after = record.time_s >= at_s
    changed = replace(case, plant=replace(case.plant, **{step.parameter: value}))
    rows = learnt(build, record)[after]
    column = case.parameters.index(step.parameter)
    since = replace(
        record,
        case=changed,
        stamp_ns=record.stamp_ns[after],
        voltage_v=record.voltage_v[after],
        torque_nm=record.torque_nm[after],
        true_torque_nm=record.true_torque_nm[after],
        speed_rad_s=record.speed_rad_s[after],
    )
    settled = settled_s(np.abs(rows[:, column] / value - 1.0), record.time_s[after] - at_s, 0.02)
    return Followed(settled, (rows[-1] / changed.truth - 1.0) / bound(since))


@dataclass(frozen=True, slots=True)
class Climbed:
    """How a slow climb was followed, over the second half of it.

    Attributes:
        error: shape (parameter,): root mean square error as a fraction of the value at that time.
        stds: shape (parameter,): the same in stated standard deviations; NaN where none is stated.
    """

    error: FloatArray
    stds: FloatArray


def climb(case: Case, seed: int, build: Build) -> Climbed:
    """Let R rise by a fifth over the whole recording."""
    cold = float(case.plant.resistance)
    column = case.parameters.index('resistance')
    schedule = [f'motor.resistance={cold:g}..{CLIMB * cold:g}@0..{case.duration_s:g}']
    record = simulate(case, [seed], None, schedule).record(seed, NOISE)
    stds = np.full((record.stamp_ns.size, case.truth.size), np.nan)
    rows = learnt(build, record, stds)
    truth = np.tile(case.truth, (rows.shape[0], 1))
    truth[:, column] *= 1.0 + (CLIMB - 1.0) * record.time_s / case.duration_s
    late = record.time_s > 0.5 * case.duration_s
    off = (rows - truth)[late]
    relative = off / truth[late]
    in_stds = off / stds[late]
    return Climbed(np.sqrt(np.mean(relative**2, axis=0)), np.sqrt(np.mean(in_stds**2, axis=0)))


def learnt(build: Build, record: Record, stds: FloatArray | None = None) -> FloatArray:
    """Values after every sample, shape (sample, parameter); inf where the method failed."""
    rows = np.full((record.stamp_ns.size, record.case.truth.size), np.inf)
    try:
        estimator = build(record)
        for k in range(rows.shape[0]):
            estimator.learn(k)
            rows[k] = estimator.theta
            covariance = estimator.covariance if stds is not None and k % 32 == 0 else None
            if stds is not None:
                stds[k] = (
                    stds[max(k - 1, 0)]
                    if covariance is None
                    else np.sqrt(np.abs(np.diagonal(covariance)))
                )
    except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError):
        rows[k:] = np.inf
    return rows


def hold(estimator: OwnRule, record: Record, seconds: float) -> FloatArray:
    """Hold the last voltage on; return the least ratio of each standard deviation to the previous.

    Before is two seconds into the hold: the transition that the recording ended in still tells of
    all parameters.
    """
    before = np.full(record.case.truth.size, np.nan)
    begun = round(2.0 * record.case.rate_hz)
    random = np.random.default_rng([record.seed, 40])
    step_ns = round(1e9 / record.case.rate_hz)
    count = round(seconds * record.case.rate_hz)
    steady = _steady_nm(record)
    noise = record.noise_nm * random.standard_normal(count)
    least = np.full(before.size, np.inf)
    for k in range(count):
        stamp = int(record.stamp_ns[-1]) + (k + 1) * step_ns
        volt = float(record.voltage_v[-1])
        estimator.rule.learn(
            Sample.of_one_motor(
                stamp, 1e-9 * step_ns, volt, steady[min(k, len(steady) - 1)] + noise[k]
            )
        )
        if k == begun:
            before = np.sqrt(np.diagonal(estimator.covariance))
        if k % 1000 == 999 and k > count // 20:
            least = np.minimum(least, np.sqrt(np.diagonal(estimator.covariance)) / before)
    return least


def _steady_nm(record: Record) -> FloatArray:
    """The true torque after a recording while its last voltage is held, until it has settled."""
    case = record.case
    count = 20 * round(record.case.rate_hz)
    held = Inputs(
        np.full(count, 1.0 / case.rate_hz),
        np.full(count, record.voltage_v[-1]),
        np.full(count + 1, np.nan),
    )
    start = float(record.true_torque_nm[-1]) / case.plant.torque_constant
    motion = solve(case.form, case.truth, start, held, np.full(count + 1, start))
    return case.plant.torque_constant * motion.current_a[1:]
