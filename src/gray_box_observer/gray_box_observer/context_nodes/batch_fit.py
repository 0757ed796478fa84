"""Maximum likelihood over a stretch of samples: Gauss-Newton on the prediction error, robust against outliers.

In the coordinates of :mod:`gray_box_observer.white_box.flow` the rate is linear in the unknowns, so a few steps from
the linear start are enough. With white torque noise the gain comes out as zero, the prediction error is the output
error, and the result stands at the Cramer-Rao bound (docs/METHOD.md, The bound).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.belief import Belief, Prior
from gray_box_observer.context_nodes.normal_equations import OUTLIER, Frame, robust_std, weighted
from gray_box_observer.context_nodes.trajectory import (
    Linearised,
    Stretch,
    Trajectory,
    find_kicks,
    follow,
    linearise,
    recurrence,
)
from gray_box_observer.white_box.base import Array, WhiteBox
from gray_box_observer.white_box.flow import within_bounds

MAX_STEPS = 15
TOLERANCE = 1e-6
"""Gauss-Newton ends when no unknown moves by more, relative to itself."""

CREDIBLE = 10.0
"""Times the size of the current (its 0.9 quantile): nothing is linearised about samples beyond."""

GAINS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Kalman gains tried against zero."""

GAIN_EVIDENCE = 8.0
"""Log-likelihood that a gain must bring: what is not there must not cost efficiency."""


RAMP_EVIDENCE = 12.0
"""Chi-square, of one degree of freedom, from which a coordinate is taken to have drifted during a stretch."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a fit.

    Attributes:
        belief: at the last sample.
        ramp: shape (motor,): chi-square of one degree of freedom, how much a steady drift of what heats would explain.
        left_out: shape (motor,): samples that do not fit, and kicks of the state.
    """

    belief: Belief
    ramp: Array
    left_out: Array


def batch_fit(
    white_box: WhiteBox, stretch: Stretch, start: Array, prior: Prior, noise_floor: float, trusting: int = 2
) -> Fit:
    """Fit the coordinates and the first state to a stretch.

    Args:
        white_box: the physics.
        stretch: the samples.
        start: shape (motor, coordinate): where the search begins.
        prior: decides what the data leave open.
        noise_floor: smallest noise that is believed, as a fraction of the current's size.
        trusting: steps taken before any sample may be left out; more where the start may be far off, for then what does
            not fit is what tells.
    """
    search = _Search(white_box, stretch, start, prior, noise_floor)
    search.run(trusting)
    if search.choose_gain():
        search.run(trusting)
    return search.result()


