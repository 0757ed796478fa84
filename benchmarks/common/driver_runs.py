"""Drawn gear motors behind drivers that filter or come late, and what is claimed of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.claims import noisy_readings
from common.motion import FloatArray
from common.motor_trial import MotorTrial, observed_trial
from common.rotor.voltages import random_levels
from common.trust.motors import Motor, gear_motor
from common.trust.plant import Plant

STEPS = 50
"""Steps of the plant in a sample interval, at least."""

SLOWEST_HZ = 20_000.0
"""Least rate of the plant's own steps."""


@dataclass(frozen=True, slots=True)
class DriverCase:
    """What a driver does to voltage and current.

    Attributes:
        averages: whether a reading is the mean of its sample interval.
        weight: of the newest reading in the moving average that a driver publishes, its noise in
            it; 1: it publishes the readings.
        low_pass: time constant of an analogue filter before the reading, in sample intervals.
        filters_noise: whether the noise passes that filter, too: a driver filters what it reads in
            a faster loop than it publishes.
        rate_hz: of the samples.
        speed_noise: of the measured speed, as a share of its spread; None: it is not measured.
        duration_s: of the record.
        late: how long after its stamp the voltage acts, in sample intervals.
        noise: of a reading, as a share of the current's spread.
        noise_behind: of what is published, as a share of the same: it comes behind all filters.
        phase: how long after a sample the voltage moves, in sample intervals, as its stamp says:
            its publisher keeps its own time.
        delay: as the observer is told it, ``estimate`` or in s.
    """

    averages: bool
    weight: float
    low_pass: float
    filters_noise: bool
    rate_hz: float
    speed_noise: float | None
    duration_s: float
    late: float = 0.0
    noise: float = 0.01
    noise_behind: float = 0.0
    phase: float = 0.0
    delay: float | str = 0.0


def run_driver(case: DriverCase, seed: int) -> MotorTrial:
    """Draw a motor, record it, and run the observer without predictor over the record."""
    rng = np.random.default_rng([29, seed])
    motor = gear_motor(rng)
    voltage = random_levels(case.rate_hz, case.duration_s, rng)
    current, speed = _measured(case, motor, voltage, rng)
    readings = noisy_readings(speed[None], case.speed_noise, rng)
    return observed_trial(
        motor, voltage, current, None if readings is None else readings[0], case.rate_hz,
        phase=case.phase, delay=case.delay,
    )  # fmt: skip


def _measured(
    case: DriverCase, motor: Motor, voltage_v: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return measured currents and true speeds, shape (k + 1,) each."""
    steps = max(STEPS, math.ceil(SLOWEST_HZ / case.rate_hz))
    plant = Plant(motor, 1.0 / (case.rate_hz * steps))
    late_v = np.zeros(round((case.late + case.phase) * steps))
    acting_v = np.concatenate([late_v, np.repeat(voltage_v, steps)])[: voltage_v.size * steps]
    course, speeds = map(np.array, plant.run(acting_v.tolist()))
    if case.low_pass > 0.0:
        course = moving_average(course, 1.0 - math.exp(-1.0 / (steps * case.low_pass)))
    read = course.reshape(-1, steps)
    current = np.array([0.0, *(read.mean(axis=1) if case.averages else read[:, -1])])
    noise = rng.normal(size=current.size)
    if case.filters_noise:
        noise = filtered_noise(noise, math.exp(-1.0 / case.low_pass))
    size_a = current.std()
    current += case.noise * size_a * noise
    published_a = moving_average(current, case.weight)
    if case.noise_behind:
        published_a = published_a + case.noise_behind * size_a * rng.normal(size=current.size)
    return published_a, np.array([0.0, *speeds[steps - 1 :: steps]])


def filtered_noise(white: FloatArray, memory: float) -> FloatArray:
    """Return noise as a filter leaves it, shape (n,), whose size stays.

    Args:
        white: shape (n,): as it was before, at the samples.
        memory: what is left of it after a sample interval.
    """
    noise = white.copy()
    fresh = math.sqrt(1.0 - memory**2)
    for place in range(1, noise.size):
        noise[place] = memory * noise[place - 1] + fresh * white[place]
    return noise


def moving_average(values: FloatArray, weight: float) -> FloatArray:
    """Return the exponential moving average from 0 on, shape (n,); weight 1 changes nothing."""
    averages = np.empty_like(values)
    average = 0.0
    for place, value in enumerate(values.tolist()):
        average += weight * (value - average)
        averages[place] = average
    return averages
