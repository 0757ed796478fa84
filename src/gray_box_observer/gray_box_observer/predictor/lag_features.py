"""Past voltage and speed of a motor, smoothed by leaky integrators with a ladder of times.

Inertia makes the speed, and hence the back-EMF, a slow filter of the voltage. A network would have
to learn such memory by back-propagation through hundreds of samples. Leaky integrators have it from
the first: weighted sums of theirs come near every filter whose poles are real and between the
shortest time and the longest, and what a held signal makes of them follows in closed form for an
interval of any length.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.predictor.network import Mask
from gray_box_observer.white_box.interface import Array

LADDER: Array = 2.0 ** np.arange(1.0, 8.0, dtype=np.float64)
"""Times of the integrators, in sample intervals: the rungs are near enough for what lies between
them."""

SIGNALS = 2
"""Voltage and speed."""

LONGEST = 8 * int(LADDER[-1])
"""Samples behind which 3e-4 is left of what the slowest integrator held."""


def blank(motors: int) -> Array:
    """Return the traces of motors at rest, shape (motor, SIGNALS, rung)."""
    return np.zeros((motors, SIGNALS, LADDER.size))


def cleared(traces: Array, motors: Mask) -> Array:
    """Return the traces, blank for the motors that a mask of shape (motor,) marks."""
    return np.where(motors[:, None, None], 0.0, traces) if motors.any() else traces


def advance(traces: Array, voltage_v: Array, speed_rad_s: Array, intervals: Array) -> Array:
    """Return the traces at the end of an interval over which voltage and speed are held.

    Args:
        traces: shape (motor, SIGNALS, rung): at its beginning.
        voltage_v: shape (motor,).
        speed_rad_s: shape (motor,).
        intervals: shape (motor,): its length, in sample intervals.
    """
    inputs = np.empty((*voltage_v.shape, SIGNALS, 1))
    inputs[..., 0, 0] = voltage_v
    inputs[..., 1, 0] = speed_rad_s
    traces_at_end: Array = (
        inputs + (traces - inputs) * np.exp(-intervals[:, None] / LADDER)[:, None, :]
    )
    return traces_at_end


def along(voltage_v: Array, speed_rad_s: Array, intervals: Array, start: Array) -> Array:
    """Return the traces along a signal history, shape (motor, time, SIGNALS, rung).

    Args:
        voltage_v: shape (motor, time).
        speed_rad_s: shape (motor, time).
        intervals: shape (motor, time): lengths, in sample intervals.
        start: shape (motor, SIGNALS, rung): at its beginning.
    """
    decay = np.exp(-intervals[..., None] / LADDER)[:, :, None, :]
    path = np.stack([voltage_v, speed_rad_s], axis=-1)[..., None] * (1.0 - decay)
    traces = start
    for k in range(path.shape[1]):
        traces = path[:, k] = path[:, k] + traces * decay[:, k]
    return path


def ending(voltage_v: Array, speed_rad_s: Array, intervals: Array) -> Array:
    """Return the traces at the end of a history that began at rest, at once; see :func:`along`."""
    to_end = np.cumsum(intervals[:, ::-1], axis=1)[:, ::-1][
        ..., None
    ]  # from the beginning of each interval
    weight = np.exp(-(to_end - intervals[..., None]) / LADDER) - np.exp(-to_end / LADDER)
    traces: Array = np.einsum('mts,mtr->msr', np.stack([voltage_v, speed_rad_s], axis=-1), weight)
    return traces


def presumed(voltage_v: Array, speed_rad_s: Array) -> Array:
    """Guess the traces before a stretch that goes on from samples which are lost.

    Each is the mean over as many samples to come as the integrator reaches back: as it was before,
    so it goes on.

    Args:
        voltage_v: shape (motor, time).
        speed_rad_s: shape (motor, time).
    """
    signals = np.stack([voltage_v, speed_rad_s], axis=1)  # shape: (motor, SIGNALS, time)
    return np.stack([signals[..., : int(time)].mean(axis=-1) for time in LADDER], axis=-1)
