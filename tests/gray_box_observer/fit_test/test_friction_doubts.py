"""A torque that the white box has not: how the current answers, and what of it is left open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from linear_motor_records import WHITE_BOX, Floats, Record, current_of, steps

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import Run, run
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.friction_doubts import GIVE_RAD, friction_doubts
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun, rotor_free_run
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 4000
INTERVAL_S = 1e-3
KT = KB = 0.02
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
THETA = np.array([4e-3, 2.0, 1e-5, 1e-5, 8.4e-3])
INERTIA = THETA[2]
ROTOR = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})


def _path_under(torque_nm: Floats, theta: Floats = THETA, white_box: MotorWhiteBox = ROTOR) -> Run:
    voltage_v = steps(SAMPLES, 2)[:-1]
    interval_s = np.full(voltage_v.size, INTERVAL_S)
    limits = np.array([1e3, 1e6])
    load_rad_s2 = -torque_nm / INERTIA
    return run(
        KT, coordinates(white_box, theta), np.zeros(2), voltage_v, interval_s, limits, load_rad_s2
    )


def _stretch(current_a: Floats) -> SampleWindow:
    return Record(steps(SAMPLES, 2), current_a).stretch


def _run_freely(current_a: Floats, theta: Floats = THETA) -> RotorFreeRun:
    free = rotor_free_run(ROTOR, to_coordinates(theta[None]), _stretch(current_a))
    assert isinstance(free, RotorFreeRun)
    return free


def test_the_current_answers_a_torque_as_a_second_run_does() -> None:
    slow = np.sin(2.0 * np.pi * 3.0 * INTERVAL_S * np.arange(SAMPLES - 1))
    bump_nm = 1e-6 * slow
    still = np.zeros(SAMPLES - 1)
    base_a = _path_under(still).states[:, 0]
    (response_a,) = _run_freely(base_a).torque_response(bump_nm[None], INERTIA)
    true_a = _path_under(bump_nm).states[:, 0] - base_a
    assert np.std(response_a - true_a) < 0.15 * np.std(true_a)  # its shaft stops and starts


@pytest.mark.parametrize('rho', [0.1, 1.0, 4.0])
def test_it_does_so_however_many_time_constants_an_interval_has(rho: float) -> None:
    theta = THETA.copy()
    theta[0] = theta[1] * INTERVAL_S / rho
    theta[4] = 1e-9  # a shaft that never stops
    bump_nm = 1e-6 * np.sin(2.0 * np.pi * 60.0 * INTERVAL_S * np.arange(SAMPLES - 1))
    base_a = _path_under(np.zeros(SAMPLES - 1), theta).states[:, 0]
    (response_a,) = _run_freely(base_a, theta).torque_response(bump_nm[None], INERTIA)
    true_a = _path_under(bump_nm, theta).states[:, 0] - base_a
    assert np.std(response_a - true_a) < 0.05 * np.std(true_a)


def test_the_shaft_of_the_run_turns_as_the_motor_does() -> None:
    path = _path_under(np.zeros(SAMPLES - 1))
    free = _run_freely(path.states[:, 0])
    assert free.speed_rad_s == pytest.approx(path.states[:, 1], rel=1e-3, abs=0.1)


def _open_stds(current_a: Floats) -> dict[str, float]:
    """Standard deviations of the logarithms that the doubts add."""
    rng = np.random.default_rng(1)
    noisy = _stretch(current_a + 0.01 * rng.normal(size=current_a.size))
    shifts = analyse(ROTOR, to_coordinates(THETA[None]), noisy).open_shifts
    return dict(zip(NODES, np.sqrt((shifts**2).sum(axis=0)), strict=True))


def test_friction_that_grows_with_the_square_of_the_speed_opens_the_frictions() -> None:
    speed = _path_under(np.zeros(SAMPLES - 1)).states[:-1, 1]
    share = speed / np.abs(speed).max()
    plain = _open_stds(_path_under(np.zeros(SAMPLES - 1)).states[:, 0])
    fan = _open_stds(_path_under(-2e-3 * share * np.abs(share)).states[:, 0])
    assert fan['viscous_friction'] > 10.0 * plain['viscous_friction']
    assert fan['coulomb_friction'] > 3.0 * plain['coulomb_friction']
    assert fan['inductance'] < 0.01


def test_a_resistance_that_grows_with_the_speed_opens_itself() -> None:
    still = np.zeros(SAMPLES - 1)
    full_rad_s = float(np.abs(_path_under(still).states[:, 1]).max())
    iron = replace(ROTOR, known={**ROTOR.known, 'hysteresis': 0.02 * THETA[1] / full_rad_s})
    plain = _open_stds(_path_under(still).states[:, 0])
    grown = _open_stds(_path_under(still, white_box=iron).states[:, 0])
    assert grown['resistance'] > 3.0 * plain['resistance']
    assert 0.005 < grown['resistance'] < 0.04


def test_friction_that_takes_more_to_break_opens_the_frictions() -> None:
    speed = _path_under(np.zeros(SAMPLES - 1)).states[:-1, 1]
    share = speed / np.abs(speed).max()
    slow_nm = -0.3 * THETA[4] * np.sign(share) * np.exp(-((share / 0.02) ** 2))
    plain = _open_stds(_path_under(np.zeros(SAMPLES - 1)).states[:, 0])
    sticky = _open_stds(_path_under(slow_nm).states[:, 0])
    assert sticky['coulomb_friction'] > 3.0 * plain['coulomb_friction']
    assert plain['coulomb_friction'] < 0.01


def _turned(speed_rad_s: Floats) -> tuple[Floats, list[Doubt]]:
    """Current of a motor that is turned at a measured speed, and the doubts about it."""
    measured = MotorWhiteBox(
        ('inductance', 'resistance'), KT, {'back_emf_constant': KB}, speed_measured=True
    )
    voltage_v = steps(SAMPLES, 4)
    current_a = current_of(voltage_v - KB * speed_rad_s)
    stretch = Record(voltage_v, current_a).stretch
    stretch.speed_rad_s[0] = speed_rad_s
    theta = np.array([4e-3, 2.0])
    free = free_run(measured, to_coordinates(theta[None]), stretch)
    return current_a, friction_doubts(measured, free, theta)


@pytest.mark.parametrize('rests', [False, True])
def test_a_shaft_gives_only_where_it_rests(rests: bool) -> None:
    speed_rad_s = np.full(SAMPLES, 50.0)
    if rests:
        speed_rad_s[SAMPLES // 2 :] = 0.0
    current_a, doubts = _turned(speed_rad_s)
    assert len(doubts) == int(rests)
    if rests:
        rests_from = slice(SAMPLES // 2, None)
        largest_a = np.abs(current_a[rests_from]).max()
        give_v = np.zeros(SAMPLES)
        give_v[rests_from] = np.diff(current_a[rests_from], append=current_a[-1]) / INTERVAL_S
        give_v *= KB * GIVE_RAD / largest_a
        later = slice(SAMPLES // 2 + 50, None)  # the run begins anew where the speed jumps
        response_a = doubts[0].response_a[later]
        expected_a = current_of(-give_v)[later]
        assert np.ptp(expected_a) > 1e-4 * largest_a
        assert response_a == pytest.approx(expected_a, abs=1e-6 * largest_a)


@pytest.mark.parametrize('moves', [20, 400, SAMPLES // 2])
@pytest.mark.parametrize('noise_rad_s', [0.0, 0.02])
def test_a_shaft_that_hardly_ever_turns_rests(moves: int, noise_rad_s: float) -> None:
    speed_rad_s = noise_rad_s * np.random.default_rng(3).normal(size=SAMPLES)
    speed_rad_s[:moves] += 50.0
    _, (doubt,) = _turned(speed_rad_s)
    assert (
        np.abs(doubt.response_a[moves + 50 :]).max() > 10.0 * np.abs(doubt.response_a[:moves]).max()
    )


def test_a_shaft_that_is_sampled_too_slowly_does_not_rest() -> None:
    speed_rad_s = 40.0 + 30.0 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 6.0)
    assert _turned(speed_rad_s)[1] == []


def test_a_blocked_motor_has_no_friction_to_doubt() -> None:
    voltage_v = steps(SAMPLES, 4)
    stretch = Record(voltage_v, current_of(voltage_v)).stretch
    theta = np.array([4e-3, 2.0])
    free = free_run(WHITE_BOX, to_coordinates(theta[None]), stretch)
    assert friction_doubts(WHITE_BOX, free, theta) == []
    assert math.isclose(free.inductance_h, 4e-3)
