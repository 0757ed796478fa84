"""How fast a load walks at random, from what its knots turn out to be."""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import shortest_solution
from gray_box_observer.context_nodes.rotor.history_unknowns import LOADS
from gray_box_observer.context_nodes.rotor.logarithms import Fit
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES
from gray_box_observer.context_nodes.rotor.window import Window

OPEN = 1e6
"""Standard deviation of first states that are as good as unknown, in A and rad/s."""

LEAST = 1e-12
"""Variance in a second of a load that stands still, in (rad/s2)^2/s."""


def walk_of_load(fit: Fit, window: Window) -> float:
    """Return the variance that the load gains in a second, in (rad/s2)^2/s.

    It is what the knots have moved by, and what is unknown of that: one step of an
    expectation-maximisation (Dempster 1977).

    Args:
        fit: with the knots of every history.
        window: its samples, whose output says what walk was taken for granted.
    """
    output = window.speed_output
    assert output is not None
    variation = 0.0
    time_s = 0.0
    steps = np.diff(np.eye(output.knots), axis=0)
    for history, start, slope in zip(window.histories, fit.starts, fit.runs.by_start, strict=True):
        prior = output.precision(np.full(STATES, OPEN), history.interval_s)
        regressor = slope / fit.noise_a
        precision = regressor.T @ regressor + prior
        covariance = shortest_solution(precision, np.eye(precision.shape[0]))[LOADS, LOADS]
        variation += float(((steps @ start[LOADS]) ** 2).sum())
        variation += float(np.trace(steps @ covariance @ steps.T))
        time_s += float(history.interval_s.sum())
    return max(variation / max(time_s, 1e-9), LEAST) if np.isfinite(variation) else LEAST
