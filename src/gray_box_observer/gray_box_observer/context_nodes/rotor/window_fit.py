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

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.normal_equations import (
    MAD_TO_STD,
    OUTLIER,
    bounded_solution,
    logarithmic_curvature,
    shortest_solution,
)
from gray_box_observer.context_nodes.rotor.window import (
    FreeRuns,
    Window,
    free_runs,
    guessed_starts,
)
from gray_box_observer.samples.order_statistics import median
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

MOST_IDLE = 2
"""Steps in a row that gain nothing and end a search."""

NEAR = 0.5
"""Standard deviations from where another search has ended within which a search ends there too."""

LONGEST_STEP = 1.0
"""Largest change of a logarithm in a step."""

LOOSE = 0.1
"""Information of a logarithm below which a step that it makes too long is cut for it alone: a
factor of e then moves chi-square by less than that."""

LEAST_NOISE = 3e-4
"""Smallest noise that is believed, as a share of the current's spread: what softened friction and
finite steps leave."""

PROMISING = 3
"""Starts that are searched from, of all that are tried."""

SHORT = 512
"""Samples of a first fit from a start that is not trusted."""

LEAST_START_GAIN = 1.0
"""Of chi-square, from which first states are moved by themselves before all else is."""

RESOLVED = 2.0
"""Sample intervals in L/R up to which the current's rise has several explanations."""

OTHERS = (0.2, 0.45, 3.0)
"""Times the inductance found from which it is searched again then."""

RIVAL = 9.0
"""Difference of chi-square up to which another optimum is as likely as not."""

STUCK = 2.0
"""Gain of chi-square that the equations promise, and no step brings, from which a search has ended
before a kink: where a rotor turns or is held, a sample can stand in the way."""

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
    tries_others: bool = True,
) -> Pieces[Fit | None]:
    """Fit the context nodes to a window; None where no start can be run.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from; the best few of many are taken.
        tries_others: whether other inductances are tried where the current settles within a few
            samples.
    """
    searches = []
    for start in starts:
        search = _Search(white_box, window, prior, np.log(start))
        yield from search.settle()
        if search.is_valid:
            searches.append(search)
    searches.sort(key=lambda search: search.scale_a)
    ends: list[_End] = []
    for search in searches[:PROMISING]:
        end = yield from _searched(search, ends)
        if end is not None:
            ends.append(end)
    if not ends:
        return None
    yield from _leap(min(ends, key=lambda end: _size(end.fit)), ends)
    if tries_others:
        yield from _try_others(min(ends, key=lambda end: _size(end.fit)), ends)
    noise = min(end.fit.noise_a for end in ends)
    fits = [end.fit for end in ends]
    fits.sort(key=lambda fit: fit.chi_square * (fit.noise_a / noise) ** 2 + _size(fit))
    return _with_rivals(fits, prior)


def _leap(best: _End, ends: list[_End]) -> Pieces[None]:
    """Search again from beyond what a search has stopped at, where it was to go on."""
    start = best.search
    if start.promised_gain < STUCK:
        return
    search = _Search(start.white_box, start.window, start.prior, start.beyond)
    yield from search.settle()
    if search.is_valid:
        end = yield from search.run(ends)
        if end is not None:
            ends.append(end)


def _try_others(best: _End, ends: list[_End]) -> Pieces[None]:
    """Search again from other inductances where the current settles within a few samples."""
    last, nodes = best.search, best.search.white_box.context_nodes
    values = dict(zip(nodes, best.fit.theta.tolist(), strict=True))
    interval_s = last.window.interval_s
    if values['inductance'] > RESOLVED * interval_s * values.get('resistance', np.inf):
        return
    for factor in OTHERS:
        neighbour = best.fit.logarithms.copy()
        neighbour[nodes.index('inductance')] += np.log(factor)
        search = _Search(last.white_box, last.window, last.prior, neighbour)
        yield from search.settle()
        if search.is_valid:
            end = yield from search.run(ends)
            if end is not None:
                ends.append(end)


def _size(fit: Fit) -> float:
    """Log-determinant of the noise of all samples: the larger noise is the worse fit."""
    return 2.0 * fit.runs.residual_a.size * float(np.log(fit.noise_a))


def search_from(
    white_box: MotorWhiteBox, window: Window, prior: LogPrior, start: Array
) -> Pieces[Fit | None]:
    """Fit a window from one start alone; None where it cannot be run. See :func:`fit_window`."""
    search = _Search(white_box, window, prior, np.log(start))
    yield from search.settle()
    if not search.is_valid:
        return None
    end = yield from search.run()
    return None if end is None else end.fit


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
    completed(search.settle())
    return search.runs


