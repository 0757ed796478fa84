"""The delay of a motor whose rotor turns unseen, as one more unknown of a fit of the whole motor.

A back-EMF that nobody measures explains a shifted voltage as well as any other, so the balance of
the winding tells no delay (:mod:`~gray_box_observer.delay.coarse`). The whole motor does: a voltage
moves the current at once, and the rotor behind it. A linear recurrence says where about the delay
is, and fits of the free run say it to a part of a sample interval
(docs/METHOD.md, The delay between voltage and torque).
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_equations import robust_cost, robust_weights
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.context_nodes.rotor.window_learner import POOR, SEARCHED, VAGUE
from gray_box_observer.context_nodes.rotor.window_search import NEARLY, Search
from gray_box_observer.delay.coarse import credible
from gray_box_observer.samples.raw_history import RawSignals
from gray_box_observer.samples.replay_buffer import (
    HELD_VOLTAGE,
    INTERVAL,
    MOMENT,
    TORQUE,
    VOLTAGE,
)
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

NEWEST = 2048
"""Newest torques that a search rests on, at most."""

STRIDES = (1, 4, 16)
"""Samples between those that a recurrence joins: a current that rises slowly tells little from one
to the next."""

SHIFTS_A_PIECE = 16
"""Delays that are tried in one piece of work."""

SCANNED = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)
"""Sample intervals from the coarse delay at which the fine search begins to look: where a move of
the voltage passes a sample, the likelihood bends."""

STEPS = 8
"""Steps at most in which the delay settles."""

LONGEST_STEP = 0.25
"""Sample intervals of a step, at most."""

SHARES = (1.0, 0.5, 0.25)
"""Shares of a step that are tried."""

NEAR, NEAR_STDS = 0.002, 0.1
"""Step that is none any more, in sample intervals and in standard deviations."""

SIDE = 0.05
"""Sample intervals to either side, over which the current is differentiated by the delay."""

FILTER_SHARES = (0.9, 1.0, 1.05)
"""Time constants of filters that are compared, over the L/R that was found."""

FILTER_STEPS = 8
"""Steps of a voltage behind a filter in a sample interval."""

SETTLED = 8.0
"""Time constants of a filter before the first sample, in which it forgets where it began."""

FAST_SHARE = 0.15
"""L/R behind a filter from which a fit begins, over the one that was found."""

NEARLY_WHOLE = 0.1
"""Sample intervals by which a delay may lie below a whole number of them, and be that."""

RIVAL_EVIDENCE = 15.0
"""Log-likelihood by which a filter has to be worse."""

LEAST_SIZE = 1e-9
"""Size of a direction in which the unknowns move the current, over the largest, at least."""

RUNS_A_PIECE = 2
"""Free runs of a fit that are one piece of work."""

MOST_WORK = 1_048_576
"""Work of a fit, at most."""


@dataclass(frozen=True)
class HiddenRotorDelay:
    """Delay that explains the current best, with the rotor behind it.

    Attributes:
        delay_s: in s.
        std_s: standard deviation of that, all parameters being free.
        evidence: log-likelihood that it brings over the delay in force.
    """

    delay_s: float
    std_s: float
    evidence: float


class HiddenRotorSearch:
    """Looks for the delay in one stretch of signals.

    Args:
        white_box: of one motor with a hidden rotor.
        initial: shape (parameter,): first guess.
        signals: voltage and torque; the voltage is known wherever the delay may lead.
        restart: shape (n - 1,): where the signal history starts anew.
        interval_s: usual time between torques.
        reach_s: smallest and largest delay.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        signals: RawSignals,
        restart: NDArray[np.bool_],
        interval_s: float,
        reach_s: tuple[float, float],
    ) -> None:
        self._white_box = white_box
        self._initial = initial
        newest = slice(-NEWEST, None)
        self._signals = replace(
            signals, time_s=signals.time_s[newest], torque_nm=signals.torque_nm[newest]
        )
        self._restart = restart[1 - self._signals.time_s.size :]
        self._interval_s = interval_s
        self._reach_s = reach_s
        self._prior = LogPrior(np.log(initial), np.eye(initial.size) / VAGUE**2)

    def run(self, applied_s: float) -> Generator[None, None, HiddenRotorDelay | None]:
        """Search; yield after each piece of work.

        Args:
            applied_s: the delay in force.

        Returns:
            What was found; None where no delay explains the signals.
        """
        coarse: list[tuple[float, Fit]] = []
        for stride in (0, *STRIDES):
            delay_s = (yield from self._coarse(stride)) if stride else applied_s
            if any(abs(delay_s - other_s) < 0.5 * self._interval_s for other_s, _ in coarse):
                continue
            window = self._window(delay_s)
            newest = window.tail(SEARCHED) if window.histories else window
            if newest.spread_a > 0.0:
                starts = [self._initial, *weak_starts(self._white_box, newest)]
                fit = yield from _paced(fit_window(self._white_box, newest, self._prior, starts))
                coarse += [] if fit is None else [(delay_s, fit)]
        if not coarse:
            return None
        delay_s, near = min(coarse, key=lambda one: one[1].noise_a)
        end = yield from self._settled(delay_s, near)
        if end is None:
            return None
        delay_s, std_s, best = end
        if (yield from self._has_rival(delay_s, best)):
            return None
        gain = math.inf
        for start in (best, *(fit for other_s, fit in coarse if other_s == applied_s)):
            fit = yield from self._fit(applied_s, start.logarithms)
            gain = gain if fit is None else min(gain, _evidence(best, fit))
        return HiddenRotorDelay(delay_s, std_s, gain)

    def _coarse(self, stride: int) -> Generator[None, None, float]:
        """Return the delay in s at which a linear recurrence foretells the current best.

        Args:
            stride: samples between those that it joins.
        """
        time_s = self._signals.time_s
        current_a = credible(np.asarray(self._white_box.state(self._signals.torque_nm)))
        last_a = current_a[2 * stride :]
        before_a = [current_a[stride:-stride], current_a[: -2 * stride], np.ones_like(last_a)]
        start_counts = np.concatenate([[0], np.cumsum(self._restart)])
        is_whole = (start_counts[2 * stride :] == start_counts[: -2 * stride]).astype(float)
        directions = np.linalg.qr(np.stack(before_a, axis=1) * is_whole[:, None])[0]
        rest_a = last_a * is_whole
        rest_a = rest_a - directions @ (directions.T @ rest_a)
        low, high = (round(edge_s / self._interval_s) for edge_s in self._reach_s)
        best = 0.0, self._reach_s[0]
        for shift in range(low, high + 1):
            delay_s = shift * self._interval_s
            integral_vs = self._signals.voltage_integral(time_s - delay_s)
            volts = integral_vs[stride:] - integral_vs[:-stride]
            pair = np.stack([volts[stride:], volts[:-stride]], axis=1) * is_whole[:, None]
            pair = pair - directions @ (directions.T @ pair)
            gain = rest_a @ pair
            power_a2 = float(gain @ np.linalg.lstsq(pair.T @ pair, gain, rcond=1e-9)[0])
            if power_a2 > best[0]:
                best = power_a2, delay_s
            if shift % SHIFTS_A_PIECE == 0:
                yield
        return best[1]

    def _window(self, delay_s: float, signals: RawSignals | None = None) -> Window:
        """Return the samples, with a voltage that acts so much later than it is stamped.

        Args:
            delay_s: by how much.
            signals: with another voltage; None: that of the stretch.
        """
        signals = signals or self._signals
        time_s = self._signals.time_s
        interval_s = np.diff(time_s)
        samples = np.zeros((MOMENT + 1, time_s.size))
        samples[INTERVAL, 1:] = np.where(self._restart, 0.0, interval_s)
        mean_v, moment_v, held_v = signals.between(time_s - delay_s)
        samples[VOLTAGE, 1:] = mean_v
        samples[TORQUE] = self._signals.torque_nm
        samples[HELD_VOLTAGE] = held_v
        samples[MOMENT, 1:] = moment_v
        return Window.from_samples(self._white_box, samples)

    def _fit(
        self, delay_s: float, logarithms: Array, signals: RawSignals | None = None
    ) -> Generator[None, None, Fit | None]:
        """Fit all signals under a delay.

        Args:
            delay_s: the delay.
            logarithms: shape (parameter,): where the search begins.
            signals: with another voltage; None: that of the stretch.
        """
        window = self._window(delay_s, signals)
        search = Search(self._white_box, window, self._prior, logarithms)
        search.looks_for_noise = False
        return (yield from _paced(_descended(search)))

    def _has_rival(self, delay_s: float, best: Fit) -> Generator[None, None, bool]:
        """Tell whether a filter explains the signals about as well as winding and delay do.

        A filter lags as a winding does, and the winding behind it comes late as by a delay of a
        part of an interval. R and L are far off where one is taken for the other.

        Args:
            delay_s: that was found.
            best: fit under it.
        """
        values = self._white_box.values(best.theta)
        winding_s = values['inductance'] / values['resistance']
        span_s = float(self._signals.time_s[-1] - self._signals.time_s[0])
        if not SETTLED * winding_s < span_s:  # its shape tells a winding that is so slow
            return False
        place = self._white_box.context_nodes.index('inductance')
        logarithms = best.logarithms.copy()
        logarithms[place] += math.log(FAST_SHARE)
        whole_s = math.floor(delay_s / self._interval_s + NEARLY_WHOLE) * self._interval_s
        for share in FILTER_SHARES:
            signals = self._behind_filter(share * winding_s)
            for other_s in (whole_s, delay_s):
                fit = yield from self._fit(other_s, logarithms, signals)
                if fit is not None and _evidence(best, fit) < RIVAL_EVIDENCE:
                    return True
        return False

    def _behind_filter(self, lag_s: float) -> RawSignals:
        """Return the signals with a voltage behind a filter of first order, in short steps."""
        signals = self._signals
        step_s = self._interval_s / FILTER_STEPS
        begin_s = float(signals.time_s[0]) - self._reach_s[1] - SETTLED * lag_s
        grid_s = np.arange(begin_s, float(signals.time_s[-1]) - self._reach_s[0], step_s)
        volts, _, held_v = signals.between(grid_s)
        remainder = math.exp(-step_s / lag_s)
        factor = np.full((1, volts.size), remainder)
        inputs = (1.0 - remainder) * volts[None, None]
        ends_v = recurrence(factor, inputs, np.array([[held_v[0]]]))[0, 0]
        means_v = volts + (ends_v[:-1] - volts) * (1.0 - remainder) * lag_s / step_s
        return replace(signals, voltage_time_s=grid_s[:-1], voltage_v=means_v)

    def _settled(
        self, delay_s: float, near: Fit
    ) -> Generator[None, None, tuple[float, float, Fit] | None]:
        """Move a delay until a fit moves it no more; return it, its deviation and the fit."""
        best = yield from self._fit(delay_s, near.logarithms)
        if best is None:
            return None
        coarse_s = delay_s
        for share in SCANNED:
            other_s = coarse_s + share * self._interval_s
            other = yield from self._fit(other_s, near.logarithms)
            if other is not None and _evidence(other, best) > 0.0:
                best = other
                delay_s = other_s
        std_s = math.inf
        for _ in range(STEPS):
            step_s, std_s = self._step(delay_s, best)
            yield
            if not math.isfinite(step_s):
                return None
            if abs(step_s) < max(NEAR * self._interval_s, NEAR_STDS * std_s):
                break
            better = yield from self._better(delay_s, step_s, best)
            if better is None:
                break
            delay_s, best = better
        least_a = max(difference_noise(best.runs.residual_a), best.least_noise_a)
        return None if best.noise_a > POOR * least_a else (delay_s, std_s, best)

    def _better(
        self, delay_s: float, step_s: float, best: Fit
    ) -> Generator[None, None, tuple[float, Fit] | None]:
        """Take a step of the delay, or a part of it; None where none leads to a better fit."""
        longest_s = LONGEST_STEP * self._interval_s
        step_s = min(max(step_s, -longest_s), longest_s)
        for share in SHARES:
            next_s = min(max(delay_s + share * step_s, self._reach_s[0]), self._reach_s[1])
            fit = yield from self._fit(next_s, best.logarithms)
            if fit is not None and _evidence(fit, best) > 0.0:
                return next_s, fit
        return None

    def _step(self, delay_s: float, fit: Fit) -> tuple[float, float]:
        """Return by how much a delay is to move, in s, and the standard deviation of that.

        All parameters and first states are free. Where a move of the voltage passes a sample, the
        derivative is another one to either side, and a side counts whose step leads there.
        """
        residual_a = fit.runs.residual_a
        root = np.sqrt(robust_weights(residual_a, fit.noise_a, leaves_out=False))
        columns = [*_blocks(fit.runs.by_start), fit.runs.by_parameter]
        directions = _directions(root[:, None] * np.column_stack(columns))
        best_s = best_stds = 0.0
        powers = []
        for side_s in (SIDE * self._interval_s, -SIDE * self._interval_s):
            window = self._window(delay_s + side_s)
            runs = free_runs(self._white_box, fit.theta, window, fit.starts)
            if not runs.is_bounded:
                return math.nan, math.nan
            slope = root * (residual_a - runs.residual_a) / side_s
            slope = slope - directions @ (directions.T @ slope)
            power = max(float(slope @ slope), 1e-300)
            step_s = float(slope @ (root * residual_a)) / power
            powers.append(power)
            if step_s * side_s > 0.0 and abs(step_s) * math.sqrt(power) > best_stds:
                best_stds = abs(step_s) * math.sqrt(power)
                best_s = step_s
        return best_s, fit.noise_a / math.sqrt(min(powers))


