"""A rule beside a measured speed goes on where it was saved, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from measured_speed_readings import learnt, readings, rule

from gray_box_observer.errors import CheckpointError


@pytest.mark.slow
def test_the_present_motor_begins_where_its_speed_was_doubted_whatever_window_is_fitted() -> None:
    """It tells that the motor is the same; what counts begins with every window anew."""
    update = rule()
    places = set()
    begins = set()
    for sample in readings('noisy', 6.0):
        update.learn(sample)
        if update.is_noisy:
            places.add(update.present_since(0))
            begins.add(update.replay.begin_of(0))
    assert len(places) == 1
    assert len(begins) > 1
    plain, arrays = update.state()
    again = rule()
    again.restore(plain, arrays)
    assert {again.present_since(0)} == places
    assert again.replay.begin_of(0) == update.replay.begin_of(0) == max(begins)


@pytest.mark.parametrize(('count', 'is_asked'), [(50, False), (1100, True)])
def test_a_state_of_an_early_release_was_asked_where_the_speed_is_doubted(
    count: int, is_asked: bool
) -> None:
    plain, arrays = learnt(readings('late')[:count]).state()
    del plain['measured_speed']['asked']
    update = rule()
    update.restore(plain, arrays)
    assert update.is_asked == update.is_noisy == is_asked


@pytest.mark.parametrize('later_count', [0, 300])
def test_the_readings_are_kept_beside_the_speed_that_is_believed(later_count: int) -> None:
    samples = readings('noisy')
    update = learnt(samples[: 1100 + later_count])
    place = int(update.replay.received[0])
    assert update.is_noisy and place <= 1100 + later_count
    count = update.replay.stored(0)
    expected = [float(sample.speed_rad_s[0]) for sample in samples[place - count : place]]
    assert update.speed_readings(count).tolist() == expected
    assert update.speed_readings(count).tolist() != update.replay.newest(count)[3, 0].tolist()
    plain, arrays = update.state()
    other = rule()
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    assert other.speed_readings(count).tolist() == expected


def test_a_speed_that_is_exact_has_no_readings_beside_it() -> None:
    assert learnt(readings('exact', 1.0)).speed_readings(100) is None


@pytest.mark.slow
@pytest.mark.parametrize('cut', [100, 900, 2900])
def test_what_is_restored_goes_on_bit_for_bit(cut: int) -> None:
    samples = readings('noisy')[: cut + 1300]
    one = learnt(samples[:cut])
    plain, arrays = one.state()
    other = rule()
    other.restore(plain, {name: array.copy() for name, array in arrays.items()})
    assert other.estimate().verdicts == one.estimate().verdicts
    learnt(samples[cut:], one)
    learnt(samples[cut:], other)
    assert one.theta.tobytes() == other.theta.tobytes()
    assert one.estimate().covariance.tobytes() == other.estimate().covariance.tobytes()
    assert one.replay.content().tobytes() == other.replay.content().tobytes()


@pytest.mark.slow
def test_a_fit_of_both_outputs_under_way_goes_on_bit_for_bit_where_it_is_restored() -> None:
    one = rule()
    restored = []
    for k, sample in enumerate(readings('noisy')):
        changed = one.learn(sample)
        assert all(other.learn(sample) == changed for other in restored)
        plain, arrays = one.state() if k % 10 == 0 else ({}, {})
        if 'fitting' in plain.get('measured_speed', {}).get('outputs', {}) and len(restored) < 3:
            restored.append(rule())
            restored[-1].restore(plain, {name: array.copy() for name, array in arrays.items()})
    assert len(restored) == 3
    for other in restored:
        assert other.is_noisy == one.is_noisy
        assert other.theta.tobytes() == one.theta.tobytes()
        assert other.estimate().covariance.tobytes() == one.estimate().covariance.tobytes()
        assert other.state()[0] == one.state()[0]


def test_a_state_that_nobody_learnt_is_refused() -> None:
    plain, arrays = learnt(readings('noisy')[:1500]).state()
    assert plain['measured_speed']['noisy']
    with pytest.raises(CheckpointError, match='walk'):
        rule().restore(plain, arrays | {'outputs.walk': np.array([-1.0])})
    with pytest.raises(CheckpointError, match='samples'):
        rule().restore(plain, arrays | {'measured_speed.samples': np.zeros(3)})
    with pytest.raises(CheckpointError, match='noisy'):
        own = plain['measured_speed'] | {'noisy': 'yes'}
        rule().restore(plain | {'measured_speed': own}, arrays)
