"""Of a rotor that is explained its newest samples leave noise alone; of any other they do not."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, recorded, recorded_in_steps

from dc_motor_sim.simulation import Recording
from gray_box_observer.fit_test.noise_alone import leaves_noise_alone
from gray_box_observer.samples.replay_buffer import (
    HELD_VOLTAGE,
    INTERVAL,
    MOMENT,
    TORQUE,
    VOLTAGE,
)
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
BOX = MotorWhiteBox(NODES, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02})
THETA = np.array([getattr(GEAR_MOTOR, name) for name in NODES])
SAMPLES = 512


def samples_of(record: Recording, begin: int = 0) -> np.ndarray:
    """Return samples of a record, shape (signal, n), as a replay buffer gives them."""
    samples = np.zeros((MOMENT + 1, SAMPLES))
    samples[INTERVAL, 1:] = 1e-3
    samples[VOLTAGE, 1:] = record.voltage_v[0, begin : begin + SAMPLES - 1]
    samples[HELD_VOLTAGE] = samples[VOLTAGE]
    samples[TORQUE] = record.torque_nm[0, begin : begin + SAMPLES]
    return samples


@pytest.mark.parametrize('begin', [0, 700, 1500])
def test_a_motor_that_is_explained_leaves_noise_wherever_one_looks(begin: int) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4)
    assert leaves_noise_alone(BOX, THETA, samples_of(record, begin))


@pytest.mark.parametrize(('place', 'factor'), [(0, 1.1), (1, 1.05), (2, 1.2), (4, 2.0)])
def test_another_motor_leaves_more(place: int, factor: float) -> None:
    theta = THETA.copy()
    theta[place] *= factor
    record = recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4)
    assert not all(leaves_noise_alone(BOX, theta, samples_of(record, k)) for k in (0, 700, 1500))


def test_an_outlier_is_worth_a_closer_look() -> None:
    samples = samples_of(recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4))
    samples[TORQUE, 100] += 0.3
    assert not leaves_noise_alone(BOX, THETA, samples)


@pytest.mark.parametrize('signal', [INTERVAL, TORQUE])
def test_what_is_no_plain_history_is_left_to_a_test(signal: int) -> None:
    samples = samples_of(recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4))
    samples[signal, 300] = 0.0 if signal == INTERVAL else np.nan
    assert not leaves_noise_alone(BOX, THETA, samples)


def test_a_voltage_that_moves_between_samples_is_left_to_a_test() -> None:
    record = recorded_in_steps(0)
    samples = samples_of(recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4))
    samples[MOMENT, 200] = 0.2 * np.abs(record.voltage_v).max()
    samples[HELD_VOLTAGE, 200] += 3.0
    assert not leaves_noise_alone(BOX, THETA, samples)


def test_values_that_cannot_be_run_leave_no_noise() -> None:
    samples = samples_of(recorded(GEAR_MOTOR, LIVELY, 2.5, seed=4))
    assert not leaves_noise_alone(BOX, THETA * np.array([1e-9, 1.0, 1e-9, 1.0, 1.0]), samples)
    assert not leaves_noise_alone(BOX, np.full(5, np.nan), samples)
