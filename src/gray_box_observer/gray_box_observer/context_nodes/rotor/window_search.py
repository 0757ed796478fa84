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

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.normal_equations import (
    OUTLIER,
    bounded_solution,
    logarithmic_curvature,
)
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns, free_runs, guessed_starts
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.noise_filter import ReadingNoise
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.context_nodes.rotor.window import FEWEST, Window
from gray_box_observer.context_nodes.rotor.window_equations import (
    Equations,
    robust_cost,
    robust_weights,
    start_mean,
    start_precision,
    without_noise,
)
from gray_box_observer.context_nodes.rotor.window_noise import WindowNoise, noise_of
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.declaration import State
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

SHORTEST = 0.03
"""Shortest L/R that a step leads to, in sample intervals. A run of a shorter one takes so many
steps that it is given up. Samples hardly tell one: R moves by so many intervals over the mechanical
time constant, a percent where that is three of them."""

LOOSE = 0.1
"""Information of a logarithm below which a step that it makes too long is cut for it alone: a
factor of e then moves chi-square by less than that."""

LEAST_NOISE = 3e-4
"""Smallest noise that is believed, as a share of the current's spread: what softened friction and
finite steps leave."""

FEW = 3
"""Intervals that tell the speed of a rotor which forgets it soon."""

MOST_SETTLED = 4
"""Steps at most in which first states are moved by themselves where the parameters are believed."""

STILL = 2e-3
"""Standard deviation of the back-EMF of a rotor that is at rest, as a share of the largest voltage,
beside what the noise of a current of none may hide."""

LEAST_START_GAIN = 1.0
"""Of chi-square, from which first states are moved by themselves before all else is."""

NO_START_GAIN = 0.1
"""The same, below which they are not moved any more where the parameters are believed."""


@dataclass(frozen=True)
class Accuracy:
    """How near a search goes to where it would end.

    Attributes:
        distance: in standard deviations, an unknown.
        gain: of chi-square in a step, which is none any more.
    """

    distance: float
    gain: float


ROUGHLY = Accuracy(0.3, 0.3)
"""Of a search while outliers pull, which another one follows."""

NEARLY = Accuracy(0.02, 1e-2)
"""Of the last search."""


@dataclass(frozen=True, eq=False)
class SearchEnd:
    """Where a search has ended.

    Attributes:
        fit: there.
        search: which.
        robust: shape (parameter,): logarithms where it stood while outliers still pulled.
    """

    fit: Fit
    search: Search
    robust: Array


