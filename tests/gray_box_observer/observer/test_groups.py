"""Many motors in the same messages: one computation, and for each what it would be alone."""

from __future__ import annotations

import math
import sys
from typing import Any

import group_messages
import numpy as np
import pytest
from group_messages import Signals

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration

MOTORS = 9
NAMES = tuple(f'm{k}' for k in range(MOTORS))
CALM, CHANGED, BROKEN_SENSOR, BROKEN_SUPPLY, LATE, GONE, STIFF, WILD, PLAIN = NAMES
PERIOD_NS = 10_000_000
SAMPLES = 1300


@pytest.fixture(scope='module')
def recording() -> Recording:
    """Nine motors; one changes halfway, one is fifty times as quick as the others."""
    plants = {name: PlantParameters(resistance=1.0 + 0.1 * k) for k, name in enumerate(NAMES)}
    plants[STIFF] = PlantParameters(inductance=0.01, resistance=1.6)
    schedule = (f'{CHANGED}.resistance=1.7@7',)
    return Simulation(
        plants, 'R[5,15]D[0.2,2]', seed=5, torque_noise_std=1e-4, schedule=schedule
    ).record(SAMPLES / 100)


@pytest.fixture(scope='module')
def said(recording: Recording) -> Signals:
    """Voltage and torque of every motor as sensors say; infinite: absent from the message."""
    random = np.random.default_rng(2)
    told = {}
    for m, name in enumerate(NAMES):
        told[name] = recording.voltage_v[m].copy(), recording.torque_nm[m].copy()
    told[BROKEN_SENSOR][1][random.choice(np.arange(50, SAMPLES), 200, replace=False)] = np.nan
    told[BROKEN_SUPPLY][0][random.choice(np.arange(50, SAMPLES), 65, replace=False)] = np.nan
    told[WILD][1][random.choice(np.arange(200, SAMPLES), 40, replace=False)] = 1e12
    for signal in (0, 1):
        told[LATE][signal][:555] = told[GONE][signal][950:] = np.inf
    return told


def observer(**given: Any) -> Observer:
    settings = {'motors': list(NAMES), 'group_from': 8, 'training.residual': False}
    settings |= {'training.period': 600, 'training.minibatch': 4, 'training.steps': 4, **given}
    settings |= {f'{name}.torque_constant': 0.01 for name in NAMES}
    return Observer(Configuration.from_flat(settings), InlineTraining)


def feed(
    one: Observer, said: Signals, names: tuple[str, ...], first: int = 0, last: int | None = None
) -> dict[str, list[Result]]:
    """Give messages of some motors to an observer; return what became of each."""
    return group_messages.feed(one, said, names, PERIOD_NS, first, last)


@pytest.mark.slow
def test_motors_in_one_message_are_what_each_would_be_alone(
    said: Signals,
) -> None:
    whole = observer()
    together = feed(whole, said, NAMES)
    assert whole.groups(NAMES)[0].names == tuple(name for name in NAMES if name != LATE)
    for name in NAMES:
        single = observer(group_from=1000)
        alone = feed(single, said, (name,))[name]
        ours = together[name]
        assert [r.sample.stamp_ns for r in ours] == [r.sample.stamp_ns for r in alone]
        for field in ('interval_s', 'voltage_v', 'torque_nm'):
            values = [
                np.array([getattr(r.sample, field)[0] for r in results])
                for results in (ours, alone)
            ]
            np.testing.assert_allclose(*values, rtol=1e-12, atol=1e-15, err_msg=f'{name} {field}')
        estimates = [
            np.array([r.estimate.value[0] for r in x if r.estimate is not None])
            for x in (ours, alone)
        ]
        assert len(estimates[1]) - len(estimates[0]) in (0, 1)
        np.testing.assert_allclose(
            estimates[0], estimates[1][: len(estimates[0])], rtol=1e-12, err_msg=name
        )
        torques = [
            np.array([np.nan if r.prediction is None else r.prediction.torque_nm[0] for r in x])
            for x in (ours, alone)
        ]
        np.testing.assert_allclose(*torques, rtol=1e-3, atol=1e-9, err_msg=name)
        # the predicted state remembers the theta before a fit that waited for its turn, for a few
        # of its time constants
        waits = np.abs(torques[0] - torques[1]) > 1e-5 * np.abs(torques[1]) + 1e-9
        assert np.sum(waits) <= 4, f'{name}: a fit that waits for its turn is all that may be late'
        kept = whole.counts(name)
        own = single.counts(name)
        assert (kept.used_count, kept.received_torque, kept.received_voltage) == (
            own.used_count, own.received_torque, own.received_voltage,
        )  # fmt: skip
        assert dict(kept.rejected) == dict(own.rejected)
        assert whole.motors[name].counters == single.motors[name].counters
        assert whole.motors[name].identified == single.motors[name].identified
        assert whole.alarm(name) == single.alarm(name)
    assert whole.counts(BROKEN_SENSOR).rejected[Rejection.NON_FINITE] == 200
    assert whole.counts(WILD).rejected[Rejection.ABSURD] == 40
    assert whole.motors[CHANGED].counters['motor changes'] == 1


