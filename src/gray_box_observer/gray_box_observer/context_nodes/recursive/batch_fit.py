"""Maximum likelihood over a window of samples: robust Gauss-Newton on the prediction error.

In the coordinates of :mod:`gray_box_observer.white_box.flow` the rate is linear in the unknowns, so
a few steps from the linear start are enough. With white torque noise the gain comes out as zero,
the prediction error is the output error, and the result stands at the Cramer-Rao bound
(docs/METHOD.md, The bound).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import Belief, Prior
from gray_box_observer.context_nodes.recursive.negligible import linear_std
from gray_box_observer.context_nodes.recursive.normal_equations import (
    OUTLIER,
    Scaling,
    bounded_solution,
    inverted,
    logarithmic_curvature,
    robust_std,
    solved,
    step_limits,
    weighted,
)
from gray_box_observer.context_nodes.recursive.trajectory import (
    COORDINATES,
    CURRENT,
    STATES,
    Linearised,
    SampleWindow,
    find_kicks,
    follow,
    follow_moves,
    linearise,
    recurrence,
    restart_variance,
    taken_over,
)
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.white_box.flow import within_bounds
from gray_box_observer.white_box.interface import Array, WhiteBox

MAX_STEPS = 15
TOLERANCE, TOLERANCE_STD = 1e-6, 1e-3
"""Gauss-Newton ends when no unknown moves by more, relative to itself, or all of them together in
standard deviations."""

ARRIVED = 1e-4
"""Last step, relative to the unknown, of a search that ends before it has arrived: along a valley,
as of R and Kb where the speed is that of the thesis. Its covariance is in the units of where it
stood before."""

RECOVERY = 2.0
"""Factor by which damped steps become longer again."""

CREDIBLE = 10.0
"""Times the size of the current (its 0.9 quantile): nothing is linearised about samples beyond."""

GAINS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Kalman gains tried against zero."""

GAIN_EVIDENCE = 8.0
"""Log-likelihood that a gain must bring: what is not there must not cost efficiency."""

RAMP_EVIDENCE = 12.0
"""Chi-square, of one degree of freedom, from which a coordinate is taken to have drifted during a
stretch."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit.

    Attributes:
        belief: at the last sample.
        ramp: shape (motor,): chi-square of one degree of freedom, how much a steady drift of what
            heats would explain.
        left_out: shape (motor,): samples that do not fit, and kicks of the state.
        linear_std: shape (motor, parameter): what the data alone leave open of the parameters
            themselves.
    """

    belief: Belief
    ramp: Array
    left_out: Array
    linear_std: Array

    def select(self, index: NDArray[np.intp]) -> Fit:
        """Return the result of the chosen motors."""
        ramp = self.ramp[index]
        left_out = self.left_out[index]
        linear = self.linear_std[index]
        return Fit(self.belief.select(index), ramp, left_out, linear)


def batch_fit(
    white_box: WhiteBox,
    stretch: SampleWindow,
    start: Array,
    prior: Prior,
    noise_floor: float,
    plain_steps: int = 2,
    least_noise: Array | float = 0.0,
) -> Fit:
    """Fit the coordinates and the first state to a stretch.

    Args:
        white_box: the physics.
        stretch: the samples.
        start: shape (motor, coordinate): where the search begins.
        prior: decides what the data leave open.
        noise_floor: smallest noise that is believed, as a fraction of the current's size.
        plain_steps: steps taken before any sample may be left out; more where the start may be far
            off, for then what does not fit is what tells.
        least_noise: shape (motor,): likewise in A, what quantisation leaves of it.
    """
    searches = []
    for search in _Search(white_box, stretch, start, prior, noise_floor, least_noise).run(
        plain_steps
    ):
        for part, is_disturbed in search.split(search.choose_gain()):
            searches += part.run(plain_steps) if is_disturbed else [part]
    fits = [search.result() for search in searches]
    if len(fits) == 1:
        return fits[0]
    order = np.argsort(np.concatenate([search.motors for search in searches]))
    beliefs = [fit.belief.arrays() for fit in fits]
    belief = Belief(
        **{name: np.concatenate([arrays[name] for arrays in beliefs])[order] for name in beliefs[0]}
    )
    names = ('ramp', 'left_out', 'linear_std')
    return Fit(
        belief, *(np.concatenate([getattr(fit, name) for fit in fits])[order] for name in names)
    )


