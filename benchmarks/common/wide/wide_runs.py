"""Records motors of a wide range, and lets the observer see the record."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.claims import noisy_readings
from common.motion import FloatArray
from common.motor_trial import MotorTrial, observed_trial
from common.trust.motors import log_uniform
from common.trust.plant import Plant
from common.wide.drives import DRIVES, Drive
from common.wide.wide_motors import WideMotor, wide_motor

RATES_HZ = (50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
SECONDS = 20.0
FEWEST = 3000
MOST = 12_000
"""Length of a record, and its samples at least and at most."""

SLOWEST_HZ = 5000.0
FEWEST_STEPS = 4
"""Least rate of the plant's own steps, and least steps in an interval."""


@dataclass(frozen=True, slots=True)
class WideCase:
    """How motors are driven, and what is measured.

    Attributes:
        drive: one of :data:`~common.wide.drives.DRIVES`.
        speed_is_measured: with 0.1 to 3 % noise.
        voltage_is_measured: with noise of 0.1 to 1 % of the supply; else the command is published.
        most: samples of a record.
    """

    drive: str
    speed_is_measured: bool
    voltage_is_measured: bool
    most: int = MOST


def run_wide(case: WideCase, seed: int) -> MotorTrial:
    """Draw a motor, record it, and run the observer without predictor over the record."""
    rng = np.random.default_rng([77, seed, DRIVES.index(case.drive)])
    driven = wide_motor(rng)
    rate_hz = float(rng.choice(RATES_HZ))
    voltage, current, speed = record(driven, case, rate_hz, rng)
    current += log_uniform(rng, 0.002, 0.03) * current.std() * rng.normal(size=current.size)
    noise = log_uniform(rng, 0.001, 0.03) if case.speed_is_measured else None
    readings = noisy_readings(speed[None], noise, rng)
    if case.voltage_is_measured:
        noise_v = log_uniform(rng, 0.001, 0.01) * driven.supply_v
        voltage += noise_v * rng.normal(size=voltage.size)
    speeds = None if readings is None else readings[0]
    return observed_trial(driven.motor, voltage, current, speeds, rate_hz)


def record(
    driven: WideMotor, case: WideCase, rate_hz: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive a motor; return voltages, shape (k,), true currents and speeds, (k + 1,) each."""
    size = min(case.most, max(FEWEST, round(SECONDS * rate_hz)))
    steps = max(FEWEST_STEPS, math.ceil(SLOWEST_HZ / rate_hz))
    plant = Plant(driven.motor, 1.0 / (rate_hz * steps))
    drive = Drive(case.drive, driven, 1.0 / rate_hz, rng)
    voltage = np.zeros(size)
    current = np.zeros(size + 1)
    speed = np.zeros(size + 1)
    for k in range(size):
        voltage[k] = drive.voltage(plant.speed_rad_s)
        plant.run([float(voltage[k])] * steps)
        current[k + 1] = plant.current_a
        speed[k + 1] = plant.speed_rad_s
    return voltage, current, speed
