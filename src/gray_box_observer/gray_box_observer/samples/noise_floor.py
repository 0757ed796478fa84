"""The least noise that readings can have: what their quantisation leaves of it.

A sensor whose noise stays below half a step repeats itself to the last bit, and its residuals look
free of noise. What is lost is spread over the step: a standard deviation of step / sqrt(12) at
least (Widrow 1956).
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.samples.order_statistics import distinct, median
from gray_box_observer.white_box.interface import Array

STEP_TO_STD = 1.0 / math.sqrt(12.0)
"""Standard deviation of what is lost by rounding to a step, in units of the step."""

COUNTED_STEP_TO_STD = 1.0 / math.sqrt(6.0)
"""The same of a speed that is counted: the angle is rounded at either end of its interval."""

WITHIN_STEP = 1.5
"""Steps within which a current has not moved: readings toggle between two levels."""

STILL = WITHIN_STEP / STEP_TO_STD
"""The same in units of the noise that the step leaves."""

REPEATED = 0.02
"""Share of the readings that repeat others before a step is looked for: a finer step is drowned in
the noise."""

ON_GRID = 0.8
"""Share of the distances between levels that must be multiples of the step."""

MULTIPLE = 0.1
"""Nearness to a multiple of the step, in steps; chance brings a fifth of all distances as near."""

FEWEST_DISTANCES = 6
"""Distances between levels that make a grid; of fewer only restless readings tell."""

RESTLESS = 0.1
"""Share of readings that differ from the one before: two levels of noise, rather than two of a
signal without any."""

RETURNS = 5.0
"""Changes of the reading for every level met that show few levels to be a grid all the same."""

ROTOR_RETURNS = 2
"""Changes of a speed beyond one for every level met, from which few levels are a grid."""

_QUANTILES = (0.0, 0.02, 0.05, 0.1, 0.25, 0.5)
"""Where among the sorted distances the step is looked for: readings off the grid bring distances
below it."""


def speed_step(speed_rad_s: Array) -> float:
    """Read the step of one rotor's speed, of a few samples too.

    A rotor has inertia: it does not jump from one speed to another and back to exactly the first
    one. Where its readings do, they are steps, however seldom they change.

    Args:
        speed_rad_s: shape (n,): readings in the order of time.

    Returns:
        In rad/s; 0 where there is none to be seen.
    """
    step = float(quantisation_step(speed_rad_s[None])[0])
    if step > 0.0:
        return step
    levels = distinct(speed_rad_s)
    distances = np.diff(levels)
    changes = int(np.count_nonzero(speed_rad_s[1:] != speed_rad_s[:-1]))
    is_back = changes >= levels.size + ROTOR_RETURNS
    if not 0 < distances.size < FEWEST_DISTANCES or not is_back:
        return 0.0
    least = float(distances.min())
    return least if _is_grid(distances, least) else 0.0


def reading_step(speed_rad_s: Array) -> float:
    """Return by how much one rotor's speed moves when its reading does.

    Most readings of a slow speed in steps repeat the one before, and so do those of a speed that is
    read more seldom than it is asked for. Then it is the usual move.

    Args:
        speed_rad_s: shape (n,): readings in the order of time.

    Returns:
        In rad/s; 0 where readings move freely, NaN where they have never moved.
    """
    moves = np.abs(np.diff(speed_rad_s))
    moves = moves[moves > 0.0]
    if 2 * moves.size < speed_rad_s.size:
        return float(median(moves)) if moves.size else math.nan
    return speed_step(speed_rad_s)


def quantisation_step(readings: Array) -> Array:
    """Read the step of a quantised signal from its readings.

    The distances between the levels met are multiples of the step, save those at a few levels off
    the grid. Readings of a continuous sensor hardly ever repeat, and their distances are multiples
    of nothing.

    Args:
        readings: shape (motor, n), in the order of time; what is not finite is left out.

    Returns:
        Shape (motor,): the step, in the unit of the readings; 0 where there is none to be seen.
    """
    sorted_readings = np.sort(readings, axis=1)
    has_repeats = np.sum(np.diff(sorted_readings, axis=1) == 0.0, axis=1) >= max(
        2.0, REPEATED * readings.shape[1]
    )
    step = np.zeros(readings.shape[0])
    for motor in np.flatnonzero(has_repeats):
        row = readings[motor]
        step[motor] = _step(row[np.isfinite(row)])
    return step


def _step(readings: Array) -> float:
    """The step of one motor's readings; 0 where there is none."""
    levels = distinct(readings)
    distances = np.diff(levels)
    distances = distances[distances > 1e-12 * np.max(np.abs(levels), initial=0.0)]
    if distances.size == 0:
        return 0.0
    if distances.size < FEWEST_DISTANCES:
        changes = np.count_nonzero(readings[1:] != readings[:-1])
        has_returns = distances.size > 1 and changes >= RETURNS * levels.size
        if not has_returns and changes < RESTLESS * readings.size:
            return 0.0
    in_order = np.sort(distances)
    candidates = [
        _refined(distances, float(in_order[int(share * (in_order.size - 1))]))
        for share in _QUANTILES
    ]
    return max((step for step in candidates if _is_grid(distances, step)), default=0.0)


def _refined(distances: Array, step: float) -> float:
    """The step again, from distances of ever more steps, which averages the rounding out."""
    for reach in (1.5, 8.0, 64.0, 512.0):
        near = distances[(distances > 0.5 * step) & (distances < reach * step)]
        if near.size:
            step = float(np.sum(near) / np.sum(np.round(near / step)))
    return step


def _is_grid(distances: Array, step: float) -> bool:
    multiple = distances / step
    near = (np.abs(multiple - np.round(multiple)) <= MULTIPLE) & (multiple > 0.5)
    return bool(np.mean(near) >= ON_GRID)