def test_few_motors_stay_by_themselves(said: Signals) -> None:
    one = observer(group_from=MOTORS + 1, predictor=False)
    feed(one, said, NAMES, last=50)
    assert [group.names for group in one.groups((CALM, PLAIN))] == [(CALM,), (PLAIN,)]


@pytest.mark.parametrize(('motors', 'groups'), [(64, 64), (65, 1)])
def test_by_default_the_motors_of_a_robot_are_observed_one_by_one(motors: int, groups: int) -> None:
    names = tuple(f'joint{place}' for place in range(motors))
    flat = {'motors': list(names)} | {f'{name}.torque_constant': 0.01 for name in names}
    robot = Observer(Configuration.from_flat(flat), None)
    for stamp_ns in range(0, 3 * PERIOD_NS, PERIOD_NS):
        robot.ingest('voltage', names, stamp_ns, np.ones(motors))
        robot.ingest('torque', names, stamp_ns, np.ones(motors))
    assert len(robot.groups(names)) == groups
    assert {robot.counts(name).used_count for name in names} == {3}


def test_motors_of_different_kinds_are_not_computed_together(
    said: Signals,
) -> None:
    other = {f'{name}.context_nodes': ['inductance', 'resistance'] for name in NAMES[:4]}
    one = observer(group_from=2, predictor=False, **other)
    feed(one, said, NAMES, last=50)
    assert [group.names for group in one.groups(NAMES)] == [NAMES[:4], (LATE,), NAMES[5:]]
    assert one.motors[CALM].estimate.value.shape == (1, 2)


def test_motors_whose_torque_comes_in_several_messages_are_parted(
    said: Signals,
) -> None:
    one = observer(group_from=2, predictor=False)
    halves = ((CALM, CHANGED), (GONE, STIFF, PLAIN))
    used = halves[0] + halves[1]
    for k in range(100):
        one.ingest('voltage', used, k * PERIOD_NS, np.array([said[name][0][k] for name in used]))
        for half in halves:  # the second speaks of other stamps
            stamp_ns = k * PERIOD_NS + (half is halves[1]) * 1_000_000
            one.ingest('torque', half, stamp_ns, np.array([said[name][1][k] for name in half]))
    assert [group.names for group in one.groups(used)] == list(halves)
    assert {one.counts(name).used_count for name in halves[0]} == {100}
    assert {one.counts(name).used_count for name in halves[1]} == {
        99
    }  # the last one waits for its voltage
    assert sum(one.counts(name).rejected.total() for name in (CALM, STIFF, PLAIN)) == 0


def test_a_torque_that_was_given_up_waits_no_more_when_its_motors_are_parted() -> None:
    one = observer(group_from=2, predictor=False)
    one.ingest('torque', NAMES, 0, np.full(MOTORS, 0.1))
    one.flush()  # no voltage has come
    one.ingest('voltage', NAMES[:2], PERIOD_NS, np.full(2, 9.0))
    for name in NAMES:
        counts = one.counts(name)
        assert (counts.waiting_count, counts.received_torque) == (0, 1), name
        assert counts.rejected == {Rejection.NO_VOLTAGE: 1}, name


