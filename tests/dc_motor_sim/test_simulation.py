"""Excitation, plant and sensors together."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dc_motor_sim.errors import ConfigurationError, ExcitationError, PlantError, SimulationError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation

THESIS = PlantParameters()


def simulation(excitation='R[5,15]D[1,20]', **options):
    return Simulation({'motor': options.pop('motor', THESIS)}, excitation, **options)


def test_stamps_are_on_the_exact_grid():
    recording = simulation(sample_rate_hz=3.0, start_ns=1_700_000_000_123_456_789).record(100.0)
    assert recording.stamp_ns.tolist() == [
        1_700_000_000_123_456_789 + k * 333_333_333 for k in range(300)
    ]


def test_a_voltage_sample_holds_until_the_next_one_and_torque_is_at_its_stamp():
    # Closed form of the linear motor, fed with the recorded voltages: exact only with both
    # conventions kept.
    motor = replace(THESIS, hysteresis=0.0, back_emf_constant=0.0)
    recording = simulation('R[5,15]D[0.001,0.1]', motor=motor, seed=3).record(5.0)
    current_a = 0.0
    decay = np.exp(-0.01 / 0.5)
    for voltage_v, torque_nm in zip(recording.voltage_v[0], recording.torque_nm[0], strict=True):
        assert torque_nm == pytest.approx(0.01 * current_a, rel=1e-6, abs=1e-12)
        current_a = voltage_v + (current_a - voltage_v) * decay


def test_the_thesis_motor_agrees_with_an_adaptive_solver_over_a_minute_of_table_5_1():
    recording = simulation('table_5_1/4', seed=5).record(60.0)
    current_a = 0.0
    for k in range(0, 6000, 100):
        volts = recording.voltage_v[0, k : k + 100]
        assert recording.torque_nm[0, k] == pytest.approx(0.01 * current_a, rel=1e-6, abs=1e-12)
        for voltage_v, count in _runs(volts):
            current_a = _second_solver(current_a, voltage_v, 0.01 * count)


def _runs(values):
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1), len(values)]
    return [(values[a], b - a) for a, b in pairwise(edges)]


def _second_solver(current_a, voltage_v, duration_s):
    def equation(_, i):
        return (voltage_v - 1.0001 * i - 0.1 * np.abs(i) * i) / 0.5

    return solve_ivp(equation, (0.0, duration_s), [current_a], rtol=1e-10, atol=1e-12).y[0, -1]


@pytest.mark.slow
@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
def test_the_same_seed_gives_the_same_bytes(mode):
    options = {
        'speed_mode': mode,
        'torque_noise_std': 0.01,
        'speed_noise_std': 0.1,
        'voltage_noise_std': 0.1,
    }
    first, second = (simulation(seed=9, **options).record(3.0) for _ in range(2))
    other = simulation(seed=10, **options).record(3.0)
    for name in ('voltage_v', 'torque_nm', 'true_torque_nm', 'speed_rad_s'):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
        assert getattr(first, name).tobytes() != getattr(other, name).tobytes()


def test_sensor_noise_does_not_touch_the_truth():
    clean = simulation().record(20.0)
    noisy = simulation(torque_noise_std=0.01).record(20.0)
    assert noisy.true_torque_nm.tobytes() == clean.torque_nm.tobytes()
    assert noisy.voltage_v.tobytes() == clean.voltage_v.tobytes()
    assert (noisy.torque_nm - noisy.true_torque_nm).std() == pytest.approx(0.01, rel=0.06)


@pytest.mark.slow
def test_relative_torque_noise_is_a_fraction_of_the_noise_free_torque():
    noisy = simulation('R[1,2]D[3,3]', torque_noise_relative=0.01, seed=2)
    clean = simulation('R[1,2]D[3,3]', seed=2).record(60.0)
    assert noisy.torque_noise_std_nm == pytest.approx([0.01 * clean.torque_nm.std()], rel=1e-12)


def test_motors_side_by_side_do_what_the_first_does_alone():
    motors = {'a': THESIS, 'b': replace(THESIS, resistance=2.0)}
    pair = Simulation(
        motors, {'a': 'table_5_1/8', 'b': 'C[4]'}, seed=3, torque_noise_std=0.01
    ).record(5.0)
    alone = Simulation({'a': THESIS}, 'table_5_1/8', seed=3, torque_noise_std=0.01).record(5.0)
    assert pair.torque_nm[0].tobytes() == alone.torque_nm[0].tobytes()
    assert (pair.voltage_v[1] == 4.0).all()


def test_a_parameter_changed_between_samples_keeps_the_current_and_moves_the_steady_state():
    motors = simulation('C[10]', motor=replace(THESIS, hysteresis=0.0))
    before = motors.record(10.0).torque_nm[0, -1]
    motors.set_parameters({'motor': replace(motors.parameters['motor'], resistance=2.0)})
    after = motors.record(10.0).torque_nm[0]
    assert after[0] == pytest.approx(before, rel=1e-6)
    assert after[-1] == pytest.approx(0.01 * 10.0 / 2.0001, rel=1e-6)


def test_a_plant_too_fast_for_the_sample_rate_is_refused_and_the_old_one_goes_on():
    motors = simulation()
    with pytest.raises(PlantError, match='solver steps'):
        motors.set_parameters({'motor': PlantParameters(inductance=1e-6, resistance=1e6)})
    assert motors.parameters['motor'] == THESIS
    assert np.isfinite(motors.record(1.0).torque_nm).all()


def test_a_schedule_changes_the_plant_at_its_sample():
    texts = ['motor.resistance=2.0@5', 'motor.inductance=0.5..0.25@1..3']
    scheduled = simulation('C[10]', schedule=texts[:1])
    by_hand = simulation('C[10]')
    first = np.concatenate([by_hand.record(5.0).torque_nm, [[]]], axis=1)
    by_hand.set_parameters({'motor': replace(THESIS, resistance=2.0)})
    expected = np.concatenate([first, by_hand.record(5.0).torque_nm], axis=1)
    assert scheduled.record(10.0).torque_nm.tobytes() == expected.tobytes()

    ramp = simulation(schedule=texts)
    ramp.record(2.0)
    ramp.step()
    assert ramp.parameters['motor'].inductance == pytest.approx(0.375)
    ramp.record(4.0)
    assert ramp.parameters['motor'] == replace(THESIS, resistance=2.0, inductance=0.25)


def test_a_command_drives_an_external_motor_only():
    motors = Simulation({'a': THESIS, 'b': THESIS}, {'a': 'external', 'b': 'C[1]'})
    assert motors.is_external('a')
    assert not motors.is_external('b')
    assert motors.command('a', 5.0)
    assert not motors.command('b', 5.0)
    assert not motors.command('c', 5.0)
    assert not motors.command('a', float('nan'))
    assert motors.step().voltage_v.tolist() == [5.0, 1.0]


def test_one_step_is_one_sample_of_a_recording():
    stepped = simulation(torque_noise_std=0.01)
    recorded = simulation(torque_noise_std=0.01).record(0.5)
    for k in range(50):
        sample = stepped.step()
        assert sample.stamp_ns == recorded.stamp_ns[k]
        assert sample.torque_nm.tolist() == recorded.torque_nm[:, k].tolist()
    assert stepped.step().stamp_ns == 500_000_000


@pytest.mark.parametrize(
    ('options', 'error', 'what'),
    [
        ({'excitation': 'R[1'}, ExcitationError, 'column 4'),
        ({'excitation': {'left': 'C[1]'}}, ConfigurationError, 'every motor'),
        (
            {'excitation': 'external', 'torque_noise_relative': 0.01},
            ConfigurationError,
            'known in advance',
        ),
        ({'torque_noise_std': 0.1, 'torque_noise_relative': 0.01}, ConfigurationError, 'not both'),
        ({'torque_noise_std': -0.1}, SimulationError, 'torque_noise_std must be'),
        ({'voltage_noise_std': -0.1}, ConfigurationError, 'voltage_noise_std must be'),
        ({'sample_rate_hz': 0.0}, ConfigurationError, 'sample_rate_hz must be'),
        ({'sample_rate_hz': float('nan')}, ConfigurationError, 'sample_rate_hz must be'),
        ({'seed': -1}, ConfigurationError, 'seed'),
        ({'speed_mode': 'gear'}, PlantError, 'speed_mode'),
        ({'schedule': ['x.resistance=1@1']}, SimulationError, "no motor 'x'"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_on_one_line(options, error, what):
    with pytest.raises(error, match=what) as caught:
        simulation(**options)
    assert '\n' not in str(caught.value)


@pytest.mark.slow
def test_ten_thousand_motors_run_in_the_same_code():
    motors = {f'm{k}': replace(THESIS, resistance=1.0 + k / 10_000) for k in range(10_000)}
    recording = Simulation(motors, 'C[10]').record(0.1)
    assert recording.torque_nm.shape == (10_000, 10)
    assert (np.diff(recording.torque_nm[:, -1]) < 0.0).all()


def test_a_sensor_that_lags_leaves_the_true_torque_as_it_is():
    lagging = simulation(torque_lag_s=0.02, seed=3).record(5.0)
    prompt = simulation(seed=3).record(5.0)
    assert lagging.true_torque_nm == pytest.approx(prompt.true_torque_nm, rel=1e-6, abs=1e-12)
    late_nm = np.interp(np.arange(500) - 2.0, np.arange(500), prompt.torque_nm[0])
    off_nm = [
        np.abs(lagging.torque_nm[0, 50:] - nm[50:]).mean() for nm in (late_nm, prompt.torque_nm[0])
    ]
    assert off_nm[0] < 0.2 * off_nm[1]
    with pytest.raises(
        ConfigurationError, match=r'^torque_lag_s must be from 1e-06 to 10; got -1$'
    ):
        simulation(torque_lag_s=-1.0)


def test_a_load_that_walks_moves_the_rotor_as_its_deviation_says():
    # With friction alone w = -T_load / b: the speed is the walk, but for a lag of 10 ms.
    motors = {f'm{k}': replace(THESIS, load_walk=0.5) for k in range(200)}
    walks = Simulation(motors, 'C[0]', speed_mode='rotor', sample_rate_hz=50.0, seed=2).record(4.0)
    for after_s in (1.0, 4.0):
        speed = walks.speed_rad_s[:, round(after_s * 50.0) - 1]
        assert speed.std() == pytest.approx(0.5 * np.sqrt(after_s), rel=0.15)
    still = Simulation({'motor': THESIS}, 'C[0]', speed_mode='rotor', seed=2).record(1.0)
    assert not still.speed_rad_s.any()


def test_a_walk_that_begins_later_begins_at_the_load_that_was():
    walker = simulation('C[0]', speed_mode='rotor', seed=2, schedule=['motor.load_walk=0.5@1'])
    speed = walker.record(2.0).speed_rad_s[0]
    assert not speed[:100].any()
    assert np.abs(np.diff(speed)).max() < 0.5
    assert speed[101:].any()


def test_the_walk_of_one_motor_is_the_same_whatever_another_does():
    def speeds(other_walk):
        motors = {'a': replace(THESIS, load_walk=other_walk), 'b': THESIS}
        schedule = ['b.load_walk=0.5@0.5']
        options = {'speed_mode': 'rotor', 'seed': 2, 'schedule': schedule}
        return Simulation(motors, 'C[0]', **options).record(1.5).speed_rad_s[1]

    assert speeds(0.1).tolist() == speeds(0.0).tolist()


def test_what_is_accepted_beside_a_load_that_has_walked_far_can_be_simulated():
    walker = replace(THESIS, load_walk=3.0)
    one = simulation('C[0]', motor=walker, speed_mode='rotor', seed=1)
    for _ in range(500):
        one.step()
    assert abs(float(one._load_walk.load_nm[0])) > 1.0
    fast = replace(walker, viscous_friction=1e-6, inertia=1e-7, hysteresis=10.0)
    with pytest.raises(PlantError, match='solver steps'):
        one.check_parameters({'motor': fast})
    one.step()


def test_relative_noise_does_not_depend_on_how_a_load_walks():
    still, walking = (
        simulation(
            'R[5,15]D[0.1,1]', motor=replace(THESIS, load_walk=walk), speed_mode='rotor',
            torque_noise_relative=0.01,
        )
        for walk in (0.0, 0.5)
    )  # fmt: skip
    assert walking.torque_noise_std_nm == pytest.approx(still.torque_noise_std_nm)


def test_a_lag_too_short_to_be_one_is_refused():
    with pytest.raises(ConfigurationError, match=r'^torque_lag_s must be from 1e-06 to 10; got'):
        simulation(torque_lag_s=1e-320)
