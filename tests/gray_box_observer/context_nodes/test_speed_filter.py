"""The speed that nobody measures, against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_motors import BOX, KB, KT, NODES, THETA, recorded

from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate, SpeedFilter
from gray_box_observer.white_box import MotorWhiteBox

INTERVAL_S = 1e-3
SUBSTEPS = 20
SETTLED = 300
"""Samples after which the first guess is forgotten."""


def simulated(seed: int, load: float, count: int = 3000) -> tuple[np.ndarray, ...]:
    """Draw a motor, and run it under a load that wanders; by Euler's midpoint rule.

    Returns:
        Its parameters, and voltage, current and speed at every sample.
    """
    rng = np.random.default_rng([41, seed])
    theta = THETA * np.exp(rng.uniform(-0.7, 0.7, THETA.size))
    inductance, resistance, inertia, viscous, coulomb = theta.tolist()
    voltage = np.repeat(rng.uniform(-12.0, 12.0, count), rng.integers(50, 500, count))[:count]
    step_s = INTERVAL_S / SUBSTEPS

    def rates(current: float, speed: float, volt: float, torque: float) -> tuple[float, float]:
        dry = speed * (0.03 + abs(speed)) / (0.0009 + 0.03 * abs(speed) + speed * speed)
        return (
            (volt - resistance * current - KB * speed) / inductance,
            (KT * current - viscous * speed - coulomb * dry - torque) / inertia,
        )

    current = speed = torque = 0.0
    rows = [(0.0, 0.0)]
    for volt in voltage[:-1].tolist():
        torque += -0.01 * torque + load * KT * 12.0 / resistance * rng.normal(0.0, 0.14)
        for _ in range(SUBSTEPS):
            slope = rates(current, speed, volt, torque)
            middle = current + 0.5 * step_s * slope[0], speed + 0.5 * step_s * slope[1]
            slope = rates(*middle, volt, torque)
            current = current + step_s * slope[0]
            speed = speed + step_s * slope[1]
        rows.append((current, speed))
    return theta, voltage, *np.array(rows).T


def filtered(theta: np.ndarray, voltage: np.ndarray, measured: np.ndarray, noise_a: float):
    """Return the speed and its standard deviation at every sample."""
    speeds = SpeedFilter(MotorWhiteBox(NODES, KT, {'back_emf_constant': KB}))
    estimates = [
        speeds.step(theta, noise_a, INTERVAL_S if k else 0.0, float(voltage[max(k - 1, 0)]), value)
        for k, value in enumerate(measured.tolist())
    ]
    return np.array([[e.speed_rad_s, e.std_rad_s] for e in estimates])


@pytest.mark.parametrize(('load', 'largest'), [(0.0, 0.01), (0.1, 0.03)])
def test_the_speed_is_near_the_truth_and_so_is_its_standard_deviation(
    load: float, largest: float
) -> None:
    for seed in range(4):
        theta, voltage, current, speed = simulated(seed, load)
        noise_a = 0.01 * float(current.std())
        measured = current + np.random.default_rng(seed).normal(0.0, noise_a, current.size)
        estimate, std = filtered(theta, voltage, measured, noise_a)[SETTLED:].T
        error = estimate - speed[SETTLED:]
        assert np.sqrt(np.mean(error**2)) < largest * speed.std(), seed
        assert np.mean(np.abs(error) < 3.0 * std) > 0.95, seed
        assert np.median(std) < 2.0 * largest * speed.std(), seed


def test_an_outlier_hardly_moves_the_speed() -> None:
    theta, voltage, current, speed = simulated(1, 0.0, count=1500)
    noise_a = 0.01 * float(current.std())
    spoilt = current + np.random.default_rng(1).normal(0.0, noise_a, current.size)
    spoilt[1000] += 50.0 * noise_a
    estimate = filtered(theta, voltage, spoilt, noise_a)[1000:1010, 0]
    assert np.abs(estimate - speed[1000:1010]).max() < 0.05 * speed.std()


def test_a_voltage_that_is_no_number_ends_the_run_and_the_next_sample_begins_another() -> None:
    speeds = SpeedFilter(BOX)
    assert isinstance(speeds.step(THETA, 0.01, 0.0, 6.0, 0.1), SpeedEstimate)
    assert speeds.step(THETA, 0.01, INTERVAL_S, np.nan, 0.1) is None
    assert isinstance(speeds.step(THETA, 0.01, INTERVAL_S, 6.0, 0.1), SpeedEstimate)


def test_the_first_guess_says_how_little_it_knows() -> None:
    first = SpeedFilter(BOX).step(THETA, 0.01, 0.0, 6.0, 0.1)
    assert first is not None
    assert first.std_rad_s > 100.0


def test_the_record_of_the_simulator_agrees() -> None:
    record = recorded()
    measured = record.torque_nm[0] / KT
    noise_a = 0.015
    estimate = filtered(THETA, record.voltage_v[0], measured, noise_a)[SETTLED:, 0]
    error = estimate - record.speed_rad_s[0, SETTLED:]
    assert np.sqrt(np.mean(error**2)) < 0.01 * record.speed_rad_s[0].std()


def test_compiled_code_gives_the_same_speed() -> None:
    theta, voltage, current, _ = simulated(1, 0.1, count=400)
    noise_a = 0.01 * float(current.std())
    measured = current + np.random.default_rng(2).normal(0.0, noise_a, current.size)
    measured[100] += 50.0 * noise_a
    box = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})
    one = SpeedFilter(box)
    other = SpeedFilter(box, is_compiled=False)
    for k, value in enumerate(measured.tolist()):
        interval_s = 0.0 if k in (0, 200) else INTERVAL_S
        told = [
            each.step(theta, noise_a, interval_s, float(voltage[max(k - 1, 0)]), value, 0.01)
            for each in (one, other)
        ]
        assert told[0] is not None
        assert told[1] is not None
        assert told[0].speed_rad_s == pytest.approx(told[1].speed_rad_s, rel=1e-8, abs=1e-8)
        assert told[0].std_rad_s == pytest.approx(told[1].std_rad_s, rel=1e-6)
