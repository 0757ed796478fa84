"""What follows from the balance of the measured state: its rate and its integrated equation."""

from __future__ import annotations

from typing import Any

import numpy as np

from gray_box_observer.white_box.balance import deducted
from gray_box_observer.white_box.interface import Array, WhiteBox

FEWEST_INTERVALS, MOST_INTERVALS = 0.05, 100.0
"""Intervals in a time constant below which the end of one is all of its mean, and from which the
trapezoidal rule is exact to a thousandth."""


def rate(white_box: WhiteBox, theta: Any, voltage_v: Any, state: Any, speed_rad_s: Any) -> Any:
    """Time derivative of the state (``di/dt``, thesis 4.17), for arrays and tensors alike.

    Args:
        white_box: the physics.
        theta: shape (..., parameter): unknown parameters, broadcast against the signals.
        voltage_v: armature voltage, any shape.
        state: current in A, same shape.
        speed_rad_s: measured speed, same shape; ignored where the white box has its own.
    """
    speed = white_box.speed(state, speed_rad_s)
    storage, *others = (theta[..., place] for place in range(theta.shape[-1]))
    return (
        deducted(
            white_box.drive(voltage_v, state, speed),
            others,
            white_box.basis(voltage_v, state, speed),
        )
        / storage
    )


def integrated_regressors(
    white_box: WhiteBox, voltage_v: Array, state: Array, speed_rad_s: Array, interval_s: Array
) -> tuple[Array, Array]:
    """Integrate the equation over each interval, instead of differentiating the samples.

    ``int drive dt = theta_0 (x_k - x_{k-1}) + sum_j theta_j int phi_j dt``, the integrals by the
    trapezoidal rule.

    Args:
        white_box: the physics.
        voltage_v: shape (motor, ..., n): voltage held over the interval that ends at sample 1 ...
            n.
        state: shape (motor, ..., n + 1): current at samples 0 ... n.
        speed_rad_s: shape (motor, ..., n + 1).
        interval_s: shape (motor, ..., n): length of the interval that ends at sample 1 ... n.

    Returns:
        regressors, shape (motor, ..., n, parameter), and target, shape (motor, ..., n), in V s.
    """
    speed = white_box.speed(state, speed_rad_s)
    start = voltage_v, state[..., :-1], speed[..., :-1]
    end = voltage_v, state[..., 1:], speed[..., 1:]
    half_s = 0.5 * interval_s
    columns = [state[..., 1:] - state[..., :-1]]
    columns += [
        half_s * (after + before)
        for before, after in zip(white_box.basis(*start), white_box.basis(*end), strict=True)
    ]
    return np.stack(columns, axis=-1), half_s * (white_box.drive(*start) + white_box.drive(*end))


def decaying_regressors(
    white_box: WhiteBox,
    voltage_v: Array,
    state: Array,
    speed_rad_s: Array,
    interval_s: Array,
    intervals: float,
) -> tuple[Array, Array]:
    """Integrate the equation over each interval, the current as it decays under a held voltage.

    Where that takes few intervals, the trapezoidal rule is off, and a delay of the voltage seems to
    be there. A current that begins and ends at zero under a speed that runs straight has a mean,
    too: it counts where the speed has the weights of the current.

    Args:
        white_box: the physics.
        voltage_v: as for :func:`integrated_regressors`.
        state: likewise.
        speed_rad_s: likewise.
        interval_s: likewise.
        intervals: in a time constant L/R.

    Returns:
        As :func:`integrated_regressors`.
    """
    share = 0.5 if intervals >= MOST_INTERVALS else 1.0
    if FEWEST_INTERVALS < intervals < MOST_INTERVALS:
        share = float(end_share(intervals))
    speed = white_box.speed(state, speed_rad_s)
    means = [begin + share * (end - begin) for begin, end in map(_ends, (state, speed))]
    effects = white_box.basis(voltage_v, *means)
    columns = [np.diff(state), *(interval_s * effect for effect in effects)]
    return np.stack(columns, axis=-1), interval_s * white_box.drive(voltage_v, *means)


def _ends(signal: Array) -> tuple[Array, Array]:
    """Return a signal at the start and at the end of every interval."""
    return signal[..., :-1], signal[..., 1:]


def end_share(intervals: Any) -> Any:
    """Return the weight of an interval's end in the mean of a current that decays along it.

    Args:
        intervals: in a time constant L/R, above 0.
    """
    return -1.0 / np.expm1(-1.0 / intervals) - intervals
