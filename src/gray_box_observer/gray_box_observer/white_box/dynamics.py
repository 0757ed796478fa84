"""What follows from a white box: its rate, its motion under a held voltage and its integrated equation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gray_box_observer.white_box.base import Array, WhiteBox

MAX_SUBSTEPS = 64
"""Where more Runge-Kutta steps were needed, exponential ones are taken: they settle where Runge-Kutta would burst."""

STABLE_STEP = 0.5
"""Largest product of step and decay rate; the error of the classical Runge-Kutta step is then below 3e-4."""


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
    total = white_box.drive(voltage_v, state, speed)
    for j, phi in enumerate(white_box.basis(state, speed), start=1):
        total = total - theta[..., j] * phi
    return total / theta[..., 0]


def decay_rate(white_box: WhiteBox, theta: Array, state: Array, speed_rad_s: Array) -> Array:
    """How fast the state forgets, ``-d rate / d state`` in 1/s (the inverse of the electrical time constant)."""
    speed = white_box.speed(state, speed_rad_s)
    slope = -white_box.drive_slope(state, speed)
    for j, phi in enumerate(white_box.basis_slope(state, speed), start=1):
        slope = slope + theta[..., j] * phi
    result: Array = slope / theta[..., 0]
    return result


def substeps_for(fastest_decay: float, interval_s: Array) -> int:
    """Number of Runge-Kutta steps that intervals need where nothing decays faster (1/s), at most MAX_SUBSTEPS."""
    stiffness = fastest_decay * float(np.max(interval_s))
    if not math.isfinite(stiffness):
        return MAX_SUBSTEPS
    return min(MAX_SUBSTEPS, max(1, math.ceil(stiffness / STABLE_STEP)))


def advance(
    white_box: WhiteBox,
    theta: Array,
    state: Array,
    voltage_v: Array,
    speed_rad_s: Array,
    next_speed_rad_s: Array,
    interval_s: Array,
    fastest_decay: float | None = None,
) -> Array:
    """Move the state over one interval of held voltage.

    Classical Runge-Kutta, as many steps as the time constant asks for; measured speed runs linearly between samples.

    Args:
        white_box: the physics.
        theta: shape (motor, parameter).
        state: shape (motor,): current at the start, in A.
        voltage_v: shape (motor,): voltage held over the interval.
        speed_rad_s: shape (motor,): speed at the start.
        next_speed_rad_s: shape (motor,): speed at the end.
        interval_s: shape (motor,): length of the interval.
        fastest_decay: a bound of the decay rate in 1/s, where one is known; else it is worked out.

    Returns:
        Shape (motor,): the state at the end.
    """
    if fastest_decay is None:
        fastest_decay = float(np.max(np.abs(decay_rate(white_box, theta, state, speed_rad_s))))
    n = substeps_for(fastest_decay, interval_s)
    step = interval_s / n
    slope = (next_speed_rad_s - speed_rad_s) / n
    stiff = not fastest_decay * float(np.max(interval_s)) <= n * STABLE_STEP
    for k in range(n):
        w0 = speed_rad_s + k * slope
        wm = w0 + 0.5 * slope
        k1 = rate(white_box, theta, voltage_v, state, w0)
        if stiff:
            decay = np.maximum(decay_rate(white_box, theta, state, w0), 1e-12)
            state = state - np.expm1(-decay * step) / decay * k1
            continue
        k2 = rate(white_box, theta, voltage_v, state + 0.5 * step * k1, wm)
        k3 = rate(white_box, theta, voltage_v, state + 0.5 * step * k2, wm)
        k4 = rate(white_box, theta, voltage_v, state + step * k3, w0 + slope)
        state = state + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return state


def integrated_regressors(
    white_box: WhiteBox, voltage_v: Array, state: Array, speed_rad_s: Array, interval_s: Array
) -> tuple[Array, Array]:
    """Integrate the equation over each interval between samples, instead of differentiating the samples.

    ``int drive dt = theta_0 (x_k - x_{k-1}) + sum_j theta_j int phi_j dt``, the integrals by the trapezoidal rule.

    Args:
        white_box: the physics.
        voltage_v: shape (motor, ..., n): voltage held over the interval that ends at sample 1 ... n.
        state: shape (motor, ..., n + 1): current at samples 0 ... n.
        speed_rad_s: shape (motor, ..., n + 1).
        interval_s: shape (motor, ..., n): length of the interval that ends at sample 1 ... n.

    Returns:
        regressors, shape (motor, ..., n, parameter), and target, shape (motor, ..., n), in V s.
    """
    speed = white_box.speed(state, speed_rad_s)
    phis = white_box.basis(state, speed)
    columns = [state[..., 1:] - state[..., :-1]]
    columns += [0.5 * interval_s * (phi[..., 1:] + phi[..., :-1]) for phi in phis]
    start = white_box.drive(voltage_v, state[..., :-1], speed[..., :-1])
    end = white_box.drive(voltage_v, state[..., 1:], speed[..., 1:])
    return np.stack(columns, axis=-1), 0.5 * interval_s * (start + end)
