"""Peers for hidden rotors: filterpy's extended and unscented filters over states and parameters.

The state is the current, the speed and the logarithms of L, R, J, B and T_c. A sample interval is
classical Runge-Kutta in as many steps as L/R asks for; the extended filter's transition follows
from the Jacobian at the middle. Everything a careful user would do, in plain Python floats. The
true noise of the current is given to them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from common.motion import FloatArray
from common.rotor.records import NODES, Record

STATES = 2
FARTHEST = 5.0
"""A logarithm is kept within a factor of e^5 of its start."""

STEP = 0.7
"""Largest product of a Runge-Kutta step and R / L."""

START_FACTOR = 2.0
"""Every parameter begins too large or too small by this factor."""

TUNED_ON = range(1000, 1003)
TUNED_S = 6.0
WORST = 1e6


@dataclass(frozen=True, slots=True)
class JointSettings:
    """What the tuning chooses.

    Attributes:
        initial_std: of every logarithm.
        walk_std: random walk of every logarithm a square root of a second.
        process_std: process noise of current and speed a square root of a second, as a share of
            stall current and no-load speed.
        bend: speed below which dry friction is softened, as a share of the no-load speed.
    """

    initial_std: float = 0.7
    walk_std: float = 0.0
    process_std: float = 1e-3
    bend: float = 3e-3


GRID = {
    'initial_std': (0.3, 0.7),
    'walk_std': (0.0, 3e-3),
    'process_std': (1e-4, 3e-3, 3e-2),
    'bend': (1e-3, 1e-2),
}
"""What is tried, with the extended filter; the unscented one runs under the same."""


class _Problem:
    """One record in the coordinates of a filter."""

    def __init__(self, record: Record, settings: JointSettings) -> None:
        motor = record.motor
        self.start = np.log(joint_start(record))
        self.kt = motor.torque_constant
        self.kb = motor.back_emf_constant
        self.interval_s = record.interval_s
        self.voltage: list[float] = record.voltage_v.tolist()
        self.measured: list[float] = record.measured_a.tolist()
        self.noise_a = record.noise_a
        largest_v = float(np.abs(record.voltage_v).max())
        speed = largest_v / self.kb
        current = float(np.abs(record.measured_a).max())
        self.bend = settings.bend * speed
        self.low = (self.start - FARTHEST).tolist()
        self.high = (self.start + FARTHEST).tolist()
        h = self.interval_s
        parameters = [settings.initial_std**2] * len(NODES)
        walks = [settings.walk_std**2 * h] * len(NODES)
        self.state = np.array([self.measured[0], 0.0, *self.start])
        self.covariance = np.diag([self.noise_a**2, (0.01 * speed) ** 2, *parameters])
        unit = settings.process_std**2 * h
        self.walk = np.diag([unit * current**2, unit * speed**2, *walks])

    def values(self, logarithms: Sequence[float]) -> list[float]:
        """Return L, R, J, B and T_c, kept where they make sense."""
        near = zip(logarithms, self.low, self.high, strict=True)
        return [math.exp(min(max(x, low), high)) for x, low, high in near]

    def rates(self, i: float, w: float, p: Sequence[float], volt: float) -> tuple[float, float]:
        """di/dt and dw/dt."""
        turn = w / (abs(w) + self.bend)
        return (
            (volt - p[1] * i - self.kb * w) / p[0],
            (self.kt * i - p[3] * w - p[4] * turn) / p[2],
        )

    def moved(
        self, i: float, w: float, p: Sequence[float], volt: float
    ) -> tuple[float, float, float, float]:
        """Return current and speed after an interval, and those at its middle."""
        count = max(1, math.ceil(self.interval_s * p[1] / p[0] / STEP))
        count = 2 * min(count, 8)  # even: one step ends in the middle
        h = self.interval_s / count
        middle = i, w
        for k in range(count):
            a1, b1 = self.rates(i, w, p, volt)
            a2, b2 = self.rates(i + 0.5 * h * a1, w + 0.5 * h * b1, p, volt)
            a3, b3 = self.rates(i + 0.5 * h * a2, w + 0.5 * h * b2, p, volt)
            a4, b4 = self.rates(i + h * a3, w + h * b3, p, volt)
            i += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            w += h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)
            if 2 * (k + 1) == count:
                middle = i, w
        return i, w, *middle

    def transition(self, i: float, w: float, p: Sequence[float], volt: float) -> FloatArray:
        """Return the derivatives of the states at an interval's end, shape (state, all)."""
        rate_i, rate_w = self.rates(i, w, p, volt)
        bent = abs(w) + self.bend
        turn = w / bent
        slope = self.bend / bent**2
        own = np.array(
            [[-p[1] / p[0], -self.kb / p[0]], [self.kt / p[2], -(p[3] + p[4] * slope) / p[2]]]
        )
        h = self.interval_s
        # states decay by the exponential, and parameters act through its mean
        decay, mean = _exponential(own * h)
        by_parameter = np.array(
            [
                [-rate_i, -p[1] * i / p[0], 0.0, 0.0, 0.0],
                [0.0, 0.0, -rate_w, -p[3] * w / p[2], -p[4] * turn / p[2]],
            ]
        )
        return np.hstack([decay, h * mean @ by_parameter])

    def clamp(self, x: FloatArray) -> FloatArray:
        """Keep a filter's state where it makes sense."""
        x[STATES:] = np.clip(x[STATES:], self.low, self.high)
        return x


