"""Gauss-Newton on the free run of one motor's current, in the logarithms of its context nodes.

The first states of every signal history are free: they are eliminated, so that the equations that
are left are those of the parameters. White noise on the current is what is assumed; outliers are
left out, though only where the search has ended: until then the samples behind a step of the
voltage look like outliers, and tell most. Damped after Levenberg (1944), robust after Huber (1964).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import (
    MAD_TO_STD,
    OUTLIER,
    shortest_solution,
)
from gray_box_observer.context_nodes.rotor.window import (
    FreeRuns,
    Window,
    free_runs,
    guessed_starts,
)
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

MOST_STEPS = 20
"""Damped steps at most."""

MOST_ATTEMPTS = 8
"""Steps tried from one place, each shorter than the one before."""

FREE_ATTEMPTS = 3
"""Of these the first in which first states move, too.

Of a rotor that friction holds, the first speed has no derivative and would leap.
"""

TOLERANCE = 1e-3
"""A search ends when it would move by less than this share of a standard deviation."""

IDLE, MOST_IDLE = 1e-3, 3
"""Gain of chi-square that is none, and steps in a row without one that end a search."""

LONGEST_STEP = 1.0
"""Largest change of a logarithm in a step."""

LEAST_NOISE = 3e-4
"""Smallest noise that is believed, as a share of the current's spread: what softened friction and
finite steps leave."""

PROMISING = 3
"""Starts that are searched from, of all that are tried."""

SHORT = 512
"""Samples of a first fit from a start that is not trusted."""

RESOLVED = 2.0
"""Sample intervals in L/R up to which the current's rise has several explanations."""

OTHERS = (0.2, 0.45, 3.0)
"""Times the inductance found from which it is searched again then."""

RIVAL = 9.0
"""Difference of chi-square up to which another optimum is as likely as not."""

DISTINCT = 1.0
"""Standard deviations from which two ends of a search are two."""


@dataclass(frozen=True, slots=True)
class LogPrior:
    """What is believed of the logarithms of the parameters: Gaussian.

    Attributes:
        mean: shape (parameter,).
        precision: shape (parameter, parameter).
    """

    mean: Array
    precision: Array

    def joined(self, other: LogPrior) -> LogPrior:
        """Return what both together say."""
        precision = self.precision + other.precision
        right = self.precision @ self.mean + other.precision @ other.mean
        return LogPrior(shortest_solution(precision, right), precision)

    def chi_square(self, mean: Array) -> float:
        """How far a value is off."""
        off = mean - self.mean
        return float(off @ self.precision @ off)


@dataclass(frozen=True, slots=True)
class Fit:
    """Where a search has ended.

    Attributes:
        logarithms: shape (parameter,).
        information: shape (parameter, parameter): of the samples alone, without the prior.
        spread: shape (parameter, parameter): covariance that rival optima add.
        noise_a: standard deviation of the noise.
        least_noise_a: smallest one that is believed.
        chi_square: of the samples and the prior together.
        starts: shape (history, unknown): first states, and what else is free in a history.
        runs: the free runs there.
    """

    logarithms: Array
    information: Array
    spread: Array
    noise_a: float
    least_noise_a: float
    chi_square: float
    starts: Array
    runs: FreeRuns

    @property
    def theta(self) -> Array:
        """Shape (parameter,)."""
        result: Array = np.exp(self.logarithms)
        return result


def fit_window(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    *,
    is_resolved: bool = False,
) -> Fit | None:
    """Fit the context nodes to a window; None where no start can be run.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from; the best few of many are taken.
        is_resolved: whether the inductance is known too well for another one to be in question.
    """
    tried = [_Search(white_box, window, prior, np.log(start)) for start in starts]
    tried = [search for search in tried if search.is_valid]
    tried.sort(key=lambda search: search.scale_a)
    ended = [fit for fit in (_searched(search) for search in tried[:PROMISING]) if fit is not None]
    if not ended:
        return None
    if not is_resolved:
        ended += _unresolved(white_box, window, prior, min(ended, key=_size))
    noise = min(fit.noise_a for fit in ended)
    ended.sort(key=lambda fit: fit.chi_square * (fit.noise_a / noise) ** 2 + _size(fit))
    return _with_rivals(ended, prior)


