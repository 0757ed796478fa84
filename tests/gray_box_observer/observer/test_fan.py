"""A fan or a pump on a rotor: a friction that grows with the square of the speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, recorded

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_form import MEASURED, ROTOR, THESIS, FormKind
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

FAN = replace(GEAR_MOTOR, quadratic_friction=6e-8)
NODES = [
    *('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction'),
    'quadratic_friction',
]


def observed(record: Recording, *, with_speed: bool = False, **values: object) -> Observer:
    """Return an observer of a record, of its speed with 0.5 % noise too where that is measured."""
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    if not with_speed:
        feed(observer, [record])
        return observer
    speed = record.speed_rad_s[0]
    noise = np.random.default_rng(4).normal(0.0, 5e-3 * np.std(speed), speed.size)
    signals = (record.voltage_v[0], record.torque_nm[0], speed + noise)
    for stamp, volt, torque, speed in zip(record.stamp_ns, *signals, strict=True):
        observer.voltage('motor', int(stamp), float(volt))
        observer.torque('motor', int(stamp), float(torque), float(speed))
    return observer


def assert_right(motor: MotorView, names: list[str]) -> None:
    """Assert that some parameters are identified, and right."""
    estimate = motor.estimate
    for place, parameter in enumerate(estimate.parameters):
        if parameter.name not in names:
            continue
        value, std = float(estimate.value[0, place]), float(estimate.std[0, place])
        true = getattr(FAN, parameter.name)
        assert estimate.verdicts[0][place] is Verdict.IDENTIFIED, parameter.name
        assert abs(value - true) < max(4.0 * std, 0.01 * true), parameter.name
        assert value == pytest.approx(true, rel=0.05), parameter.name


@pytest.mark.slow
def test_a_fan_is_found_and_what_leans_on_it_is_right() -> None:
    motor = observed(recorded(FAN, LIVELY, 8.0, 2)).motors['motor']
    assert motor.added_effects == ('quadratic_friction',)
    assert motor.effects_reason.startswith('a rotor with a quadratic friction explains the data')
    assert motor.fit.verdict is FitVerdict.OK
    assert_right(motor, [name for name in NODES if name != 'viscous_friction'])


@pytest.mark.slow
def test_where_nothing_is_added_a_fan_leaves_a_misfit_and_its_remedy_names_it() -> None:
    motor = observed(recorded(FAN, LIVELY, 8.0, 2), **{'motor.effects': 'none'}).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert Verdict.IDENTIFIED not in motor.estimate.verdicts[0]


@pytest.mark.slow
def test_a_motor_without_a_fan_has_none() -> None:
    motor = observed(recorded(GEAR_MOTOR, LIVELY, 8.0, 2)).motors['motor']
    assert motor.added_effects == ()
    assert motor.fit.verdict is FitVerdict.OK


@pytest.mark.slow
def test_a_fan_that_is_named_is_told_beside_a_measured_speed() -> None:
    values = {'motor.speed_source': 'measured', 'motor.context_nodes': NODES}
    motor = observed(recorded(FAN, LIVELY, 8.0, 2), with_speed=True, **values).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert_right(motor, NODES)


@pytest.mark.slow
def test_a_found_fan_survives_a_checkpoint(tmp_path: Path) -> None:
    one = observed(recorded(FAN, LIVELY, 8.0, 2))
    other = Observer(Configuration.from_flat(CONSTANTS))
    checkpoint.save(one, tmp_path / 'one.safetensors')
    checkpoint.load(other, tmp_path / 'one.safetensors')
    for observer in (one, other):
        feed(observer, [recorded(FAN, LIVELY, 1.0, 3)], 9_000_000_000)
    before, after = one.motors['motor'], other.motors['motor']
    assert after.added_effects == ('quadratic_friction',)
    assert before.estimate.value.tobytes() == after.estimate.value.tobytes()


def test_a_fan_belongs_to_a_rotor_alone() -> None:
    choice = observed(recorded(FAN, LIVELY, 0.1, 2)).motors['motor'].observer.form_choice
    assert choice.may_take(FormKind(ROTOR, ('quadratic_friction',)))
    assert choice.may_take(FormKind(ROTOR, ('load_torque', 'quadratic_friction')))
    assert not choice.may_take(FormKind(THESIS, ('quadratic_friction',)))
    assert not choice.may_take(FormKind(MEASURED, ('quadratic_friction',)))
