"""Errors of the voltage's stamps: what they do to the current, and how much of them data tell."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import INTERVAL_S, Floats, Record, steps

from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run
from gray_box_observer.fit_test.stamp_errors import INSTANT, stamp_responses
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 3000
KT = KB = 0.02
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
ROTOR = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})
BLOCKED = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB})
NEARLY_HELD = 1.0
"""Inertia in kg m2 with which a rotor does not turn."""


def _theta(share: float) -> Floats:
    """A motor with so many sample intervals in L/R; its friction never holds it."""
    return np.array([share * 2.0 * INTERVAL_S, 2.0, 2e-6, 1e-5, 1e-9])


def _current(theta: Floats, late: float = 0.0) -> Floats:
    """Current in A where the voltage acts a part of an interval after its stamp."""
    voltage_v = steps(SAMPLES, 2)[:-1]
    before_v = np.concatenate([voltage_v[:1], voltage_v[:-1]])
    parts_v = np.column_stack([before_v, voltage_v]).ravel()
    parts_s = np.tile([late * INTERVAL_S, (1.0 - late) * INTERVAL_S], voltage_v.size)
    if late == 0.0:
        parts_v, parts_s = voltage_v, np.full(voltage_v.size, INTERVAL_S)
    limits = np.array([1e3, 1e6])
    path = run(KT, coordinates(ROTOR, theta), np.zeros(2), parts_v, parts_s, limits)
    assert path.is_bounded
    current_a: Floats = path.states[:: 1 if late == 0.0 else 2, 0]
    return current_a


def _response(free: FreeRun) -> Floats:
    return stamp_responses(free)[INSTANT]


@pytest.mark.parametrize('share', [0.2, 0.5, 2.0])
def test_the_current_answers_a_late_instant_as_a_second_run_does(share: float) -> None:
    theta = _theta(share)
    current_a = _current(theta)
    record = Record(steps(SAMPLES, 2), current_a)
    free = rotor_free_run(ROTOR, to_coordinates(theta[None]), record.stretch)
    true_a = (_current(theta, 1e-3) - current_a) / 1e-3
    assert np.std(_response(free) - true_a) < 0.02 * np.std(true_a)


@pytest.mark.parametrize('share', [0.2, 0.5, 2.0])
def test_it_does_so_where_no_rotor_turns(share: float) -> None:
    theta = _theta(share)
    theta[2] = NEARLY_HELD
    current_a = _current(theta)
    record = Record(steps(SAMPLES, 2), current_a)
    free = free_run(BLOCKED, to_coordinates(theta[None, :2]), record.stretch)
    true_a = (_current(theta, 1e-3) - current_a) / 1e-3
    assert np.std(_response(free) - true_a) < 0.02 * np.std(true_a)


def test_a_rotor_with_friction_tells_the_instant_of_a_step_and_r_goes_with_it() -> None:
    """L takes over what the winding shows: one interval looks like all of L."""
    theta = _theta(0.2)
    theta[4] = 5e-3
    noise_a = 0.01 * np.random.default_rng(4).normal(size=SAMPLES)
    record = Record(steps(SAMPLES, 2), _current(theta) + noise_a)
    instant = analyse(ROTOR, to_coordinates(theta[None]), record.stretch).stamps.instant
    assert instant.shift[0] == pytest.approx(-1.0, abs=0.3)
    assert 0.01 < abs(instant.shift[1]) < 0.5
    assert abs(instant.amount.mean) < 4.0 * instant.amount.std < 0.2
