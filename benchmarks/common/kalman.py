"""Peers: filterpy's extended and unscented Kalman filters with the parameters in the state.

State: current, then the parameters as logarithms (``log``: positive by construction) or as the
coordinates in which the rate is linear, in units of their start (``linear``: 1/L, R/L, K_HS/L,
...). Prediction is one classical Runge-Kutta step over the held voltage; the extended filter's
Jacobian is analytic. Everything a careful user would do, in plain Python floats, because that is
fastest for four or five numbers. The true measurement noise is given to them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from common.cases import Record
from common.motion import FloatArray

SMALLEST_NOISE = 1e-4
"""Measurement noise that the filters assume where there is none, as a fraction of the current's
spread."""

SMALLEST_COORDINATE = 1e-3
"""A linear coordinate is kept between this and its inverse, in units of its start: L must not
become negative."""

LARGEST_LOGARITHM = 7.0
"""And a logarithm within a factor of e^7 of its start."""


@dataclass(frozen=True, slots=True)
class KalmanSettings:
    """What the tuning chooses.

    Attributes:
        coordinates: ``log`` or ``linear``.
        initial_std: of every parameter, in units of the coordinates.
        walk_std: random walk of every parameter a square root of a second, in the same units.
        current_std: process noise of the current a square root of a second, as a fraction of its
            spread.
        alpha: spread of the sigma points (unscented filter only).
    """

    coordinates: str = 'log'
    initial_std: float = 1.0
    walk_std: float = 0.0
    current_std: float = 0.0
    alpha: float = 0.1


class _Problem:
    """The motor in the coordinates of a filter: scalar prediction with its Jacobian."""

    def __init__(self, record: Record, settings: KalmanSettings) -> None:
        case = record.case
        self.start = record.start
        self.logarithmic = settings.coordinates == 'log'
        start_p = _to_linear(self.start)
        self.p0 = start_p.tolist()
        self.z0 = np.log(self.start) if self.logarithmic else np.ones(len(self.start))
        self.lowest = (
            self.z0 - LARGEST_LOGARITHM if self.logarithmic else SMALLEST_COORDINATE * self.z0
        ).tolist()
        self.highest = (
            self.z0 + LARGEST_LOGARITHM if self.logarithmic else self.z0 / SMALLEST_COORDINATE
        ).tolist()
        self.kt = case.plant.torque_constant
        self.kb = None if len(self.start) > 3 else case.plant.back_emf_constant
        self.rotor = case.rotor
        inputs = record.inputs
        self.interval = [0.0, *inputs.interval_s.tolist()]
        self.voltage = [0.0, *inputs.voltage_v.tolist()]
        self.speed = record.speed_rad_s.tolist()
        self.measured = (record.torque_nm / self.kt).tolist()
        spread = float(np.std(record.torque_nm)) / self.kt
        self.noise_a = max(record.noise_a, SMALLEST_NOISE * spread)
        interval = float(np.median(inputs.interval_s))
        n = len(self.start)
        self.walk = np.diag(
            [(settings.current_std * spread) ** 2 * interval]
            + [settings.walk_std**2 * interval] * n
        )
        self.covariance = np.diag([self.noise_a**2] + [settings.initial_std**2] * n)
        self.state = np.concatenate([[self.measured[0]], self.z0])

    def coordinates(self, z: list[float]) -> list[float]:
        """Linear coordinates 1/L, R/L, ... of a filter's parameters."""
        near = [
            min(max(x, low), high)
            for x, low, high in zip(z, self.lowest, self.highest, strict=True)
        ]
        if not self.logarithmic:
            return [p * x for p, x in zip(self.p0, near, strict=True)]
        leading = near[0]
        return [math.exp(-leading), *(math.exp(x - leading) for x in near[1:])]

    def clamp(self, x: FloatArray) -> FloatArray:
        """Keep a filter's state where it makes sense."""
        x[1:] = np.clip(x[1:], self.lowest, self.highest)
        return x

    def theta(self, z: FloatArray) -> FloatArray:
        """Physical parameters of a filter's."""
        return _to_linear(np.array(self.coordinates(z.tolist())))

    def theta_jacobian(self, z: FloatArray) -> FloatArray:
        """Derivative of the physical parameters by the filter's."""
        theta = self.theta(z)
        if self.logarithmic:
            return np.diag(theta)
        p = np.array(self.coordinates(z.tolist()))
        jacobian = np.diag(np.concatenate([[-1.0 / p[0] ** 2], np.full(len(p) - 1, 1.0 / p[0])]))
        jacobian[1:, 0] = -p[1:] / p[0] ** 2
        result: FloatArray = jacobian * np.array(self.p0)
        return result

    def slope(self, i: float, p: list[float], v: float, w: float) -> float:
        """di/dt."""
        if not self.rotor:
            w = self.kt * i
        drop = p[1] * i + p[2] * abs(w) * i
        drop += p[0] * self.kb * w if self.kb is not None else p[3] * w
        return p[0] * v - drop

    def ahead(self, i: float, p: list[float], k: int) -> tuple[float, float]:
        """Return the currents at sample k and halfway to it, by one Runge-Kutta step from k - 1."""
        h, v = self.interval[k], self.voltage[k]
        w0 = self.speed[k - 1]
        w1 = self.speed[k]
        wm = 0.5 * (w0 + w1)
        k1 = self.slope(i, p, v, w0)
        k2 = self.slope(i + 0.5 * h * k1, p, v, wm)
        k3 = self.slope(i + 0.5 * h * k2, p, v, wm)
        k4 = self.slope(i + h * k3, p, v, w1)
        return i + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), i + 0.5 * h * k2

    def jacobian(self, im: float, p: list[float], k: int) -> list[float]:
        """First row of the transition's Jacobian, linearised halfway: third order in the step."""
        h, v = self.interval[k], self.voltage[k]
        kt = self.kt
        kb = self.kb
        if self.rotor:
            w = 0.5 * (self.speed[k - 1] + self.speed[k])
            a = -(p[1] + p[2] * abs(w))
        else:
            w = kt * im
            a = -(p[1] + p[2] * 2.0 * kt * abs(im) + p[0] * (kb or 0.0) * kt)
        phi = math.exp(a * h)
        gain = (phi - 1.0) / a if a else h
        by_p = [gain * (v - (kb or 0.0) * w), -gain * im, -gain * abs(w) * im]
        if kb is None:
            by_p.append(-gain * w)
        scaled = [s * x for s, x in zip(by_p, p, strict=True)]
        if self.logarithmic:
            return [phi, -sum(scaled), *scaled[1:]]
        return [phi, *(s * x for s, x in zip(by_p, self.p0, strict=True))]


