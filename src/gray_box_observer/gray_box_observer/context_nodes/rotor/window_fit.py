"""Fits the context nodes to a window: searches from several starts, and weighs where these end.

One search is Gauss-Newton (:mod:`~gray_box_observer.context_nodes.rotor.window_search`). It may end
before a kink, or at an optimum beside which others are as likely: these are looked for, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE, VoltageNoise
from gray_box_observer.context_nodes.rotor.window import FreeRuns, Window
from gray_box_observer.context_nodes.rotor.window_search import ROUGHLY, Search, SearchEnd
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

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

STUCK = 2.0
"""Gain of chi-square that the equations promise, and no step brings, from which a search has ended
before a kink: where a rotor turns or is held, a sample can stand in the way."""

MOST_NOISES = 3
"""Fits at most in which the noise of a voltage settles."""

SAME_NOISE = 1.3
"""Factor between two variances of it that are the same."""

TOO_MUCH = 1.1
"""Times the noise of a fit that the voltage's may make of it, at most."""

DISTINCT = 1.0
"""Standard deviations from which two ends of a search are two."""


def fit_window(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    *,
    tries_others: bool = True,
    noise_before: VoltageNoise = NO_NOISE,
) -> Pieces[Fit | None]:
    """Fit the context nodes to a window; None where no start can be run.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from; the best few of many are taken.
        tries_others: whether other inductances are tried where the current settles within a few
            samples.
        noise_before: of the voltage, as the fit before has left it.

    What noise of a measured voltage does is known once the motor is, about. So a fit that shows
    such noise is done again, and what the noise does is taken off. Where that fit does not show it,
    there is none.
    """
    noise = noise_before
    if noise is NO_NOISE:
        plain = yield from _fitted(white_box, window, prior, starts, tries_others=tries_others)
        if plain is None:
            return None
        noise = VoltageNoise.from_runs(white_box, plain.runs, plain.logarithms)
        if noise is NO_NOISE:
            return plain
        starts = [*starts, plain.theta]
    fit = None
    for _ in range(MOST_NOISES):
        fit = yield from _fitted(white_box, window, prior, starts, noise, tries_others=tries_others)
        if fit is None:
            break
        before = noise
        noise = VoltageNoise.from_runs(white_box, fit.runs, fit.logarithms)
        if noise is NO_NOISE:
            break
        if 1.0 / SAME_NOISE < noise.variance_v2 / before.variance_v2 < SAME_NOISE:
            return fit
        starts = [fit.theta]
    if fit is not None and noise is not NO_NOISE:
        return fit
    if noise_before is NO_NOISE:
        return plain
    return (yield from _fitted(white_box, window, prior, starts, tries_others=tries_others))


def _fitted(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    noise: VoltageNoise = NO_NOISE,
    *,
    tries_others: bool,
) -> Pieces[Fit | None]:
    """Fit beside a noise of the voltage that is known; see :func:`fit_window`."""
    searches = []
    for start in starts:
        search = Search(white_box, window, prior, np.log(start), noise)
        yield from search.settle()
        if search.is_valid:
            searches.append(search)
    searches.sort(key=lambda search: search.scale_a)
    ends: list[SearchEnd] = []
    for search in searches[:PROMISING]:
        end = yield from _searched(search, ends)
        if end is not None:
            ends.append(end)
    if not ends:
        return None
    yield from _leap(min(ends, key=lambda end: _size(end.fit)), ends)
    if tries_others:
        yield from _try_others(min(ends, key=lambda end: _size(end.fit)), ends)
    fits = [end.fit for end in ends if end.fit.voltage_noise_a <= TOO_MUCH * end.fit.noise_a]
    if not fits:
        return None
    noise_a = min(fit.noise_a for fit in fits)
    fits.sort(key=lambda fit: fit.chi_square * (fit.noise_a / noise_a) ** 2 + _size(fit))
    best, *others = fits
    worse = [_size(one) - _size(best) + one.chi_square - best.chi_square for one in others]
    return with_rivals(best, others, worse, prior)


