"""Drawn sequences over all that a motor may meet, for the physics to teach on.

What the network is taught on is drawn, not recorded, so nothing ties it to the voltages that
happened to be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.predictor.operating_range import OperatingRange
from gray_box_observer.predictor.steady_state import course
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

DRIFT = 0.3
"""Standard deviation of log theta that is drawn in any case: a winding that heats up, a start that
is 40 % off."""

DOUBT = 1.0
"""Largest standard deviation of log theta that is drawn however little is known."""

LONGEST_DURATION = 30.0
"""Longest interval that a family is drawn with, in time constants."""

FAR = 3.0
"""Time constants that a forecast may reach even where no horizon is set."""

FAMILY = MotorWhiteBox(('inductance', 'resistance', 'hysteresis', 'brush_drop'), 1.0)
"""Every effect that bends the approach; back-EMF only adds to R, and measured speed makes the
others straight."""


@dataclass(frozen=True, slots=True, eq=False)
class Sequences:
    """Sequences of intervals, each of a motor of its own.

    Attributes:
        white_box: the physics, one entry a sequence.
        theta: shape (sequence, parameter).
        voltage_v, interval_s, speed_rad_s: shape (sequence, time).
        start_a: shape (sequence,): current before the first interval.
    """

    white_box: MotorWhiteBox
    theta: Array
    voltage_v: Array
    interval_s: Array
    speed_rad_s: Array
    start_a: Array

    @property
    def columns(self) -> list[Array]:
        """The parameters, each of shape (sequence,)."""
        return list(self.theta.T)


def draw_family(random: np.random.Generator, count: int, length: int) -> Sequences:
    """Draw motors of every kind, dimensionless: resistance 1 ohm, time constant L/R 1 s.

    What else sets a motor apart is drawn over decades: how much of the voltage hysteresis takes
    (0.01 to 30 times the resistance), whether there are brushes and what they take (0.01 to 3
    times), currents of 0.05 to 100 A.

    Args:
        random: source of chance.
        count: number of sequences.
        length: intervals of each.
    """
    size_a = _log_uniform(random, 0.05, 100.0, count)
    hysteresis = _log_uniform(random, 1e-2, 30.0, count)
    brushes = np.where(random.random(count) < 0.7, 1e-4, _log_uniform(random, 1e-2, 3.0, count))
    theta = np.stack(
        [np.ones(count), np.ones(count), hysteresis / size_a, brushes * size_a], axis=1
    )
    top_v = size_a * (1.0 + hysteresis + brushes)
    low_v = top_v * np.where(
        random.random(count) < 0.5, -random.random(count), random.random(count)
    )
    duration = _log_uniform(random, 1e-3, LONGEST_DURATION, count) / (1.0 + hysteresis)
    interval_s = np.repeat(duration[:, None], length, axis=1)
    uneven = random.random(count) < 0.5
    interval_s[uneven] *= _log_uniform(random, 0.1, 3.0, (int(uneven.sum()), length))
    voltage_v = _levels(random, low_v, top_v, length)
    speed = np.zeros((count, length))
    start_a = _somewhere(random, FAMILY, theta, speed, low_v, top_v)
    return Sequences(FAMILY, theta, voltage_v, interval_s, speed, start_a)


def draw_around(
    random: np.random.Generator,
    white_box: MotorWhiteBox,
    theta: Array,
    covariance: Array,
    range_seen: OperatingRange,
    limits_v: tuple[float, float],
    horizon_s: float,
    count: int,
    length: int,
) -> Sequences:
    """Draw what identified motors may meet: theta around the estimate, voltages over the range.

    Half of the sequences have intervals like those seen, half go on from there to the longest
    forecast that anyone may want: the horizon, and at least a few time constants.

    Args:
        random: source of chance.
        white_box: the physics of the motors.
        theta: shape (motor, parameter): the estimate.
        covariance: shape (motor, parameter, parameter): how uncertain it is.
        range_seen: where the motors have run.
        limits_v: lowest and highest voltage to be ready for.
        horizon_s: longest forecast wanted, in s; 0: no longer than a sample interval.
        count: number of sequences.
        length: intervals of each.
    """
    motor = random.integers(0, theta.shape[0], count)
    variance = np.diagonal(covariance, axis1=1, axis2=2) / theta**2
    spread = np.minimum(DOUBT, np.sqrt(np.where(np.isfinite(variance), variance, DOUBT) + DRIFT**2))
    lower, upper = (
        np.array([getattr(p, side) for p in white_box.parameters]) for side in ('lower', 'upper')
    )
    parameters = theta[motor] * np.exp(
        spread[motor] * random.standard_normal((count, theta.shape[1]))
    )
    parameters = np.clip(parameters, lower, upper)
    low_v = np.full(count, limits_v[0])
    top_v = np.full(count, limits_v[1])
    voltage_v = _levels(random, low_v, top_v, length)
    speed = np.zeros((count, length))
    if white_box.speed_measured:
        ends = random.uniform(*range_seen.speed_rad_s, (2, count, 1))
        speed = ends[0] + (ends[1] - ends[0]) * np.linspace(0.0, 1.0, length)
    own = white_box.of_motors(motor)
    way = course(np, own, list(parameters.T), voltage_v[:, 0], speed[:, 0], np.zeros(count))
    interval_s = _intervals(random, way.decay_rate, range_seen.interval_s, horizon_s, length)
    start_a = _somewhere(random, own, parameters, speed, low_v, top_v)
    return Sequences(own, parameters, voltage_v, interval_s, speed, start_a)


def _log_uniform(
    random: np.random.Generator,
    low: float | Array,
    high: float | Array,
    shape: int | tuple[int, ...],
) -> Array:
    values: Array = np.exp(random.uniform(np.log(low), np.log(high), shape))
    return values


def _intervals(
    random: np.random.Generator,
    decay_rate: Array,
    seen_s: tuple[float, float],
    horizon_s: float,
    length: int,
) -> Array:
    """Half like those seen, equally uneven; half of any length up to the longest forecast."""
    count = decay_rate.size
    shortest, longest = seen_s
    constant_s = np.minimum(1.0 / np.maximum(decay_rate, 1e-12), 1e4 * longest)
    farthest = np.maximum(longest, np.maximum(horizon_s, FAR * constant_s))
    typical = _log_uniform(random, 0.5 * shortest, 2.0 * longest, count)
    far = random.random(count) < 0.5
    typical[far] = _log_uniform(random, longest, farthest, count)[far]
    interval_s = np.repeat(typical[:, None], length, axis=1)
    if longest > 1.5 * shortest:
        interval_s[~far] = _log_uniform(
            random, 0.5 * shortest, 2.0 * longest, (int((~far).sum()), length)
        )
    return interval_s


def _levels(random: np.random.Generator, low_v: Array, top_v: Array, length: int) -> Array:
    """Voltages held for times of every scale, some with ripple, shape (sequence, length)."""
    count = low_v.size
    changes = (
        random.random((count, length)) < _log_uniform(random, 1.0 / length, 1.0, count)[:, None]
    )
    changes[:, 0] = True
    levels = random.uniform(low_v[:, None], top_v[:, None], (count, length))
    newest = np.maximum.accumulate(np.where(changes, np.arange(length), 0), axis=1)
    ripple = np.where(random.random(count) < 0.3, 0.05, 0.0) * (top_v - low_v)
    noisy: Array = np.take_along_axis(levels, newest, axis=1) + ripple[
        :, None
    ] * random.standard_normal((count, length))
    return noisy


def _somewhere(
    random: np.random.Generator,
    white_box: MotorWhiteBox,
    theta: Array,
    speed: Array,
    low_v: Array,
    top_v: Array,
) -> Array:
    """Currents in A, shape (sequence,), that some other voltage had led to."""
    drawn_v = random.uniform(low_v, top_v)
    steady: Array = course(
        np, white_box, list(theta.T), drawn_v, speed[:, 0], np.zeros(low_v.size)
    ).steady_a
    return steady
