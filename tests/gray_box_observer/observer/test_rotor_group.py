"""Motors with rotors in the same messages: one computation, and for each what it would be alone."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import group_messages
import numpy as np
import pytest
from group_messages import Signals
from rotor_records import GEAR_MOTOR, LIVELY

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import RotorGroup, Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 3300
HALFWAY = 1500
PERIOD_NS = 1_000_000
HOT, STUCK, SHY, BLIND = NAMES = tuple(f'm{k}' for k in range(4))
"""One is twice as quick and gets hot, one is blocked, one is absent now and then, and one's sensor
says nothing now and then."""

CHANGE = 2400
"""Sample at which the resistance of one motor is another, and one is blocked."""

SETTLED = 50
"""Samples after which a filter has forgotten when it began: together it begins a sample or two
sooner."""

LATE_TEST = 'samples since a test was due'


@pytest.fixture(scope='module')
def signals() -> Signals:
    """Voltage and torque of every motor; infinite: absent from the message."""
    plants: dict[str, PlantParameters] = dict.fromkeys(NAMES, GEAR_MOTOR)
    plants[HOT] = replace(GEAR_MOTOR, inductance=2e-3, inertia=5e-6)
    simulation = Simulation(
        plants, LIVELY, seed=11, sample_rate_hz=1000.0, torque_noise_std=3e-4, speed_mode='rotor'
    )
    taken = []
    for k in range(SAMPLES):
        if k == CHANGE:
            changes = {HOT: replace(plants[HOT], resistance=3.0)}
            changes[STUCK] = replace(GEAR_MOTOR, coulomb_friction=1.0)
            simulation.set_parameters(changes)
        taken.append(simulation.step())
    names = ('voltage_v', 'torque_nm', 'true_torque_nm', 'speed_rad_s')
    arrays = (np.stack([getattr(one, name) for one in taken], axis=1) for name in names)
    record = Recording(NAMES, np.array([one.stamp_ns for one in taken]), *arrays)
    said = {
        name: (record.voltage_v[m].copy(), record.torque_nm[m].copy())
        for m, name in enumerate(NAMES)
    }
    random = np.random.default_rng(2)
    said[BLIND][1][random.choice(np.arange(50, SAMPLES), 60, replace=False)] = np.nan
    away = random.choice(np.arange(300, SAMPLES), 40, replace=False)
    for signal in (0, 1):
        said[SHY][signal][away] = np.inf
    return said


def observer(**given: Any) -> Observer:
    """Return an observer of rotors, which are computed together if that is not changed."""
    flat: dict[str, Any] = {'motors': list(NAMES), 'group_from': 2, 'predictor': False}
    flat |= {'group_core_share': 64.0, **given}
    for name in NAMES:
        flat[f'{name}.speed_source'] = 'rotor'
        flat[f'{name}.effects'] = 'none'
        flat |= {f'{name}.{constant}_constant': 0.02 for constant in ('torque', 'back_emf')}
    return Observer(Configuration.from_flat(flat), None)


def feed(
    one: Observer,
    said: Signals,
    names: tuple[str, ...] = NAMES,
    first: int = 0,
    last: int | None = None,
) -> dict[str, list[Result]]:
    """Give messages of some motors to an observer; return what became of each."""
    return group_messages.feed(one, said, names, PERIOD_NS, first, last)


@pytest.mark.slow
def test_motors_of_a_group_are_what_each_would_be_alone(signals: Signals) -> None:
    together = observer()
    results = feed(together, signals)
    assert [group.names for group in together.groups(NAMES)] == [NAMES]
    for name in NAMES:
        check_is_as_alone(signals, together, results, name)
    estimates = together.estimates()
    for name in (SHY, BLIND):
        assert estimates[name].verdicts[0][1] is Verdict.IDENTIFIED
        assert estimates[name].value[0, 1] == pytest.approx(2.0, rel=0.01)
    is_misfit = together.fit(HOT).verdict is FitVerdict.MISFIT
    assert is_misfit or estimates[HOT].value[0, 1] == pytest.approx(3.0, rel=0.02)


def check_is_as_alone(
    signals: Signals, together: Observer, results: dict[str, list[Result]], name: str
) -> None:
    """Check that a motor of a group is what it would be alone, but for when a fit ends."""
    single = observer(group_from=1000)
    alone = feed(single, signals, (name,))[name]
    mine = results[name]
    assert [one.sample.stamp_ns for one in mine] == [one.sample.stamp_ns for one in alone]
    estimates = [
        np.array([one.estimate.value[0] for one in part if one.estimate is not None])
        for part in (mine, alone)
    ]
    assert len(estimates[0]) - len(estimates[1]) in (0, 1)  # the last fit ends sooner together
    np.testing.assert_allclose(estimates[0][: len(estimates[1])], estimates[1], rtol=1e-9)
    is_ok = [one.fit(name).verdict is FitVerdict.OK for one in (together, single)]
    assert is_ok[0] == is_ok[1]
    speeds = [
        np.array([math.nan if one.speed is None else one.speed.speed_rad_s for one in part])
        for part in (mine, alone)
    ]
    is_told = np.isfinite(speeds[1])
    assert is_told.mean() > 0.3
    assert np.mean(np.isfinite(speeds[0]) == is_told) > 0.99
    both = np.flatnonzero(is_told & np.isfinite(speeds[0]))[SETTLED:]
    np.testing.assert_allclose(speeds[0][both], speeds[1][both], rtol=1e-3, atol=0.5)
    stalls = [one.motors[name].stall for one in (together, single)]
    assert stalls[0] is not None
    assert stalls[1] is not None
    assert stalls[0].count == stalls[1].count
    assert stalls[0].still_s == pytest.approx(stalls[1].still_s)


@pytest.mark.slow
def test_a_small_share_of_the_time_only_makes_it_late(signals: Signals) -> None:
    slow = observer(group_core_share=0.01)
    quick = observer()
    for one in (slow, quick):
        feed(one, signals, last=CHANGE)
    counts = [sum(one.motors[name].counters['fits'] for name in NAMES) for one in (slow, quick)]
    assert len(NAMES) <= counts[0] < counts[1]
    for estimate in slow.estimates().values():
        assert estimate.value[0, 1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_a_group_is_saved_motor_by_motor_and_goes_on_together_or_alone(
    signals: Signals, tmp_path: Path
) -> None:
    before = observer()
    feed(before, signals, last=HALFWAY)
    checkpoint.save(before, tmp_path / 'halfway')
    together, alone = (observer(group_from=group_from) for group_from in (2, 1000))
    for one, groups in ((together, 1), (alone, len(NAMES))):
        checkpoint.load(one, tmp_path / 'halfway')
        assert len(one.groups(NAMES)) == groups
        feed(one, signals, first=HALFWAY, last=CHANGE)
    for name in NAMES:
        estimates = [one.estimates()[name] for one in (together, alone)]
        np.testing.assert_allclose(estimates[0].value, estimates[1].value, rtol=1e-9)
        assert estimates[0].verdicts == estimates[1].verdicts
        assert alone.motors[name].counters.items() <= together.motors[name].counters.items()


def test_a_frozen_group_learns_nothing_and_goes_on_afterwards(signals: Signals) -> None:
    one = observer()
    feed(one, signals, last=400)
    before = {name: estimate.value for name, estimate in one.estimates().items()}
    one.freeze(True)
    feed(one, signals, first=400, last=700)
    after = one.estimates()
    for name in NAMES:
        assert (after[name].value == before[name]).all()
        assert {*after[name].verdicts[0]} == {Verdict.FROZEN}
    fits = one.motors[SHY].counters['fits']
    one.freeze(False)
    feed(one, signals, first=700, last=1200)
    assert one.motors[SHY].counters['fits'] > fits


@pytest.mark.slow
@pytest.mark.parametrize('share', [0.05, 0.2])
def test_whoever_asks_meanwhile_changes_nothing(signals: Signals, share: float) -> None:
    quiet, asked = (observer(group_core_share=share) for _ in range(2))
    results: list[list[tuple[Any, ...]]] = [[], []]
    for k in range(SAMPLES):
        for one, seen in zip((quiet, asked), results, strict=True):
            for name, found in feed(one, signals, first=k, last=k + 1).items():
                seen += [
                    (name, result.estimate.value.tobytes(), result.estimate.verdicts)
                    for result in found
                    if result.estimate is not None
                ]
        if HOT in asked.motors:
            rule = asked.group_of(HOT).observer
            assert rule is not None
            rule.retested()
            asked.fit(NAMES[k % len(NAMES)])
            asked.estimates()
    assert results[0] == results[1]
    for name in NAMES:
        assert quiet.fit(name) == asked.fit(name)
        plain, arrays = quiet.motors[name].state()
        other_plain, other_arrays = asked.motors[name].state()
        assert plain == other_plain
        assert all((arrays[key] == other_arrays[key]).all() for key in arrays)


@pytest.mark.parametrize('share', [0.02, 0.2])
def test_beliefs_stay_while_learning_is_stopped(signals: Signals, share: float) -> None:
    one = observer(group_core_share=share)
    feed(one, signals, last=700)
    one.freeze(True)
    before = {name: (one.fit(name), one.estimates()[name]) for name in NAMES}
    feed(one, signals, first=700, last=1500)
    for name, (fit, estimate) in before.items():
        assert one.fit(name) == fit
        after = one.estimates()[name]
        assert (after.covariance == estimate.covariance).all()
        assert after.verdicts == estimate.verdicts


@pytest.mark.slow
def test_tests_that_wait_are_made_after_a_restart_and_at_the_end(
    signals: Signals, tmp_path: Path
) -> None:
    one = observer(group_core_share=0.02)
    k = 0
    waiting: set[str] = set()
    while not waiting:
        feed(one, signals, first=k, last=k + 1)
        k += 1
        counts = {name: view.counters[LATE_TEST] for name, view in one.motors.items()}
        waiting = {name for name, count in counts.items() if count > 5}
    checkpoint.save(one, tmp_path / 'waiting')
    again = observer(group_core_share=0.02)
    checkpoint.load(again, tmp_path / 'waiting')
    feed(again, signals, first=k, last=k + 3)
    late = {name: again.motors[name].counters[LATE_TEST] for name in NAMES}
    assert any(late[name] or again.fit(name).verdict is not FitVerdict.UNTESTED for name in waiting)
    again.finish()
    for name in waiting:
        assert again.motors[name].counters[LATE_TEST] == 0
        assert again.fit(name).verdict is not FitVerdict.UNTESTED


def test_only_those_are_named_whose_estimates_have_changed_at_the_end(signals: Signals) -> None:
    one = observer()
    idle = {**signals, STUCK: (np.zeros(SAMPLES), np.zeros(SAMPLES))}
    feed(one, idle, last=1000)
    names = one.finish()
    assert STUCK not in names
    assert {*names} <= {HOT, SHY, BLIND}


@pytest.mark.parametrize(
    'other',
    [
        {'predictor': True},
        {'m0.delay': 'estimate'},
        {'m0.context_nodes': ['inductance', 'resistance', 'inertia', 'coulomb_friction']},
    ],
)
def test_who_is_no_plain_rotor_of_the_same_kind_stays_alone(
    signals: Signals, other: dict[str, Any]
) -> None:
    one = observer(**other)
    feed(one, signals, last=3)
    assert one.groups((HOT,))[0].names == (HOT,)


def test_the_rule_of_a_group_counts_for_all_and_for_each(signals: Signals) -> None:
    one = observer()
    feed(one, signals, last=500)
    rule = one.groups(NAMES)[0].observer.context_nodes  # type: ignore[union-attr]
    assert isinstance(rule, RotorGroup)
    assert rule.counters()['fits'] == sum(rule.counters(k)['fits'] for k in range(len(NAMES)))
    assert rule.estimate().value.shape == (len(NAMES), 5)
    assert (rule.estimate().value == rule.theta).all()
    assert not rule.is_drifting(0)


def test_what_is_left_at_the_end_is_done(signals: Signals) -> None:
    one = observer(group_core_share=0.01)
    feed(one, signals, last=1000)
    changed = one.finish()
    assert {*changed} == {*NAMES}
    for estimate in one.estimates().values():
        assert estimate.value[0, 1] == pytest.approx(2.0, rel=0.05)
