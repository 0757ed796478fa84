"""What noise of a measured speed makes a residual remember is taken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_input_noise import ALL, CURRENT_STD, L_AND_R, NOISELESS, RHO, SPEED, _measured
from turning_motor_records import true_coordinates, turning_motor

from gray_box_observer.fit_test.fitted_residual import ljung_box
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.speed_memory import SpeedMemory
from gray_box_observer.fit_test.speed_noise import SpeedNoise

COUNT = 5_000
OWN_A = 0.01


def _residual(decay: float, start_a: float, end_a: float, seed: int = 1) -> np.ndarray:
    """Noise of readings pushes the end of one interval and the start of the next."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=COUNT + 1)
    left_a = np.zeros(COUNT + 1)
    for k in range(COUNT):
        left_a[k + 1] = decay * left_a[k] + start_a * noise[k] + end_a * noise[k + 1]
    return left_a + OWN_A * rng.normal(size=COUNT + 1)


@pytest.mark.parametrize('decay', [0.05, 0.4, 0.9])
@pytest.mark.parametrize(('start_a', 'end_a'), [(0.01, 0.01), (0.005, 0.02), (0.02, 0.03)])
def test_the_innovation_is_white(decay: float, start_a: float, end_a: float) -> None:
    residual_a = _residual(decay, start_a, end_a)
    memory = SpeedMemory(decay, start_a, end_a)
    everywhere = np.full(COUNT, True)
    innovation_a = memory.innovation(residual_a, np.full(COUNT, decay), everywhere)
    assert ljung_box(residual_a) > 8.0
    assert ljung_box(innovation_a) < 2.5
    assert innovation_a.std() < residual_a.std()


def test_nothing_is_remembered_where_brushes_hold_the_current() -> None:
    residual_a = _residual(0.6, 0.01, 0.01)
    is_held = np.arange(COUNT) % 50 < 20
    decay = np.where(is_held, 0.0, 0.6)
    everywhere = np.full(COUNT, True)
    innovation_a = SpeedMemory(0.6, 0.01, 0.01).innovation(residual_a, decay, everywhere)
    np.testing.assert_array_equal(innovation_a[1:][is_held], residual_a[1:][is_held])


def test_a_residual_of_nothing_stays() -> None:
    nothing_a = np.zeros(9)
    memory = SpeedMemory(0.5, 0.01, 0.01)
    assert not memory.innovation(nothing_a, np.full(8, 0.5), np.full(8, True)).any()
    held_a = memory.innovation(nothing_a + 1.0, np.zeros(8), np.full(8, True))
    np.testing.assert_array_equal(held_a, nothing_a + 1.0)


def test_noise_of_a_speed_is_told_by_the_current() -> None:
    stretch = _measured(turning_motor(RHO), 1, SPEED)
    p = true_coordinates(L_AND_R)
    run = free_run(L_AND_R, p, stretch)
    noise = SpeedNoise.from_run(L_AND_R, p, run)
    assert noise is not None
    assert noise.std_rad_s == pytest.approx(SPEED.speed, rel=0.1)
    assert noise.shown_share == pytest.approx(1.0, abs=0.3)
    assert noise.shown_in(run).speed_memory is not None


def test_a_speed_without_noise_shows_none() -> None:
    stretch = _measured(turning_motor(RHO), 1, NOISELESS)
    p = true_coordinates(L_AND_R)
    run = free_run(L_AND_R, p, stretch)
    noise = SpeedNoise.from_run(L_AND_R, p, run)
    assert noise is None or noise.shown_in(run).speed_memory is None
    steady = replace(stretch, speed_rad_s=np.full_like(stretch.speed_rad_s, 50.0))
    assert SpeedNoise.from_run(L_AND_R, p, free_run(L_AND_R, p, steady)) is None


def test_noise_of_the_speed_leaves_a_white_residual_and_explains_nothing_else() -> None:
    """Its residual had a whiteness of 10 and more, and a delay seemed to be there."""
    for seed in range(4):
        analysis = analyse(ALL, true_coordinates(ALL), _measured(turning_motor(RHO), seed, SPEED))
        assert analysis.ratio < 1.2
        assert analysis.whiteness < 3.0
        assert analysis.remembers_speed
        assert all(score.score < 16.0 for score in analysis.scores)
        assert analysis.floor_a > CURRENT_STD
