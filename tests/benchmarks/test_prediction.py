"""The benchmark of the predictor: its scores by formula, and its plan by what it covers."""

from __future__ import annotations

import numpy as np
from common.cases import THESIS_MOTOR
from common.prediction import SETS, errors, motors, one_step, record, samples, scores, theta_of

from dc_motor_sim.excitation import parse_excitation


def test_the_error_is_the_mean_behind_the_first_second_in_percent_of_the_spread() -> None:
    recording = record([THESIS_MOTOR], 'R[5,15]D[0.2,2]', 1, 3.0)
    said = recording.true_torque_nm + 0.002
    said[:, :100] += 7.0
    np.testing.assert_allclose(
        errors(said, recording), 0.2 / recording.true_torque_nm.std(), rtol=1e-12
    )


def test_the_white_box_with_the_true_parameters_is_the_truth_and_untrained_is_worse() -> None:
    plants = motors(2, 3, 0.4)
    score = scores(plants, record(plants, 'R[0,33]D[1,2]', 1, 6.0, rate_hz=5.0), theta_of(plants))
    assert np.all(score.white_box < 1e-3)
    assert np.all(score.network < 0.1)
    assert np.all(score.network < score.untrained)


def test_the_sets_are_those_of_the_thesis() -> None:
    assert len({parse_excitation(name) for name in SETS}) == 8


def test_strangers_are_as_far_off_as_they_are_said_to_be() -> None:
    ratio = theta_of(motors(400, 0, 0.4)) / theta_of([THESIS_MOTOR])
    assert ratio.min() > 0.6
    assert ratio.max() < 1.4
    assert np.ptp(ratio) > 0.75


def test_samples_are_those_of_pairing() -> None:
    recording = record([THESIS_MOTOR], 'R[5,15]D[0.2,2]', 1, 1.0)
    first, second, *_ = samples(recording)
    assert first.interval_s[0] == 0.0
    assert second.interval_s[0] == 0.01
    assert second.voltage_v[0] == recording.voltage_v[0, 0]


def test_one_step_is_harder_the_longer_it_is_up_to_a_time_constant() -> None:
    short, long = (one_step(duration, 500, 0) for duration in (0.03, 1.0))
    assert short.untrained.mean() < long.untrained.mean()
    assert long.trained.mean() < 0.5 * long.untrained.mean()
