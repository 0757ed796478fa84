"""A measured speed that comes late: how late the mechanics say, and what is left open of R."""

from __future__ import annotations

import numpy as np
import pytest
from free_rotor_records import (
    FINE,
    KB,
    KT,
    NODES,
    RESISTANCE_OF_HALF_AN_INTERVAL,
    THETA,
    WHITE_BOX,
    late,
    mean_speeds,
    motion,
)
from linear_motor_records import Floats, Record

from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.late_speed import lag_of_speed, late_speed_doubts
from gray_box_observer.fit_test.least_squares import LEAST_SQUARES
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 4000
RESISTANCE = NODES.index('resistance')


def _run_freely(
    speed_rad_s: Floats, voltage_v: Floats, current_a: Floats, white_box: MotorWhiteBox = WHITE_BOX
) -> FreeRun:
    stretch = Record(voltage_v, current_a).stretch
    stretch.speed_rad_s[0] = speed_rad_s
    theta = THETA[: len(white_box.context_nodes)]
    return free_run(white_box, to_coordinates(theta[None]), stretch)


@pytest.mark.parametrize('lag', [0.0, 0.25, 0.5, 1.0])
def test_the_mechanics_tell_how_late_a_speed_is(lag: float) -> None:
    voltage_v, current_a, speed_rad_s = motion(SAMPLES)
    free = _run_freely(late(speed_rad_s, lag), voltage_v, current_a[::FINE])
    assert lag_of_speed(free).mean == pytest.approx(lag, rel=0.07, abs=0.05)
    assert lag_of_speed(free).std < 0.02


def test_a_difference_of_angles_is_half_an_interval_late() -> None:
    voltage_v, current_a, speed_rad_s = motion(SAMPLES)
    free = _run_freely(mean_speeds(speed_rad_s), voltage_v, current_a[::FINE])
    assert lag_of_speed(free).mean == pytest.approx(0.5, abs=0.05)


def test_the_lag_is_as_uncertain_as_the_speed_is_noisy() -> None:
    voltage_v, current_a, speed_rad_s = motion(SAMPLES)
    amounts = []
    for seed in range(20):
        noise = 0.01 * np.std(speed_rad_s) * np.random.default_rng(seed).normal(size=SAMPLES)
        noisy = late(speed_rad_s, 0.5) + noise
        amounts.append(lag_of_speed(_run_freely(noisy, voltage_v, current_a[::FINE])))
    spread = np.std([amount.mean for amount in amounts])
    assert 0.6 < np.mean([amount.std for amount in amounts]) / spread < 1.6


def _open_std(speed_rad_s: Floats, voltage_v: Floats, current_a: Floats) -> float:
    """Standard deviation of log R that is left open, of a noisy current, at its least squares."""
    noise_a = 0.01 * np.std(current_a) * np.random.default_rng(1).normal(size=SAMPLES)
    stretch = Record(voltage_v, current_a + noise_a).stretch
    stretch.speed_rad_s[0] = speed_rad_s
    evidence = analyse(WHITE_BOX, to_coordinates(THETA[None]), stretch).evidence
    least_squares = np.exp([evidence.amount(f'{LEAST_SQUARES}{name}').mean for name in NODES])
    shifts = analyse(WHITE_BOX, to_coordinates(least_squares[None]), stretch).open_shifts
    return float(np.sqrt((shifts[:, RESISTANCE] ** 2).sum()))


def test_a_late_speed_opens_the_resistance_by_what_it_takes_it_for() -> None:
    voltage_v, current_a, speed_rad_s = motion(SAMPLES)
    late_std = _open_std(mean_speeds(speed_rad_s), voltage_v, current_a[::FINE])
    assert late_std == pytest.approx(RESISTANCE_OF_HALF_AN_INTERVAL, rel=0.25)
    punctual_std = _open_std(late(speed_rad_s, 0.0), voltage_v, current_a[::FINE])
    assert punctual_std < 0.1 * RESISTANCE_OF_HALF_AN_INTERVAL


def test_a_known_back_emf_constant_leaves_no_such_doubt() -> None:
    voltage_v, current_a, speed_rad_s = motion(SAMPLES)
    white_box = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, speed_measured=True)
    free = _run_freely(mean_speeds(speed_rad_s), voltage_v, current_a[::FINE], white_box)
    assert late_speed_doubts(white_box, free, THETA[:2]) == []


@pytest.mark.parametrize('speed_rad_s', [0.0, 50.0])
def test_a_speed_that_does_not_move_tells_no_lag(speed_rad_s: float) -> None:
    voltage_v, current_a, _ = motion(400)
    free = _run_freely(np.full(400, speed_rad_s), voltage_v, current_a[::FINE])
    assert late_speed_doubts(WHITE_BOX, free, THETA) == []