def _to_linear(theta: FloatArray) -> FloatArray:
    """Map (L, R, K, ...) to (1/L, R/L, K/L, ...); the map is its own inverse."""
    return np.concatenate([[1.0], theta[1:]]) / theta[0]


class Extended:
    """filterpy's ExtendedKalmanFilter on one recording."""

    def __init__(self, record: Record, settings: KalmanSettings) -> None:
        self._problem = problem = _Problem(record, settings)
        n = len(problem.state)
        self._filter = _ExtendedFilter(n, dim_z=1)
        self._filter.motor = problem
        self._filter.x = problem.state.copy()
        self._filter.P = problem.covariance.copy()
        self._filter.Q = problem.walk
        self._filter.R = np.array([[problem.noise_a**2]])
        self._filter.F = np.eye(n)
        h = np.zeros((1, n))
        h[0, 0] = 1.0
        self._by_state: Callable[[FloatArray], FloatArray] = lambda x: h
        self._output: Callable[[FloatArray], FloatArray] = lambda x: x[:1]

    def learn(self, k: int) -> None:
        """Take sample k."""
        if k == 0:
            return
        self._filter.predict(k)
        self._filter.update(np.array([self._problem.measured[k]]), self._by_state, self._output)
        self._filter.x = self._problem.clamp(self._filter.x)

    @property
    def theta(self) -> FloatArray:
        """Present values."""
        return self._problem.theta(self._filter.x[1:])

    @property
    def covariance(self) -> FloatArray:
        """Stated covariance, linearised."""
        jacobian = self._problem.theta_jacobian(self._filter.x[1:])
        result: FloatArray = jacobian @ self._filter.P[1:, 1:] @ jacobian.T
        return result


class _ExtendedFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """The filter with the motor's prediction in the place that filterpy leaves for it."""

    motor: _Problem

    def predict_x(self, u: int = 0) -> None:
        """Move the state to sample ``u`` and linearise there."""
        state = self.x.tolist()
        p = self.motor.coordinates(state[1:])
        end, middle = self.motor.ahead(state[0], p, u)
        self.F[0, :] = self.motor.jacobian(middle, p, u)
        self.x[0] = end


class Unscented:
    """filterpy's UnscentedKalmanFilter on one recording, Merwe's scaled sigma points."""

    def __init__(self, record: Record, settings: KalmanSettings) -> None:
        self._problem = problem = _Problem(record, settings)
        n = len(problem.state)
        points = MerweScaledSigmaPoints(n, alpha=settings.alpha, beta=2.0, kappa=3.0 - n)
        self._filter = UnscentedKalmanFilter(
            dim_x=n, dim_z=1, dt=1.0, hx=lambda x: x[:1], fx=self._move, points=points
        )
        self._filter.x = problem.state.copy()
        self._filter.P = problem.covariance.copy()
        self._filter.Q = problem.walk + 1e-18 * np.eye(n) * np.diagonal(problem.covariance)
        self._filter.R = np.array([[problem.noise_a**2]])

    def _move(self, x: FloatArray, dt: float, k: int = 0) -> FloatArray:
        state = x.tolist()
        state[0] = self._problem.ahead(state[0], self._problem.coordinates(state[1:]), k)[0]
        return np.array(state)

    def learn(self, k: int) -> None:
        """Take sample k."""
        if k == 0:
            return
        self._filter.predict(k=k)
        self._filter.update(np.array([self._problem.measured[k]]))
        self._filter.P = 0.5 * (self._filter.P + self._filter.P.T)
        self._filter.x = self._problem.clamp(self._filter.x)

    @property
    def theta(self) -> FloatArray:
        """Present values."""
        return self._problem.theta(self._filter.x[1:])

    @property
    def covariance(self) -> FloatArray:
        """Stated covariance, linearised."""
        jacobian = self._problem.theta_jacobian(self._filter.x[1:])
        result: FloatArray = jacobian @ self._filter.P[1:, 1:] @ jacobian.T
        return result