def _unresolved(white_box: MotorWhiteBox, window: Window, prior: LogPrior, fit: Fit) -> list[Fit]:
    """Search again from other inductances where the current settles within a few samples."""
    values = dict(zip(white_box.context_nodes, fit.theta.tolist(), strict=True))
    interval_s = float(np.median(np.concatenate([h.interval_s for h in window.histories])))
    if values['inductance'] > RESOLVED * interval_s * values.get('resistance', np.inf):
        return []
    fits = []
    for factor in OTHERS:
        neighbour = fit.logarithms.copy()
        neighbour[white_box.context_nodes.index('inductance')] += np.log(factor)
        search = _Search(white_box, window, prior, neighbour)
        if search.is_valid:
            search.run()
            fits.append(search.result())
    return [other for other in fits if other is not None]


def _size(fit: Fit) -> float:
    """Log-determinant of the noise of all samples: the larger noise is the worse fit."""
    return 2.0 * fit.runs.residual_a.size * float(np.log(fit.noise_a))


def search_from(
    white_box: MotorWhiteBox, window: Window, prior: LogPrior, start: Array
) -> Fit | None:
    """Fit a window from one start alone; None where it cannot be run. See :func:`fit_window`."""
    search = _Search(white_box, window, prior, np.log(start))
    if not search.is_valid:
        return None
    search.run()
    return search.result()


def settled_runs(white_box: MotorWhiteBox, theta: Array, window: Window) -> FreeRuns | None:
    """Run freely at given values, the first states where they fit best; None where it cannot.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.
    """
    logarithms = np.log(theta)
    nothing = LogPrior(logarithms, np.zeros((theta.size, theta.size)))
    search = _Search(white_box, window, nothing, logarithms)
    return search.runs


def _with_rivals(ended: Sequence[Fit], prior: LogPrior) -> Fit:
    """Widen the best end by other ends that are as likely."""
    best = ended[0]
    spread = best.spread
    covariance = np.linalg.pinv(best.information + prior.precision, hermitian=True)
    std = np.sqrt(np.maximum(np.diagonal(covariance), 1e-30))
    for other in ended[1:]:
        worse = _size(other) - _size(best) + other.chi_square - best.chi_square
        apart = other.logarithms - best.logarithms
        if worse < RIVAL and np.max(np.abs(apart) / std) > DISTINCT:
            share = 1.0 / (1.0 + float(np.exp(0.5 * max(worse, 0.0))))
            spread = spread + share * np.outer(apart, apart)
    return replace(best, spread=spread)


def _searched(search: _Search) -> Fit | None:
    """Search from one start: on the newest samples first where there are many and it is far off."""
    if search.window.current_a.size > 2 * SHORT and search.scale_a > 0.1 * search.window.spread_a:
        short = search.window.tail(SHORT)
        if short.current_a.size == SHORT:
            near = _Search(search.white_box, short, search.prior, search.logarithms)
            if near.is_valid:
                near.run()
                again = _Search(search.white_box, search.window, search.prior, near.logarithms)
                search = again if again.is_valid and again.scale_a < search.scale_a else search
    search.run()
    return search.result()


