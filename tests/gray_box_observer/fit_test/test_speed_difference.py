"""A measured speed that is not that of the whole motor tells how far the estimate is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_motor_records import Floats
from scipy.signal import lfilter
from turning_motor_records import SAMPLES, true_coordinates, turning_motor, white_box

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.projection import Amount, Projection
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.speed_difference import (
    PREFIX,
    shown_by_speed,
    speed_amounts,
)
from gray_box_observer.white_box.flow import to_parameters

BOX = white_box('inductance', 'resistance')
P = true_coordinates(BOX)
THETA = to_parameters(P)[0]
MOTOR = turning_motor(0.3)
SPEED = MOTOR.speed_rad_s[0]
NAMES = [f'{PREFIX}inductance', f'{PREFIX}resistance']
NOISE = 1.0


def _modelled(wrong_rad_s: Floats, seed: int = 0) -> SampleWindow:
    """The motor's stretch with a speed that is off, and noise in the current."""
    current_a = MOTOR.state + 1e-3 * np.random.default_rng(seed).normal(size=MOTOR.state.shape)
    return replace(MOTOR, state=current_a, speed_rad_s=MOTOR.speed_rad_s + wrong_rad_s)


def _readings(seed: int, late: int = 0) -> Floats:
    noise = NOISE * np.random.default_rng([seed, 1]).normal(size=SAMPLES)
    return np.asarray(np.roll(SPEED, late) + noise)


def _projection(run: FreeRun) -> Projection:
    return Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])


def _found(stretch: SampleWindow, readings: Floats) -> list[Amount]:
    run = free_run(BOX, P, stretch)
    projection = _projection(run)
    amounts = speed_amounts(BOX, THETA, run, projection, readings)
    return [amounts[name] for name in NAMES]


def _step(stretch: SampleWindow) -> Floats:
    """By how much least squares move the logarithms of the parameters from the true values."""
    run = free_run(BOX, P, stretch)
    projection = _projection(run)
    return projection.shift(projection.residual)


def _wrong_where_the_voltage_moves() -> Floats:
    """A bump after every rise of the voltage, as of a shaft that gives."""
    rises = np.maximum(np.diff(MOTOR.voltage_v[0], prepend=0.0), 0.0)
    return np.convolve(np.append(rises, 0.0), [0.2, 0.8, 0.8, 0.2])[:SAMPLES]


def test_the_amounts_are_what_a_wrong_speed_has_moved() -> None:
    stretch = _modelled(_wrong_where_the_voltage_moves())
    expected = _step(stretch)
    assert abs(expected[0]) > 0.01
    found = np.array([[one.mean for one in _found(stretch, _readings(k))] for k in range(40)])
    chance = found.std(axis=0) / np.sqrt(40)
    assert (np.abs(found.mean(axis=0) - expected) < 4.0 * chance + 0.1 * np.abs(expected)).all()


def test_noise_of_the_readings_is_within_their_deviations() -> None:
    found = [_found(_modelled(np.zeros(SAMPLES)), _readings(seed)) for seed in range(60)]
    z = np.array([[one.mean / one.std for one in both] for both in found])
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2


@pytest.mark.parametrize('late', [-2, 1, 9])
def test_a_lag_of_the_readings_moves_nothing(late: int) -> None:
    for one in _found(_modelled(np.zeros(SAMPLES)), _readings(3, late)):
        assert abs(one.mean) < 4.0 * one.std


def test_half_a_sample_of_lag_moves_nothing() -> None:
    readings = 0.5 * (_readings(1) + np.roll(SPEED, 1))
    for one in _found(_modelled(np.zeros(SAMPLES)), readings):
        assert abs(one.mean) < 4.0 * one.std


def test_rounded_readings_count_by_errors_that_follow_the_speed() -> None:
    step_rad_s = 8.0
    readings = step_rad_s * np.floor(SPEED / step_rad_s + 0.5)
    rounded = _found(_modelled(np.zeros(SAMPLES)), readings)
    for one in rounded:
        assert abs(one.mean) < 3.0 * one.std


def test_only_what_is_clear_counts() -> None:
    clear = Evidence({NAMES[0]: Amount(0.04, 0.01), NAMES[1]: Amount(0.02, 0.01)}, 2000)
    assert shown_by_speed(BOX, clear).tolist() == [[0.04, 0.0]]
    assert not shown_by_speed(BOX, Evidence()).any()


def test_the_standard_deviation_of_the_inductance_contains_it() -> None:
    stretch = _modelled(_wrong_where_the_voltage_moves())
    readings = SPEED + 0.02 * _readings(2) - 0.02 * SPEED
    analysis = analyse(BOX, P, stretch, measured_rad_s=readings)
    without = analyse(BOX, P, stretch)
    assert abs(analysis.open_shifts[:, 0]).max() > 0.5 * abs(_step(stretch)[0])
    assert abs(without.open_shifts[:, 0]).max() < abs(analysis.open_shifts[:, 0]).max()


def test_few_samples_tell_nothing() -> None:
    few = replace(
        MOTOR,
        state=MOTOR.state[:, :40],
        voltage_v=MOTOR.voltage_v[:, :39],
        interval_s=MOTOR.interval_s[:, :39],
        speed_rad_s=MOTOR.speed_rad_s[:, :40],
        restart=MOTOR.restart[:, :39],
    )
    run = free_run(BOX, P, few)
    projection = _projection(run)
    assert speed_amounts(BOX, THETA, run, projection, SPEED[:40]) == {}


@pytest.mark.parametrize('memory', [0.8, 0.95])
def test_noise_with_a_memory_is_within_its_deviations_too(memory: float) -> None:
    z = []
    for seed in range(40):
        white = np.random.default_rng([seed, 7]).normal(size=SAMPLES)
        noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white)
        found = _found(_modelled(np.zeros(SAMPLES)), SPEED + noise)
        z += [one.mean / one.std for one in found]
    assert np.sqrt(np.mean(np.square(z))) < 1.4
    assert np.abs(z).max() < 4.0


@pytest.mark.parametrize('late', [2, 15])
def test_a_late_speed_with_gaps_moves_nothing(late: int) -> None:
    """What is late is so by samples that a gap has swallowed: both sides have nothing in common."""
    kept = np.r_[0:900, 1400:SAMPLES]
    restart = np.zeros((1, kept.size - 1), dtype=bool)
    restart[0, 899] = True
    cut = SampleWindow(
        MOTOR.state[:, kept],
        MOTOR.voltage_v[:, kept[:-1]],
        MOTOR.interval_s[:, : kept.size - 1],
        MOTOR.speed_rad_s[:, kept],
        restart,
    )
    z = []
    for seed in range(20):
        noise_a = 1e-3 * np.random.default_rng(seed).normal(size=(1, kept.size))
        stretch = replace(cut, state=cut.state + noise_a)
        z += [one.mean / one.std for one in _found(stretch, _readings(seed, late)[kept])]
    assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_where_the_readings_are_believed_again_nothing_is_left_of_it() -> None:
    earlier = Evidence({NAMES[0]: Amount(0.04, 0.001)}, 2000)
    analysis = analyse(BOX, P, _modelled(np.zeros(SAMPLES)), earlier=earlier)
    assert NAMES[0] not in analysis.evidence.amounts
    assert np.abs(analysis.open_shifts[:, 0]).max() < 0.01
