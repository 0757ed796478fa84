"""A motor that breaks while observed: the residual alarm, from simulated faults to results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.excitation import TABLE_5_1
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.settings.configuration import Configuration

BREAKS = 1200
"""The sample from which on the motor is another."""

WITHIN = 10
"""Samples after which the alarm has to stand: a tenth of a second."""

FAULTS = {
    'open brush': ('resistance=1000',),
    'weak magnet': ('torque_constant=0.006', 'back_emf_constant=0.006'),
    'blocked rotor': ('hysteresis=0', 'back_emf_constant=0'),
}


class Untrained:
    """Training that never changes the network that comes with the package."""

    is_resting = False
    busy = False
    failure = None

    def __init__(self, _configuration: dict[str, Any]) -> None:
        pass

    def submit(self, _job: dict[str, Any]) -> None:
        """Take a job."""

    def collect(self) -> dict[str, Any] | None:
        """Give nothing."""
        return None

    def close(self) -> None:
        """End nothing."""


def observer(**given: Any) -> Observer:
    return Observer(Configuration.from_flat({'alarm.learn': 500, **given}), Untrained)


def feed(
    one: Observer, recording: Recording, samples: range | None = None, shift_ns: int = 0
) -> list[Result]:
    results: list[Result] = []
    for k in samples or range(recording.stamp_ns.size):
        stamp = int(recording.stamp_ns[k]) + shift_ns
        results += one.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        results += one.torque('motor', stamp, float(recording.torque_nm[0, k]))
    return results


def stood(results: Sequence[Result]) -> np.ndarray:
    return np.array([result.alarm for result in results])


def broken(
    changes: Sequence[str],
    duration_s: float = 12.5,
    excitation: str = 'R[5,15]D[0.2,2]',
    **options: Any,
) -> Recording:
    schedule = [f'motor.{change}@{BREAKS / 100:g}' for change in changes]
    simulation = Simulation(
        {'motor': PlantParameters()},
        excitation,
        seed=3,
        torque_noise_std=1.1e-4,
        schedule=schedule,
        **options,
    )
    return simulation.record(duration_s)


@pytest.fixture(scope='module')
def open_brush() -> Recording:
    return broken(FAULTS['open brush'], 18.0)


@pytest.mark.parametrize('fault', list(FAULTS))
def test_a_fault_raises_the_alarm_within_a_tenth_of_a_second_and_nothing_does_before(
    fault: str,
) -> None:
    alarm = stood(feed(observer(), broken(FAULTS[fault])))
    assert not alarm[:BREAKS].any()
    assert alarm[BREAKS + WITHIN]


@pytest.mark.slow
def test_a_rotor_that_gets_stuck_raises_the_alarm_where_speed_is_not_measured() -> None:
    # twenty times the friction at the same mechanical time constant; the rotor slows down within
    # some 10 ms
    stuck = broken(('viscous_friction=20', 'inertia=0.2'), speed_mode='rotor')
    alarm = stood(feed(observer(), stuck))
    assert not alarm[:BREAKS].any()
    assert alarm[BREAKS + 2 * WITHIN]


@pytest.mark.slow
@pytest.mark.parametrize('excitation', TABLE_5_1.values())
def test_a_sound_motor_raises_no_alarm_in_a_minute_of_any_set_of_the_thesis(
    record: Callable[..., Recording], excitation: str
) -> None:
    one = observer()
    recording = record(excitation, 60.0, 5)
    noise_nm = 0.01 * recording.torque_nm[0].std()
    noise = np.random.default_rng(5).normal(0.0, noise_nm, recording.torque_nm.shape)
    results = feed(one, replace(recording, torque_nm=recording.torque_nm + noise))
    alarm = one.motors['motor'].alarm
    assert alarm is not None
    assert alarm.is_armed
    assert not stood(results).any()


@pytest.mark.slow
def test_the_alarm_falls_once_the_changed_motor_is_identified_again(open_brush: Recording) -> None:
    one = observer()
    alarm = stood(feed(one, open_brush))
    assert alarm[BREAKS + WITHIN : BREAKS + 100].all()
    assert not alarm[-1]
    assert not one.alarm('motor')
    assert one.estimates()['motor'].value[0, 1] > 500.0


@pytest.mark.slow
def test_a_frozen_observer_goes_on_watching_and_the_alarm_stands_for_it_adapts_to_nothing(
    open_brush: Recording,
) -> None:
    one = observer()
    feed(one, open_brush, range(BREAKS - 100))
    one.freeze(True)
    alarm = stood(feed(one, open_brush, range(BREAKS - 100, 1800)))
    assert not alarm[:100].any()
    assert alarm[100 + WITHIN :].all()


@pytest.mark.slow
def test_a_gap_neither_raises_the_alarm_nor_makes_a_standing_one_fall(
    open_brush: Recording,
) -> None:
    one = observer()
    assert not stood(feed(one, open_brush, range(BREAKS - 100))).any()
    pause_ns = 5_000_000_000
    assert not stood(feed(one, open_brush, range(BREAKS - 100, BREAKS), pause_ns)).any()
    assert stood(feed(one, open_brush, range(BREAKS, BREAKS + 20), pause_ns))[-1]
    assert stood(feed(one, open_brush, range(BREAKS + 20, BREAKS + 21), 2 * pause_ns))[-1]


@pytest.mark.slow
def test_a_saved_alarm_stands_where_it_stood(tmp_path: Path, open_brush: Recording) -> None:
    one = observer()
    other = observer()
    feed(one, open_brush, range(BREAKS + 20))
    checkpoint.save(one, tmp_path / 'c')
    checkpoint.load(other, tmp_path / 'c')
    assert other.alarm('motor')
    first, second = (o.group_of('motor').observer.alarm for o in (one, other))
    assert first is not None
    assert second is not None
    for name, array in first.state().items():
        np.testing.assert_array_equal(array, second.state()[name])


def test_without_a_prediction_by_the_physics_nothing_is_watched(open_brush: Recording) -> None:
    thesis = observer(variant='main')
    none = Observer(Configuration.from_flat({}), None)
    for one in (thesis, none):
        assert not stood(feed(one, open_brush, range(200))).any()
        assert one.motors['motor'].alarm is None
        assert not one.alarm('motor')
    assert not none.alarm('another')
