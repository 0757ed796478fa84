"""Whether a voltage is held, so that there is nothing to tell a fit by, and how noisy it is."""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array

HELD = 0.01
"""Range of the voltage, as a share of its largest value, in which it is held: that tells nothing of
the fit."""

HELD_NOISY = 0.15
"""The same, at most, where the voltage is measured: its own noise is no move."""

NOISE_RANGE = 10.0
"""Range of so much noise in standard deviations: that of 4096 samples is 7 to 9."""


def is_held(voltage_v: Array) -> bool:
    """Tell whether a voltage hardly moves, shape (n,): then there is nothing to tell a fit by."""
    lowest_v = float(voltage_v.min())
    highest_v = float(voltage_v.max())
    range_v = highest_v - lowest_v
    largest_v = max(abs(lowest_v), abs(highest_v))
    if range_v == 0.0:  # the usual case, without looking for noise
        return True
    if range_v > HELD_NOISY * largest_v:
        return False
    return range_v <= max(HELD * largest_v, noise_range(voltage_v, largest_v))


def noise_range(voltage_v: Array, largest_v: float) -> float:
    """Return the range in V that a voltage has from its own noise.

    Args:
        voltage_v: shape (n,), n at least 2.
        largest_v: voltage that drives the motor, beside which noise is small: what moves by more of
            it is no noise.
    """
    noise_v = MAD_TO_STD * float(median(np.abs(np.diff(voltage_v)))) / math.sqrt(2.0)
    return min(NOISE_RANGE * noise_v, HELD_NOISY * largest_v)