def _with_rivals(fits: Sequence[Fit], prior: LogPrior) -> Fit:
    """Widen the best end by other ends that are as likely."""
    best = fits[0]
    spread = best.spread
    covariance = np.linalg.pinv(best.information + prior.precision, hermitian=True)
    std = np.sqrt(np.maximum(np.diagonal(covariance), 1e-30))
    for other in fits[1:]:
        worse = _size(other) - _size(best) + other.chi_square - best.chi_square
        apart = other.logarithms - best.logarithms
        if worse < RIVAL and np.max(np.abs(apart) / std) > DISTINCT:
            share = 1.0 / (1.0 + float(np.exp(0.5 * max(worse, 0.0))))
            spread = spread + share * np.outer(apart, apart)
    return replace(best, spread=spread)


def _searched(search: _Search, ends: Sequence[_End]) -> Pieces[_End | None]:
    """Search from one start: on the newest samples first where there are many and it is far off."""
    if search.window.current_a.size > 2 * SHORT and search.scale_a > 0.1 * search.window.spread_a:
        short = search.window.tail(SHORT)
        if short.current_a.size == SHORT:
            near = _Search(search.white_box, short, search.prior, search.logarithms)
            yield from near.settle()
            if near.is_valid:
                yield from near.descend(ROUGHLY)
                again = _Search(search.white_box, search.window, search.prior, near.logarithms)
                yield from again.settle()
                search = again if again.is_valid and again.scale_a < search.scale_a else search
    return (yield from search.run(ends))


@dataclass(frozen=True, slots=True)
class _Accuracy:
    """How near a search goes to where it would end.

    Attributes:
        distance: in standard deviations, an unknown.
        gain: of chi-square in a step, which is none any more.
    """

    distance: float
    gain: float