def _exponential(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exponential of a matrix of two, and the mean of it from 0 to 1, by the scalars behind it."""
    (a, b), (c, d) = matrix.tolist()
    half = 0.5 * (a + d)
    root = 0.25 * (a - d) ** 2 + b * c
    size = math.sqrt(abs(root)) + 1e-12
    grow = math.exp(max(min(half, 50.0), -50.0))
    even, odd = (
        (math.cosh(min(size, 50.0)), math.sinh(min(size, 50.0)) / size)
        if root > 0.0
        else (math.cos(size), math.sin(size) / size)
    )
    unit = np.eye(2)
    decay = grow * (even * unit + odd * (matrix - half * unit))
    determinant = a * d - b * c
    if abs(determinant) < 1e-12:
        return decay, unit + 0.5 * matrix
    inverse = np.array([[d, -b], [-c, a]]) / determinant
    return decay, inverse @ (decay - unit)


class JointExtended:
    """filterpy's ExtendedKalmanFilter over one record."""

    title = 'joint EKF (filterpy)'

    def __init__(self, record: Record, settings: JointSettings) -> None:
        self.problem = problem = _Problem(record, settings)
        n = problem.state.size
        self.filter = _ExtendedFilter(n, dim_z=1)
        self.filter.problem = problem
        _prepare(self.filter, problem)
        self.filter.F = np.eye(n)
        row = np.zeros((1, n))
        row[0, 0] = 1.0
        self._by_state: Callable[[FloatArray], FloatArray] = lambda x: row
        self._output: Callable[[FloatArray], FloatArray] = lambda x: x[:1]

    def learn(self, k: int) -> None:
        """Take sample k."""
        self.filter.predict(k)
        reading = np.array([self.problem.measured[k]])
        self.filter.update(reading, self._by_state, self._output)
        self.filter.x = self.problem.clamp(self.filter.x)


class _ExtendedFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """The filter with the motor's prediction in the place that filterpy leaves for it."""

    problem: _Problem

    def predict_x(self, u: int = 0) -> None:
        """Move the state to sample ``u`` and linearise at the middle."""
        state = self.x.tolist()
        p = self.problem.values(state[STATES:])
        volt = self.problem.voltage[u - 1]
        i, w, at_i, at_w = self.problem.moved(state[0], state[1], p, volt)
        self.F[:STATES] = self.problem.transition(at_i, at_w, p, volt)
        self.x[:STATES] = i, w


class JointUnscented:
    """filterpy's UnscentedKalmanFilter over one record, Merwe's scaled sigma points."""

    title = 'joint UKF (filterpy)'

    def __init__(self, record: Record, settings: JointSettings) -> None:
        self.problem = problem = _Problem(record, settings)
        n = problem.state.size
        points = MerweScaledSigmaPoints(n, alpha=0.1, beta=2.0, kappa=3.0 - n)
        self.filter = UnscentedKalmanFilter(
            dim_x=n, dim_z=1, dt=1.0, hx=lambda x: x[:1], fx=self._moved, points=points
        )
        _prepare(self.filter, problem)
        self.filter.Q = problem.walk + 1e-14 * problem.covariance

    def _moved(self, x: FloatArray, dt: float, k: int = 0) -> FloatArray:
        state = x.tolist()
        p = self.problem.values(state[STATES:])
        i, w, _, _ = self.problem.moved(state[0], state[1], p, self.problem.voltage[k - 1])
        state[:STATES] = i, w
        return np.array(state)

    def learn(self, k: int) -> None:
        """Take sample k."""
        self.filter.predict(k=k)
        self.filter.update(np.array([self.problem.measured[k]]))
        self.filter.P = 0.5 * (self.filter.P + self.filter.P.T)
        self.filter.x = self.problem.clamp(self.filter.x)


JointFilter = JointExtended | JointUnscented


def _prepare(filter_: ExtendedKalmanFilter | UnscentedKalmanFilter, problem: _Problem) -> None:
    filter_.x = problem.state.copy()
    filter_.P = problem.covariance.copy()
    filter_.Q = problem.walk
    filter_.R = np.array([[problem.noise_a**2]])


def joint_start(record: Record) -> FloatArray:
    """Return where a peer begins: every parameter a factor off, up or down."""
    rng = np.random.default_rng(round(1e9 * record.motor.inductance))
    sign = rng.choice([-1.0, 1.0], size=len(NODES))
    return np.asarray(record.truth[: len(NODES)] * START_FACTOR**sign)


@dataclass(frozen=True, slots=True)
class JointRun:
    """What became of a peer over one record.

    Attributes:
        error: shape (parameter,): relative, at the end.
        z: shape (parameter,): errors of the logarithms in their standard deviations.
        sample_us: processor time a sample.
    """

    error: FloatArray
    z: FloatArray
    sample_us: float


def run_joint(kind: type[JointFilter], record: Record, settings: JointSettings) -> JointRun:
    """Run a filter over a record; one that breaks down has no error that is a number."""
    one = kind(record, settings)
    count = record.measured_a.size
    begun = time.process_time()
    try:
        for k in range(1, count):
            one.learn(k)
    except (np.linalg.LinAlgError, OverflowError, ValueError):
        nothing = np.full(len(NODES), np.nan)
        return JointRun(nothing, nothing, math.nan)
    sample_us = 1e6 * (time.process_time() - begun) / count
    logarithms = one.filter.x[STATES:]
    off = logarithms - np.log(record.truth)
    std = np.sqrt(np.maximum(np.diagonal(one.filter.P)[STATES:], 1e-300))
    return JointRun(np.expm1(off), off / std, sample_us)


def tuned(draw: Callable[[int, float], Record], *, quick: bool) -> JointSettings:
    """Return the settings whose errors over their bounds are smallest on held-out seeds.

    Args:
        draw: makes a record of a seed and a length in s.
        quick: the defaults, untuned.
    """
    if quick:
        return JointSettings()
    records = [draw(seed, TUNED_S) for seed in TUNED_ON]
    bounds = [record.bound() for record in records]

    def size(settings: JointSettings) -> float:
        over = [
            np.abs(run_joint(JointExtended, record, settings).error) / bound
            for record, bound in zip(records, bounds, strict=True)
        ]
        return float(np.mean(np.log(np.nan_to_num(np.clip(over, 0.1, WORST), nan=WORST))))

    return min(_grid(), key=size)


def _grid() -> Iterator[JointSettings]:
    for values in product(*GRID.values()):
        yield JointSettings(**dict(zip(GRID, values, strict=True)))