class Search:
    """Damped Gauss-Newton from one start.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        prior: decides what the samples leave open.
        logarithms: shape (parameter,): where it begins.
        rests: shape (history,): histories that begin with a rotor at rest, without a current; None:
            that is told of none.

    Attributes:
        voltage_noise: that the current does not answer: what it does is taken off.
        looks_for_noise: whether there may be any.
        logarithms: shape (parameter,): where it stands.
        rests: as above.
        scale_a: robust standard deviation of the residual there; infinite before :meth:`settle`.
        promised_gain: of chi-square by the last step that was tried, if all were straight.
        beyond: shape (parameter,): where that leads.
    """

    looks_for_noise = True

    def __init__(
        self,
        white_box: MotorWhiteBox,
        window: Window,
        prior: LogPrior,
        logarithms: Array,
        *,
        rests: Array | None = None,
    ) -> None:
        self.white_box = white_box
        self.voltage_noise = NO_NOISE
        self._noise: ReadingNoise | None = None
        self.window = window
        self.prior = prior
        lower, upper = bounds(white_box.parameters)
        self._lower, self._upper = np.log(lower), np.log(upper)
        self._floor_a = max(
            LEAST_NOISE * window.spread_a, window.quantisation_std_a, 1e-12 + 1e-9 * window.spread_a
        )
        self._shortest_s = SHORTEST * window.interval_s
        self.logarithms = np.clip(logarithms, self._lower, self._upper)
        self.promised_gain = 0.0
        self.beyond = self.logarithms
        self._leaves_out = False
        fastest = 2.0 * window.largest_voltage_v / float(white_box.known['back_emf_constant'])
        slowest = 1e-9 * (1.0 + fastest)
        start_std = np.array([10.0 * window.spread_a + 1e-9, fastest + slowest])
        self._start_std = np.tile(start_std, (len(window.histories), 1))
        self._currents = window.currents
        self.starts = guessed_starts(white_box, np.exp(self.logarithms), window)
        self.rests = rests
        if rests is not None:
            self.starts[rests, State.SPEED] = 0.0
            noise_a = window.reading_noise_a + self._floor_a
            ohms = white_box.values(np.exp(self.logarithms))['resistance']
            still_v = STILL * window.largest_voltage_v + ohms * noise_a
            kb = float(white_box.known['back_emf_constant'])
            self._start_std[rests] = noise_a, still_v / kb + slowest
        self._start_precision = start_precision(window, self._start_std)
        self._runs: FreeRuns | None = None
        self.scale_a = np.inf

    def _within_bounds(self, logarithms: Array) -> Array:
        """Return the nearest logarithms that a step may lead to: L/R gets no shorter than SHORTEST.

        Where the search stands below that, as a data sheet may have it, it may stay there.
        """
        within = logarithms.copy()
        nodes = self.white_box.context_nodes
        if 'inductance' in nodes:
            resistance = self.white_box.values(np.exp(within))['resistance']
            place = nodes.index('inductance')
            shortest = min(np.log(self._shortest_s * resistance), self.logarithms[place])
            within[place] = max(within[place], shortest)
        return np.asarray(np.clip(within, self._lower, self._upper), dtype=float)

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
            theta = np.exp(logarithms)
            runs = free_runs(self.white_box, theta, self.window, starts, noise=self._noise)
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
            steps, gain = self._start_steps(scale)
            if gain < LEAST_START_GAIN:
                return
            starts = self.starts + steps
            runs = yield from self._run(self.logarithms, starts)
            if runs is None or self._scale(runs.residual_a) > scale:
                return
            self.starts = starts
            self._runs = runs

    def _start_steps(self, scale: float) -> tuple[Array, float]:
        """Return how first states alone would move, and what that gains if all were straight.

        Args:
            scale: noise of the current.
        """
        equations = self._equations(self._weights(scale), scale)
        steps = equations.start_steps(np.zeros(self.logarithms.size))
        pairs = zip(self._at.by_start, steps, strict=True)
        gain = sum(float(np.sum((slope @ step) ** 2)) for slope, step in pairs) / scale**2
        return steps, gain

    def settle_starts_of_motor(self) -> Pieces[None]:
        """Move the first states on, where the parameters are believed, as long as that gains.

        Of a motor that forgets them within a few samples these hardly show in the scale. Where the
        first samples stay unexplained, friction may hold the search up: other speeds are tried.
        """
        yield from self._settle_further()
        if not self._begins_badly:
            return
        best = self._at, self.starts
        scale = self._scale(self._at.residual_a)
        for speeds in self._other_speeds():
            self.starts = self.starts.copy()
            self.starts[:, State.SPEED] = speeds
            self._runs = yield from self._run(self.logarithms, self.starts)
            if self._runs is not None:
                yield from self._settle_further()
                totals = [
                    self._total(runs.residual_a, scale, self.logarithms, starts)
                    for runs, starts in (best, (self._at, self.starts))
                ]
                best = best if totals[0] <= totals[1] else (self._at, self.starts)
            self._runs, self.starts = best

    def _settle_further(self) -> Pieces[None]:
        for _ in range(MOST_SETTLED):
            scale = self._scale(self._at.residual_a)
            steps, promised_gain = self._start_steps(scale)
            if promised_gain < NO_START_GAIN:
                return
            starts = self.starts + steps
            before = self._total(self._at.residual_a, scale, self.logarithms, self.starts)
            runs = yield from self._run(self.logarithms, starts)
            if runs is None:
                return
            gain = before - self._total(runs.residual_a, scale, self.logarithms, starts)
            if not gain > 0.0:
                return
            self.starts = starts
            self._runs = runs
            if gain < LEAST_START_GAIN:
                return

    @property
    def _begins_badly(self) -> bool:
        """Whether the first samples of a history lie far off, beside all of them."""
        most = OUTLIER * self._scale(self._at.residual_a)
        begin = 0
        for history in self.window.histories:
            if np.abs(self._at.residual_a[begin : begin + FEWEST]).max() > most:
                return True
            begin += history.current_a.size
        return False

    def _other_speeds(self) -> list[Array]:
        """Return other first speeds, shape (history,): by the first intervals alone, and none."""
        values = self.white_box.values(np.exp(self.logarithms))
        emf_v = [
            float(median((one.voltage_v - values['resistance'] * one.current_a[1:])[:FEW]))
            for one in self.window.histories
        ]
        return [np.array(emf_v) / values['back_emf_constant'], np.zeros(len(emf_v))]

    def _weights(self, scale: float) -> Array:
        return robust_weights(self._at.residual_a, scale, leaves_out=self._leaves_out)

    def _total(self, residual: Array, scale: float, logarithms: Array, starts: Array) -> float:
        off = starts - start_mean(self.window, starts)
        if starts.shape[1] == STATES:
            pull = float(((off / self._start_std) ** 2).sum())
        else:
            pull = float(np.einsum('hu,huv,hv->', off, self._start_precision, off))
        cost = robust_cost(residual, scale, leaves_out=self._leaves_out)
        return cost + self.prior.chi_square(logarithms) + pull

    def _look_for_noise(self) -> None:
        """Look for noise of the voltage where the search stands; take off what it does."""
        self.voltage_noise, self._noise = noise_of(self._at, is_rough=not self._leaves_out)
        self._runs = replace(self._at, noise=self._noise)

    def _equations(self, weights: Array, scale: float) -> Equations:
        return Equations.from_runs(
            self._at,
            weights / scale**2,
            self._start_precision,
            start_mean(self.window, self.starts) - self.starts,
        )

    def run(self, ends: Sequence[SearchEnd] = ()) -> Pieces[SearchEnd | None]:
        """Step until nothing moves, then leave out what does not fit and step again.

        Args:
            ends: of other searches; one that comes near such an end is given up.

        Returns:
            The end; None where it is one of these, or nothing can be said of it.
        """
        self._leaves_out = False
        if (yield from self.descend(ROUGHLY, [(end.robust, end.fit) for end in ends])):
            return None
        robust = self.logarithms
        self._leaves_out = True
        if (yield from self.descend(NEARLY, [(end.fit.logarithms, end.fit) for end in ends])):
            return None
        fit = self.result()
        return None if fit is None else SearchEnd(fit, self, robust)

    def descend(self, accuracy: Accuracy, ends: Sequence[tuple[Array, Fit]] = ()) -> Pieces[bool]:
        """Step until nothing moves; tell whether that is where another search has ended."""
        damping = 1e-3
        idle = 0
        if self.looks_for_noise:
            self._look_for_noise()
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
            damping, after = yield from self._stepped(
                equations, precision, right, before, damping, accuracy.gain
            )
            if after is None:
                return False
            idle = idle + 1 if before - after < accuracy.gain else 0
            if idle == MOST_IDLE:
                return False
        return False

    def _is_near(self, there: Array, end: Fit, equations: Equations) -> bool:
        """Tell whether the search stands where another one has, within their deviations."""
        apart = self.logarithms - there
        precision = equations.information + end.information + self.prior.precision
        return bool(apart @ precision @ apart < NEAR**2)

    def _run_after(
        self, logarithms: Array, starts: Array, promised_gain: float, attempt: int
    ) -> Pieces[tuple[FreeRuns | None, Array]]:
        """Run where a step leads; return the free runs, and what is free in their histories.

        Args:
            logarithms: shape (parameter,): there.
            starts: shape (history, unknown): there.
            promised_gain: of chi-square by the step, if all were straight.
            attempt: how many steps were tried from the same place before.
        """
        runs = yield from self._run(logarithms, starts)
        return runs, starts

    def _stepped(
        self,
        equations: Equations,
        precision: Array,
        right: Array,
        total: float,
        damping: float,
        least_gain: float,
    ) -> Pieces[tuple[float, float | None]]:
        """Take the first damped step that leads down.

        Returns:
            The damping left, and the total there; None where no step leads down.
        """
        size = np.maximum(np.diagonal(precision), 1e-12)
        most = np.where(np.diagonal(equations.information) < LOOSE, LONGEST_STEP, np.inf)
        for attempt in range(MOST_ATTEMPTS):
            own = 0.1**attempt if attempt < FREE_ATTEMPTS else 0.0
            step = bounded_solution(
                (precision + damping * np.diag(size))[None], right[None], -most, most
            )[0]
            step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            logarithms = self._within_bounds(self.logarithms + step)
            step = logarithms - self.logarithms
            promised_gain = float(2.0 * step @ right - step @ precision @ step)
            if attempt and promised_gain < least_gain:
                break
            starts = self.starts + equations.start_steps(step, own)
            runs, starts = yield from self._run_after(logarithms, starts, promised_gain, attempt)
            if runs is not None:
                after = self._total(runs.residual_a, self.scale_a, logarithms, starts)
                if np.isfinite(after) and after <= total + 1e-9 * abs(total):
                    self.logarithms = logarithms
                    self.starts = starts
                    self._runs = runs
                    easier = 0.1 if attempt == 0 else 1.0
                    return max(easier * damping, 1e-9), after
            damping = max(10.0 * damping, 1e-6)
        return damping, None

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
        if self._noise is not None and np.isfinite(information).all():
            information = without_noise(information, self._at.noise_information / noise**2)
        chi_square = self._total(residual, noise, self.logarithms, self.starts)
        if not (np.isfinite(information).all() and np.isfinite(chi_square)):
            return None
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
            self.voltage_noise,
            self._voltage_noise_a,
        )

    @property
    def _voltage_noise_a(self) -> float:
        """Standard deviation of what noise of the voltage would add to the current's residual."""
        if self.voltage_noise is NO_NOISE:
            return 0.0
        powers = WindowNoise.from_runs(self._at).powers(self.voltage_noise)
        return float(np.sqrt(powers[State.CURRENT]))


def promising_searches(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    rests: Array | None = None,
) -> Pieces[list[Search]]:
    """Return a search from every start that can be run; first the one that explains most."""
    searches = []
    for start in starts:
        search = Search(white_box, window, prior, np.log(start), rests=rests)
        yield from search.settle()
        if search.is_valid:
            searches.append(search)
    return sorted(searches, key=lambda search: search.scale_a)