class _Search:
    """Damped Gauss-Newton from one start.

    Attributes:
        logarithms: shape (parameter,): where it stands.
        scale_a: robust standard deviation of the residual there.
    """

    def __init__(
        self, white_box: MotorWhiteBox, window: Window, prior: LogPrior, logarithms: Array
    ) -> None:
        self.white_box = white_box
        self.window = window
        self.prior = prior
        lower, upper = bounds(white_box.parameters)
        self._lower, self._upper = np.log(lower), np.log(upper)
        self._floor_a = max(
            LEAST_NOISE * window.spread_a, window.quantisation_std_a, 1e-12 + 1e-9 * window.spread_a
        )
        self.logarithms = np.clip(logarithms, self._lower, self._upper)
        self._leaves_out = False
        fastest = 2.0 * window.largest_voltage_v / float(white_box.known['back_emf_constant'])
        slowest = 1e-9 * (1.0 + fastest)
        self._start_std = np.array([10.0 * window.spread_a + 1e-9, fastest + slowest])
        self._start_precision = _start_precision(window, self._start_std)
        self._currents = window.currents
        self.starts = guessed_starts(white_box, np.exp(self.logarithms), window)
        self._runs = self._run(self.logarithms, self.starts)
        self.scale_a = np.inf
        if self._runs is not None:
            self._settle_starts()
            self.scale_a = self._scale(self._at.residual_a)

    @property
    def runs(self) -> FreeRuns | None:
        """The free runs where it stands; None where they cannot be run."""
        return self._runs

    @property
    def is_valid(self) -> bool:
        """Whether the motor can be run where the search stands."""
        return self._runs is not None

    @property
    def _at(self) -> FreeRuns:
        assert self._runs is not None
        return self._runs

    def _run(self, logarithms: Array, starts: Array) -> FreeRuns | None:
        with np.errstate(all='ignore'):
            runs = free_runs(self.white_box, np.exp(logarithms), self.window, starts)
        return runs if runs.is_bounded and np.isfinite(runs.by_parameter).all() else None

    def _scale(self, residual: Array) -> float:
        """Noise of the current by its residuals, in whose unit those of the speed are."""
        currents = np.abs(residual[self._currents])
        return max(MAD_TO_STD * float(np.median(currents)), self._floor_a)

    def _settle_starts(self) -> None:
        """Move the first states alone to where they fit best."""
        for _ in range(2):
            scale = self._scale(self._at.residual_a)
            equations = self._equations(self._weights(scale), scale)
            starts = self.starts + equations.start_steps(np.zeros(self.logarithms.size))
            runs = self._run(self.logarithms, starts)
            if runs is None or self._scale(runs.residual_a) > scale:
                return
            self.starts, self._runs = starts, runs

    def _weights(self, scale: float) -> Array:
        limit, size = OUTLIER * scale, np.abs(self._at.residual_a)
        if self._leaves_out:
            near: Array = (size < limit).astype(float)
            return near
        pulled: Array = limit / np.maximum(size, limit)
        return pulled

    def _cost(self, residual: Array, scale: float) -> float:
        """Sum of squares; what lies beyond the limit counts less, or as one at the limit."""
        limit, size = OUTLIER * scale, np.abs(residual)
        within = np.minimum(size, limit)
        beyond = 0.0 if self._leaves_out else 2.0 * limit * (size - within)
        return float((within**2 + beyond).sum()) / scale**2

    def _total(self, residual: Array, scale: float, logarithms: Array, starts: Array) -> float:
        off = starts - self._start_mean(starts)
        if self.window.speed_output is None:
            pull = float(((off / self._start_std) ** 2).sum())
        else:
            pull = float(np.einsum('hu,huv,hv->', off, self._start_precision, off))
        return self._cost(residual, scale) + self.prior.chi_square(logarithms) + pull

    def _start_mean(self, starts: Array) -> Array:
        mean = np.zeros_like(starts)
        mean[:, 0] = [history.current_a[0] for history in self.window.histories]
        return mean

    def _equations(self, weights: Array, scale: float) -> _Equations:
        return _Equations.from_runs(
            self._at,
            weights / scale**2,
            self._start_precision,
            self._start_mean(self.starts) - self.starts,
        )

    def run(self) -> None:
        """Step until nothing moves, then leave out what does not fit and step again."""
        for self._leaves_out in (False, True):
            self._descend()

    def _descend(self) -> None:
        damping, idle = 1e-3, 0
        for _ in range(MOST_STEPS):
            self.scale_a = scale = self._scale(self._at.residual_a)
            equations = self._equations(self._weights(scale), scale)
            precision = equations.information + self.prior.precision
            right = equations.right + self.prior.precision @ (self.prior.mean - self.logarithms)
            before = self._total(self._at.residual_a, scale, self.logarithms, self.starts)
            neighbour, damping = self._stepped(
                equations, precision, right, (scale, before, damping)
            )
            if neighbour is None:
                return
            left = float(right @ np.linalg.lstsq(precision, right, rcond=1e-12)[0])
            after = self._total(self._at.residual_a, scale, self.logarithms, self.starts)
            idle = idle + 1 if before - after < IDLE else 0
            if left < TOLERANCE**2 * neighbour.size or idle == MOST_IDLE:
                return

    def _stepped(
        self,
        equations: _Equations,
        precision: Array,
        right: Array,
        at: tuple[float, float, float],
    ) -> tuple[Array | None, float]:
        """Take the first damped step that leads down; return it or None, and the damping left."""
        scale, before, damping = at
        size = np.maximum(np.diagonal(precision), 1e-12)
        for attempt in range(MOST_ATTEMPTS):
            own = 0.1**attempt if attempt < FREE_ATTEMPTS else 0.0
            step = shortest_solution(precision + damping * np.diag(size), right)
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            logarithms = np.clip(self.logarithms + step, self._lower, self._upper)
            step = logarithms - self.logarithms
            starts = self.starts + equations.start_steps(step, own)
            runs = self._run(logarithms, starts)
            if runs is not None:
                after = self._total(runs.residual_a, scale, logarithms, starts)
                if after <= before + 1e-9 * abs(before):
                    self.logarithms, self.starts, self._runs = logarithms, starts, runs
                    return step, max(0.1 * damping, 1e-9)
            damping = max(10.0 * damping, 1e-6)
        return None, damping

    def result(self) -> Fit | None:
        """Return where the search has ended; None where nothing can be said of it."""
        residual = self._at.residual_a
        scale = self._scale(residual)
        weights = self._weights(scale)
        unknowns = self.logarithms.size + self.starts.size
        weighted = (weights * residual**2)[self._currents]
        freedom = max(float(weights[self._currents].sum()) - unknowns, 1.0)
        noise = float(np.sqrt(weighted.sum() / freedom))
        noise = max(min(noise, 2.0 * scale), self._floor_a)
        equations = self._equations(weights, noise)
        information = 0.5 * (equations.information + equations.information.T)
        if not np.isfinite(information).all():
            return None
        chi_square = self._total(residual, noise, self.logarithms, self.starts)
        nothing = np.zeros_like(information)
        return Fit(
            self.logarithms,
            information,
            nothing,
            noise,
            self._floor_a,
            chi_square,
            self.starts,
            self._at,
        )


