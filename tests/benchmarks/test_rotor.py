"""The benchmark of hidden rotors: its records, their bound, and how a trial is counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from common.cases import CASES, simulate
from common.rotor.records import NODES, draw
from common.rotor.robot_figures import without_speed
from common.rotor.runs import run_trial
from common.rotor.speed_records import SpeedSensor, draw_with_speed
from common.rotor.thesis_sets import run_thesis_set
from common.rotor.trial_tables import over_bound, share_false
from common.trust.motors import gear_motor
from real_motors import DEFAULT_DATA, Case

from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.white_box import MotorWhiteBox


def test_a_record_is_drawn_alike_from_the_same_seed() -> None:
    one, other = (draw(gear_motor, 3, 500.0, 1.0) for _ in range(2))
    assert one.motor == other.motor
    assert np.array_equal(one.measured_a, other.measured_a)
    assert np.std(one.measured_a - one.current_a) == pytest.approx(one.noise_a, rel=0.1)


def test_the_bound_is_proportional_to_the_noise_and_falls_with_the_length() -> None:
    short, long = (draw(gear_motor, 3, 500.0, length_s) for length_s in (2.0, 6.0))
    louder = replace(short, noise_a=2.0 * short.noise_a)
    np.testing.assert_allclose(louder.bound(), 2.0 * short.bound(), rtol=1e-6)
    assert (long.bound() < short.bound()).all()


@pytest.mark.slow
def test_a_trial_ends_near_the_truth_and_claims_nothing_false() -> None:
    trial = run_trial(draw(gear_motor, 3, 500.0, 4.0))
    assert np.abs(trial.z).max() < 4.5
    assert trial.identified[: len(NODES) - 2].all()
    assert trial.claims > 0
    assert trial.false == 0
    assert trial.near_s < 4.0
    assert share_false([trial]) == 0.0
    assert over_bound([trial]).shape == (len(NODES),)


def test_a_robot_without_speed_has_a_rotor() -> None:
    case = Case(
        'robot 1',
        DEFAULT_DATA / 'none.txt',
        ('time=$1', 'left.voltage=$5', 'left.speed=$9'),
        {'left.torque_constant': 0.007, 'right.torque_constant': 0.007},
    )
    made = without_speed(case)
    assert made.columns == ('time=$1', 'left.voltage=$5')
    assert made.parameters['right.speed_source'] == 'rotor'


@pytest.mark.parametrize(
    ('sensor', 'share'),
    [
        (SpeedSensor('noise', noise=0.02), 0.02),
        (SpeedSensor('encoder', counts=500), None),
        (SpeedSensor('late', late=2), None),
    ],
)
def test_a_speed_is_read_as_its_sensor_reads_it(sensor: SpeedSensor, share: float | None) -> None:
    record = draw_with_speed(sensor, 3, 1000.0, 2.0)
    off = record.read_rad_s - record.speed_rad_s
    if share is not None:
        assert np.std(off) == pytest.approx(share * np.std(record.speed_rad_s), rel=0.1)
    if sensor.counts:
        counts = record.read_rad_s * sensor.counts * 1e-3 / (2.0 * np.pi)
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    if sensor.late:
        assert np.array_equal(record.read_rad_s[2:], record.speed_rad_s[:-2])


def test_a_second_output_only_lowers_the_bound_and_noise_raises_it() -> None:
    alone = draw(gear_motor, 3, 1000.0, 2.0).bound()[:2]
    quiet, loud = (
        draw_with_speed(SpeedSensor('noise', noise=noise), 3, 1000.0, 2.0).bound()
        for noise in (0.005, 0.05)
    )
    assert (quiet < loud).all()
    assert (loud < 1.001 * alone).all()


@pytest.mark.slow
def test_a_trial_with_a_late_speed_ends_near_the_truth() -> None:
    trial = run_trial(draw_with_speed(SpeedSensor('late', late=2), 3, 1000.0, 2.0))
    assert np.abs(trial.z).max() < 4.5
    assert trial.identified.all()
    assert trial.fit != 'misfit'


def test_a_search_that_stops_before_a_kink_goes_on_beyond_it() -> None:
    record = draw(gear_motor, 14, 100.0, 40.0)
    motor = record.motor
    samples = np.zeros((4, record.measured_a.size))
    samples[0, 1:] = record.interval_s
    samples[1, 1:] = record.voltage_v
    samples[2] = record.measured_a * motor.torque_constant
    box = MotorWhiteBox(
        NODES, motor.torque_constant, {'back_emf_constant': motor.back_emf_constant}
    )
    window = Window.from_samples(box, samples[:, :1372])
    prior = LogPrior(np.log(record.truth), 1e-3 * np.eye(len(NODES)))
    aside = record.truth * (1.0 + np.array([-0.094, -0.0041, 0.0029, 0.0137, -0.0036]))
    from_aside, from_truth = (
        completed(fit_window(box, window, prior, [start], tries_others=False))
        for start in (aside, record.truth)
    )
    assert from_aside is not None
    assert from_truth is not None
    assert from_aside.noise_a < 1.001 * from_truth.noise_a


@pytest.mark.slow
def test_a_parameter_that_another_form_does_not_have_has_no_error() -> None:
    record = simulate(CASES[0], [0], 6.0).record(0, 0.01)
    trial = run_thesis_set(record, 'rotor')
    assert trial.source == 'rotor'
    assert np.isnan(trial.over_bound[CASES[0].parameters.index('hysteresis')])
    assert np.isfinite(run_thesis_set(record, 'torque_constant').over_bound).all()
