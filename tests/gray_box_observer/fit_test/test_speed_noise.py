"""The noise of a measured speed moves an estimate by as much as the fit test says."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import (
    INDUCTANCE_H,
    INTERVAL_S,
    RESISTANCE_OHM,
    TORQUE_CONSTANT,
    Floats,
    steps,
)
from scipy.signal import lfilter

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.speed_noise import speed_noise_shift
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates

SAMPLES, SEEDS = 2000, 40
BACK_EMF_CONSTANT = 0.05
SPEED_STD = 4.0
THETA = np.array([INDUCTANCE_H, RESISTANCE_OHM])
MEASURED = MotorWhiteBox(
    ('inductance', 'resistance'),
    TORQUE_CONSTANT,
    {'back_emf_constant': BACK_EMF_CONSTANT},
    speed_measured=True,
)


def _stretch(seed: int, speed_std: float = SPEED_STD) -> SampleWindow:
    """A motor that turns as a slow sine, its speed measured with noise, and its current exactly."""
    voltage_v = steps(SAMPLES, 1, -4.0, 4.0)
    speed_rad_s = 40.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) * INTERVAL_S)
    back_emf_v = BACK_EMF_CONSTANT * 0.5 * (speed_rad_s[1:] + speed_rad_s[:-1])
    decay = np.exp(-INTERVAL_S * RESISTANCE_OHM / INDUCTANCE_H)
    push = (1.0 - decay) / RESISTANCE_OHM * (voltage_v[:-1] - back_emf_v)
    current_a = np.concatenate([[0.0], lfilter([1.0], [1.0, -decay], push)])
    measured = speed_rad_s + speed_std * np.random.default_rng(seed).normal(size=SAMPLES)
    return SampleWindow(
        current_a[None],
        voltage_v[None, :-1],
        np.full((1, SAMPLES - 1), INTERVAL_S),
        measured[None],
        np.zeros((1, SAMPLES - 1), dtype=bool),
    )


def _fitted_step(stretch: SampleWindow) -> Floats:
    """First step of a least-squares fit from the true values, in logarithms."""
    run = free_run(MEASURED, to_coordinates(THETA[None]), stretch)
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    return np.asarray(np.linalg.lstsq(columns, run.residual_a, rcond=None)[0][1:])


def test_the_bias_is_that_of_repeated_fits() -> None:
    found = np.array([_fitted_step(_stretch(seed)) for seed in range(SEEDS)])
    run = free_run(MEASURED, to_coordinates(THETA[None]), _stretch(0))
    (told,) = speed_noise_shift(MEASURED, run, THETA)
    chance = found.std(axis=0) / np.sqrt(SEEDS)
    assert told[0] > 0.01  # noise makes L too large
    assert (np.abs(told - found.mean(axis=0)) < np.maximum(4.0 * chance, 0.1 * np.abs(told))).all()


@pytest.mark.parametrize('speed_std', [0.0, SPEED_STD])
def test_the_standard_deviation_of_the_inductance_contains_it(speed_std: float) -> None:
    analysis = analyse(MEASURED, to_coordinates(THETA[None]), _stretch(3, speed_std))
    largest = np.abs(analysis.open_shifts).max()
    assert (largest > 0.01) == (speed_std > 0.0)


def test_a_speed_that_nobody_measures_has_no_noise() -> None:
    blocked = MotorWhiteBox(('inductance', 'resistance'), TORQUE_CONSTANT)
    run = free_run(blocked, to_coordinates(THETA[None]), _stretch(0))
    assert speed_noise_shift(blocked, run, THETA).shape == (0, 2)