def _directions(columns: Array) -> Array:
    """Return orthonormal directions of columns, shape (reading, direction)."""
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    directions, spans, _ = np.linalg.svd(columns / sizes, full_matrices=False)
    return np.asarray(directions[:, spans > LEAST_SIZE * spans[0]])


def _blocks(by_start: Sequence[Array]) -> list[Array]:
    """Return derivatives by the first states of each history, over all readings."""
    ends = np.cumsum([0, *(part.shape[0] for part in by_start)])
    blocks = []
    for part, begin in zip(by_start, ends[:-1].tolist(), strict=True):
        block = np.zeros((int(ends[-1]), part.shape[1]))
        block[begin : begin + part.shape[0]] = part
        blocks.append(block)
    return blocks


def _descended(search: Search) -> Pieces[Fit | None]:
    """Search without leaving out what lies far off: a late voltage shows nowhere else."""
    yield from search.settle()
    if not search.is_valid:
        return None
    yield from search.descend(NEARLY)
    return search.result()


def _paced(work: Pieces[Fit | None]) -> Generator[None, None, Fit | None]:
    """Go on with a fit, within bounds; yield after every few pieces of it."""
    pieces = bounded(work, MOST_WORK)
    while True:
        for _ in range(RUNS_A_PIECE):
            try:
                next(pieces)
            except StopIteration as end:
                fit: Fit | None = end.value
                return fit
        yield


def _evidence(fit: Fit, other: Fit) -> float:
    """Return the log-likelihood by which a fit is better than another; outliers count less."""
    costs = [
        robust_cost(one.runs.residual_a, fit.noise_a, leaves_out=False) for one in (fit, other)
    ]
    return 0.5 * (costs[1] - costs[0])
