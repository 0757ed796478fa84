"""What a current sensor behind a filter of first order reads of a free run, with its derivatives.

Between two samples the states of a motor follow a linear law, and the run knows where they begin
and end. Friction, load and losses are constant over an interval: begin and end tell them. So the
reading at the end is a weighted sum of the states at both ends and of the reading before.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array

SHORTEST = 1e-3
"""Shortest lag, in sample intervals: of less the reading is the current itself."""

APART = 1e-6
"""Share by which two rates differ at least: what is divided by their difference stays exact."""

LITTLE = 1e-4
"""Share by which a filter is taken for slower that is as slow as the motor."""

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
    """What a reading at an interval's end takes of the states at both ends.

    Attributes:
        before, after: shape (state, k): of the states.
        own: shape (k,): of the reading at the start.
    """

    before: Array
    after: Array
    own: Array

    def inputs(self, signals: Array) -> Array:
        """Weigh signals of the states, shape (k + 1, state, column): shape (k, column)."""
        result = np.zeros((signals.shape[0] - 1, signals.shape[2]))
        for state in range(STATES):
            result += self.before[state][:, None] * signals[:-1, state]
            result += self.after[state][:, None] * signals[1:, state]
        return result

    def slope(self, next_weights: _Weights, step: float) -> _Weights:
        """Differentiate the weights by what a step has led to others by."""
        return _Weights(
            (next_weights.before - self.before) / step,
            (next_weights.after - self.after) / step,
            (next_weights.own - self.own) / step,
        )


@dataclass(frozen=True, eq=False)
class FilterReadings:
    """The readings along one signal history.

    Attributes:
        states: shape (k + 1, state): of the free run.
        interval_s: shape (k,).
        lag_s: time constant of the filter; what is not positive counts for next to none.
        first_a: the first reading.
        p: shape (coordinate,): of the motor.
        torque_constant: Kt in N m/A.
        is_digital: whether it is a moving average of the samples: over the usual interval as much
            of it is left as over that time of an analogue one.
    """

    states: Array
    interval_s: Array
    lag_s: float
    first_a: float
    p: Array
    torque_constant: float
    is_digital: bool = False

    @cached_property
    def current_a(self) -> Array:
        """What the sensor reads, shape (k + 1,)."""
        inputs_a = self._weights.inputs(self.states[:, :, None])
        first_a = np.array([[self.first_a]])
        readings: Array = recurrence(self._weights.own[None], inputs_a.T[:, None], first_a)[0, 0]
        return readings

    def derivatives(self, by_unknown: Array, by_logarithm: Array) -> Array:
        """Differentiate the readings.

        Args:
            by_unknown: shape (k + 1, state, unknown + parameter): derivatives of the states.
            by_logarithm: shape (coordinate, parameter): of the coordinates by the parameters, which
                are the last of those unknowns.

        Returns:
            Shape (k + 1, unknown + parameter + 2): by the same, then by the lag and by the first
            reading.
        """
        weights = self._weights
        states = self.states[:, :, None]
        inputs_a = weights.inputs(by_unknown)
        parameters = by_logarithm.shape[1]
        is_decisive = by_logarithm[_DECISIVE].any(axis=0) & (not self.is_digital)
        for place in np.flatnonzero(is_decisive).tolist():
            next_weights = self._weights_at(self.p + STEP * by_logarithm[:, place], self._lag_s)
            slope = weights.slope(next_weights, STEP)
            inputs_a[:, place - parameters] += slope.inputs(states)[:, 0]
        step_s = STEP * self._lag_s
        slope = weights.slope(self._weights_at(self.p, self._lag_s + step_s), step_s)
        by_lag = slope.inputs(states)[:, 0] + slope.own * self.current_a[:-1]
        columns = np.column_stack([inputs_a, by_lag, np.zeros_like(by_lag)])
        start = np.zeros((columns.shape[1], 1))
        start[-1] = 1.0
        rows = recurrence(weights.own[None], columns.T[:, None], start)
        return np.ascontiguousarray(rows[:, 0].T)

    @property
    def _lag_s(self) -> float:
        return max(self.lag_s, SHORTEST * self._usual_s)

    @cached_property
    def _usual_s(self) -> float:
        return float(median(self.interval_s))

    @cached_property
    def _weights(self) -> _Weights:
        return self._weights_at(self.p, self._lag_s)

    @cached_property
    def _middle_rad_s(self) -> Array:
        """Size of the speed in the middle of every interval, shape (k,)."""
        speed = self.states[:, State.SPEED]
        middle: Array = 0.5 * np.abs(speed[1:] + speed[:-1])
        return middle

    def _weights_at(self, p: Array, lag_s: float) -> _Weights:
        """Return the weights for other coordinates and another lag.

        With the law ``x' = A x + b`` the filter ``f' = (i - f) / lag`` ends at
        ``own f + u (x1 - own x0 - lag (1 - own) b)``; ``u`` is the current's row of
        ``(1 + lag A)^-1``, and ``b = (E - 1)^-1 A (x1 - E x0)`` with ``E = exp(A t)``.

        Args:
            p: shape (coordinate,).
            lag_s: positive.
        """
        if self.is_digital:
            own = np.full(self.interval_s.size, np.exp(-self._usual_s / lag_s))
            nothing = np.zeros((STATES, own.size))
            return _Weights(nothing, np.stack([1.0 - own, nothing[0]]), own)
        of_current = -p[_PLACES['resistance']] - p[_PLACES['hysteresis']] * self._middle_rad_s
        by_speed = -p[_PLACES['back_emf_constant']]
        by_current = self.torque_constant * p[_PLACES['inertia']]
        of_speed = -p[_PLACES['viscous_friction']]
        determinant = _filter_determinant(of_current, by_speed, by_current, of_speed, lag_s)
        if (np.abs(determinant) < APART).any():
            lag_s *= 1.0 + LITTLE
            determinant = _filter_determinant(of_current, by_speed, by_current, of_speed, lag_s)
        own = np.exp(-self.interval_s / lag_s)
        to_current = (1.0 + lag_s * of_speed) / determinant
        to_speed = -lag_s * by_speed / determinant
        half = 0.5 * (of_current - of_speed)
        mean = 0.5 * (of_current + of_speed)
        even, odd = _exponential(mean, half**2 + by_speed * by_current, self.interval_s)
        flow = (even + odd * half, odd * by_speed, odd * by_current, even - odd * half)
        change = (flow[0] - 1.0, flow[1], flow[2], flow[3] - 1.0)
        scale_s = lag_s * (1.0 - own) / (change[0] * change[3] - change[1] * change[2])
        first = scale_s * (to_current * change[3] - to_speed * change[2])
        second = scale_s * (to_speed * change[0] - to_current * change[1])
        drive_current = first * of_current + second * by_current
        drive_speed = first * by_speed + second * of_speed
        before = [
            drive_current * flow[0] + drive_speed * flow[2] - own * to_current,
            drive_current * flow[1] + drive_speed * flow[3] - own * to_speed,
        ]
        after = [to_current - drive_current, to_speed - drive_speed]
        return _Weights(np.stack(before), np.stack(after), own)


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
    slow = np.exp((mean + root) * interval_s)
    fast = np.exp((mean - root) * interval_s)
    even = 0.5 * (slow + fast)
    odd = 0.5 * (slow - fast) / root
    swings = square < 0.0
    if swings.any():
        decay = np.exp(mean * interval_s)
        even = np.where(swings, decay * np.cos(root * interval_s), even)
        odd = np.where(swings, decay * np.sin(root * interval_s) / root, odd)
    return even, odd
