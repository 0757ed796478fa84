"""What a moving average of the current would do to an estimate, where it passes for the winding.

A driver that publishes a moving average leaves a lag of first order. Where samples come hardly once
in L/R, that looks like the lag of the winding. But the torque of a winding lags with its current. A
rotor before a moving average has its torque at once. R takes over most of the difference, about the
lag over the mechanical time constant. How much of the lag is a driver's, the data tell.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.noise_memory import autocovariance
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

SMOOTHEST = 1.2
"""Sample intervals in L/R up to which the lag may be a driver's: of more, its shape tells."""

SMOOTHEST_IN_NOISE = 6.0
"""The same beside noise of the voltage, where the residual has more colour than that explains."""

FAST = 0.1
"""The same of a winding that settles in an interval: its lag is left where the other is a driver's.
"""

LEAST_COLOUR = 1.0
"""Correlation by which a residual has more colour, times the root of the samples."""


def smoothing_doubts(
    white_box: WhiteBox, run: FreeRun, theta: Array, intervals: float, *, has_colour: bool
) -> list[Doubt]:
    """Return that the lag of a hidden rotor's current may be a driver's.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
        intervals: sample intervals in L/R.
        has_colour: whether its residual has more colour than noise of the voltage makes
            (:func:`shows_colour`).
    """
    is_short = 0.0 < intervals < (SMOOTHEST_IN_NOISE if has_colour else SMOOTHEST)
    if not (is_short and isinstance(run, RotorFreeRun)) or white_box.load_varies:
        return []
    assert isinstance(white_box, MotorWhiteBox)
    fast_theta = theta.copy()
    place = white_box.context_nodes.index('inductance')
    fast_theta[place] *= min(FAST / intervals, 1.0)
    with np.errstate(all='ignore'):
        fast = free_runs(white_box, fast_theta, run.runs.window, run.runs.starts)
    runs = fast if fast.is_bounded else run.runs  # averaged twice, it differs by more
    memory = math.exp(-1.0 / intervals)
    averages = [_moving_average(path.states[:, State.CURRENT], memory) for path in runs.runs]
    response_a = run.beyond_memory(np.concatenate(averages) - run.current_a)
    if not has_colour:
        return [Doubt(response_a)]
    exchange = np.zeros_like(theta)
    exchange[place] = 1.0 - fast_theta[place] / theta[place]
    return [Doubt(response_a, exchange=exchange)]


def shows_colour(run: FreeRun) -> bool:
    """Tell whether, beside noise of the voltage, the residual remembers more than that makes it."""
    if run.noise is NO_NOISE:
        return False
    product_a2, own_a2 = autocovariance(run.residual_a)
    power_a2 = max(own_a2, 1e-300)
    correlation = product_a2 / power_a2
    count = run.residual_a.size
    of_noise = count * run.noise_power_a2 / power_a2 * float(median(run.decay))
    return correlation > of_noise + LEAST_COLOUR / math.sqrt(count)


def _moving_average(current_a: Array, memory: float) -> Array:
    """Return the moving average of a current from its first value on, shape (k + 1,).

    Args:
        current_a: shape (k + 1,).
        memory: weight of the average before.
    """
    factor = np.full((1, current_a.size - 1), memory)
    inputs = (1.0 - memory) * current_a[None, None, 1:]
    averages: Array = recurrence(factor, inputs, current_a[None, :1])[0, 0]
    return averages
