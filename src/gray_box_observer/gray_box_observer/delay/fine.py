"""The delay as one more unknown of the maximum-likelihood fit, to a fraction of a sample interval.

Gauss-Newton on the prediction error in (first state, coordinates, delay), with the same linearised
trajectories as :mod:`gray_box_observer.context_nodes.recursive.batch_fit`; the derivative by the
delay is a difference of two trajectories. What is compared at the end is the likelihood with the
delay free and with the delay held where it was taken to be, the parameters free in both.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.linear_start import linear_start
from gray_box_observer.context_nodes.recursive.normal_equations import (
    OUTLIER,
    Scaling,
    bounded_solution,
    robust_std,
    step_limits,
    weighted,
)
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow, follow, linearise
from gray_box_observer.context_nodes.rotor.voltage_parts import equivalent_voltage
from gray_box_observer.delay.coarse import credible
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.samples.raw_history import RawSignals
from gray_box_observer.white_box.flow import to_parameters, within_bounds
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

STEPS = 12
TOLERANCE = 0.02
"""Gauss-Newton ends when a step is smaller, in standard deviations of all unknowns together."""

LEAST_GAIN, MOST_IDLE = 0.1, 2
"""Log-likelihood below which a step has gained nothing, and so many of these in a row end it."""

GAINS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
"""Kalman gains tried against zero: what the white box does not explain must not be taken for a
delay."""

GAIN_EVIDENCE = 8.0
CLIP = 6.0
"""Standard deviations beyond which a residual counts no more: likelihoods are compared on all
samples alike."""

NOISE_FLOOR = 1e-4
PRIOR_STD = 2.0


@dataclass(frozen=True)
class Fitted:
    """One maximum of the likelihood.

    Attributes:
        delay_s: where.
        std_s: standard deviation of the delay; 0 where it was held.
        loss_a2: Huber's loss, half the sum of squares but for outliers.
        noise_a: standard deviation of the prediction error of the current, where the data speak of
            the delay.
        correlation_length: so many neighbouring prediction errors count for one there; 1 where they
            are white.
    """

    delay_s: float
    std_s: float
    loss_a2: float
    noise_a: float
    correlation_length: float


class FineSearch:
    """Gauss-Newton over one stretch of signals.

    Args:
        white_box: the physics.
        signals: voltage and torque; the voltage is known wherever the delay may lead.
        restart: shape (n - 1,): where the signal history starts anew.
        interval_s: usual time between torques.
        initial: shape (1, coordinate): first guess of the coordinates.
        reach_s: smallest and largest delay.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        signals: RawSignals,
        restart: NDArray[np.bool_],
        interval_s: float,
        initial: Array,
        reach_s: tuple[float, float],
    ) -> None:
        self._white_box = white_box
        self._signals = signals
        self._restart = restart[None]
        self._interval_s = interval_s
        self._initial = initial
        self._reach_s = reach_s
        self._state = white_box.state(signals.torque_nm)[None]
        near = credible(self._state[0])[None]
        self._near = near
        size = np.maximum(quantile(np.abs(near), 0.9), 1e-9)
        self._size: Array = np.maximum(size, 0.1 * np.max(np.abs(near), axis=1))
        self._floor: Array = NOISE_FLOOR * self._size

    def fit(self, delay_s: float, *, free: bool) -> Generator[None, None, Fitted]:
        """Climb from a delay, held or free; yield after each piece of work, return the maximum."""
        self._start(delay_s)
        yield
        yield from self._climb(free)
        if self._choose_gain():
            yield
            yield from self._climb(free)
        return self._fitted(free)

    @property
    def _decay_rate(self) -> float:
        """R/L in 1/s, at the present values; 0 where it is not known."""
        if not isinstance(self._white_box, MotorWhiteBox):
            return 0.0
        values = self._white_box.values(to_parameters(self._p)[0])
        return values.get('resistance', 0.0) / values['inductance']

    def _start(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._gain = 0.0
        self._p = self._initial
        stretch = replace(self._stretch(delay_s), state=self._near)
        window = min(20, stretch.voltage_v.shape[1] // 4)
        self._p = within_bounds(
            self._white_box, linear_start(self._white_box, self._initial, stretch, window)
        )
        self._about = self._near
        self._first = self._near[:, 0]

    def _stretch(self, delay_s: float) -> SampleWindow:
        times = self._signals.time_s
        interval = np.diff(times)[None]
        moves = self._signals.between(times - delay_s)
        voltage = equivalent_voltage(*moves, interval[0] * self._decay_rate)[None]
        voltage = np.where(self._restart, 0.0, voltage)
        interval = np.where(self._restart, 0.0, interval)
        return SampleWindow(
            self._state, voltage, interval, self._signals.speed_rad_s[None], self._restart
        )

    def _climb(self, free: bool) -> Generator[None, None, None]:
        least = math.inf
        idle = 0
        for iteration in range(STEPS):
            is_small = self._step(free)
            gain = 0.5 * np.count_nonzero(self._valid) * np.log(least / self._noise2)
            least = min(least, self._noise2)
            idle = 0 if gain > LEAST_GAIN else idle + 1
            if iteration > 2 and (is_small or idle == MOST_IDLE):
                return
            yield

    def _evaluate(self) -> None:
        """Predict the stretch from where we stand, and weigh its samples (Huber)."""
        stretch = self._stretch(self._delay_s)
        self._maps = linearise(self._white_box, self._p, stretch, self._about)
        self._predict(stretch, self._gain)
        if self._gain > 0.0:  # an outlier must not be followed
            self._predict(stretch, self._gain * (np.abs(self._residual) < OUTLIER * self._scale))
        weights = np.minimum(
            1.0, OUTLIER * self._scale / np.maximum(np.abs(self._residual), 1e-300)
        )
        self._weights = weights * self._valid

    def _predict(self, stretch: SampleWindow, gain: float | NDArray[np.floating[Any]]) -> None:
        self._gains = gain * np.ones_like(self._state)
        self._path = follow(self._maps, stretch, self._first, self._gains)
        self._residual = self._state - self._path.state
        self._scale = np.maximum(robust_std(self._residual, self._valid), self._floor)[:, None]

    @cached_property
    def _valid(self) -> NDArray[np.bool_]:
        return np.concatenate([np.ones((1, 1), dtype=bool), ~self._restart], axis=1)

    def _step(self, free: bool) -> bool:
        """One Gauss-Newton step; tell whether it was a small one."""
        self._evaluate()
        n = self._p.shape[1]
        jacobian = Scaling(self._size, self._p).jacobian(self._path)
        if free:
            jacobian = np.concatenate([jacobian, self._by_delay()[..., None]], axis=2)
        information, right = weighted(jacobian, self._weights, self._residual)
        near = np.minimum(np.abs(self._residual), OUTLIER * self._scale) * self._valid
        noise2 = float(np.sum(near**2) / max(np.sum(self._valid) - n - 2, 1.0))
        self._noise2 = max(noise2, float(self._floor[0]) ** 2)
        pull = np.full(information.shape[1], self._noise2 / PRIOR_STD**2)
        if free:  # unknown in units of one interval
            pull[-1] *= (PRIOR_STD * self._interval_s / (self._reach_s[1] - self._reach_s[0])) ** 2
        matrix = information[0] + np.diag(pull)
        if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(right))):
            return True
        self._covariance = np.linalg.inv(matrix)
        smallest, largest = step_limits(n)
        if free:
            smallest, largest = np.append(smallest, -1.0), np.append(largest, 1.0)
        step = bounded_solution(matrix[None], right, smallest, largest)[0]
        shift = float(step[-1]) if free else 0.0
        self._about = self._path.state + (jacobian @ step)
        self._first = self._about[:, 0]
        self._p = within_bounds(self._white_box, self._p * (1.0 + step[1 : n + 1]))
        self._delay_s = float(np.clip(self._delay_s + shift * self._interval_s, *self._reach_s))
        return bool(step @ information[0] @ step < TOLERANCE**2 * self._noise2)

    def _by_delay(self) -> Array:
        """Derivative of the prediction by the delay in sample intervals, by central difference."""
        paths = []
        for side in (-0.25, 0.25):
            stretch = self._stretch(self._delay_s + side * self._interval_s)
            maps = linearise(self._white_box, self._p, stretch, self._about).motion
            paths.append(follow(maps, stretch, self._first, self._gains).state)
        slope: Array = (paths[1] - paths[0]) / 0.5
        return slope

    def _choose_gain(self) -> bool:
        """Take the gain that explains the signals best, if the evidence is clear."""
        self._evaluate()
        self._maps = self._maps.motion
        stretch = self._stretch(self._delay_s)
        least = self._spread()
        count = float(np.sum(self._valid))
        best_gain = 0.0
        near = np.abs(self._residual) < OUTLIER * self._scale
        for gain in GAINS:
            self._predict(stretch, gain * near)
            spread = self._spread()
            if count * np.log(least / spread) > (GAIN_EVIDENCE if best_gain == 0.0 else 0.0):
                best_gain = gain
                least = spread
        self._gain = best_gain
        return best_gain > 0.0

    def _spread(self) -> float:
        near = np.minimum(np.abs(self._residual), CLIP * self._scale)[self._valid]
        return float(max(np.sqrt(np.mean(near**2)), self._floor[0]))

    def _fitted(self, free: bool) -> Fitted:
        """Judge the maximum: the uncertainty of the delay, from noise where data allow it."""
        self._evaluate()
        residual = self._residual[0] * self._valid[0]
        limit = OUTLIER * float(self._scale[0, 0])
        size = np.abs(residual)
        loss = float(
            np.sum(np.where(size < limit, 0.5 * residual**2, limit * (size - 0.5 * limit)))
        )
        if not free:
            return Fitted(self._delay_s, 0.0, loss, math.sqrt(self._noise2), 1.0)
        jacobian = np.concatenate(
            [Scaling(self._size, self._p).jacobian(self._path), self._by_delay()[..., None]], axis=2
        )
        influence = (jacobian[0] * self._weights[0, :, None]) @ self._covariance[-1]
        floor = float(self._floor[0])
        square = np.minimum(size, limit) ** 2 + floor**2
        local = float(np.sum(influence**2 * square))
        leverage = max(float(np.sum(influence**2)), 1e-300)
        noise = math.sqrt(max(local / leverage, self._noise2))
        pairs = np.abs(influence[1:] * influence[:-1]) * residual[1:] * residual[:-1]
        correlation = min(max(float(np.sum(pairs)) / max(local, 1e-300), 0.0), 0.99)
        correlation_length = (1.0 + correlation) / (1.0 - correlation)
        std = noise * math.sqrt(max(float(self._covariance[-1, -1]), 0.0) * correlation_length)
        effective_count = leverage**2 / max(
            float(np.sum(influence**4)), 1e-300
        )  # no more can count for one than there are
        return Fitted(
            self._delay_s,
            std * self._interval_s,
            loss,
            noise,
            min(correlation_length, effective_count),
        )


def evidence(best: Fitted, held_fit: Fitted) -> float:
    """Log-likelihood gain of the best delay over the held one, less for correlated residuals."""
    scale = best.noise_a**2 * best.correlation_length
    return (
        (held_fit.loss_a2 - best.loss_a2) / scale if scale > 0.0 else 0.0
    )  # a motor at rest says nothing
