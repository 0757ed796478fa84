"""Fits a window of a motor whose load varies and whose speed nobody measures.

The load takes a part of the acceleration that runs straight between knots and walks at random over
them. How fast it walks follows from where the knots come to lie, fit after fit
(:mod:`~gray_box_observer.context_nodes.rotor.load_walk`). What the load has in common with inertia
and friction is told by neither: there the deviations are opened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.normal_equations import shortest_solution
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns, current_of_histories
from gray_box_observer.context_nodes.rotor.history_unknowns import LoadWalk
from gray_box_observer.context_nodes.rotor.load_walk import (
    ALIKE,
    WALKS,
    first_walk,
    load_spread,
    walk_of_load,
    with_load,
)
from gray_box_observer.context_nodes.rotor.loaded_search import LoadedSearch
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import is_resolved, with_rivals
from gray_box_observer.context_nodes.rotor.window_search import ROUGHLY
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

SEARCHED_STARTS = 2
"""Starts that are searched from, of all that are tried."""

EXPLAINING_WALK = 100.0
"""Times the walk that a fit begins with, where it is asked what a load may explain."""

ROUGH = {'resistance': 0.008, 'inductance': 0.015}
"""Standard deviations of logarithms that a load leaves which is no random walk: a friction that
gives before it breaks, a load that jumps between knots."""

UNRESOLVED = 0.25
"""Standard deviation of the inductance's logarithm where the current settles within a few samples:
a load may take what others would explain."""

LEAST_SPREAD = 1e-3
"""Share by which a load that varies may have moved a parameter of the rotor, at least."""


@dataclass(frozen=True, eq=False)
class LoadedFit:
    """Where the fit of a motor with a load that varies has ended.

    Attributes:
        fit: of the parameters; what it tells of the rotor is opened by what the load may have done.
        inertia_std: of its logarithm, before it was opened.
        open_std: shape (parameter,): of the logarithms, by what load and friction may have done.
            It is the same in window after window, so it is in every estimate whole.
    """

    fit: Fit
    inertia_std: float
    open_std: Array

    @property
    def walk(self) -> float:
        """Variance that the load gains in a second, in (rad/s2)^2/s."""
        return _load_of(self.fit).walk


def fit_loaded(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    walk: float = 0.0,
) -> Pieces[LoadedFit | None]:
    """Fit the context nodes to a window; None where no start can be run.

    Dry friction and load explain much of each other, and a search may end beside a rival that is as
    likely. What lies between them is in the spread.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from; the best few of many are taken.
        walk: variance that the load has gained in a second before; 0: not known.
    """
    fits = []
    for search in (yield from _promising(white_box, window, prior, starts, walk)):
        fit = yield from _settled(search)
        if fit is not None:
            fits.append(fit)
    if not fits:
        return None
    best, *others = sorted(fits, key=_cost)
    worse = [_cost(other) - _cost(best) for other in others]
    return _opened(white_box, with_rivals(best, others, worse, prior))


def loaded_runs(white_box: MotorWhiteBox, theta: Array, window: Window) -> Pieces[FreeRuns | None]:
    """Run freely at given values, the load where it fits best; None where it cannot.

    The load may move by the stalled motor's torque within a second.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.
    """
    nothing = LogPrior(np.log(theta), np.zeros((theta.size, theta.size)))
    walk = EXPLAINING_WALK * first_walk(white_box, window, theta)
    loaded_window = with_load(window, walk)
    if not loaded_window.histories:
        return None
    search = LoadedSearch(white_box, loaded_window, nothing, nothing.mean)
    yield from search.settle()
    return search.runs


def loaded_current(white_box: MotorWhiteBox, theta: Array, samples: Array) -> Array:
    """Run through every history, where it begins and what loads it as they fit best.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        samples: shape (signal, n): interval in s, voltage in V and torque in N m.

    Returns:
        Shape (n,): current in A; NaN where the values cannot be run.
    """

    def run_of(window: Window) -> FreeRuns | None:
        return completed(loaded_runs(white_box, theta, window))

    return current_of_histories(white_box, samples, run_of)


def _promising(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    walk: float,
) -> Pieces[list[LoadedSearch]]:
    """Return searches from the starts that explain most before anything is searched."""
    searches = []
    walks = [walk or first_walk(white_box, window, start) for start in starts]
    loaded_window = with_load(window, float(median(np.array(walks))))
    if not loaded_window.histories:
        return []
    for start in starts:
        search = LoadedSearch(white_box, loaded_window, prior, np.log(start))
        yield from search.settle()
        if search.is_valid:
            searches.append(search)
    searches.sort(key=lambda search: search.scale_a)
    return searches[:SEARCHED_STARTS]


def _settled(search: LoadedSearch) -> Pieces[Fit | None]:
    """Search until the walk of the load agrees with where its knots lie, then to the end."""
    for _ in range(WALKS):
        yield from search.descend(ROUGHLY)
        assert search.runs is not None
        walk = walk_of_load(search.runs, search.scale_a)
        yield search.runs.work
        before = search.load.walk
        search = search.with_walk(walk)
        yield from search.settle()
        if not search.is_valid:
            return None
        if 1.0 / ALIKE < walk / before < ALIKE:
            break
    end = yield from search.run()
    return None if end is None else end.fit


def _load_of(fit: Fit) -> LoadWalk:
    load = fit.runs.window.unknowns.load
    assert load is not None
    return load


def _cost(fit: Fit) -> float:
    """Minus twice the log-likelihood of a fit: of its residual, and of the walk of its load."""
    load = _load_of(fit)
    knots = load.knots * len(fit.runs.window.histories)
    size = 2.0 * fit.runs.residual_a.size * math.log(fit.noise_a)
    return size + fit.chi_square + knots * math.log(load.walk)


def _opened(white_box: MotorWhiteBox, fit: Fit) -> LoadedFit:
    """Open what a fit tells of the rotor by what its load may have done."""
    nodes = white_box.context_nodes
    rotor = [place for place, name in enumerate(nodes) if TERMS[name].state is State.SPEED]
    values = white_box.values(fit.theta)
    rotor_nodes = [nodes[place] for place in rotor]
    of_load = load_spread(rotor_nodes, values, fit.runs, float(white_box.torque_constant))
    least = np.diag(np.maximum(of_load, LEAST_SPREAD) ** -2.0)
    of_rotor = fit.information[np.ix_(rotor, rotor)] + least
    across = fit.information[rotor]
    information = fit.information - across.T @ shortest_solution(of_rotor, across)
    place = nodes.index('inertia')
    variance = np.linalg.pinv(fit.information, hermitian=True)[place, place]
    open_std = np.array([ROUGH.get(name, 0.0) for name in nodes])
    open_std[rotor] = of_load
    if not is_resolved(white_box, fit.runs.window.interval_s, fit.theta):
        open_std[nodes.index('inductance')] = UNRESOLVED
    open_fit = replace(fit, information=0.5 * (information + information.T))
    return LoadedFit(open_fit, math.sqrt(max(float(variance), 0.0)), open_std)
