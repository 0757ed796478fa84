"""Fits the context nodes to a window: searches from several starts, and weighs where these end.

One search is Gauss-Newton (:mod:`~gray_box_observer.context_nodes.rotor.window_search`). It may end
before a kink, or at an optimum beside which others are as likely: these are looked for, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, bounded, completed
from gray_box_observer.context_nodes.rotor.breakaway_start import breakaway_starts
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.logarithms import RIVAL, Fit, LogPrior
from gray_box_observer.context_nodes.rotor.rest_search import ends_of_rest
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_noise import voltage_noise_of
from gray_box_observer.context_nodes.rotor.window_search import (
    ROUGHLY,
    Search,
    SearchEnd,
    promising_searches,
)
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

STUCK = 2.0
"""Gain of chi-square that the equations promise, and no step brings, from which a search has ended
before a kink: where a rotor turns or is held, a sample can stand in the way."""

MOST_PLAIN_RUNS = 16
"""Runs of a search without noise of the voltage, at most: it leads there soon, or nowhere."""

CLEARLY = 25.0
"""Log-likelihood by which a fit leaves clearly more than another one."""

REST = 4.0
"""Difference of chi-square up to which a rotor that begins without a current is at rest."""

DISTINCT = 1.0
"""Standard deviations from which two ends of a search are two."""


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
            samples; and no noise of the voltage where some is found.

    Where the best end knows of noise of the voltage, and one beside it without any leaves no more
    than the noise of the readings, there is none: the current answers what seemed to be noise.
    """
    searches = (yield from promising_searches(white_box, window, prior, starts))[:PROMISING]
    begins = [np.exp(search.logarithms) for search in searches]
    if tries_others and window.speed_output is None:
        breakaways = [*breakaway_starts(white_box, window, begins)]
        searches += (yield from promising_searches(white_box, window, prior, breakaways))[:1]
    ends: list[SearchEnd] = []
    for search in searches:
        end = yield from _searched(search, ends)
        if end is not None:
            ends.append(end)
    if not ends:
        return None
    yield from _leap(min(ends, key=lambda end: end.fit.noise_size), ends)
    if tries_others:
        yield from _try_others(min(ends, key=lambda end: end.fit.noise_size), ends)
    best_end = min(ends, key=lambda end: end.fit.noise_size)
    ends += yield from ends_of_rest(best_end, begins if tries_others else ())
    best, *others = _likeliest(ends)
    if best.voltage_noise is not NO_NOISE and tries_others:
        pieces = search_from(white_box, window, prior, best.theta, looks_for_noise=False)
        plain = yield from bounded(pieces, MOST_PLAIN_RUNS * best.runs.work)
        if plain is not None and _explains_more(plain, best):
            return plain
    worse = [one.noise_size - best.noise_size + one.chi_square - best.chi_square for one in others]
    return with_rivals(best, others, worse, prior)


def _likeliest(ends: Sequence[SearchEnd]) -> list[Fit]:
    """Return the fits of ends, the likeliest first.

    Those in which a rotor turns first are left out where one in which it surely rests explains as
    much.
    """
    noise_a = min(end.fit.noise_a for end in ends)

    ends = sorted(ends, key=lambda end: end.fit.cost(noise_a))
    rests = [end for end in ends if end.search.rests is not None]
    if rests and rests[0].fit.cost(noise_a) - ends[0].fit.cost(noise_a) < REST:
        ends = rests
    return [end.fit for end in ends]


def _explains_more(plain: Fit, aware: Fit) -> bool:
    """Tell whether a fit without noise of the voltage leaves no more than that of the readings.

    It has to leave clearly less than the fit that knows of noise: of a current that moves at every
    sample the noise of the readings is hardly known. And it must not show such noise itself.

    Args:
        plain: that without.
        aware: that with.
    """
    count = plain.runs.residual_a.size
    aware_a = math.hypot(aware.noise_a, aware.voltage_noise_a)
    if count * math.log(plain.noise_a / _noise_of_readings(plain)) > CLEARLY:
        return False
    if not count * math.log(aware_a / plain.noise_a) > CLEARLY:
        return False
    return voltage_noise_of(plain.runs) is NO_NOISE


def _noise_of_readings(fit: Fit) -> float:
    """Return the noise in A that the second differences of the readings show."""
    return max(fit.runs.window.reading_noise_a, fit.least_noise_a)


def _leap(best: SearchEnd, ends: list[SearchEnd]) -> Pieces[None]:
    """Search again from beyond what a search has stopped at, where it was to go on."""
    start = best.search
    if start.promised_gain < STUCK:
        return
    search = Search(start.white_box, start.window, start.prior, start.beyond)
    yield from search.settle()
    if search.is_valid:
        end = yield from search.run(ends)
        if end is not None:
            ends.append(end)


def _try_others(best: SearchEnd, ends: list[SearchEnd]) -> Pieces[None]:
    """Search again from other inductances where the current settles within a few samples."""
    last = best.search
    nodes = best.search.white_box.context_nodes
    if is_resolved(last.white_box, last.window.interval_s, best.fit.theta):
        return
    for factor in OTHERS:
        neighbour = best.fit.logarithms.copy()
        neighbour[nodes.index('inductance')] += np.log(factor)
        search = Search(last.white_box, last.window, last.prior, neighbour)
        yield from search.settle()
        if search.is_valid:
            end = yield from search.run(ends)
            if end is not None:
                ends.append(end)


def is_resolved(white_box: MotorWhiteBox, interval_s: float, theta: Array) -> bool:
    """Tell whether the current's rise takes so many samples that one inductance explains it.

    Args:
        white_box: of one motor.
        interval_s: the usual one between two samples.
        theta: shape (parameter,).
    """
    values = white_box.values(theta)
    slowest_s = RESOLVED * interval_s
    return bool(values['inductance'] > slowest_s * values['resistance'])


def search_from(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    start: Array,
    *,
    looks_for_noise: bool = True,
) -> Pieces[Fit | None]:
    """Fit a window from one start alone; None where it cannot be run. See :func:`fit_window`."""
    search = Search(white_box, window, prior, np.log(start))
    search.looks_for_noise &= looks_for_noise
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
    covariance = best.covariance(prior)
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
            near = Search(search.white_box, short, search.prior, search.logarithms)
            yield from near.settle()
            if near.is_valid:
                yield from near.descend(ROUGHLY)
                again = Search(search.white_box, search.window, search.prior, near.logarithms)
                yield from again.settle()
                search = again if again.is_valid and again.scale_a < search.scale_a else search
    return (yield from search.run(ends))
