"""The residual alarm: false ones at the stated rate, quick on true ones, deaf to the rest."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.alarm import (
    AlarmSettings,
    ResidualAlarm,
    run_length,
    threshold_for,
)

INTERVAL_S = 0.01
SPREAD_NM = 2e-3


def watch(alarm: ResidualAlarm, residuals: np.ndarray, identified: bool = True) -> np.ndarray:
    """Feed residuals of shape (sample, motor); return whether the alarm stood after each."""
    motors = residuals.shape[1]
    interval = np.full(motors, INTERVAL_S)
    known = np.full(motors, identified)
    return np.array([alarm.update(row, interval, known) for row in residuals])


def noise(samples: int, motors: int, seed: int, correlation: float = 0.0) -> np.ndarray:
    """Residuals of a sound motor, in N m."""
    random = np.random.default_rng(seed)
    white = random.standard_normal((samples, motors))
    for k in range(1, samples):
        white[k] = correlation * white[k - 1] + np.sqrt(1.0 - correlation**2) * white[k]
    return SPREAD_NM * white


def rules(samples_between: float) -> AlarmSettings:
    """Accept one false alarm in so many samples."""
    return AlarmSettings(false_a_day=86400.0 / (INTERVAL_S * samples_between))


@pytest.mark.slow
def test_false_alarms_come_as_often_as_stated() -> None:
    alarm = ResidualAlarm(400, rules(2000.0))
    motors = 400
    between = 2000.0
    watch(alarm, noise(4000, motors, 0))
    expected = motors * 3000.0 / between  # the first thousand samples teach the spread
    assert 0.6 * expected < alarm.count.sum() < 1.5 * expected


def test_residuals_that_hang_together_raise_no_more_false_alarms_than_stated() -> None:
    alarm = ResidualAlarm(400, rules(2000.0))
    motors = 400
    between = 2000.0
    watch(alarm, noise(4000, motors, 1, correlation=0.7))
    assert alarm.count.sum() < 1.5 * motors * 3000.0 / between


def test_the_default_keeps_still_for_hours_of_white_noise() -> None:
    alarm = ResidualAlarm(100)
    watch(
        alarm, noise(6000, 100, 2)
    )  # 100 motors for a minute are 1.7 hours; 0.1 a day is accepted of each
    assert alarm.count.sum() == 0


@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_a_shift_of_three_standard_deviations_is_found_within_ten_samples(sign: float) -> None:
    alarm = ResidualAlarm(20)
    watch(alarm, noise(3000, 20, 3))
    assert not np.any(alarm.is_raised)
    after = watch(alarm, noise(40, 20, 4) + sign * 3.0 * SPREAD_NM)
    found = np.argmax(after, axis=0)
    assert np.all(after[-1])
    assert np.median(found) <= 10


def test_the_alarm_stands_while_the_fault_does_and_falls_when_it_has_gone() -> None:
    alarm = ResidualAlarm(1)
    watch(alarm, noise(2000, 1, 5))
    assert np.all(watch(alarm, noise(500, 1, 6) + 10.0 * SPREAD_NM)[50:])
    assert not watch(alarm, noise(300, 1, 7))[-1]
    assert alarm.count[0] == 1


def test_single_outliers_raise_nothing() -> None:
    alarm = ResidualAlarm(20)
    residuals = noise(4000, 20, 8)
    residuals[1500::100] += 50.0 * SPREAD_NM
    watch(alarm, residuals)
    assert alarm.count.sum() == 0


def test_nothing_is_judged_before_the_parameters_are_identified() -> None:
    alarm = ResidualAlarm(1)
    watch(alarm, 100.0 * noise(3000, 1, 9), identified=False)
    assert not alarm.is_armed[0]
    assert np.isnan(alarm.spread[0])
    assert alarm.count[0] == 0


def test_samples_without_prediction_and_gaps_change_nothing() -> None:
    alarm = ResidualAlarm(1)
    watch(alarm, noise(2000, 1, 10))
    before = {name: array.copy() for name, array in alarm.state().items()}
    watch(alarm, np.full((5, 1), np.nan))
    alarm.update(np.ones(1), np.zeros(1), np.ones(1, dtype=bool))
    after = alarm.state()
    for name in ('sums', 'variance', 'learnt', 'count'):
        np.testing.assert_array_equal(before[name], after[name])


def test_what_is_restored_goes_on_alike() -> None:
    alarm = ResidualAlarm(2)
    twin = ResidualAlarm(2)
    watch(alarm, noise(1777, 2, 11))
    for motor in range(2):
        twin.restore(alarm.state(motor), motor)
    shifted = noise(300, 2, 12) + SPREAD_NM
    np.testing.assert_array_equal(watch(alarm, shifted), watch(twin, shifted))
    np.testing.assert_array_equal(alarm.level, twin.level)


def test_the_threshold_grows_with_the_logarithm_of_the_time_between_false_alarms() -> None:
    assert threshold_for(1e6) - threshold_for(1e5) == pytest.approx(
        np.log(10.0), abs=0.05
    )  # exp(2 k h), k = 1/2
    assert run_length(threshold_for(12345.0)) == pytest.approx(12345.0, rel=1e-6)


def test_rules_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigurationError, match='false_a_day > 0'):
        AlarmSettings(false_a_day=0.0)


def test_a_motor_alone_is_watched_as_it_is_among_others() -> None:
    residuals = noise(6000, 3, seed=5)
    residuals[4000:4300, 1] += 3.0 * SPREAD_NM
    residuals[::700, 2] = np.nan
    together = ResidualAlarm(3, rules(500.0))
    alone = [ResidualAlarm(1, rules(500.0)) for _ in range(3)]
    stands = watch(together, residuals)
    for motor, one in enumerate(alone):
        np.testing.assert_array_equal(
            watch(one, residuals[:, motor : motor + 1])[:, 0], stands[:, motor]
        )
        state = together.state(motor)
        assert all(state[name].tobytes() == array.tobytes() for name, array in one.state().items())
    assert together.count[1] > 0
