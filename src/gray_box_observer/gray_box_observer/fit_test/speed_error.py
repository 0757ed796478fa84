"""What lag and steps of a measured speed would do to an estimate that takes it for exact.

They are looked at before a fit of the whole motor has told what the sensor does, and by tests for
as long as the speed is taken for exact. A lag of an interval is likely, or what acceleration and
current leave of it (:mod:`~gray_box_observer.fit_test.late_speed`).

A reading that is rounded, or counted, is wrong by a part of its step, and it stays so for as long
as it is the same.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.late_speed import UNEXPLAINED, lag_of_speed, response_to_lag
from gray_box_observer.fit_test.projection import UNKNOWN, Projection
from gray_box_observer.fit_test.speed_difference import influence_of_speeds
from gray_box_observer.samples.noise_floor import COUNTED_STEP_TO_STD, reading_step
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

FEWEST = 16
"""Samples from which something can be told."""

MOST_SAMPLES = 512
"""Samples that are looked at before the first answer. A speed that does not move over so many is
that of a shaft that stands, or of a dead sensor; over fewer it may not have come to its first step.
"""

LIKELY, FEWEST_LIKELY = 1.0, 24
"""Standard deviation in sample intervals of a lag before anything is known of it, and intervals in
which the shaft turns from which they tell more."""

FARTHEST = 1.0
"""Shift of a log-parameter at which it is held: L cannot fall below zero. What it would have taken
of the response beyond, the other parameters take."""


def likely_shifts(white_box: MotorWhiteBox, theta: Array, content: Array) -> Array:
    """Return by how much likely errors of the speed move the log-parameters.

    Args:
        white_box: of one motor whose speed is measured.
        theta: shape (1, parameter): its present values.
        content: shape (signal, 1, n): samples, as a replay buffer gives them; FEWEST at least.

    Returns:
        Shape (error, parameter), one row for each of some errors that do not depend on each other:
        the lag, and every reading that lasts. NaN where nothing can be told.
    """
    run = free_run(white_box, to_coordinates(theta), SampleWindow.of_content(white_box, content))
    projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
    lag = lag_of_speed(run, FEWEST_LIKELY)
    if lag.mean < -UNEXPLAINED:  # no speed comes early: a transient or two tell nothing
        lag = UNKNOWN
    lag_a = response_to_lag(white_box, theta[0], run, lag.likely(LIKELY).size)
    lag_shift = projection.shift(projection.with_weight(lag_a))
    step_shifts = _step_shifts(white_box, theta[0], run, projection)
    shifts = np.concatenate([lag_shift[None], step_shifts])
    return _within_reach(shifts, projection.covariance_of_white())


def _step_shifts(
    white_box: MotorWhiteBox, theta: Array, run: FreeRun, projection: Projection
) -> Array:
    """Return by how much the steps of the readings move the log-parameters, (reading, parameter).

    Successive samples with the same reading share their error.
    """
    speed_rad_s = run.stretch.speed_rad_s[0]
    std_rad_s = COUNTED_STEP_TO_STD * reading_step(speed_rad_s)
    is_still = np.isnan(std_rad_s) and speed_rad_s.size >= MOST_SAMPLES
    if std_rad_s == 0.0 or is_still:
        return np.empty((0, theta.size))
    influence = influence_of_speeds(white_box, theta, run, projection)
    begins = np.concatenate([[0], 1 + np.flatnonzero(np.diff(speed_rad_s))])
    return std_rad_s * np.add.reduceat(influence, begins, axis=1).T


def _within_reach(shifts: Array, covariance: Array) -> Array:
    """Return shifts none of which is beyond :data:`FARTHEST`, shape (error, parameter).

    Args:
        shifts: by independent errors.
        covariance: shape (parameter, parameter): of the log-parameters under white noise.
    """
    result = shifts
    if not np.isfinite(covariance).all():  # of an absurd motor; its inverse would never be found
        return np.full_like(shifts, np.nan)
    places: list[int] = []  # of the parameters that are held
    while np.isfinite(result).all() and len(places) < shifts.shape[1]:
        sizes = np.linalg.norm(result, axis=0)
        sizes[places] = 0.0
        place = int(np.argmax(sizes))
        if sizes[place] <= FARTHEST:
            break
        places.append(place)
        ends = result[:, places]
        ends[:, -1] *= FARTHEST / sizes[place]
        to_others = np.linalg.pinv(covariance[np.ix_(places, places)]) @ covariance[places]
        result = shifts - (shifts[:, places] - ends) @ to_others
        result[:, places] = ends
    return result