def _start_precision(window: Window, start_std: Array) -> Array:
    """Return what is known of the unknowns of every history, shape (history, unknown, unknown)."""
    output = window.speed_output
    if output is None:
        return np.stack([np.diag(start_std**-2.0) for _ in window.histories])
    return np.stack([output.precision(start_std, one.interval_s) for one in window.histories])


@dataclass(frozen=True, slots=True)
class _Equations:
    """Normal equations of the parameters, the first states eliminated.

    Attributes:
        information: shape (parameter, parameter).
        right: shape (parameter,).
        gain: shape (history, unknown, parameter): how the unknowns of the histories, their first
            states before all, answer the parameters.
        level: shape (history, unknown): how they move by themselves.
    """

    information: Array
    right: Array
    gain: Array
    level: Array

    @classmethod
    def from_runs(
        cls, runs: FreeRuns, weights: Array, start_precision: Array, start_pull: Array
    ) -> _Equations:
        """Build them.

        Args:
            runs: free runs at the values in question.
            weights: shape (sample,): inverse variances.
            start_precision: shape (history, unknown, unknown): what is known of the unknowns of
                every history beforehand.
            start_pull: shape (history, unknown): what is expected less what they are.
        """
        by_parameter = runs.by_parameter
        weighted = by_parameter * weights[:, None]
        information = weighted.T @ by_parameter
        right = weighted.T @ runs.residual_a
        count, parameters = len(runs.by_start), by_parameter.shape[1]
        unknowns = start_pull.shape[1]
        gain, level = np.zeros((count, unknowns, parameters)), np.zeros((count, unknowns))
        begin = 0
        for row, by_start in enumerate(runs.by_start):
            own = slice(begin, begin + by_start.shape[0])
            begin = own.stop
            turned = (by_start * weights[own, None]).T
            inner = turned @ by_start + start_precision[row]
            across = turned @ by_parameter[own]
            pull = turned @ runs.residual_a[own] + start_precision[row] @ start_pull[row]
            gain[row] = shortest_solution(inner, across)
            level[row] = shortest_solution(inner, pull)
            information = information - across.T @ gain[row]
            right = right - across.T @ level[row]
        return cls(information, right, gain, level)

    def start_steps(self, step: Array, own: float = 1.0) -> Array:
        """Return how the unknowns of the histories move with a step of the parameters.

        Args:
            step: shape (parameter,).
            own: share of what they would move by.

        Returns:
            Shape (history, unknown).
        """
        result: Array = own * (self.level - self.gain @ step)
        return result
