"""Two effects that come together on a rotor whose speed nobody measures: both are found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, driven, feed, observed, part, told

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

FULL_SPEED = 12.0 / GEAR_MOTOR.back_emf_constant
AMOUNTS = {
    'brush_drop': 0.4,
    'hysteresis': 0.15 * GEAR_MOTOR.resistance / FULL_SPEED,
    'quadratic_friction': 6e-8,
}
PAIRS = [
    ('brush_drop', 'hysteresis'),
    ('brush_drop', 'quadratic_friction'),
    ('hysteresis', 'quadratic_friction'),
]
OFFSET_A = 0.2


def motor_with(effects: tuple[str, ...]) -> PlantParameters:
    return replace(GEAR_MOTOR, **{name: AMOUNTS[name] for name in effects})


@cache
def recorded_with(effects: tuple[str, ...], duration_s: float = 15.0, seed: int = 3) -> Recording:
    """Record the gear motor with some effects, its voltage in random steps."""
    rng = np.random.default_rng(seed)
    levels_v = [np.full(n, rng.uniform(-12.0, 12.0)) for n in rng.integers(50, 500, 90)]
    voltage_v = np.concatenate(levels_v)[: round(1e3 * duration_s)]
    return driven(motor_with(effects), voltage_v, seed)


@pytest.mark.slow
@pytest.mark.parametrize('effects', PAIRS, ids='+'.join)
def test_both_are_found_and_what_is_identified_is_right(effects: tuple[str, ...]) -> None:
    """Each alone left a misfit, so that neither was found."""
    motor = observed(recorded_with(effects)).motors['motor']
    assert set(motor.added_effects) == set(effects)
    assert motor.fit.verdict is FitVerdict.OK
    truth = motor_with(effects)
    for name in motor.white_box.context_nodes:
        value, std, verdict = told(motor, name)
        if verdict is Verdict.IDENTIFIED:
            true = getattr(truth, name)
            assert abs(value - true) < max(4.0 * std, 0.02 * true), name
    assert told(motor, 'resistance')[2] is Verdict.IDENTIFIED


def offset(record: Recording) -> Recording:
    """The same with an offset of the current sensor."""
    offset_nm = OFFSET_A * GEAR_MOTOR.torque_constant
    return replace(record, torque_nm=record.torque_nm + offset_nm)


@pytest.mark.slow
def test_an_offset_of_the_sensor_is_no_load() -> None:
    """It drives the shaft of the model, too: a load and an offset of the voltage stand for it."""
    motor = observed(offset(recorded_with((), 20.0))).motors['motor']
    assert set(motor.added_effects) == {'load_torque', 'voltage_offset'}
    assert motor.fit.verdict is FitVerdict.OK
    value, std, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert abs(value - GEAR_MOTOR.resistance) < max(4.0 * std, 0.01 * value)
    assert told(motor, 'load_torque')[2] is not Verdict.IDENTIFIED
    assert told(motor, 'voltage_offset')[2] is not Verdict.IDENTIFIED


@pytest.mark.slow
def test_beside_hysteresis_that_offset_is_no_load_either() -> None:
    """It goes through the hysteresis, too, so that it explains even more than both of them do."""
    motor = observed(offset(recorded_with(('hysteresis',), 20.0))).motors['motor']
    assert 'load_torque' in motor.added_effects
    assert told(motor, 'load_torque')[2] is not Verdict.IDENTIFIED
    value, std, verdict = told(motor, 'resistance')
    if verdict is Verdict.IDENTIFIED:
        assert abs(value - GEAR_MOTOR.resistance) < max(4.0 * std, 0.01 * value)


@pytest.mark.slow
def test_two_levels_do_not_tell_what_brushes_take() -> None:
    """R was 5 % too large, and sure: what brushes took seemed to be a share of the voltage."""
    rng = np.random.default_rng(4)
    holds = rng.integers(50, 500, 40)
    signs = np.where(np.arange(holds.size) % 2, -12.0, 12.0)
    levels_v = [np.full(n, volts) for n, volts in zip(holds, signs, strict=True)]
    motor = observed(driven(motor_with(('brush_drop',)), np.concatenate(levels_v)[:10000])).motors[
        'motor'
    ]
    value, std, verdict = told(motor, 'resistance')
    assert verdict is not Verdict.IDENTIFIED
    assert abs(value - GEAR_MOTOR.resistance) < 3.0 * std


@pytest.mark.slow
def test_a_search_that_is_saved_comes_to_the_same_end(tmp_path: Path) -> None:
    record = recorded_with(PAIRS[0])
    one = Observer(Configuration.from_flat(CONSTANTS))
    other = Observer(Configuration.from_flat(CONSTANTS))
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        one.voltage('motor', stamp, float(record.voltage_v[0, k]))
        one.torque('motor', stamp, float(record.torque_nm[0, k]))
        motor = one.motors.get('motor')
        if motor is not None and k % 16 == 0:
            plain, _ = motor.observer.form_choice.state(0)
            if 'trial' in plain and plain['trial']['pieces'] > 60:
                break
    else:
        raise AssertionError('no trial went on for so long')
    checkpoint.save(one, tmp_path / 'one.safetensors')
    checkpoint.load(other, tmp_path / 'one.safetensors')
    for observer in (one, other):
        feed(observer, [part(recorded_with(PAIRS[0], seed=4), 12000)], 20_000_000_000)
    before, after = one.motors['motor'], other.motors['motor']
    assert set(before.added_effects) == set(PAIRS[0])
    assert after.added_effects == before.added_effects
    assert before.estimate.value.tobytes() == after.estimate.value.tobytes()
