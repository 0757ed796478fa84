"""A driver that opens the winding at a command of 0: found by the data, or declared."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, driven

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.coasting import seems_to_coast
from gray_box_observer.observer.motor_forms.voltage_path import VoltagePath
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.replay_buffer import is_lone, without_lone
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

COASTING = replace(GEAR_MOTOR, coasting_resistance=40.0)
SAMPLES = 8000
BOX = MotorWhiteBox(('inductance', 'resistance'), 0.02, {'back_emf_constant': 0.02})


@cache
def _recorded(plant: PlantParameters, seed: int = 2) -> Recording:
    """Record a motor whose voltage is drawn anew ten times a second, and is 0 every third time."""
    rng = np.random.default_rng(seed)
    levels_v = rng.uniform(-12.0, 12.0, SAMPLES // 100)
    levels_v[2::3] = 0.0
    return driven(plant, np.repeat(levels_v, 100))


def _content(record: Recording) -> np.ndarray:
    """Return a record as a replay buffer would hold it, shape (signal, 1, n)."""
    content = np.zeros((4, 1, record.stamp_ns.size))
    content[0, 0, 1:] = np.diff(record.stamp_ns) * 1e-9
    content[1, 0, 1:] = record.voltage_v[0, :-1]
    content[2] = record.torque_nm
    return content


def _observed(
    record: Recording, *, speed: bool, observer: Observer | None = None, begin: int = 0,
    end: int = SAMPLES, **values: object,
) -> Observer:  # fmt: skip
    """Let an observer see a part of a record; its speed has 1 % noise."""
    observer = observer or Observer(Configuration.from_flat({**CONSTANTS, **values}))
    speed_rad_s = record.speed_rad_s[0]
    noise = 0.01 * speed_rad_s.std() * np.random.default_rng(7).normal(size=SAMPLES)
    readings = speed_rad_s + noise if speed else np.full(SAMPLES, np.nan)
    for k in range(begin, end):
        stamp_ns = int(record.stamp_ns[k])
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp_ns, float(record.torque_nm[0, k]), float(readings[k]))
    return observer


def _check_resistance(motor: MotorView) -> None:
    estimate = motor.estimate
    assert motor.fit.verdict in (FitVerdict.OK, FitVerdict.WARNING)
    assert estimate.verdicts[0][1].value == 'identified'
    assert estimate.value[0, 1] == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize('speed', [True, False], ids=['measured', 'hidden'])
def test_a_driver_that_coasts_is_found_and_the_motor_with_it(speed: bool) -> None:
    motor = _observed(_recorded(COASTING), speed=speed).motors['motor']
    assert motor.added_effects == ('coasting',)
    assert 'with a driver that coasts explains the data' in motor.effects_reason
    _check_resistance(motor)


@pytest.mark.slow
@pytest.mark.parametrize('speed', [True, False], ids=['measured', 'hidden'])
def test_a_driver_that_is_said_to_coast_needs_no_trial(speed: bool) -> None:
    values = {'motor.coasting': True, 'motor.effects': 'none'}
    motor = _observed(_recorded(COASTING), speed=speed, **values).motors['motor']
    assert motor.added_effects == ()
    _check_resistance(motor)


@pytest.mark.slow
def test_without_effects_the_cause_and_its_remedy_are_named() -> None:
    motor = _observed(_recorded(COASTING), speed=True, **{'motor.effects': 'none'}).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.fit.suspects[0].effect == 'coasting'
    assert motor.fit.suspects[0].remedy.startswith('motor.coasting: true')


@pytest.mark.slow
def test_a_driver_that_brakes_is_taken_for_none_that_coasts() -> None:
    record = _recorded(GEAR_MOTOR)
    assert not seems_to_coast(BOX, _content(record)[:, 0])
    motor = _observed(record, speed=False).motors['motor']
    assert motor.added_effects == ()
    _check_resistance(motor)


def test_no_current_where_a_command_of_zero_finds_the_rotor_turning_seems_to_be_coasting() -> None:
    content = _content(_recorded(COASTING))[:, 0]
    assert seems_to_coast(BOX, content)
    assert not seems_to_coast(BOX, content[:, :400])  # the command was 0 but once
    slow = content.copy()
    before_zero = np.flatnonzero((slow[1, 1:] == 0.0) & (slow[1, :-1] != 0.0))
    slow[1, before_zero] = 0.1  # a controller has braked: little speed is left
    assert not seems_to_coast(BOX, slow)


@pytest.mark.slow
def test_what_is_saved_goes_on_bit_for_bit(tmp_path: Path) -> None:
    record = _recorded(COASTING)
    whole = _observed(record, speed=False)
    half = _observed(record, speed=False, end=6000)
    assert half.motors['motor'].added_effects == ('coasting',)
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(half, path)
    restored = Observer(Configuration.from_flat(CONSTANTS))
    checkpoint.load(restored, path)
    _observed(record, speed=False, observer=restored, begin=6000)
    one, other = (seen.motors['motor'].estimate for seen in (whole, restored))
    assert one.value.tobytes() == other.value.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()


def test_what_the_path_opens_sample_by_sample_it_opens_all_at_once() -> None:
    content = _content(_recorded(COASTING))
    content[1, 0, 50] = 0.3  # within the dead zone
    path = VoltagePath(np.array([0.5]), coasts=True)
    together = VoltagePath(np.array([0.5]), coasts=True).driven(content)
    is_open = path.is_open(content)[0]
    assert is_open[50]
    assert np.array_equal(is_open[1:], np.abs(content[1, 0, 1:]) <= 0.5)
    assert (together[0, 0] == np.where(is_open, 0.0, content[0, 0])).all()
    for k in range(content.shape[2]):
        interval_s = path.known_interval(content[0, :, k], content[1, :, k])
        assert interval_s[0] == together[0, 0, k]


def test_samples_that_are_a_history_each_are_lone() -> None:
    content = np.zeros((4, 1, 6))
    content[0, 0] = [0.0, 1.0, 0.0, 0.0, 1.0, 0.0]
    assert is_lone(content).tolist() == [False, False, True, False, False, True]
    assert without_lone(content)[0, 0].tolist() == [0.0, 1.0, 0.0, 1.0]


@pytest.mark.slow
@pytest.mark.parametrize('speed', [True, False], ids=['measured', 'hidden'])
def test_a_motor_that_coasts_for_long_forgets_nothing_and_stops_at_nothing(speed: bool) -> None:
    rng = np.random.default_rng(5)
    lively_v = np.repeat(rng.uniform(-12.0, 12.0, 20), 100)
    rest_v = np.zeros(SAMPLES - lively_v.size)
    record = driven(COASTING, np.concatenate([lively_v, rest_v]))
    observer = _observed(record, speed=speed, end=5000, **{'motor.coasting': True})
    motor = observer.motors['motor']
    assert motor.estimate.value[0, 1] == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)
    assert observer.counts('motor').rejected.total() == 0
    rest = driven(COASTING, np.zeros(SAMPLES))
    idle = _observed(rest, speed=speed, end=1000, **{'motor.coasting': True})
    assert not any(idle.parameters_identified('motor'))


def test_a_motor_that_brakes_within_an_interval_or_two_does_not_seem_to_coast() -> None:
    content = _content(_recorded(GEAR_MOTOR))
    slow = content[:, :, ::50].copy()  # 20 Hz; a rotor stops in one interval
    slow[1, 0, 1:] = content[1, 0, 50::50]
    slow[0, 0, 1:] = 0.05
    assert not seems_to_coast(BOX, slow[:, 0])


def test_no_delay_is_estimated_beside_a_driver_that_coasts() -> None:
    values = {**CONSTANTS, 'motor.coasting': True, 'motor.delay': 'estimate'}
    with pytest.raises(ConfigurationError, match=r'motor\.delay in s'):
        Configuration.from_flat(values)


@pytest.mark.slow
def test_who_has_stated_what_was_found_goes_on_with_it(tmp_path: Path) -> None:
    found = _observed(_recorded(COASTING), speed=False)
    path = tmp_path / 'motor.safetensors'
    checkpoint.save(found, path)
    stated = Observer(Configuration.from_flat({**CONSTANTS, 'motor.coasting': True}))
    checkpoint.load(stated, path)
    motor = stated.motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.added_effects == ()
    _check_resistance(motor)


def test_a_command_that_opens_the_winding_is_told_from_others() -> None:
    path = VoltagePath(np.array([0.5]), coasts=True)
    assert path.opens(np.array([-0.4]))
    assert not path.opens(np.array([0.6]))
    assert not VoltagePath(np.array([0.5])).opens(np.array([0.0]))
