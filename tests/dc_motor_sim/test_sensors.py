"""Sensors: noise, resolution, range."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.errors import SensorError
from dc_motor_sim.sensors import SensorParameters, Sensors


def measured(parameters, std_nm, count=1, seed=1, torque_nm=0.1):
    sensors = Sensors(parameters, np.asarray(std_nm), seed)
    truth = np.full(len(std_nm), torque_nm)
    series = [sensors.measure(truth, 10.0 * truth) for _ in range(count)]
    torque, speed = zip(*series, strict=True)
    return np.array(torque).T, np.array(speed).T  # shape: (motor, sample)


def test_a_perfect_sensor_shows_the_truth():
    torque, speed = measured(SensorParameters(), [0.0, 0.0])
    assert torque.ravel().tolist() == [0.1, 0.1]
    assert speed.ravel().tolist() == [1.0, 1.0]


def test_each_motor_has_its_own_noise_of_its_own_deviation():
    torque, speed = measured(SensorParameters(speed_noise_std=0.5), [0.01, 0.002, 0.0], 20_000)
    assert torque.std(axis=1) == pytest.approx([0.01, 0.002, 0.0], rel=0.03, abs=1e-12)
    assert torque.mean(axis=1) == pytest.approx([0.1] * 3, abs=4 * 0.01 / np.sqrt(20_000))
    assert speed.std(axis=1) == pytest.approx([0.5] * 3, rel=0.03)
    assert np.abs(np.corrcoef([*torque[:2], *speed]) - np.eye(5)).max() < 0.04


def test_the_same_seed_gives_the_same_noise():
    assert measured(SensorParameters(), [0.01], 300, seed=4)[0].tolist() == (
        measured(SensorParameters(), [0.01], 300, seed=4)[0].tolist()
    )


def test_a_value_is_rounded_to_the_resolution_and_kept_in_the_range():
    parameters = SensorParameters(
        torque_quantisation=0.03, torque_limit=0.2, speed_quantisation=0.4
    )
    torque, speed = measured(parameters, [0.0])
    assert torque[0, 0] == pytest.approx(0.09)
    assert speed[0, 0] == pytest.approx(0.8)
    assert measured(parameters, [0.0], torque_nm=5.0)[0][0, 0] == 0.2
    assert measured(parameters, [0.0], torque_nm=-5.0)[0][0, 0] == -0.2


def test_an_offset_is_read_before_the_resolution_and_the_range():
    parameters = SensorParameters(torque_offset=0.05, torque_quantisation=0.03, torque_limit=0.2)
    assert measured(parameters, [0.0])[0][0, 0] == pytest.approx(0.15)
    assert measured(parameters, [0.0], torque_nm=0.19)[0][0, 0] == 0.2
    assert measured(SensorParameters(torque_offset=-0.02), [0.0])[0][0, 0] == pytest.approx(0.08)


def test_a_negative_deviation_is_refused():
    with pytest.raises(SensorError, match=r'^torque_noise_std must be'):
        SensorParameters(torque_noise_std=-0.1)
