"""Noise of a measured voltage or speed moves an estimate by as much as the fit test says."""

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
from gray_box_observer.fit_test.input_noise import input_noise_shift
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates

SAMPLES, SEEDS = 2000, 40
BACK_EMF_CONSTANT = 0.05
CURRENT_STD = 0.01
THETA = np.array([INDUCTANCE_H, RESISTANCE_OHM])
MEASURED = MotorWhiteBox(
    ('inductance', 'resistance'),
    TORQUE_CONSTANT,
    {'back_emf_constant': BACK_EMF_CONSTANT},
    speed_measured=True,
)


def _stretch(
    seed: int, speed_std: float = 0.0, voltage_std: float = 0.0, dither_std: float = 0.0
) -> SampleWindow:
    """A motor that turns as a slow sine, its current measured exactly.

    Args:
        seed: of all noise.
        speed_std: of the noise of the measured speed.
        voltage_std: of the noise of the measured voltage.
        dither_std: of noise that the driver really applies.
    """
    rng = np.random.default_rng(seed)
    voltage_v = steps(SAMPLES, 1, -4.0, 4.0) + dither_std * rng.normal(size=SAMPLES)
    speed_rad_s = 40.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) * INTERVAL_S)
    back_emf_v = BACK_EMF_CONSTANT * 0.5 * (speed_rad_s[1:] + speed_rad_s[:-1])
    decay = np.exp(-INTERVAL_S * RESISTANCE_OHM / INDUCTANCE_H)
    push = (1.0 - decay) / RESISTANCE_OHM * (voltage_v[:-1] - back_emf_v)
    current_a = np.concatenate([[0.0], lfilter([1.0], [1.0, -decay], push)])
    measured_rad_s = speed_rad_s + speed_std * rng.normal(size=SAMPLES)
    measured_v = voltage_v + voltage_std * rng.normal(size=SAMPLES)
    current_a += CURRENT_STD * rng.normal(size=SAMPLES)
    return SampleWindow(
        current_a[None],
        measured_v[None, :-1],
        np.full((1, SAMPLES - 1), INTERVAL_S),
        measured_rad_s[None],
        np.zeros((1, SAMPLES - 1), dtype=bool),
    )


def _fitted_step(stretch: SampleWindow) -> Floats:
    """First step of a least-squares fit from the true values, in logarithms."""
    run = free_run(MEASURED, to_coordinates(THETA[None]), stretch)
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    return np.asarray(np.linalg.lstsq(columns, run.residual_a, rcond=None)[0][1:])


@pytest.mark.parametrize('noise', [{'speed_std': 1.0}, {'voltage_std': 0.05}])
def test_the_bias_is_that_of_repeated_fits(noise: dict[str, float]) -> None:
    first_steps = np.array([_fitted_step(_stretch(seed, **noise)) for seed in range(SEEDS)])
    run = free_run(MEASURED, to_coordinates(THETA[None]), _stretch(0, **noise))
    (shift,) = input_noise_shift(MEASURED, run, THETA)
    chance = first_steps.std(axis=0) / np.sqrt(SEEDS)
    assert shift[0] > 0.005  # noise makes L too large
    bias = first_steps.mean(axis=0)
    assert (np.abs(shift - bias) < 4.0 * chance + 0.1 * np.abs(shift)).all()


@pytest.mark.parametrize('noise', [{'speed_std': 1.0}, {'voltage_std': 0.05}])
def test_the_standard_deviation_of_the_inductance_contains_it(noise: dict[str, float]) -> None:
    p = to_coordinates(THETA[None])
    assert np.abs(analyse(MEASURED, p, _stretch(3, **noise)).open_shifts).max() > 0.005
    assert np.abs(analyse(MEASURED, p, _stretch(3)).open_shifts).max() < 1e-4


@pytest.mark.parametrize('dither_std', [0.05, 2.0])
@pytest.mark.parametrize('seed', range(5))
def test_noise_that_the_driver_applies_leaves_nothing_open(dither_std: float, seed: int) -> None:
    run = free_run(MEASURED, to_coordinates(THETA[None]), _stretch(seed, dither_std=dither_std))
    assert np.abs(input_noise_shift(MEASURED, run, THETA)).max() < 1e-4


def test_a_speed_that_nobody_measures_has_no_noise() -> None:
    blocked = MotorWhiteBox(('inductance', 'resistance'), TORQUE_CONSTANT)
    run = free_run(blocked, to_coordinates(THETA[None]), _stretch(0, speed_std=4.0))
    assert input_noise_shift(blocked, run, THETA).shape == (0, 2)
