"""The plant against closed forms, and against another solver on the equation written out again."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dc_motor_sim.errors import PlantError
from dc_motor_sim.plant import MAX_SUBSTEPS, MOST_BY_NUMBERS, Plant, PlantParameters

THESIS = PlantParameters()


def run(plant, voltage_v, duration_s, step_s=0.01, state=None):
    state = plant.initial_state() if state is None else state
    voltage_v = np.atleast_1d(np.asarray(voltage_v, dtype=float))
    for _ in range(round(duration_s / step_s)):
        state = plant.step(
            state, voltage_v, step_s, plant.substeps_for(state, voltage_v, step_s, 0.01)
        )
    return state


def test_without_hysteresis_the_motor_is_a_first_order_circuit():
    motor = replace(THESIS, hysteresis=0.0)
    state = run(Plant([motor]), 7.0, 0.8)
    r = 1.0 + 0.01 * 0.01
    assert state[0, 0] == pytest.approx(7.0 / r * (1.0 - np.exp(-r * 0.8 / 0.5)), rel=1e-6)


@pytest.mark.parametrize('voltage_v', [0.5, 15.0, 33.0, -15.0])
def test_the_steady_state_solves_the_quadratic_in_both_directions(voltage_v):
    state = run(Plant([THESIS]), voltage_v, 15.0)
    r, k = 1.0 + 0.01 * 0.01, 10.0 * 0.01
    root = (-r + np.sqrt(r * r + 4.0 * k * abs(voltage_v))) / (2.0 * k)
    assert state[0, 0] == pytest.approx(np.sign(voltage_v) * root, rel=1e-9)


def test_a_transient_with_hysteresis_agrees_with_an_adaptive_solver():
    def equation(_, current):
        return (15.0 - (1.0 + 1e-4) * current - 10.0 * 0.01 * np.abs(current) * current) / 0.5

    truth = solve_ivp(equation, (0.0, 0.4), [0.0], rtol=1e-11, atol=1e-13).y[0, -1]
    assert run(Plant([THESIS]), 15.0, 0.4)[0, 0] == pytest.approx(truth, rel=1e-6)


@pytest.mark.parametrize(
    ('voltage_v', 'effects'),
    [
        (12.0, {'hysteresis': 0.3, 'load_torque': 0.004}),
        (-12.0, {'hysteresis': 0.0, 'quadratic_friction': 2e-4}),
    ],
    ids=['hysteresis and load', 'fan'],
)
def test_rotor_mode_agrees_with_an_adaptive_solver(voltage_v, effects):
    motor = replace(THESIS, inertia=2e-4, viscous_friction=1e-3, back_emf_constant=0.05, **effects)

    def equation(_, state):
        i, w = state
        di = (voltage_v - 1.0 * i - 0.05 * w - motor.hysteresis * abs(w) * i) / 0.5
        fan = motor.quadratic_friction * abs(w) * w
        return [di, (0.01 * i - 1e-3 * w - fan - motor.load_torque) / 2e-4]

    truth = solve_ivp(equation, (0.0, 1.0), [0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
    assert np.sign(voltage_v) * truth[1] > 10.0
    assert run(Plant([motor], 'rotor'), voltage_v, 1.0)[0] == pytest.approx(truth, rel=1e-5)


def test_a_light_rotor_with_unit_friction_is_the_motor_of_the_thesis():
    light = replace(THESIS, inertia=1e-3)
    rotor = Plant([light], 'rotor')
    thesis = Plant([THESIS])
    state = run(rotor, 10.0, 1.0)
    assert rotor.torque_nm(state) == pytest.approx(
        thesis.torque_nm(run(thesis, 10.0, 1.0)), rel=5e-3
    )
    assert rotor.speed_rad_s(state) == pytest.approx(0.01 * state[:, 0], rel=5e-3)


def test_the_brush_drop_takes_its_voltage_in_both_directions():
    motor = replace(THESIS, hysteresis=0.0, brush_drop=2.0)
    r = 1.0 + 1e-4
    assert run(Plant([motor]), 10.0, 10.0)[0, 0] == pytest.approx(8.0 / r, rel=1e-6)
    assert run(Plant([motor]), -10.0, 10.0)[0, 0] == pytest.approx(-8.0 / r, rel=1e-6)


def test_an_offset_is_missing_whatever_the_current():
    motor = replace(THESIS, hysteresis=0.0, voltage_offset=0.5)
    r = 1.0 + 1e-4
    for voltage_v, current_a in ((10.0, 9.5), (0.0, -0.5), (-10.0, -10.5)):
        assert run(Plant([motor]), voltage_v, 10.0)[0, 0] == pytest.approx(current_a / r, rel=1e-6)


def test_the_dead_zone_of_the_driver_takes_its_voltage_and_all_of_a_smaller_one():
    motor = replace(THESIS, hysteresis=0.0, dead_zone=2.0)
    r = 1.0 + 1e-4
    for voltage_v, current_a in ((10.0, 8.0), (-10.0, -8.0), (1.5, 0.0), (-2.0, 0.0)):
        found_a = run(Plant([motor]), voltage_v, 10.0)[0, 0]
        assert found_a == pytest.approx(current_a / r, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize('others', [0, pytest.param(12, marks=pytest.mark.slow)])
def test_a_driver_that_coasts_lets_no_current_flow_at_a_command_of_zero(others: int) -> None:
    motor = replace(
        THESIS, hysteresis=0.0, inductance=0.01, coasting_resistance=100.0, dead_zone=0.5
    )
    plant = Plant([motor, *[replace(motor, coasting_resistance=0.0)] * others], 'rotor')
    state = run(plant, 10.0, 0.15)
    assert state[0, 0] > 5.0
    for command_v in (0.0, 0.5, -0.5):
        later = run(plant, command_v, 0.01, state=state)
        assert abs(later[0, 0]) < 1e-12
        assert later[0, 1] > 0.0
        if others:  # that brake
            assert abs(later[1, 0]) > 0.1
    again = run(plant, 10.0, 0.15, state=run(plant, 0.0, 0.01, state=state))
    assert again[0, 0] == pytest.approx(state[0, 0], rel=1e-3)


@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
def test_a_sensor_that_lags_reads_the_torque_filtered(mode):
    lag_s = 0.05
    motor = replace(THESIS, hysteresis=0.0, back_emf_constant=0.0)
    plant = Plant([motor], mode, lag_s)
    state = run(plant, 10.0, 0.3)
    electrical_s = 0.5
    fast_s = np.exp(-0.3 / lag_s) * lag_s
    slow_s = np.exp(-0.3 / electrical_s) * electrical_s
    sensed_a = 10.0 * (1.0 + (fast_s - slow_s) / (electrical_s - lag_s))
    assert plant.sensed_torque_nm(state) == pytest.approx(0.01 * sensed_a, rel=1e-5)
    assert plant.torque_nm(state) == pytest.approx(
        0.1 * (1.0 - np.exp(-0.3 / electrical_s)), rel=1e-6
    )


def test_a_sensor_that_lags_does_not_jump_with_the_torque_constant():
    slow = Plant([THESIS], 'thesis', 5.0)
    state = run(slow, 10.0, 1.0)
    stronger = Plant([replace(THESIS, torque_constant=0.05)], 'thesis', 5.0)
    assert stronger.sensed_torque_nm(state) == slow.sensed_torque_nm(state)


def test_the_solver_is_as_fine_as_the_load_that_walks_asks():
    constant = Plant([replace(THESIS, load_torque=30.0)], 'rotor')
    state = np.array([[5.0, 0.0]])
    volts = np.array([1.0])
    walk_nm = np.array([30.0])
    substeps = Plant([THESIS], 'rotor').substeps_for(state, volts, 0.1, 0.01, walk_nm)
    assert substeps == constant.substeps_for(state, volts, 0.1, 0.01) > 100


def test_the_solver_is_as_fine_as_the_lag_asks():
    state = Plant([THESIS], 'thesis', 1e-3).initial_state()
    assert Plant([THESIS], 'thesis', 1e-3).substeps_for(state, np.array([1.0]), 0.01, 0.01) == 100


def test_coulomb_friction_holds_the_rotor_against_a_smaller_torque():
    motor = replace(THESIS, viscous_friction=0.0, coulomb_friction=0.05, hysteresis=0.0)
    plant = Plant([motor], 'rotor')
    assert abs(plant.speed_rad_s(run(plant, 2.0, 5.0))[0]) < 0.1
    assert plant.speed_rad_s(run(plant, 10.0, 5.0))[0] > 1.0


@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
@pytest.mark.parametrize('lag_s', [0.0, 0.02])
@pytest.mark.parametrize('crowd', [0, MOST_BY_NUMBERS])
def test_motors_side_by_side_do_what_each_does_alone(mode, lag_s, crowd):
    driven = replace(
        THESIS, dead_zone=1.0, voltage_offset=-0.5, brush_drop=0.3, quadratic_friction=0.02
    )
    motors = [THESIS, PlantParameters(inductance=0.35, resistance=0.8, hysteresis=14.0), driven]
    everybody = Plant(motors + crowd * [THESIS], mode, lag_s)
    state = everybody.initial_state() + 0.5
    voltage_v = np.array([3.0, 12.0, -0.5] + crowd * [1.0])
    load_nm = np.array([0.0, 0.1, -0.2] + crowd * [0.0])
    together = everybody.step(state, voltage_v, 0.01, 4, load_nm)
    for m, motor in enumerate(motors):
        one = slice(m, m + 1)
        alone = Plant([motor], mode, lag_s).step(state[one], voltage_v[one], 0.01, 4, load_nm[one])
        assert together[m] == pytest.approx(alone[0], rel=1e-13)
        assert crowd or together[m].tolist() == alone[0].tolist()


def test_a_further_load_is_added_to_the_constant_one():
    both = Plant([replace(THESIS, load_torque=0.3)], 'rotor')
    state = both.initial_state()
    further = Plant([replace(THESIS, load_torque=0.1)], 'rotor').step(
        state, np.array([5.0]), 0.01, 10, np.array([0.2])
    )
    assert both.step(state, np.array([5.0]), 0.01, 10) == pytest.approx(further, rel=1e-12)


@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
def test_a_motor_without_voltage_loses_its_current_in_every_quadrant(mode):
    plant = Plant([THESIS, THESIS], mode)
    state = plant.initial_state()
    state[:, 0] = [5.0, -5.0]
    for _ in range(50):
        after = plant.step(state, np.zeros(2), 0.01, 4)
        assert (np.abs(after[:, 0]) < np.abs(state[:, 0])).all()
        state = after


def test_a_solver_step_is_at_most_a_tenth_of_the_electrical_time_constant():
    fast = Plant([replace(THESIS, inductance=1e-3, hysteresis=0.0, back_emf_constant=0.0)])
    assert fast.substeps_for(fast.initial_state(), np.array([5.0]), 0.01, 0.01) == 100
    assert Plant([THESIS]).substeps_for(np.zeros((1, 1)), np.array([1.0]), 0.1, 0.01) == 10


def test_a_motor_too_fast_for_its_sample_rate_is_refused():
    plant = Plant([replace(THESIS, inductance=1e-6, resistance=1e6)])
    with pytest.raises(PlantError, match=f'at most {MAX_SUBSTEPS}'):
        plant.substeps_for(plant.initial_state(), np.zeros(1), 0.01, 0.01)


def test_a_state_that_runs_away_is_named_and_not_returned():
    plant = Plant([THESIS, THESIS])
    with pytest.raises(PlantError, match='motor 1 became non-finite'):
        plant.step(plant.initial_state(), np.array([1.0, 1e300]), 0.01, 1)


@pytest.mark.parametrize('name', [f.name for f in fields(PlantParameters)])
@pytest.mark.parametrize('value', [float('nan'), float('inf'), '1.0', -2e6])
def test_every_parameter_refuses_what_is_no_number_in_its_bounds(name, value):
    with pytest.raises(PlantError, match=f'^{name} must be') as caught:
        PlantParameters(**{name: value})
    assert '\n' not in str(caught.value)


def test_a_negative_resistance_is_refused_with_bounds_and_unit():
    with pytest.raises(PlantError, match=r'^resistance must be from 1e-06 to 1e\+06 ohm; got -1$'):
        PlantParameters(resistance=-1.0)


def test_an_unknown_speed_mode_and_no_motor_are_refused():
    with pytest.raises(PlantError, match='thesis, rotor'):
        Plant([THESIS], 'gear')
    with pytest.raises(PlantError, match='at least one motor'):
        Plant([])