def test_motors_with_speed_are_parted_from_those_without(
    said: Signals,
) -> None:
    one = observer(group_from=2)
    speeds = np.array([3.0 if k < 3 else np.nan for k in range(MOTORS)])
    for k in range(600, 650):
        one.ingest('voltage', NAMES, k * PERIOD_NS, np.array([said[name][0][k] for name in NAMES]))
        one.ingest(
            'torque', NAMES, k * PERIOD_NS, np.array([said[name][1][k] for name in NAMES]), speeds
        )
    assert [group.names for group in one.groups(NAMES)] == [NAMES[:3], NAMES[3:]]
    assert [one.motors[name].white_box.speed_measured for name in (CALM, PLAIN)] == [True, False]


def test_a_group_is_forecast_as_it_is_predicted(
    said: Signals,
) -> None:
    one = observer()
    compared = 0
    for k in range(600, 800):
        one.ingest('voltage', NAMES, k * PERIOD_NS, np.array([said[name][0][k] for name in NAMES]))
        (group,) = one.groups(NAMES)
        forecast = one.forecast_group(group, k * PERIOD_NS)
        held = one.forecast_group_held(group, 0.5)
        (result,) = one.ingest(
            'torque', NAMES, k * PERIOD_NS, np.array([said[name][1][k] for name in NAMES])
        )
        if forecast is not None:
            assert result.prediction is not None
            present = np.isfinite(result.sample.torque_nm)
            np.testing.assert_allclose(
                forecast[present], result.prediction.torque_nm[present], rtol=1e-12
            )
            compared += 1
            assert held is not None
            assert np.isfinite(held[1]).sum() >= MOTORS - 3
    assert compared > 150


@pytest.mark.slow
def test_a_group_is_saved_motor_by_motor_and_goes_on_together_or_alone(
    said: Signals, tmp_path: Any
) -> None:
    one = observer()
    feed(one, said, NAMES, last=700)
    checkpoint.save(one, tmp_path / 'all')
    for group_from in (2, 1000):
        again = observer(group_from=group_from)
        checkpoint.load(again, tmp_path / 'all')
        assert len(again.groups(NAMES)) == (2 if group_from == 2 else MOTORS), (
            'as before: the late one is alone'
        )
        for name in NAMES:
            np.testing.assert_array_equal(
                again.estimates()[name].value, one.estimates()[name].value
            )
            np.testing.assert_array_equal(
                again.estimates()[name].covariance, one.estimates()[name].covariance
            )
        results = feed(again, said, NAMES, 700, 900)
        assert len(results[CALM]) == 200
        assert len(results[LATE]) == 200


def test_a_checkpoint_that_is_refused_leaves_every_motor_by_itself(
    said: Signals,
) -> None:
    one = observer()
    feed(one, said, NAMES, last=200)
    saved = {name: motor.state() for name, motor in one.motors.items()}
    good = saved[CHANGED]
    saved[CHANGED] = {**good[0], 'white_box': {**good[0]['white_box'], 'terms': 'other'}}, good[1]
    fresh = observer()
    with pytest.raises(ConfigurationError, match='learnt with other known constants'):
        fresh.restore(saved, [NAMES])
    assert [group.names for group in fresh.every_group] == [(name,) for name in NAMES]
    saved[CHANGED] = good
    fresh.restore(saved, [NAMES])
    assert [group.names for group in fresh.every_group][-1] == NAMES


@pytest.mark.slow
def test_freezing_and_new_settings_reach_a_group(
    said: Signals,
) -> None:
    one = observer()
    feed(one, said, NAMES, last=600)
    one.freeze(True)
    before = one.estimates()[CALM].value
    results = feed(one, said, NAMES, 600, 700)
    assert all(result.estimate is None for result in results[CALM])
    np.testing.assert_array_equal(one.estimates()[CALM].value, before)
    one.freeze(False)
    settings = {
        'motors': list(NAMES),
        'verdict.identified_relative_std': 1e-9,
        'verdict.excited_relative_std': 1e-8,
    }
    one.reconfigure(Configuration.from_flat(settings))
    assert not one.motors[CALM].identified