class _Search:
    """Gauss-Newton on one stretch; what every iteration leaves for the next."""

    def __init__(self, white_box: WhiteBox, stretch: Stretch, start: Array, prior: Prior, noise_floor: float) -> None:
        self._white_box = white_box
        self._prior = prior
        self._precision = np.linalg.inv(prior.covariance)
        self._stretch = stretch
        self._restarts = np.sum(stretch.restart, axis=1)
        measured = stretch.state
        self._size = np.maximum(np.quantile(np.abs(measured), 0.9, axis=1), 1e-9)
        reach = CREDIBLE * self._size[:, None]
        self._measured_near = np.clip(measured, -reach, reach)
        self._floor = noise_floor * self._size
        self._p = within_bounds(white_box, start)
        self._about = self._measured_near
        self._first = self._about[:, 0]
        self._gain = np.zeros(measured.shape[0])
        self._scale = np.full(measured.shape[0], np.inf)

    def run(self, trusting: int) -> None:
        """Iterate until nothing moves."""
        best_scale, best_p, damping = np.full_like(self._scale, np.inf), self._p, 1.0
        for iteration in range(MAX_STEPS):
            self._evaluate(robust=iteration >= trusting)
            worse = ~(self._scale <= 2.0 * best_scale)
            if np.any(worse) and iteration > 0:  # stepped too far: back, and shorter
                damping *= 0.3
                self._p = np.where(worse[:, None], best_p, self._p)
                self._about = np.where(worse[:, None], self._measured_near, self._about)
                self._first = self._about[:, 0]
                continue
            best_p = np.where((self._scale < best_scale)[:, None], self._p, best_p)
            best_scale = np.minimum(self._scale, best_scale)
            if self._step(damping) < TOLERANCE and iteration > trusting:
                break

    def _evaluate(self, *, robust: bool) -> None:
        """Predict the stretch from where we stand, and weigh its samples."""
        self._maps = linearise(self._white_box, self._p, self._stretch, self._about)
        gain = np.tile(self._gain[:, None], (1, self._stretch.state.shape[1]))
        self._predict(self._maps, gain)
        near = np.abs(self._residual) < OUTLIER * self._scale[:, None]
        if robust and not np.all(near):
            kicks = find_kicks(self._path, self._residual, ~self._stretch.restart, self._sharp_scale())
            if np.any(kicks):
                self._stretch = self._stretch.restarted(kicks)
                self._maps = linearise(self._white_box, self._p, self._stretch, self._about)
            self._predict(self._maps, gain * near)
            near = np.abs(self._residual) < OUTLIER * self._scale[:, None]
        self._weights = (self._valid & near if robust else self._valid).astype(float)

    def _predict(self, maps: Linearised, gain: Array) -> None:
        self._path: Trajectory = follow(maps, self._stretch, self._first, gain)
        self._residual = self._stretch.state - self._path.state
        self._scale = np.maximum(robust_std(self._residual, self._valid), self._floor)

    def _sharp_scale(self) -> Array:
        """Noise by how the residual changes between samples: a kick counts there once, however long it stays."""
        change = self._residual[:, 1:] - self._path.factor * self._residual[:, :-1]
        white = change / np.sqrt(1.0 + self._path.factor**2)
        sharp = np.minimum(self._scale, robust_std(white, ~self._stretch.restart))
        floored: Array = np.maximum(sharp, self._floor)
        return floored

    @property
    def _valid(self) -> NDArray[np.bool_]:
        first = np.ones((self._stretch.state.shape[0], 1), dtype=bool)
        return np.concatenate([first, ~self._stretch.restart], axis=1)

    def _step(self, damping: float) -> float:
        """One Gauss-Newton step; return the largest relative move."""
        n, p, prior = self._p.shape[1], self._p, self._prior
        self._frame = Frame(self._size, p)
        jacobian = self._frame.jacobian(self._path)
        information, right = weighted(jacobian, self._weights, self._residual)
        finite = np.all(np.isfinite(information), axis=(1, 2)) & np.all(np.isfinite(right), axis=1)
        information = np.where(finite[:, None, None], information, 0.0)  # numbers no float can square say nothing
        right = np.where(finite[:, None], right, 0.0)
        freedom = np.maximum(self._weights.sum(axis=1) - n - 1, 1.0)
        spread = np.sqrt(np.sum(self._weights * self._residual**2, axis=1) / freedom)
        self._noise = np.maximum(np.minimum(spread, 2.0 * self._scale), self._floor)
        pull = np.zeros_like(information)
        pull[:, 1:, 1:] = self._precision * self._noise[:, None, None] ** 2
        pull[:, 0, 0] = 1e-12 * np.maximum(information[:, 0, 0], self._size**2) + 1e-300
        towards = np.concatenate([np.zeros((p.shape[0], 1)), np.log(prior.p / p)], axis=1)
        self._covariance = np.linalg.inv(information + pull)
        step = damping * (self._covariance @ (right[..., None] + pull @ towards[..., None]))[..., 0]
        step = np.nan_to_num(step, nan=0.0, posinf=0.0, neginf=0.0)
        step[:, 1:] = np.clip(step[:, 1:], -0.5, 1.0)
        self._about = self._path.state + (jacobian @ step[..., None])[..., 0]
        self._first = self._about[:, 0]
        self._p = within_bounds(self._white_box, p * (1.0 + step[:, 1:]))
        return float(np.max(np.abs(step)))

    def choose_gain(self) -> bool:
        """Take the gain that explains the stretch best, if the evidence is clear; tell whether it is not zero."""
        count = np.sum(self._weights, axis=1)
        trust = self._weights.astype(bool)
        best, least = np.zeros_like(self._gain), self._spread(self._residual, trust)
        least = least * np.exp(-GAIN_EVIDENCE / np.maximum(count, 1.0))
        for gain in GAINS:
            path = follow(self._maps, self._stretch, self._first, gain * trust)
            spread = self._spread(self._stretch.state - path.state, trust)
            best, least = np.where(spread < least, gain, best), np.minimum(spread, least)
        self._gain = best
        return bool(np.any(best > 0.0))

    def _spread(self, residual: Array, trust: NDArray[np.bool_]) -> Array:
        spread: Array = np.sqrt(np.sum(trust * residual**2, axis=1) / np.maximum(np.sum(trust, axis=1), 1))
        floored: Array = np.maximum(spread, self._floor)
        return floored

    def result(self) -> Fit:
        """Return where the search has ended."""
        transfer = self._frame.transfer(self._path)
        covariance = transfer @ self._covariance @ np.swapaxes(transfer, 1, 2)
        belief = Belief(
            self._size, self._p, self._about[:, -1], covariance, self._noise, self._gain, transfer[:, 0, 1:]
        )
        restarts = np.sum(self._stretch.restart, axis=1)
        left_out = np.sum(self._valid & (self._weights == 0.0), axis=1) + restarts - self._restarts
        return Fit(belief, self._ramp(), left_out.astype(float))

    def _ramp(self) -> Array:
        """Score test of one further unknown: a drift, linear in time, of the coordinates that heat."""
        heats = np.array([parameter.heats for parameter in self._white_box.parameters])
        if not np.any(heats):
            return np.zeros(self._p.shape[0])
        passed = np.cumsum(self._stretch.interval_s, axis=1)
        share = passed / np.maximum(passed[:, -1:], 1e-300)
        by_heat = np.einsum('jmk,mj->mk', self._maps.by_coordinate[heats], self._p[:, heats])
        inputs = np.where(self._stretch.restart, 0.0, by_heat * share)
        drift = recurrence(self._path.factor, inputs[None], np.zeros((1, self._p.shape[0])))[0]
        jacobian = self._frame.jacobian(self._path)
        information, right = weighted(jacobian, self._weights, drift)
        n = information.shape[1]
        ridge = 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] / n + 1e-300
        inside = np.linalg.solve(information + ridge * np.eye(n), right[..., None])
        left = (drift - (jacobian @ inside)[..., 0]) * self._weights
        size = np.sum(left**2, axis=1)
        statistic = np.sum(left * self._residual, axis=1) ** 2 / np.maximum(size * self._noise**2, 1e-300)
        clear: Array = np.where(size > 1e-9 * np.sum(drift**2 * self._weights, axis=1), statistic, 0.0)
        return np.nan_to_num(clear)