ROUGHLY, NEARLY = _Accuracy(0.3, 0.3), _Accuracy(3e-3, 1e-2)
"""Of a search while outliers pull, which another one follows, and of the last one."""


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a step begins.

    Attributes:
        scale_a: robust standard deviation of the residual.
        total: chi-square.
        damping: of the step.
        gain: of chi-square, which is none any more.
    """

    scale_a: float
    total: float
    damping: float
    gain: float


@dataclass(frozen=True, slots=True)
class _End:
    """Where a search has ended.

    Attributes:
        fit: there.
        search: which.
        robust: shape (parameter,): logarithms where it stood while outliers still pulled.
    """

    fit: Fit
    search: _Search
    robust: Array


class _Search:
    """Damped Gauss-Newton from one start.

    Attributes:
        logarithms: shape (parameter,): where it stands.
        scale_a: robust standard deviation of the residual there; infinite before :meth:`settle`.
        promised_gain: of chi-square by the last step that was tried, if all were straight.
        beyond: shape (parameter,): where that leads.
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
        self.promised_gain, self.beyond = 0.0, self.logarithms
        self._leaves_out = False
        fastest = 2.0 * window.largest_voltage_v / float(white_box.known['back_emf_constant'])
        slowest = 1e-9 * (1.0 + fastest)
        self._start_std = np.array([10.0 * window.spread_a + 1e-9, fastest + slowest])
        self._start_precision = _start_precision(window, self._start_std)
        self._currents = window.currents
        self.starts = guessed_starts(white_box, np.exp(self.logarithms), window)
        self._runs: FreeRuns | None = None
        self.scale_a = np.inf

    def settle(self) -> Pieces[None]:
        """Run where the search begins, and move the first states alone to where they fit best."""
        self._runs = yield from self._run(self.logarithms, self.starts)
        if self._runs is not None:
            yield from self._settle_starts()
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

    def _run(self, logarithms: Array, starts: Array) -> Pieces[FreeRuns | None]:
        with np.errstate(all='ignore'):
            runs = free_runs(self.white_box, np.exp(logarithms), self.window, starts)
            slopes = (runs.by_logarithm, *(path.slopes[-1] for path in runs.runs))
            is_usable = runs.is_bounded and all(np.isfinite(slope).all() for slope in slopes)
        yield runs.work
        return runs if is_usable else None

    def _scale(self, residual: Array) -> float:
        """Noise of the current by its residuals, in whose unit those of the speed are."""
        currents = np.abs(residual[self._currents])
        return max(MAD_TO_STD * float(median(currents)), self._floor_a)

    def _settle_starts(self) -> Pieces[None]:
        """Move the first states alone to where they fit best."""
        for _ in range(2):
            scale = self._scale(self._at.residual_a)
            equations = self._equations(self._weights(scale), scale)
            steps = equations.start_steps(np.zeros(self.logarithms.size))
            pairs = zip(self._at.by_start, steps, strict=True)
            gain = sum(float(np.sum((slope @ step) ** 2)) for slope, step in pairs) / scale**2
            if gain < LEAST_START_GAIN:
                return
            starts = self.starts + steps
            runs = yield from self._run(self.logarithms, starts)
            if runs is None or self._scale(runs.residual_a) > scale:
                return
            self.starts, self._runs = starts, runs

    def _weights(self, scale: float) -> Array:
        limit, size = OUTLIER * scale, np.abs(self._at.residual_a)
        if self._leaves_out:
            near: Array = (size < limit).astype(float)
            return near
        weights: Array = limit / np.maximum(size, limit)
        return weights

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

    def run(self, ends: Sequence[_End] = ()) -> Pieces[_End | None]:
        """Step until nothing moves, then leave out what does not fit and step again.

        Args:
            ends: of other searches; one that comes near such an end is given up.

        Returns:
            The end; None where it is one of these, or nothing can be said of it.
        """
        self._leaves_out = False
        if (yield from self.descend(ROUGHLY, [(end.robust, end.fit) for end in ends])):
            return None
        robust, self._leaves_out = self.logarithms, True
        if (yield from self.descend(NEARLY, [(end.fit.logarithms, end.fit) for end in ends])):
            return None
        fit = self.result()
        return None if fit is None else _End(fit, self, robust)

    def descend(self, accuracy: _Accuracy, ends: Sequence[tuple[Array, Fit]] = ()) -> Pieces[bool]:
        """Step until nothing moves; tell whether that is where another search has ended."""
        damping, idle = 1e-3, 0
        for _ in range(MOST_STEPS):
            self.scale_a = scale = self._scale(self._at.residual_a)
            equations = self._equations(self._weights(scale), scale)
            if any(self._is_near(there, end, equations) for there, end in ends):
                return True
            towards_prior = self.prior.precision @ (self.prior.mean - self.logarithms)
            curvature = np.diag(logarithmic_curvature(towards_prior, equations.right))
            precision = equations.information + self.prior.precision + curvature
            right = equations.right + towards_prior
            step = np.linalg.lstsq(precision, right, rcond=1e-12)[0]
            self.promised_gain = left = float(right @ step)
            self.beyond = self.logarithms + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
            if left < accuracy.distance**2 * right.size:
                return False
            before = self._total(self._at.residual_a, scale, self.logarithms, self.starts)
            damping, has_moved = yield from self._stepped(
                equations, precision, right, _Place(scale, before, damping, accuracy.gain)
            )
            if not has_moved:
                return False
            after = self._total(self._at.residual_a, scale, self.logarithms, self.starts)
            idle = idle + 1 if before - after < accuracy.gain else 0
            if idle == MOST_IDLE:
                return False
        return False

    def _is_near(self, there: Array, end: Fit, equations: _Equations) -> bool:
        """Tell whether the search stands where another one has, within their deviations."""
        apart = self.logarithms - there
        precision = equations.information + end.information + self.prior.precision
        return bool(apart @ precision @ apart < NEAR**2)

    def _stepped(
        self,
        equations: _Equations,
        precision: Array,
        right: Array,
        at: _Place,
    ) -> Pieces[tuple[float, bool]]:
        """Take the first damped step that leads down; return the damping left, and whether any."""
        damping = at.damping
        size = np.maximum(np.diagonal(precision), 1e-12)
        most = np.where(np.diagonal(equations.information) < LOOSE, LONGEST_STEP, np.inf)
        for attempt in range(MOST_ATTEMPTS):
            own = 0.1**attempt if attempt < FREE_ATTEMPTS else 0.0
            step = bounded_solution(
                (precision + damping * np.diag(size))[None], right[None], -most, most
            )[0]
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            logarithms = np.clip(self.logarithms + step, self._lower, self._upper)
            step = logarithms - self.logarithms
            if attempt and 2.0 * step @ right - step @ precision @ step < at.gain:
                break
            starts = self.starts + equations.start_steps(step, own)
            runs = yield from self._run(logarithms, starts)
            if runs is not None:
                after = self._total(runs.residual_a, at.scale_a, logarithms, starts)
                if after <= at.total + 1e-9 * abs(at.total):
                    self.logarithms, self.starts, self._runs = logarithms, starts, runs
                    easier = 0.1 if attempt == 0 else 1.0
                    return max(easier * damping, 1e-9), True
            damping = max(10.0 * damping, 1e-6)
        return damping, False

    def result(self) -> Fit | None:
        """Return where the search has ended; None where nothing can be said of it."""
        residual = self._at.residual_a
        scale = self._scale(residual)
        weights = self._weights(scale)
        unknowns = self.logarithms.size + self.starts.size
        weighted_squares = (weights * residual**2)[self._currents]
        freedom = max(float(weights[self._currents].sum()) - unknowns, 1.0)
        noise = float(np.sqrt(weighted_squares.sum() / freedom))
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
        weighted_rows = by_parameter * weights[:, None]
        information = weighted_rows.T @ by_parameter
        right = weighted_rows.T @ runs.residual_a
        count, parameters = len(runs.by_start), by_parameter.shape[1]
        unknowns = start_pull.shape[1]
        gain, level = np.zeros((count, unknowns, parameters)), np.zeros((count, unknowns))
        begin = 0
        for row, by_start in enumerate(runs.by_start):
            own = slice(begin, begin + by_start.shape[0])
            begin = own.stop
            weighted_slopes = (by_start * weights[own, None]).T
            inner = weighted_slopes @ by_start + start_precision[row]
            across = weighted_slopes @ by_parameter[own]
            pull = weighted_slopes @ runs.residual_a[own] + start_precision[row] @ start_pull[row]
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