def test_parting_a_group_forgets_no_message() -> None:
    one = observer(group_from=2)
    names = (CALM, CHANGED, GONE, STIFF)
    ones = np.ones(4)
    for k in range(3):
        one.ingest('voltage', names, k * PERIOD_NS, ones)
    one.ingest('voltage', names, 2 * PERIOD_NS, ones)  # a duplicate
    one.ingest('voltage', names, 3 * PERIOD_NS, np.array([1.0, math.nan, 1e12, 1.0]))
    one.ingest('torque', names, 4 * PERIOD_NS, np.array([math.nan, 0.1, 0.1, 0.1]))
    before = {name: one.counts(name) for name in names}
    assert before[CHANGED].refusal_counts['voltage'] == {
        Rejection.DUPLICATE: 1,
        Rejection.NON_FINITE: 1,
    }
    one.ingest('voltage', (CALM, CHANGED, GONE), 4 * PERIOD_NS, ones[:3])
    assert [group.names for group in one.groups(names)] == [names[:3], (STIFF,)]
    for name, counts in before.items():
        after = one.counts(name)
        more = 0 if name == STIFF else 1
        assert after.received_voltage == counts.received_voltage + more == 5 + more
        assert after.received_torque == counts.received_torque == 1
        assert after.refusal_counts == counts.refusal_counts
        assert after.taken_voltage == counts.taken_voltage + more
        assert after.waiting_count + after.used_count == counts.waiting_count


def test_motors_that_come_each_in_messages_of_its_own_go_on_so_from_a_checkpoint(
    said: Signals, tmp_path: Any
) -> None:
    names = (CALM, STIFF)
    one, other = (observer(group_from=2) for _ in range(2))
    for name in names:
        feed(one, said, (name,), 600, 700)
    checkpoint.save(one, tmp_path / 'alone')
    checkpoint.load(other, tmp_path / 'alone')
    for k in range(700, 710):
        for name in names:
            feed(other, said, (name,), k, k + 1)
    for name in names:
        assert other.counts(name).rejected == {}
        assert other.counts(name).used_count == 10


def test_motors_that_were_parted_by_their_speeds_go_on_so_from_a_checkpoint(
    said: Signals, tmp_path: Any
) -> None:
    one, other = (observer(group_from=2) for _ in range(2))
    speeds = np.array([3.0 if k < 3 else np.nan for k in range(MOTORS)])
    for k in range(600, 650):
        one.ingest('voltage', NAMES, k * PERIOD_NS, np.array([said[name][0][k] for name in NAMES]))
        one.ingest(
            'torque', NAMES, k * PERIOD_NS, np.array([said[name][1][k] for name in NAMES]), speeds
        )
    checkpoint.save(one, tmp_path / 'parted')
    checkpoint.load(other, tmp_path / 'parted')
    assert [group.names for group in other.groups(NAMES)] == [NAMES[:3], NAMES[3:]]
    assert [other.motors[name].white_box.speed_measured for name in (CALM, PLAIN)] == [True, False]


def test_the_network_too_learns_nothing_across_a_freeze_during_which_a_motor_went_away(
    said: Signals,
) -> None:
    one = observer(group_from=2)
    names = (CALM, CHANGED, GONE, STIFF)
    feed(one, said, names, 600, 700)
    one.freeze(True)
    feed(one, said, names, 700, 710)
    one.freeze(False)
    feed(one, said, names[1:], 710, 711)
    feed(one, said, names, 711, 712)
    motors = one.group_of(CALM).observer
    assert motors is not None
    assert motors.forecasting is not None
    for replay in (motors.forecasting.training.replay, motors.context_nodes.replay):
        begun = replay.newest(1, slice(None), replay.received)[0, :, 0] == 0.0
        assert [name for name, first in zip(names, begun, strict=True) if first] == [CALM]


def test_a_list_of_very_many_names_is_used_but_not_kept() -> None:
    one = observer(predictor=False)
    names = (CALM,) + ('stranger',) * 30_000
    owners = sys.getrefcount(names)
    for stamp_ns in (0, PERIOD_NS):
        for signal in ('voltage', 'torque'):
            one.ingest(signal, names, stamp_ns, np.zeros(len(names)))
    assert one.counts(CALM).used_count == 2
    assert sys.getrefcount(names) == owners
