"""The benchmarks' own solution: against closed form, differences, and the package's."""

from __future__ import annotations

import numpy as np
import pytest
from common.cases import CASES, Case, simulate
from common.motion import Form, Inputs, solve, step_all

from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import flow, to_coordinates

THESIS = Form(('inductance', 'resistance', 'hysteresis'), 0.01, 0.01, speed_measured=False)
THETA = np.array([0.5, 1.0, 10.0])


def held(voltage_v: float, samples: int, interval_s: float) -> Inputs:
    n = samples - 1
    return Inputs(np.full(n, interval_s), np.full(n, voltage_v), np.full(samples, np.nan))


def test_a_held_voltage_leads_along_the_hyperbolic_tangent_of_the_riccati_equation() -> None:
    inputs = held(8.0, 300, 0.01)
    r, k = 1.0 + 0.01 * 0.01, 10.0 * 0.01
    root = np.sqrt(r * r + 4.0 * k * 8.0)
    t = 0.01 * np.arange(300)
    closed = (root * np.tanh(0.5 * root * t / 0.5 + np.arctanh(r / root)) - r) / (2.0 * k)
    motion = solve(THESIS, THETA, 0.0, inputs, np.ones(300))
    np.testing.assert_allclose(motion.current_a, closed, rtol=0.0, atol=1e-7 * closed[-1])


@pytest.mark.parametrize('case', CASES, ids=lambda case: case.name)
def test_sensitivities_are_the_derivatives_of_the_motion(case: Case) -> None:
    record = simulate(case, [3], 300 / case.rate_hz).record(3, 0.0)
    currents = record.true_torque_nm / case.plant.torque_constant
    motion = solve(case.form, case.truth, 0.1, record.inputs, currents)
    unknowns = np.concatenate([[0.1], case.truth])
    for j, value in enumerate(unknowns):
        step = np.zeros(unknowns.size)
        step[j] = 1e-5 * value
        above, below = (
            solve(case.form, (unknowns + s)[1:], (unknowns + s)[0], record.inputs, currents)
            for s in (step, -step)
        )
        difference = (above.current_a - below.current_a) / (2e-5 * value)
        np.testing.assert_allclose(
            motion.sensitivity[j], difference, atol=1e-6 * np.abs(difference).max()
        )


@pytest.mark.parametrize('case', CASES, ids=lambda case: case.name)
def test_the_motion_agrees_with_the_simulator(case: Case) -> None:
    record = simulate(case, [4], 400 / case.rate_hz).record(4, 0.0)
    currents = record.true_torque_nm / case.plant.torque_constant
    found = solve(case.form, case.truth, 0.0, record.inputs, currents).current_a
    allowed = (
        1e-3 if case.rotor else 2e-5
    )  # the rotor's speed is not quite straight between samples
    assert np.abs(found - currents).max() < allowed * currents.std()


@pytest.mark.parametrize('case', CASES, ids=lambda case: case.name)
def test_one_step_agrees_with_the_package_that_works_in_other_coordinates(case: Case) -> None:
    record = simulate(case, [5], 200 / case.rate_hz).record(5, 0.0)
    inputs = record.inputs
    start = record.true_torque_nm[:-1] / case.plant.torque_constant
    end, by_start, by_theta = step_all(case.form, case.truth, start, inputs)
    known = (
        {}
        if 'back_emf_constant' in case.parameters
        else {'back_emf_constant': case.plant.back_emf_constant}
    )
    white_box = MotorWhiteBox(
        case.parameters, case.plant.torque_constant, known, speed_measured=case.rotor
    )
    p = to_coordinates(case.truth[None, :])
    speed = inputs.speed_rad_s
    signals = inputs.voltage_v[None], speed[None, :-1], speed[None, 1:], inputs.interval_s[None]
    theirs, slope, forced = flow(white_box, p, [start[None]], *signals).of_state(State.CURRENT)
    by_p = by_theta / p[0, 0]  # theta_0 = 1 / p_0, theta_j = p_j / p_0
    by_p[0] = -(by_theta[0] + p[0, 1:] @ by_theta[1:]) / p[0, 0] ** 2
    # One step of theirs is enough for the estimate; ours is cut finer, which shows at the fast
    # motor.
    np.testing.assert_allclose(theirs[0], end, rtol=3e-5)
    np.testing.assert_allclose(slope[0], by_start, rtol=1e-3)
    scale = np.abs(by_p).max(axis=1, keepdims=True)
    np.testing.assert_allclose(forced[:, 0] / scale, by_p / scale, atol=1e-3)


def test_parameters_without_a_motion_are_refused_in_one_line() -> None:
    with pytest.raises(ArithmeticError, match='did not settle'):
        solve(THESIS, np.array([-0.5, 1.0, 10.0]), 0.0, held(8.0, 300, 0.01), np.zeros(300))
