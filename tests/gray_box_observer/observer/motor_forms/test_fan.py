"""A fan or a pump on a rotor: a friction that grows with the square of the speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, observed, part, recorded, told

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict, effects
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR, THESIS, FormKind
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

FAN = replace(GEAR_MOTOR, quadratic_friction=6e-8)
NODES = [
    *('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction'),
    'quadratic_friction',
]


def noisy_speed(record: Recording) -> NDArray[np.float64]:
    """Return the speed of a record with 0.5 % noise."""
    speed = record.speed_rad_s[0]
    noise = np.random.default_rng(4).normal(0.0, 5e-3 * np.std(speed), speed.size)
    return np.asarray(speed + noise)


def assert_right(motor: MotorView, names: list[str]) -> None:
    """Assert that some parameters are identified, and right."""
    for name in names:
        value, std, verdict = told(motor, name)
        true = getattr(FAN, name)
        assert verdict is Verdict.IDENTIFIED, name
        assert abs(value - true) < max(4.0 * std, 0.01 * true), name
        assert value == pytest.approx(true, rel=0.05), name


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 5])
def test_a_fan_is_found_and_what_leans_on_it_is_right(seed: int) -> None:
    motor = observed(recorded(FAN, LIVELY, 8.0, seed)).motors['motor']
    assert motor.added_effects == ('quadratic_friction',)
    assert motor.effects_reason.startswith('a rotor with a quadratic friction explains the data')
    assert motor.fit.verdict is FitVerdict.OK
    assert_right(motor, [name for name in NODES if name != 'viscous_friction'])


@pytest.mark.slow
@pytest.mark.parametrize('seed', [3, 5])
def test_where_nothing_is_added_the_remedy_names_a_fan(seed: int) -> None:
    record = recorded(FAN, LIVELY, 8.0, seed)
    motor = observed(record, **{'motor.effects': 'none'}).motors['motor']
    assert motor.added_effects == ()
    assert motor.fit.verdict in (FitVerdict.WARNING, FitVerdict.MISFIT)
    assert 'quadratic_friction' in motor.fit.suspects[0].remedy
    assert told(motor, 'viscous_friction')[2] is not Verdict.IDENTIFIED


def test_a_remedy_names_only_what_is_missing() -> None:
    assert 'add to {motor}.context_nodes load_torque' in effects.load_remedy('quadratic_friction')
    assert 'quadratic_friction' not in effects.load_remedy('quadratic_friction')
    assert 'add to' not in effects.load_remedy('load_torque', 'quadratic_friction')


@pytest.mark.slow
def test_a_motor_without_a_fan_has_none() -> None:
    motor = observed(recorded(GEAR_MOTOR, LIVELY, 5.0, 2)).motors['motor']
    assert motor.added_effects == ()
    assert motor.fit.verdict is FitVerdict.OK


@pytest.mark.slow
def test_a_fan_that_is_named_is_told_beside_a_measured_speed() -> None:
    values = {'motor.speed_source': 'measured', 'motor.context_nodes': NODES}
    record = recorded(FAN, LIVELY, 6.0, 2)
    motor = observed(record, noisy_speed(record), **values).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert_right(motor, NODES)


GEAR = 30.0


@pytest.mark.slow
def test_a_fan_behind_a_gear_is_told_from_no_near_start() -> None:
    """Its coefficient is 27,000 times as large as where identification starts by default."""
    powers = {'inertia': 2, 'coulomb_friction': 1, 'quadratic_friction': 3}
    record = recorded(FAN, LIVELY, 6.0, 2)
    geared = replace(
        record, torque_nm=GEAR * record.torque_nm, speed_rad_s=record.speed_rad_s / GEAR
    )
    constants = {name: GEAR * value for name, value in CONSTANTS.items()}
    values = {'motor.speed_source': 'measured', 'motor.context_nodes': NODES, **constants}
    motor = observed(geared, noisy_speed(geared), **values).motors['motor']
    for name, power in powers.items():
        true = GEAR**power * getattr(FAN, name)
        assert told(motor, name)[0] == pytest.approx(true, rel=0.02), name


STAGES: dict[str, Callable[[dict[str, Any]], bool]] = {
    'it looks like another motor': lambda state: state['change_count'] > 1000,
    'a trial is under way': lambda state: state['change_count'] > 0 and 'trial' in state,
    'a fan was found': lambda state: state['effects'] == ['quadratic_friction'],
}


@pytest.mark.slow
@pytest.mark.parametrize('stage', STAGES)
def test_what_is_saved_at_any_stage_goes_on_bit_for_bit(stage: str, tmp_path: Path) -> None:
    """A rotor gets a fan when it is known: before that its first trial would find one."""
    record = recorded(FAN, LIVELY, 12.0, 3)
    one = Observer(Configuration.from_flat(CONSTANTS))
    other = Observer(Configuration.from_flat(CONSTANTS))
    begin_ns = feed(one, [part(recorded(GEAR_MOTOR, LIVELY, 5.0, 2), 4000)])
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        one.voltage('motor', begin_ns + stamp, float(record.voltage_v[0, k]))
        one.torque('motor', begin_ns + stamp, float(record.torque_nm[0, k]))
        if (
            k > 256
            and k % 16 == 0
            and STAGES[stage](one.motors['motor'].observer.form_choice.state(0)[0])
        ):
            break
    else:
        raise AssertionError(f'never: {stage}')
    checkpoint.save(one, tmp_path / 'one.safetensors')
    checkpoint.load(other, tmp_path / 'one.safetensors')
    for observer in (one, other):
        feed(observer, [part(recorded(FAN, LIVELY, 8.0, 5), 6000)], 20_000_000_000)
    before, after = one.motors['motor'], other.motors['motor']
    assert after.added_effects == before.added_effects == ('quadratic_friction',)
    assert before.estimate.value.tobytes() == after.estimate.value.tobytes()


@pytest.mark.slow
def test_a_rotor_that_truly_changes_gets_no_fan() -> None:
    observer = observed(part(recorded(GEAR_MOTOR, LIVELY, 5.0, 2), 4000))
    changed = replace(GEAR_MOTOR, coulomb_friction=4e-3, viscous_friction=3e-5)
    begin_ns = 7_000_000_000
    for seed in (3, 4):
        for plant in (changed, GEAR_MOTOR):
            begin_ns = feed(observer, [recorded(plant, LIVELY, 3.0, seed)], begin_ns)
            assert observer.motors['motor'].added_effects == ()


def test_a_fan_belongs_to_a_rotor_alone() -> None:
    choice = observed(part(recorded(FAN, LIVELY, 6.0, 2), 100)).motors['motor'].observer.form_choice
    assert choice.may_take(FormKind(ROTOR, ('quadratic_friction',)))
    assert choice.may_take(FormKind(ROTOR, ('load_torque', 'quadratic_friction')))
    assert not choice.may_take(FormKind(THESIS, ('quadratic_friction',)))
    assert not choice.may_take(FormKind(MEASURED, ('quadratic_friction',)))
