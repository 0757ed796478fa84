"""Searches again with a rotor that is at rest where its signal history begins.

Under a voltage that has not turned yet, R, L, 1/J and the first speed explain each other: times s
the one, and ``(1 - s) V_0 / Kb`` the other (docs/METHOD.md, The whole motor). A motor that has no
current where its history begins mostly stands still, and surely where it has no voltage either. So
a rotor that was to turn then is asked whether one at rest explains the samples as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.context_nodes.rotor.breakaway_start import NO_CURRENT
from gray_box_observer.context_nodes.rotor.logarithms import RIVAL, Fit
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_search import (
    Search,
    SearchEnd,
    promising_searches,
)
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array

STANDSTILL = 0.005
"""Share of the largest voltage up to which a first back-EMF is that of a rotor at rest."""

NO_VOLTAGE = 0.02
"""The same of the first voltage, up to which there is none."""

OPEN = 0.05
"""Standard deviation of the inertia's logarithm from which the first speed may hide in it."""

VAGUE = 2.0
"""The same from which no start tells it."""

MOST_RUNS = 32
"""Runs of such a search, at most."""


def ends_of_rest(best: SearchEnd, starts: Sequence[Array]) -> Pieces[list[SearchEnd]]:
    """Search with a rotor that is at rest first, where it has no current and was to turn.

    Args:
        best: where the search that explains most has ended.
        starts: shape (parameter,) each: where to search from beside that end.

    Returns:
        The end; none where nothing is asked, or nothing is found. Where the rotor does not surely
        rest the search goes on from there with a first speed that is free: that end is returned.
    """
    rests, turns = _rests(best)
    if not rests.any():
        return []
    last = best.search
    begins = [best.fit.theta, *(starts if turns else ())]
    searches = yield from promising_searches(last.white_box, last.window, last.prior, begins, rests)
    if not searches:
        return []
    most = MOST_RUNS * best.fit.runs.work
    end = yield from bounded(searches[0].run(), most)
    if end is None or _is_far(end.fit, best.fit):
        return []
    if not surely_rests(last.window, rests, end.fit.noise_a):
        free = Search(last.white_box, last.window, last.prior, end.fit.logarithms)
        free.starts = end.fit.starts.copy()
        yield from free.settle()
        end = (yield from bounded(free.run(), most)) if free.is_valid else None
    return [] if end is None else [end]


def _is_far(fit: Fit, best: Fit) -> bool:
    """Tell whether a fit explains so much less than another that it is no rival of it."""
    noise_a = min(fit.noise_a, best.noise_a)
    return fit.cost(noise_a) - best.cost(noise_a) > RIVAL


def _rests(best: SearchEnd) -> tuple[Array, bool]:
    """Return which histories may begin at rest, shape (history,), and whether one does not yet.

    Where the inertia is open the first speed may hide in it: a rotor that surely rests is asked.

    Behind a driver that coasts many begin without a current, and the rotor turns: none is asked.
    """
    search = best.search
    window = search.window
    first_a = np.array([history.current_a[0] for history in window.histories])
    has_no_current = np.abs(first_a) < NO_CURRENT * best.fit.noise_a
    if window.speed_output is not None or np.count_nonzero(has_no_current) > 1:
        return np.zeros_like(has_no_current), False
    place = search.white_box.context_nodes.index('inertia')
    variance = float(best.fit.covariance(search.prior)[place, place])
    emf_v = search.starts[:, State.SPEED] * float(search.white_box.known['back_emf_constant'])
    turns = has_no_current & (np.abs(emf_v) > STANDSTILL * window.largest_voltage_v)
    if OPEN**2 < variance < VAGUE**2 and surely_rests(window, has_no_current, best.fit.noise_a):
        return has_no_current, bool(turns.any())
    return turns, bool(turns.any())


def surely_rests(window: Window, rests: Array, noise_a: float) -> bool:
    """Tell whether histories that begin without a current have no voltage and get no current.

    Args:
        window: the samples.
        rests: shape (history,): which histories.
        noise_a: standard deviation of the current's noise.
    """
    firsts = [(history.voltage_v[0], history.current_a[1]) for history in window.histories]
    largest = NO_VOLTAGE * window.largest_voltage_v, NO_CURRENT * noise_a
    return bool((np.abs(np.array(firsts)[rests]) < largest).all())
