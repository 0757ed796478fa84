"""The motion of the state over one interval, with its derivatives, in the coordinates in which the rate is linear.

The rate of a white box that is linear in its parameters is linear too in ``p = (1, theta_1, ...) / theta_0``, for a
motor ``(1/L, R/L, K_HS/L, ...)``: ``dx/dt = p_0 drive - sum_j p_j phi_j`` (docs/METHOD.md, The form).
Sensitivities follow the variational equation, integrated together with the state.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.base import Array, WhiteBox, bounds

LARGEST_STEP = 0.35
"""Largest product of step and decay rate; the Runge-Kutta step is then right to 5e-5 of a decay."""

MAX_STEPS = 16
"""Where more Runge-Kutta steps were needed, exponential ones are taken: they settle where Runge-Kutta would burst."""

STIFF = MAX_STEPS + 1
"""Number of steps that stands for MAX_STEPS exponential ones."""

_Rate = tuple[Array, Array, Array]
"""Rate of the state, its derivative by the state, and by every coordinate (shape (coordinate, motor, k))."""


def to_coordinates(theta: Array) -> Array:
    """Turn parameters, shape (motor, parameter), into the coordinates of the rate."""
    leading, coordinates = theta[:, :1], np.empty_like(theta)
    np.divide(1.0, leading, out=coordinates[:, :1])
    np.divide(theta[:, 1:], leading, out=coordinates[:, 1:])
    return coordinates


def to_parameters(p: Array) -> Array:
    """Turn coordinates back into parameters; the map is its own inverse."""
    return to_coordinates(p)


def within_bounds(white_box: WhiteBox, p: Array) -> Array:
    """Move coordinates so that every parameter lies inside its bounds."""
    return to_coordinates(to_parameters(p).clip(*bounds(white_box.parameters)))


def parameter_covariance(theta: Array, relative: Array) -> Array:
    """Turn a covariance of the coordinates' logarithms into that of the parameters.

    With ``log theta_0 = -log p_0`` and ``log theta_j = log p_j - log p_0``.

    Args:
        theta: shape (motor, parameter).
        relative: shape (motor, coordinate, coordinate).
    """
    moved = np.empty_like(relative)
    np.negative(relative[:, :1], out=moved[:, :1])
    np.subtract(relative[:, 1:], relative[:, :1], out=moved[:, 1:])
    moved[:, :, 1:] -= moved[:, :, :1]
    np.negative(moved[:, :, :1], out=moved[:, :, :1])
    return moved * theta[:, :, None] * theta[:, None, :]


@dataclass(frozen=True, slots=True)
class _Interval:
    """Intervals, or equal parts of them, and what is known of them; every field of shape (motor, k).

    Attributes:
        voltage_v: voltage held over it.
        speed_rad_s: measured speed at its start; it runs linearly to that at the end.
        end_speed_rad_s: measured speed at its end.
        length_s: how long it lasts.
    """

    voltage_v: Array
    speed_rad_s: Array
    end_speed_rad_s: Array
    length_s: Array

    def of(self, index: NDArray[np.intp]) -> _Interval:
        """Return those of the chosen motors."""
        speeds = self.speed_rad_s[index], self.end_speed_rad_s[index]
        return _Interval(self.voltage_v[index], *speeds, self.length_s[index])

    def parts(self, count: int) -> Iterator[_Interval]:
        """Cut into equal parts, the first one first; the last ends where the whole does, to the last bit."""
        slope, length = (self.end_speed_rad_s - self.speed_rad_s) / count, self.length_s / count
        for j in range(count):
            end = self.end_speed_rad_s if j + 1 == count else self.speed_rad_s + (j + 1) * slope
            yield _Interval(self.voltage_v, self.speed_rad_s + j * slope, end, length)


@dataclass(frozen=True, slots=True)
class Flow:
    """Where intervals lead, linearised about where they begin.

    Attributes:
        end: shape (motor, k): state at the end of each interval.
        by_state: shape (motor, k): derivative of the end by the start.
        by_coordinate: shape (coordinate, motor, k): derivative of the end by the coordinates.
    """

    end: Array
    by_state: Array
    by_coordinate: Array


def flow(
    white_box: WhiteBox,
    p: Array,
    start: Array,
    voltage_v: Array,
    speed_rad_s: Array,
    end_speed: Array,
    interval_s: Array,
    ops: Any = np,
) -> Flow:
    """Move many intervals on at once, each from its own start, by classical Runge-Kutta steps.

    As many steps as each motor's fastest decay asks for; beyond MAX_STEPS, exponential steps, which are stable however
    stiff.

    Args:
        white_box: the physics.
        p: shape (motor, coordinate).
        start: shape (motor, k): state at the start of every interval.
        voltage_v: shape (motor, k): voltage held over it.
        speed_rad_s: shape (motor, k): measured speed at its start.
        end_speed: shape (motor, k): measured speed at its end, in rad/s.
        interval_s: shape (motor, k).
        ops: numpy, or :class:`~gray_box_observer.torch_ops.TorchOps` where everything is a tensor.
    """
    interval = _Interval(voltage_v, speed_rad_s, end_speed, interval_s)
    here = _rate(ops, white_box, p, start, voltage_v, speed_rad_s)
    stiffness = _stiffness(ops, here, interval_s)
    if ops.all(stiffness <= LARGEST_STEP):
        return _runge_kutta_step(ops, white_box, p, start, here, interval)
    steps = ops.where(stiffness <= MAX_STEPS * LARGEST_STEP, ops.ceil(stiffness / LARGEST_STEP), STIFF)
    first = steps[0]
    if ops.all(steps == first):
        return _in_steps(ops, white_box, p, start, here, interval, int(first))
    ends, slopes, forced = (ops.empty_like(like) for like in (start, start, here[2]))
    for count in ops.unique(steps).tolist():  # no motor moves otherwise than it would alone
        which = ops.flatnonzero(steps == count)
        rate = (here[0][which], here[1][which], here[2][:, which])
        box, own = white_box.of_motors(which), interval.of(which)
        moved = _in_steps(ops, box, p[which], start[which], rate, own, int(count))
        ends[which], slopes[which], forced[:, which] = moved.end, moved.by_state, moved.by_coordinate
    return Flow(ends, slopes, forced)


def is_stiff(
    white_box: WhiteBox, p: Array, start: Array, voltage_v: Array, speed_rad_s: Array, interval_s: Array, ops: Any = np
) -> NDArray[np.bool_]:  # fmt: skip
    """Tell for whom :func:`flow` takes exponential steps, shape (motor,); arguments as there."""
    here = _rate(ops, white_box, p, start, voltage_v, speed_rad_s)
    stiff: NDArray[np.bool_] = ~(_stiffness(ops, here, interval_s) <= MAX_STEPS * LARGEST_STEP)
    return stiff


def _stiffness(ops: Any, here: _Rate, interval_s: Array) -> Any:
    """Largest product of interval and decay rate, shape (motor,)."""
    return ops.max(abs(here[1]) * interval_s, axis=1, initial=0.0)


def _in_steps(
    ops: Any, white_box: WhiteBox, p: Array, start: Array, here: _Rate, interval: _Interval, count: int
) -> Flow:  # fmt: skip
    """Move intervals on in equal steps; ``here`` is the rate at the start."""
    step, count = (_runge_kutta_step, max(1, count)) if count <= MAX_STEPS else (_exponential_step, MAX_STEPS)
    if count == 1:
        return step(ops, white_box, p, start, here, interval)
    state, by_state = start, ops.ones_like(start)
    by_coordinate = ops.zeros_like(here[2])
    for j, part in enumerate(interval.parts(count)):
        if j > 0:
            here = _rate(ops, white_box, p, state, interval.voltage_v, part.speed_rad_s)
        moved = step(ops, white_box, p, state, here, part)
        state, by_state = moved.end, moved.by_state * by_state
        by_coordinate = moved.by_state * by_coordinate + moved.by_coordinate
    return Flow(state, by_state, by_coordinate)


def _runge_kutta_step(
    ops: Any, white_box: WhiteBox, p: Array, start: Array, here: _Rate, interval: _Interval
) -> Flow:  # fmt: skip
    """One classical Runge-Kutta step of the state and its variational equation; ``here`` is the rate at the start."""
    voltage_v, step_s = interval.voltage_v, interval.length_s
    half, middle = 0.5 * step_s, 0.5 * (interval.speed_rad_s + interval.end_speed_rad_s)
    k1, l1, m1 = here
    k2, a2, g2 = _rate(ops, white_box, p, start + half * k1, voltage_v, middle)
    l2, m2 = a2 * (1.0 + half * l1), a2 * (half * m1) + g2
    k3, a3, g3 = _rate(ops, white_box, p, start + half * k2, voltage_v, middle)
    l3, m3 = a3 * (1.0 + half * l2), a3 * (half * m2) + g3
    k4, a4, g4 = _rate(ops, white_box, p, start + step_s * k3, voltage_v, interval.end_speed_rad_s)
    l4, m4 = a4 * (1.0 + step_s * l3), a4 * (step_s * m3) + g4
    sixth = step_s / 6.0
    return Flow(
        start + sixth * (k1 + 2.0 * (k2 + k3) + k4),
        1.0 + sixth * (l1 + 2.0 * (l2 + l3) + l4),
        sixth * (m1 + 2.0 * (m2 + m3) + m4),
    )


def _exponential_step(
    ops: Any, white_box: WhiteBox, p: Array, start: Array, here: _Rate, interval: _Interval
) -> Flow:  # fmt: skip
    """One exponential (Rosenbrock-Euler) step: exact for the rate linearised at the start, and L-stable."""
    rate, slope, by_coordinate = here
    decay = ops.minimum(slope, -1e-12)
    left = ops.exp(decay * interval.length_s)
    reach = (left - 1.0) / decay
    return Flow(start + reach * rate, left, reach * by_coordinate)


def _rate(ops: Any, white_box: WhiteBox, p: Array, state: Array, voltage_v: Array, speed_rad_s: Array) -> _Rate:
    """Work out the rate and its derivatives."""
    speed = white_box.speed(state, speed_rad_s)
    drive = white_box.drive(voltage_v, state, speed)
    value = p[:, :1] * drive
    slope = p[:, :1] * white_box.drive_slope(state, speed)
    by_coordinate = [drive]
    phis, slopes = white_box.basis(state, speed), white_box.basis_slope(state, speed)
    for j, (phi, phi_slope) in enumerate(zip(phis, slopes, strict=True), start=1):
        column = p[:, j : j + 1]
        value = value - column * phi
        slope = slope - column * phi_slope
        by_coordinate.append(-phi)
    return value, slope, ops.stack(by_coordinate)