def _leap(best: SearchEnd, ends: list[SearchEnd]) -> Pieces[None]:
    """Search again from beyond what a search has stopped at, where it was to go on."""
    start = best.search
    if start.promised_gain < STUCK:
        return
    search = Search(start.white_box, start.window, start.prior, start.beyond, start.noise)
    yield from search.settle()
    if search.is_valid:
        end = yield from search.run(ends)
        if end is not None:
            ends.append(end)


def _try_others(best: SearchEnd, ends: list[SearchEnd]) -> Pieces[None]:
    """Search again from other inductances where the current settles within a few samples."""
    last = best.search
    nodes = best.search.white_box.context_nodes
    if is_resolved(last.white_box, last.window, best.fit.theta):
        return
    for factor in OTHERS:
        neighbour = best.fit.logarithms.copy()
        neighbour[nodes.index('inductance')] += np.log(factor)
        search = Search(last.white_box, last.window, last.prior, neighbour, last.noise)
        yield from search.settle()
        if search.is_valid:
            end = yield from search.run(ends)
            if end is not None:
                ends.append(end)


def is_resolved(white_box: MotorWhiteBox, window: Window, theta: Array) -> bool:
    """Tell whether the current's rise takes so many samples that one inductance explains it.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        theta: shape (parameter,).
    """
    values = white_box.values(theta)
    slowest_s = RESOLVED * window.interval_s
    return bool(values['inductance'] > slowest_s * values['resistance'])


def _size(fit: Fit) -> float:
    """Log-determinant of the noise of all samples: the larger noise is the worse fit.

    What noise of the voltage adds to it is no fault of a fit.
    """
    size_a = fit.noise_a
    if fit.voltage_noise_a > 0.0:
        own_a = max(difference_noise(fit.runs.window.current_a), fit.least_noise_a)
        size_a /= math.hypot(1.0, fit.voltage_noise_a / own_a)
    return 2.0 * fit.runs.residual_a.size * float(np.log(size_a))


def search_from(
    white_box: MotorWhiteBox, window: Window, prior: LogPrior, start: Array
) -> Pieces[Fit | None]:
    """Fit a window from one start alone; None where it cannot be run. See :func:`fit_window`."""
    search = Search(white_box, window, prior, np.log(start))
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
    search = Search(white_box, window, nothing, logarithms)
    completed(search.settle())
    if search.is_valid:
        completed(search.settle_starts_of_motor())
    return search.runs


def with_rivals(best: Fit, others: Sequence[Fit], worse: Sequence[float], prior: LogPrior) -> Fit:
    """Widen the best end by other ends that are as likely.

    Args:
        best: it.
        others: the other ends.
        worse: one an end: difference of its cost, which is chi-square, to that of the best.
        prior: decides what the samples leave open.
    """
    spread = best.spread
    covariance = np.linalg.pinv(best.information + prior.precision, hermitian=True)
    std = np.sqrt(np.maximum(np.diagonal(covariance), 1e-30))
    for other, difference in zip(others, worse, strict=True):
        apart = other.logarithms - best.logarithms
        if difference < RIVAL and np.max(np.abs(apart) / std) > DISTINCT:
            share = 1.0 / (1.0 + float(np.exp(0.5 * max(difference, 0.0))))
            spread = spread + share * np.outer(apart, apart)
    return replace(best, spread=spread)


def _searched(search: Search, ends: Sequence[SearchEnd]) -> Pieces[SearchEnd | None]:
    """Search from one start: on the newest samples first where there are many and it is far off."""
    if search.window.current_a.size > 2 * SHORT and search.scale_a > 0.1 * search.window.spread_a:
        short = search.window.tail(SHORT)
        if short.current_a.size == SHORT:
            near = Search(search.white_box, short, search.prior, search.logarithms, search.noise)
            yield from near.settle()
            if near.is_valid:
                yield from near.descend(ROUGHLY)
                again = Search(
                    search.white_box, search.window, search.prior, near.logarithms, search.noise
                )
                yield from again.settle()
                search = again if again.is_valid and again.scale_a < search.scale_a else search
    return (yield from search.run(ends))
