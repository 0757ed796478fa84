"""Tells of samples whether the motor rests: then they hold noise alone, and no fit is made of it.

A voltage that is measured with noise moves at every sample, also where the driver holds none.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.samples.replay_buffer import SPEED, TORQUE, VOLTAGE
from gray_box_observer.white_box.interface import Array

ABOUT_ZERO = 1.25
"""Root mean square of a signal about zero over its noise, up to which it is noise."""

ANSWERS = 3.0
"""Correlation of a current with the voltages before, times the root of the samples, from which it
answers them."""

LAGS = 16
"""Intervals before a sample whose voltages are asked."""


def is_at_rest(samples: Array) -> bool:
    """Tell whether current and speed are noise about zero, and the current answers no voltage.

    Args:
        samples: shape (signal, n), as a replay buffer gives them of one motor.
    """
    torque_nm = samples[TORQUE]
    has_speed = samples.shape[0] > SPEED and bool(np.isfinite(samples[SPEED]).all())
    signals = (torque_nm, samples[SPEED]) if has_speed else (torque_nm,)
    if not all(map(_is_noise, signals)):
        return False
    return not any(_answers(torque_nm[lag:], samples[VOLTAGE, 1:], lag) for lag in range(LAGS))


def _is_noise(signal: Array) -> bool:
    size = float(np.sqrt(np.mean(signal * signal)))
    return size <= ABOUT_ZERO * difference_noise(signal)


def _answers(torque_nm: Array, voltage_v: Array, lag: int) -> bool:
    """Tell whether torques, shape (n - lag,), follow voltages of so many intervals before."""
    count = torque_nm.size - 1
    one = torque_nm[1:] - torque_nm[1:].mean()
    other = voltage_v[:count] - voltage_v[:count].mean()
    size = math.sqrt(float(one @ one) * float(other @ other))
    return size > 0.0 and abs(float(one @ other)) * math.sqrt(count) > ANSWERS * size