class _Search:
    """Gauss-Newton on one stretch; what every iteration leaves for the next.

    Every motor searches for itself: how far it steps, what it leaves out and when it has arrived is
    its own affair, so that it finds what it would find alone. Those that have arrived leave the
    others to go on.

    Attributes:
        motors: which motors of the stretch it is about.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        stretch: SampleWindow,
        start: Array,
        prior: Prior,
        noise_floor: float,
        least_noise: Array | float,
    ) -> None:
        self.motors: NDArray[np.intp] = np.arange(start.shape[0])
        self._white_box = white_box
        self._prior = prior
        self._prior_precision = inverted(prior.covariance)
        self._stretch = stretch
        self._restarts = np.sum(stretch.restart, axis=1)
        measured_state = stretch.state
        self._size = np.maximum(quantile(np.abs(measured_state), 0.9), 1e-9)
        reach = CREDIBLE * self._size[:, None]
        self._measured_near = np.clip(measured_state, -reach, reach)
        self._floor = np.maximum(noise_floor * self._size, least_noise)
        self._p = within_bounds(white_box, start)
        self._about = self._measured_near
        self._first = self._about[:, 0]
        self._gain = np.zeros(measured_state.shape[0])
        self._loose = np.zeros_like(
            measured_state
        )  # variance that restarts leave in the predicted state
        self._scale = self._noise = np.full_like(self._size, np.inf)
        self._frame = Scaling(self._size, self._p)
        unknowns = start.shape[1] + STATES
        self._information = np.zeros((start.shape[0], unknowns, unknowns))
        self._precision = self._information
        self._begin()

    def _begin(self) -> None:
        self._best_scale, self._best_p = np.full_like(self._scale, np.inf), self._p
        self._damping = np.ones_like(self._scale)

    def select(self, selection: NDArray[np.bool_]) -> _Search:
        """Return the search of some of the motors."""
        if np.all(selection):
            return self
        index = np.flatnonzero(selection)
        part = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(part, name, value[index])
            else:
                setattr(
                    part,
                    name,
                    value.of_motors(index) if value is self._white_box else value.select(index),
                )
        return part

    def split(self, selection: NDArray[np.bool_]) -> list[tuple[_Search, bool]]:
        """Return the searches of the motors in a mask and of the others, where there are any."""
        return [
            (self.select(mask), is_marked)
            for mask, is_marked in ((selection, True), (~selection, False))
            if np.any(mask)
        ]

    def run(self, plain_steps: int) -> list[_Search]:
        """Iterate until nothing moves; return the searches that have come to an end."""
        converged_searches = []
        search = self
        search._begin()
        for iteration in range(MAX_STEPS):
            search._evaluate(robust=iteration >= plain_steps)
            advances = (search._scale <= 2.0 * search._best_scale) | (iteration == 0)
            if not advances.all():  # stepped too far: back, and shorter
                search._go_back(~advances)
                if not advances.any():
                    continue
            search._keep_best(advances)
            there = advances & search._step(advances)
            if iteration > plain_steps and np.any(there):
                converged_searches.append(search.select(there))
                if np.all(there):
                    return converged_searches
                search = search.select(~there)
        return [*converged_searches, search]

    def _keep_best(self, advances: NDArray[np.bool_]) -> None:
        """Keep the best coordinates so far of some motors, and let their steps be longer again."""
        longer = np.minimum(1.0, RECOVERY * self._damping)
        self._damping = np.where(advances, longer, self._damping)
        best = advances & (self._scale < self._best_scale)
        self._best_p = np.where(best[:, None], self._p, self._best_p)
        self._best_scale = np.where(best, self._scale, self._best_scale)

    def _go_back(self, worse: NDArray[np.bool_]) -> None:
        """Return some motors to their best coordinates so far, with smaller steps from there."""
        self._damping = np.where(worse, 0.3 * self._damping, self._damping)
        self._p = np.where(worse[:, None], self._best_p, self._p)
        self._about = np.where(worse[:, None], self._measured_near, self._about)
        self._first = self._about[:, 0]

    def _evaluate(self, *, robust: bool) -> None:
        """Predict the stretch from where we stand, and weigh its samples."""
        self._maps = linearise(self._white_box, self._p, self._stretch, self._about)
        gain = self._gains()
        self._predict(self._maps, gain)
        near = np.abs(self._residual) < OUTLIER * self._scale[:, None]
        if robust and not np.all(near):
            odd = ~near.all(
                axis=1, keepdims=True
            )  # whoever has no outlier is asked nothing, as it would be alone
            kicks = (
                find_kicks(self._path, self._residual, ~self._stretch.restart, self._sharp_scale())
                & odd
            )
            kicks &= ~follow_moves(kicks, self._stretch.moves)[:, None]
            if np.any(kicks):
                self._stretch = self._stretch.restarted(kicks)
                self._maps = linearise(self._white_box, self._p, self._stretch, self._about)
                gain = self._gains()
            self._predict(self._maps, gain * near)
            near = np.abs(self._residual) < OUTLIER * self._scale[:, None]
        self._weights = (self._stretch.valid & near if robust else self._stretch.valid) / (
            1.0 + self._loose
        )

    def _gains(self) -> Array:
        """Share of every sample's error that the state takes over, shape (motor, k + 1)."""
        steady = self._gain[:, None]
        restart = self._stretch.restart
        self._loose = restart_variance(self._maps.decay, restart)
        return np.maximum(steady, taken_over(self._loose))

    def _predict(self, maps: Linearised, gain: Array) -> None:
        self._path = follow(maps, self._stretch, self._first, gain)
        self._residual = self._stretch.state - self._path.state
        self._scale = np.maximum(robust_std(self._residual, self._stretch.valid), self._floor)

    def _sharp_scale(self) -> Array:
        """Noise by the residual's changes between samples, where a lasting kick counts once."""
        change = self._residual[:, 1:] - self._path.factor * self._residual[:, :-1]
        white = change / np.sqrt(1.0 + self._path.factor**2)
        sharp = np.minimum(self._scale, robust_std(white, ~self._stretch.restart))
        bounded_scale: Array = np.maximum(sharp, self._floor)
        return bounded_scale

    def _step(self, selection: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """One Gauss-Newton step of some of the motors; tell of each if it was small."""
        n = self._p.shape[1]
        p = self._p
        prior = self._prior
        frame = Scaling(self._size, p)
        jacobian = frame.jacobian(self._path)
        information, right = weighted(jacobian, self._weights, self._residual)
        if not (np.isfinite(information).all() and np.isfinite(right).all()):
            finite: NDArray[np.bool_] = np.all(np.isfinite(information), axis=(1, 2))
            finite &= np.all(np.isfinite(right), axis=1)
            information = np.where(
                finite[:, None, None], information, 0.0
            )  # numbers no float can square say nothing
            right = np.where(finite[:, None], right, 0.0)
        freedom = np.maximum(self._weights.sum(axis=1) - n - 1, 1.0)
        spread = np.sqrt(np.sum(self._weights * self._residual**2, axis=1) / freedom)
        noise = np.maximum(np.minimum(spread, 2.0 * self._scale), self._floor)
        pull = np.zeros_like(information)
        pull[:, COORDINATES, COORDINATES] = self._prior_precision * noise[:, None, None] ** 2
        state_information = np.maximum(information[:, CURRENT, CURRENT], self._size**2)
        pull[:, CURRENT, CURRENT] = 1e-12 * state_information + 1e-300
        towards = np.concatenate([np.zeros((p.shape[0], 1)), np.log(prior.p / p)], axis=1)
        precision = information + pull
        towards_prior = (pull @ towards[..., None])[..., 0]
        curvature = logarithmic_curvature(towards_prior, right)
        step = self._damping[:, None] * bounded_solution(
            precision + curvature[..., None] * np.eye(n + 1),
            right + towards_prior,
            *step_limits(n),
        )
        step = np.where(np.isfinite(step), step, 0.0)
        about = self._path.state + (jacobian @ step[..., None])[..., 0]
        next_p = within_bounds(self._white_box, p * (1.0 + step[:, COORDINATES]))
        if not np.all(selection):
            one = selection[:, None]
            two = selection[:, None, None]
            frame = Scaling(self._size, np.where(one, p, self._frame.p))
            noise = np.where(selection, noise, self._noise)
            precision = np.where(two, precision, self._precision)
            information = np.where(two, information, self._information)
            about = np.where(one, about, self._about)
            next_p = np.where(one, next_p, p)
        self._frame = frame
        self._noise = noise
        self._information = information
        self._precision = precision
        self._about = about
        self._first = about[:, 0]
        self._p = next_p
        step[:, COORDINATES] = next_p / p - 1.0
        distance2 = (step * (precision @ step[..., None])[..., 0]).sum(axis=1)
        is_small: NDArray[np.bool_] = (np.abs(step).max(axis=1) < TOLERANCE) | (
            distance2 < (TOLERANCE_STD * noise) ** 2
        )
        return is_small

    def choose_gain(self) -> NDArray[np.bool_]:
        """Adopt the gain that explains the window best, on clear evidence; tell where not 0."""
        count = np.sum(self._weights, axis=1)
        trust = self._weights > 0.0
        restart_gain = taken_over(self._loose)
        maps = self._maps.motion
        best = np.zeros_like(self._gain)
        least = self._spread(self._residual, trust)
        least = least * np.exp(-GAIN_EVIDENCE / np.maximum(count, 1.0))
        for gain in GAINS:
            path = follow(maps, self._stretch, self._first, np.maximum(gain, restart_gain) * trust)
            spread = self._spread(self._stretch.state - path.state, trust)
            best, least = np.where(spread < least, gain, best), np.minimum(spread, least)
        self._gain = best
        is_disturbed: NDArray[np.bool_] = best > 0.0
        return is_disturbed

    def _spread(self, residual: Array, trust: NDArray[np.bool_]) -> Array:
        spread: Array = np.sqrt(
            np.sum(trust * residual**2, axis=1) / np.maximum(np.sum(trust, axis=1), 1)
        )
        bounded_spread: Array = np.maximum(spread, self._floor)
        return bounded_spread

    def result(self) -> Fit:
        """Return where the search has ended."""
        transfer = self._frame.transfer(self._path)
        covariance = transfer @ inverted(self._precision) @ np.swapaxes(transfer, 1, 2)
        covariance[:, CURRENT, CURRENT] += taken_over(self._loose[:, -1]) / self._size**2
        if (short := np.abs(self._p / self._frame.p - 1.0).max(axis=1) > ARRIVED).any():
            there = self._frame.convert(covariance, Scaling(self._size, self._p))
            covariance = np.where(short[:, None, None], there, covariance)
        belief = Belief(
            self._size,
            self._p,
            self._about[:, -1],
            covariance,
            self._noise,
            self._gain,
            transfer[:, 0, 1:],
        )
        restarts = np.sum(self._stretch.restart, axis=1)
        left_out = (
            np.sum(self._stretch.valid & (self._weights == 0.0), axis=1) + restarts - self._restarts
        )
        linear = linear_std(self._frame.p, self._information, self._noise)
        return Fit(belief, self._ramp(), left_out.astype(float), linear)

    def _ramp(self) -> Array:
        """Score test of one further unknown: linear drift in time of the coordinates that heat."""
        heats = np.array([parameter.heats for parameter in self._white_box.parameters])
        if not np.any(heats):
            return np.zeros(self._p.shape[0])
        elapsed_s = np.cumsum(self._stretch.interval_s, axis=1)
        share = elapsed_s / np.maximum(elapsed_s[:, -1:], 1e-300)
        by_heat = np.einsum('jmk,mj->mk', self._maps.by_coordinate[heats], self._p[:, heats])
        inputs = np.where(self._stretch.restart, 0.0, by_heat * share)
        drift = recurrence(self._path.factor, inputs[None], np.zeros((1, self._p.shape[0])))[0]
        jacobian = self._frame.jacobian(self._path)
        information, right = weighted(jacobian, self._weights, drift)
        n = information.shape[1]
        ridge = 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] / n + 1e-300
        inside = solved(information + ridge * np.eye(n), right[..., None])
        remainder = (drift - (jacobian @ inside)[..., 0]) * self._weights
        size = np.sum(remainder**2, axis=1)
        statistic = np.sum(remainder * self._residual, axis=1) ** 2 / np.maximum(
            size * self._noise**2, 1e-300
        )
        clear: Array = np.where(
            size > 1e-9 * np.sum(drift**2 * self._weights, axis=1), statistic, 0.0
        )
        return np.nan_to_num(clear)
