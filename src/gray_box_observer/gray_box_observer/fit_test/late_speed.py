"""How late a measured speed comes, and what that would do to an estimate whose Kb is free.

A difference of angles is the speed of half an interval ago, a filter adds its own lag. Such a speed
leaves out ``Kb lag dw/dt`` of the voltage. Without friction the acceleration follows the current:
then it looks like resistance, and the voltage balance shows nothing. The mechanics show it: the
acceleration comes later than its current. Where Kb is known, see
:mod:`~gray_box_observer.fit_test.speed_error`.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import (
    UNKNOWN,
    Amount,
    Doubt,
    long_run_covariance,
)
from gray_box_observer.samples.noise_floor import quantisation_step
from gray_box_observer.white_box.dynamics import end_share
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

SHOWN_STDS = 4.0
"""Standard deviations from which a lag is believed to be there, as of stamps: most robots have slow
and coarse speeds of which nothing can be told."""

UNEXPLAINED = 0.05
"""Sample intervals of lag that acceleration and current do not tell better than."""

FEWEST = 50
"""Intervals in which the shaft turns, from which they tell something."""

TURNS = 4.0
"""Standard deviations of the speed's noise beyond which the shaft turns: at rest friction takes
what the current gives."""

EXPONENTIAL = 1e-3
"""Time constants L/R in an interval below which a current is a straight line in it."""


def late_speed_doubts(white_box: WhiteBox, run: FreeRun, theta: Array) -> list[Doubt]:
    """Return what a lag of the measured speed would do to a motor with a free Kb.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
    """
    assert isinstance(white_box, MotorWhiteBox)
    if not white_box.speed_measured or 'back_emf_constant' not in white_box.context_nodes:
        return []
    lag = lag_of_speed(run)
    if not lag.exceeds(SHOWN_STDS):
        return []
    size = math.hypot(lag.size, UNEXPLAINED)
    return [Doubt(response_to_lag(white_box, theta, run, size))]


def response_to_lag(white_box: MotorWhiteBox, theta: Array, run: FreeRun, lag: float) -> Array:
    """Return how the current answers a lag of the speed in sample intervals, shape (k + 1,)."""
    change = np.where(run.is_whole, np.diff(run.stretch.speed_rad_s[0]), 0.0)
    back_emf_v = white_box.values(theta)['back_emf_constant'] * lag * change
    response_a: Array = run.response(-back_emf_v[None])[0]
    return response_a


def lag_of_speed(run: FreeRun, fewest: int = FEWEST) -> Amount:
    """Return by how many sample intervals the speed comes after its current.

    Its change is regressed on the mean current of its interval and the change of that from the
    interval before, on the speed, its sign and a constant load.
    """
    speed = run.stretch.speed_rad_s[0]
    current_a = _mean_currents(run)
    change = np.diff(speed)
    mean_speed = interval_means(speed)
    is_counted = float(quantisation_step(speed[None])[0]) > 0.0  # then it is zero at rest
    slowest = 0.0 if is_counted else TURNS * difference_noise(speed)
    turns = run.is_whole & (np.abs(speed[1:]) > slowest) & (np.abs(speed[:-1]) > slowest)
    turns[1:] &= run.is_whole[:-1]
    turns[0] = False
    if np.count_nonzero(turns) < fewest:
        return UNKNOWN
    interval_s = run.stretch.interval_s[0]
    columns = np.stack(
        [
            current_a,
            np.diff(current_a, prepend=current_a[:1]),
            mean_speed,
            np.sign(mean_speed),
            np.ones_like(mean_speed),
        ],
        axis=1,
    )
    columns = (columns * interval_s[:, None])[turns]
    scale = np.linalg.norm(columns, axis=0)
    if not (np.isfinite(scale).all() and scale[0] > 0.0 and scale[1] > 0.0):
        return UNKNOWN
    columns /= np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-10, hermitian=True)
    coefficients = inverse @ (columns.T @ change[turns])
    residual = change[turns] - columns @ coefficients
    covariance = inverse @ long_run_covariance(columns * residual[:, None]) @ inverse
    gain, gain_before = coefficients[:2] / scale[:2]
    if not gain > 0.0:
        return UNKNOWN
    lag = -gain_before / gain
    weights = np.array([lag / scale[0], 1.0 / scale[1]]) / gain
    variance = float(weights @ covariance[:2, :2] @ weights)
    return Amount(float(lag), math.sqrt(variance)) if 0.0 < variance < math.inf else UNKNOWN


def _mean_currents(run: FreeRun) -> Array:
    """Return the mean of the free run's current over every interval, shape (k,)."""
    constants = -np.log(np.clip(run.decay, 1e-12, 1.0))
    is_curved = constants > EXPONENTIAL
    share = np.where(is_curved, end_share(1.0 / np.where(is_curved, constants, 1.0)), 0.5)
    return np.asarray(run.current_a[:-1] + share * np.diff(run.current_a))
