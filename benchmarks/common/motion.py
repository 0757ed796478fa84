"""The benchmarks' own solution of the motor equation, with sensitivities, as a cross-check.

``L di/dt = V - R i - Kb w - K_HS |w| i`` (docs/METHOD.md, The form) over held voltages, in the
physical parameters themselves. All intervals are stepped at once, each from a guess of its start;
the guesses are mended by Newton's method on the whole sequence, a bidiagonal system, so that a
minute of samples takes milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

FloatArray = NDArray[np.float64]

STEP_TIMES_RATE = 0.1
"""Largest product of solver step and decay rate: the classical Runge-Kutta step is then exact to
1e-7."""

RUNGE_KUTTA = ((0.0, 1.0, 0.5), (0.5, 2.0, 0.5), (0.5, 2.0, 1.0), (1.0, 1.0, 0.0))
"""Where each slope of the classical method is taken, its weight, and how far the next stage goes
along it."""

MAX_SUBSTEPS = 32
MAX_SWEEPS = 30


@dataclass(frozen=True, slots=True)
class Form:
    """Which terms of the equation are unknown.

    Attributes:
        parameters: names of the unknowns; the first three are always inductance, resistance and
            hysteresis, and ``back_emf_constant`` may follow.
        torque_constant: Kt in N m/A.
        back_emf_constant: Kb in V s/rad, used where it is not among the unknowns.
        speed_measured: whether w is a signal, linear between samples; else ``w = Kt i``.
    """

    parameters: tuple[str, ...]
    torque_constant: float
    back_emf_constant: float
    speed_measured: bool


@dataclass(frozen=True, slots=True)
class Inputs:
    """Known signals of n + 1 samples: arrays of length n belong to the intervals between them.

    Attributes:
        interval_s: shape (n,).
        voltage_v: shape (n,): held over each interval.
        speed_rad_s: shape (n + 1,): measured speed; ignored where the form has its own.
    """

    interval_s: FloatArray
    voltage_v: FloatArray
    speed_rad_s: FloatArray

    def first(self, intervals: int) -> Inputs:
        """Return the beginning, so many intervals long."""
        return Inputs(
            self.interval_s[:intervals],
            self.voltage_v[:intervals],
            self.speed_rad_s[: intervals + 1],
        )


@dataclass(frozen=True, slots=True)
class Motion:
    """Current at every sample and its derivatives.

    Attributes:
        current_a: shape (n + 1,).
        sensitivity: shape (1 + parameter, n + 1): by the first current, then by each parameter.
    """

    current_a: FloatArray
    sensitivity: FloatArray


def rate(
    form: Form, theta: FloatArray, current: FloatArray, voltage: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return di/dt, its derivative by the current, and by each parameter, shape (parameter, k)."""
    L, R, K = theta[:3]
    kt = form.torque_constant
    kb = theta[3] if len(theta) > 3 else form.back_emf_constant
    if form.speed_measured:
        slope = -(R + K * np.abs(speed)) / L
    else:
        speed = kt * current
        slope = -(R + kb * kt + 2.0 * K * kt * np.abs(current)) / L
    loss = np.abs(speed) * current
    value = (voltage - R * current - kb * speed - K * loss) / L
    columns = [-value / L, -current / L, -loss / L]
    if len(theta) > 3:
        columns.append(-speed / L)
    return value, slope, np.stack(columns)


def step_all(
    form: Form, theta: FloatArray, start: FloatArray, inputs: Inputs
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Step every interval from its own start.

    Returns:
        The ends, their derivatives by the starts, both shape (n,), and by the parameters, shape
        (parameter, n).
    """
    slope = rate(form, theta, start, inputs.voltage_v, inputs.speed_rad_s[:-1])[1]
    fastest = float(np.max(np.abs(slope) * inputs.interval_s))
    n = (
        min(MAX_SUBSTEPS, max(1, int(np.ceil(fastest / STEP_TIMES_RATE))))
        if np.isfinite(fastest)
        else MAX_SUBSTEPS
    )
    h = inputs.interval_s / n
    acceleration = np.diff(inputs.speed_rad_s) / n
    x = start
    by_start = np.ones_like(start)
    by_theta = np.zeros((len(theta), start.size))
    for k in range(n):
        w = inputs.speed_rad_s[:-1] + k * acceleration
        base = (x, by_start, by_theta)
        stage = base
        total = (np.zeros_like(x), np.zeros_like(x), np.zeros_like(by_theta))
        for node, weight, ahead in RUNGE_KUTTA:
            value, a, b = rate(form, theta, stage[0], inputs.voltage_v, w + node * acceleration)
            slopes = (value, a * stage[1], a * stage[2] + b)
            total = tuple(t + weight * s for t, s in zip(total, slopes, strict=True))
            stage = tuple(y + ahead * h * s for y, s in zip(base, slopes, strict=True))
        x, by_start, by_theta = (y + h / 6.0 * t for y, t in zip(base, total, strict=True))
    return x, by_start, by_theta


def solve(
    form: Form, theta: FloatArray, first_a: float, inputs: Inputs, guess_a: FloatArray
) -> Motion:
    """Solve the equation over all samples.

    Args:
        form: which terms are unknown.
        theta: shape (parameter,).
        first_a: current at the first sample.
        inputs: the signals.
        guess_a: shape (n + 1,): currents to start Newton's method from, such as the measured ones.

    Raises:
        ArithmeticError: the solution is not finite or Newton's method does not settle.
    """
    current = np.array(guess_a, dtype=float)
    scale = float(np.max(np.abs(current))) + 1e-12
    with np.errstate(all='ignore'):
        for _ in range(MAX_SWEEPS):
            end, by_start, by_theta = step_all(form, theta, current[:-1], inputs)
            gap = np.concatenate([[first_a], end]) - current
            if not np.all(np.isfinite(gap)):
                break
            current = current + _chain(by_start, gap)
            if np.max(np.abs(gap)) < 1e-11 * scale:
                forcing = np.zeros((current.size, 1 + len(theta)))
                forcing[0, 0] = 1.0
                forcing[1:, 1:] = by_theta.T
                return Motion(current, _chain(by_start, forcing).T)
    raise ArithmeticError(
        f'the motion under {np.round(theta, 6).tolist()} did not settle in {MAX_SWEEPS} sweeps'
    )


def _chain(by_start: FloatArray, forcing: FloatArray) -> FloatArray:
    """Solve ``y_0 = f_0``, ``y_{k+1} = a_k y_k + f_{k+1}``; forcing has time on its first axis."""
    bands = np.ones((2, by_start.size + 1))
    bands[1, :-1] = -by_start
    result: FloatArray = solve_banded((1, 0), bands, forcing, check_finite=False)
    return result
