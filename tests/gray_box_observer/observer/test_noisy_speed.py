"""A noisy measured speed under a speed controller: no delay may be found in its noise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, recording_of

from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.delay import DelayVerdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 4000
RATE_HZ = 1000.0
SPEED_NOISE = 0.02
"""As a share of the speed's spread."""

LATE = 3
"""Samples by which a voltage acts late."""


@cache
def _driven_by_speed() -> Recording:
    """Record a motor whose speed follows trapezoids, by a controller that has no noise."""
    rng = np.random.default_rng(4)
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'external', seed=3, sample_rate_hz=RATE_HZ, torque_noise_std=3e-4,
        speed_mode='rotor',
    )  # fmt: skip
    samples = []
    goal_rad_s = target_rad_s = integral_v = speed_rad_s = 0.0
    for k in range(SAMPLES):
        if k % 600 == 0:
            target_rad_s = rng.uniform(-350.0, 350.0)
        goal_rad_s += float(np.clip(target_rad_s - goal_rad_s, -2.0, 2.0))
        error_v = GEAR_MOTOR.back_emf_constant * (goal_rad_s - speed_rad_s)
        integral_v = float(np.clip(integral_v + 20.0 * error_v / RATE_HZ, -12.0, 12.0))
        simulation.command('motor', float(np.clip(2.0 * error_v + integral_v, -12.0, 12.0)))
        samples.append(simulation.step())
        speed_rad_s = float(samples[-1].speed_rad_s[0])
    return recording_of(samples)


def _observed(late: int) -> Observer:
    record = _driven_by_speed()
    speed_rad_s = record.speed_rad_s[0]
    noise = np.random.default_rng(5).normal(size=SAMPLES)
    readings = speed_rad_s + SPEED_NOISE * speed_rad_s.std() * noise
    observer = Observer(Configuration.from_flat(CONSTANTS))
    for k in range(LATE, SAMPLES):
        stamp_ns = int(record.stamp_ns[k])
        volt_place = min(k + late, SAMPLES - 1)
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, volt_place]))
        observer.torque('motor', stamp_ns, float(record.torque_nm[0, k]), float(readings[k]))
    return observer


@pytest.mark.slow
def test_a_healthy_motor_under_a_speed_controller_is_identified_beside_a_noisy_speed() -> None:
    observer = _observed(0)
    motor = observer.motors['motor']
    assert observer.delays()['motor'].verdict is not DelayVerdict.UNDECLARED
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.estimate.verdicts[0][1] is Verdict.IDENTIFIED
    assert motor.estimate.value[0, 1] == pytest.approx(GEAR_MOTOR.resistance, rel=0.02)


@pytest.mark.slow
def test_a_voltage_that_is_late_there_is_still_told() -> None:
    observer = _observed(LATE)
    motor = observer.motors['motor']
    delay = observer.delays()['motor']
    assert delay.verdict is DelayVerdict.UNDECLARED
    assert delay.value_s > 1e-3
    assert motor.estimate.verdicts[0][0] is not Verdict.IDENTIFIED
