"""A load that varies: how it is laid over a window, and how fast it walks at random."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import shortest_solution
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.history_unknowns import LoadWalk
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

OPEN = 1e6
"""Standard deviation of first states that are as good as unknown, in A and rad/s."""

LEAST = 1e-12
"""Variance in a second of a load that stands still, in (rad/s2)^2/s."""

MOST_KNOTS = 64
FEWEST_KNOTS = 4
SAMPLES_A_KNOT = 32
"""Knots of a load that varies."""

FEWEST_SAMPLES_A_KNOT, SECONDS_A_KNOT = 16, 0.04
"""The same where nobody measures the speed: slow samples have more knots."""

KNOTS_A_HISTORY = 32
"""The longest course of a load there: work grows as the square of its knots."""

SHORTEST = 0.5
"""Share of the longest history that another one lasts there at least: all have as many knots."""

FIRST_LOAD = 0.1
"""Share of the stalled motor's torque by which a load is first taken to vary within a second."""

WALKS = 4
"""Fits at most in which the walk of a load settles."""

ALIKE = 1.4
"""Factor between two walks that are the same."""

WIDEST = 100.0
"""Relative spread that is told at most."""


def load_over(window: Window, walk: float, samples_a_knot: int = SAMPLES_A_KNOT) -> LoadWalk:
    """Lay a load over a window.

    Args:
        window: the samples.
        walk: variance that it gains in a second, in (rad/s2)^2/s.
        samples_a_knot: samples from one knot to the next.
    """
    longest = max(history.current_a.size for history in window.histories)
    return LoadWalk(int(np.clip(longest // samples_a_knot, FEWEST_KNOTS, MOST_KNOTS)), walk)


def with_load(window: Window, walk: float) -> Window:
    """Lay a load over a window without speed, whose histories are cut where they are long.

    Histories that are too short for the knots are left out; none may be left.

    Args:
        window: the samples.
        walk: variance that it gains in a second, in (rad/s2)^2/s.
    """
    if not window.histories:
        return window
    samples_a_knot = round(SECONDS_A_KNOT / max(window.interval_s, 1e-9))
    samples_a_knot = min(max(samples_a_knot, FEWEST_SAMPLES_A_KNOT), SAMPLES_A_KNOT)
    longest = KNOTS_A_HISTORY * samples_a_knot
    parts = [part for history in window.histories for part in _parts(history, longest)]
    sizes = [part.current_a.size for part in parts]
    least = max(SHORTEST * max(sizes, default=0), FEWEST_KNOTS * samples_a_knot)
    parts = [part for part, size in zip(parts, sizes, strict=True) if size >= least]
    if not parts:
        return replace(window, histories=())
    window = replace(window, histories=tuple(parts))
    load = load_over(window, walk, samples_a_knot)
    return replace(window, unknowns=replace(window.unknowns, load=load))


def knot_count(window: Window) -> int:
    """Return how many knots a load has over a window without speed.

    Args:
        window: the samples.
    """
    laid = with_load(window, 1.0)
    return 0 if laid.unknowns.load is None else laid.unknowns.load.knots * len(laid.histories)


def _parts(history: History, longest: int) -> list[History]:
    """Return equal parts of a history; the interval between two of them is left out."""
    count = history.current_a.size
    edges = np.linspace(0.0, count, -(-count // longest) + 1).round().astype(int).tolist()
    return [
        History(
            history.current_a[begin:end],
            history.voltage_v[begin : end - 1],
            history.interval_s[begin : end - 1],
            None if history.speed_rad_s is None else history.speed_rad_s[begin:end],
            history.place + begin,
        )
        for begin, end in pairwise(edges)
    ]


def first_walk(white_box: MotorWhiteBox, window: Window, theta: Array) -> float:
    """Return the walk of a load that takes a tenth of the stalled motor's torque within a second.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        theta: shape (parameter,).
    """
    values = white_box.values(theta)
    stall_torque_nm = (
        float(white_box.torque_constant) * window.largest_voltage_v / values['resistance']
    )
    return float(FIRST_LOAD * stall_torque_nm / values['inertia']) ** 2 + LEAST


def walk_of_load(runs: FreeRuns, noise_a: float) -> float:
    """Return the variance that the load gains in a second, in (rad/s2)^2/s.

    It is what the knots have moved by, and what is unknown of that: one step of an
    expectation-maximisation (Dempster 1977).

    Args:
        runs: where the knots of every history fit best, at the walk that was taken for granted.
        noise_a: standard deviation of the residual.
    """
    unknowns = runs.window.unknowns
    loads = unknowns.loads
    variation = 0.0
    time_s = 0.0
    steps = np.diff(np.eye(loads.stop - loads.start), axis=0)
    histories = zip(runs.window.histories, runs.starts, runs.by_start, strict=True)
    for history, start, slope in histories:
        prior = unknowns.precision(np.full(STATES, OPEN), history.interval_s)
        regressor = slope / noise_a
        precision = regressor.T @ regressor + prior
        covariance = shortest_solution(precision, np.eye(precision.shape[0]))[loads, loads]
        variation += float(((steps @ start[loads]) ** 2).sum())
        variation += float(np.trace(steps @ covariance @ steps.T))
        time_s += float(history.interval_s.sum())
    return max(variation / max(time_s, 1e-9), LEAST) if np.isfinite(variation) else LEAST


def load_spread(
    nodes: Sequence[str], values: Mapping[str, float], runs: FreeRuns, torque_constant: float
) -> Array:
    """Return by how much a load that varies may have moved the rotor's parameters, relative.

    A load is told from inertia and friction by its course alone, and how it goes is an assumption.
    So every parameter is known no better than if all that varies were its own.

    Args:
        nodes: the rotor's parameters.
        values: of all parameters, by name.
        runs: where they fit best.
        torque_constant: Kt in N m/A.

    Returns:
        Shape (node,); 0 where the load is constant.
    """
    spread = np.zeros(len(nodes))
    load = _rms(runs.starts[:, runs.window.unknowns.loads])
    if not load > 0.0:
        return spread
    pairs = zip(runs.window.histories, runs.runs, strict=True)
    accelerations = [np.diff(path.states[:, State.SPEED]) / one.interval_s for one, path in pairs]
    current, speed = np.concatenate([path.states for path in runs.runs]).T
    for place, name in enumerate(nodes):
        if TERMS[name].formula:
            effect = forms.SHARP_EFFECTS[name].value(current, speed, torque_constant, 0.0)
            own = values[name] / values['inertia'] * np.broadcast_to(effect, current.shape)
        else:
            own = np.concatenate(accelerations)
        spread[place] = load / max(_rms(own), 1e-300)
    return np.asarray(np.minimum(spread, WIDEST))


def _rms(signal: Array) -> float:
    return float(np.sqrt(np.mean(signal**2))) if signal.size else 0.0
