"""What a current sensor that lags by first order reads of a motor's free run, with its derivatives.

Between two samples the states of a motor follow a linear law of which the run knows both ends. The
filter of that is a weighted sum of these ends, and of its own reading before. Friction, load and
losses are constant over an interval; the ends tell them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array

SHORTEST = 1e-3
"""Shortest lag that is told from none, in sample intervals."""

APART = 1e-6
"""Share by which two time constants differ at least: what divides by their difference stays exact.
"""

LITTLE = 1e-4
"""Share by which a sensor is taken for slower that is as slow as the motor."""

STEP = 1e-5
"""Relative step by which the weights are differentiated."""

_PLACES = {name: place for place, name in enumerate(TERMS)}
_DECISIVE = [
    _PLACES[name]
    for name in ('resistance', 'hysteresis', 'back_emf_constant', 'inertia', 'viscous_friction')
]
"""Coordinates that the law between two samples has."""


@dataclass(frozen=True, eq=False)
class _Weights:
    """What the filter's reading at an interval's end takes of the states at both ends.

    Attributes:
        before, after: shape (state, k): of the states.
        own: shape (k,): of its reading at the start.
    """

    before: Array
    after: Array
    own: Array


@dataclass(frozen=True, eq=False)
class LaggingCurrent:
    """The readings along one signal history.

    Attributes:
        states: shape (k + 1, state): of the free run.
        interval_s: shape (k,).
        lag_s: time constant of the sensor; 0 and less count for none.
        first_a: its first reading.
        p: shape (coordinate,): of the motor.
        torque_constant: Kt in N m/A.
    """

    states: Array
    interval_s: Array
    lag_s: float
    first_a: float
    p: Array
    torque_constant: float

    def readings(self) -> Array:
        """Return what the sensor reads, shape (k + 1,), in A."""
        weights = self._weights(self.p, self.lag_s)
        inputs_a = self._taken(weights, self.states[:, :, None])[:, 0]
        readings: Array = recurrence(weights.own[None], inputs_a[None, None], _row(self.first_a))[0, 0]
        return readings

    def derivatives(self, readings_a: Array, by_unknown: Array, by_logarithm: Array) -> Array:
        """Differentiate the readings.

        Args:
            readings_a: shape (k + 1,): :meth:`readings`.
            by_unknown: shape (k + 1, state, unknown + parameter): derivatives of the states.
            by_logarithm: shape (coordinate, parameter): of the coordinates by the parameters, which
                are the last of those unknowns.

        Returns:
            Shape (k + 1, unknown + parameter + 2): by the same, then by the lag in 1/s and by the
            first reading.
        """
        weights = self._weights(self.p, self.lag_s)
        taken = self._taken(weights, by_unknown)
        parameters = by_logarithm.shape[1]
        for place in np.flatnonzero(by_logarithm[_DECISIVE].any(axis=0)).tolist():
            moved_p = self.p + STEP * by_logarithm[:, place]
            moved = self._difference(weights, lambda p=moved_p: self._weights(p, self.lag_s), STEP)
            taken[:, place - parameters] += self._taken(moved, self.states[:, :, None])[:, 0]
        step_s = STEP * self._least(self.lag_s)
        moved = self._difference(
            weights, lambda: self._weights(self.p, self._least(self.lag_s) + step_s), step_s
        )
        by_lag = self._taken(moved, self.states[:, :, None]) + (moved.own * readings_a[:-1])[:, None]
        nothing = np.zeros_like(by_lag)
        inputs = np.concatenate([taken, by_lag, nothing], axis=1)
        start = np.zeros((inputs.shape[1], 1))
        start[-1] = 1.0
        rows = recurrence(weights.own[None], inputs.T[:, None], start)
        return np.ascontiguousarray(rows[:, 0].T)

    @staticmethod
    def _difference(
        weights: _Weights, moved_weights: Callable[[], _Weights], step: float
    ) -> _Weights:
        moved = moved_weights()
        return _Weights(
            (moved.before - weights.before) / step,
            (moved.after - weights.after) / step,
            (moved.own - weights.own) / step,
        )

    @staticmethod
    def _taken(weights: _Weights, signals: Array) -> Array:
        """Weigh signals of the states, shape (k + 1, state, column): shape (k, column)."""
        result = np.zeros((signals.shape[0] - 1, signals.shape[2]))
        for state in range(STATES):
            result += weights.before[state][:, None] * signals[:-1, state]
            result += weights.after[state][:, None] * signals[1:, state]
        return result

    def _least(self, lag_s: float) -> float:
        return max(lag_s, SHORTEST * float(self.interval_s[0]))

    def _weights(self, p: Array, lag_s: float) -> _Weights:
        """Return the weights at given values.

        With the law ``x' = A x + b`` the filter ``f' = (i - f) / lag`` ends at
        ``own f + u (x1 - own x0 - lag (1 - own) b)``; ``u`` is the current's row of
        ``(1 + lag A)^-1``, and ``b = (E - 1)^-1 A (x1 - E x0)`` with ``E = exp(A t)``.
        """
        lag_s = self._least(lag_s)
        of_current = -p[_PLACES['resistance']] - p[_PLACES['hysteresis']] * self._middle_rad_s
        by_speed = -p[_PLACES['back_emf_constant']]
        by_current = self.torque_constant * p[_PLACES['inertia']]
        of_speed = -p[_PLACES['viscous_friction']]
        determinant = _filter_determinant(of_current, by_speed, by_current, of_speed, lag_s)
        if (np.abs(determinant) < APART).any():  # the sensor is as slow as the motor
            lag_s *= 1.0 + LITTLE
            determinant = _filter_determinant(of_current, by_speed, by_current, of_speed, lag_s)
        own = np.exp(-self.interval_s / lag_s)
        to_current = (1.0 + lag_s * of_speed) / determinant
        to_speed = -lag_s * by_speed / determinant
        half = 0.5 * (of_current - of_speed)
        even, odd = _exponential(
            0.5 * (of_current + of_speed), half**2 + by_speed * by_current, self.interval_s
        )
        flow = (even + odd * half, odd * by_speed, odd * by_current, even - odd * half)
        moved = (flow[0] - 1.0, flow[1], flow[2], flow[3] - 1.0)
        scale = lag_s * (1.0 - own) / (moved[0] * moved[3] - moved[1] * moved[2])
        first = scale * (to_current * moved[3] - to_speed * moved[2])
        second = scale * (to_speed * moved[0] - to_current * moved[1])
        drive_current = first * of_current + second * by_current
        drive_speed = first * by_speed + second * of_speed
        before = np.stack(
            [
                drive_current * flow[0] + drive_speed * flow[2] - own * to_current,
                drive_current * flow[1] + drive_speed * flow[3] - own * to_speed,
            ]
        )
        after = np.stack([to_current - drive_current, to_speed - drive_speed])
        return _Weights(before, after, own)

    @cached_property
    def _middle_rad_s(self) -> Array:
        """Size of the speed in the middle of every interval, shape (k,)."""
        speed = self.states[:, State.SPEED]
        middle: Array = 0.5 * np.abs(speed[1:] + speed[:-1])
        return middle


def _filter_determinant(
    of_current: Array, by_speed: float, by_current: float, of_speed: float, lag_s: float
) -> Array:
    """Return the determinant of ``1 + lag A``, shape (k,)."""
    determinant: Array = (1.0 + lag_s * of_current) * (1.0 + lag_s * of_speed)
    determinant -= lag_s**2 * by_speed * by_current
    return determinant


def _exponential(mean: Array, square: Array, interval_s: Array) -> tuple[Array, Array]:
    """Return what ``exp(A t)`` takes of 1 and of ``A - mean``, shape (k,) each.

    Args:
        mean: shape (k,): of both eigenvalues of ``A``.
        square: shape (k,): square of what they differ from it by.
        interval_s: shape (k,): t.
    """
    root = np.sqrt(np.maximum(np.abs(square), (APART * mean) ** 2))
    fast = np.exp((mean + root) * interval_s)
    slow = np.exp((mean - root) * interval_s)
    even, odd = 0.5 * (fast + slow), 0.5 * (fast - slow) / root
    swings = square < 0.0
    if swings.any():
        decay = np.exp(mean * interval_s)
        even = np.where(swings, decay * np.cos(root * interval_s), even)
        odd = np.where(swings, decay * np.sin(root * interval_s) / root, odd)
    return even, odd


def _row(value: float) -> Array:
    return np.array([[value]])
