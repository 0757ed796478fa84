"""A constant load of either sign on a rotor whose speed nobody measures is found by data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, observed, recorded, told

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.builder import initial_estimate
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR, THESIS, FormKind
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

LIFTING = replace(GEAR_MOTOR, coulomb_friction=5e-3, load_torque=6e-3)
FRICTIONLESS = replace(GEAR_MOTOR, coulomb_friction=0.0, load_torque=6e-3)
NODES = [
    'inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction', 'load_torque'
]  # fmt: skip
LOADED = {'motor.speed_source': 'rotor', 'motor.context_nodes': NODES}


@pytest.mark.slow
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_load_of_either_sign_is_found_and_everything_is_right(sign: float) -> None:
    plant = replace(LIFTING, load_torque=sign * LIFTING.load_torque)
    motor = observed(recorded(plant, LIVELY, 8.0, 2)).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.added_effects == ('load_torque',)
    assert motor.effects_reason.startswith('a rotor with a load explains the data')
    assert motor.fit.verdict is FitVerdict.OK
    for name in NODES:
        value, std, verdict = told(motor, name)
        true = getattr(plant, name)
        assert verdict is Verdict.IDENTIFIED, name
        assert abs(value - true) < max(4.0 * std, 0.02 * abs(true)), name


@pytest.mark.slow
def test_a_found_load_survives_a_checkpoint(tmp_path: Path) -> None:
    record = recorded(LIFTING, LIVELY, 6.0, 2)
    one = observed(record)
    other = Observer(Configuration.from_flat(CONSTANTS))
    checkpoint.save(one, tmp_path / 'one.safetensors')
    checkpoint.load(other, tmp_path / 'one.safetensors')
    for observer in (one, other):
        feed(observer, [recorded(LIFTING, LIVELY, 1.0, 3)], 7_000_000_000)
    before, after = one.motors['motor'], other.motors['motor']
    assert after.added_effects == ('load_torque',)
    assert before.estimate.value.tobytes() == after.estimate.value.tobytes()


@pytest.mark.slow
def test_where_nothing_is_added_a_load_is_suspected_and_no_dead_zone() -> None:
    motor = observed(recorded(LIFTING, LIVELY, 6.0, 2), **{'motor.effects': 'none'}).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.fit.suspects[0].effect in ('load', 'rotor')
    assert 'dead_zone' not in [suspect.effect for suspect in motor.fit.suspects]


@pytest.mark.slow
def test_without_dry_friction_a_load_may_be_an_offset_and_is_not_believed() -> None:
    motor = observed(recorded(FRICTIONLESS, LIVELY, 6.0, 2), **LOADED).motors['motor']
    assert motor.fit.verdict is not FitVerdict.MISFIT
    value, std, verdict = told(motor, 'load_torque')
    assert value == pytest.approx(FRICTIONLESS.load_torque, rel=0.1)
    assert verdict is Verdict.CONVERGING
    assert std > 0.5 * value
    resistance, _, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert resistance == pytest.approx(FRICTIONLESS.resistance, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize('coulomb_friction', [6e-4, 3e-4])
def test_little_dry_friction_does_not_tell_a_load_from_an_offset(coulomb_friction: float) -> None:
    plant = replace(LIFTING, coulomb_friction=coulomb_friction)
    motor = observed(recorded(plant, LIVELY, 2.0, 2), **LOADED).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    _, std, verdict = told(motor, 'load_torque')
    assert verdict is Verdict.CONVERGING
    assert 0.9 * plant.load_torque < std < 2.0 * plant.load_torque
    for name in ('inductance', 'resistance'):
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED
        assert abs(value - getattr(plant, name)) < max(4.0 * std, 0.005 * value)


@pytest.mark.slow
def test_an_offset_of_the_current_sensor_is_no_load_that_is_believed() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 6.0, 2)
    offset = replace(record, torque_nm=record.torque_nm + 3e-3)
    motor = observed(offset, **LOADED).motors['motor']
    is_known = told(motor, 'load_torque')[2] is Verdict.IDENTIFIED
    assert motor.fit.verdict is FitVerdict.MISFIT or not is_known


def test_a_load_belongs_to_a_rotor_alone() -> None:
    choice = observed(recorded(LIFTING, LIVELY, 0.1, 2)).motors['motor'].observer.form_choice
    assert choice.may_take(FormKind(ROTOR, ('load_torque',)))
    assert not choice.may_take(FormKind(THESIS, ('load_torque',)))
    assert not choice.may_take(FormKind(MEASURED, ('load_torque',)))


def test_a_start_beyond_the_range_is_refused() -> None:
    for start in (-2.0, 2.0, 5.0):
        with pytest.raises(ConfigurationError, match='must lie between -2 and 2 N m'):
            Configuration.from_flat({**CONSTANTS, **LOADED, 'motor.initial.load_torque': start})


def test_a_start_of_what_data_may_add_is_held_to_its_range_too() -> None:
    with pytest.raises(ConfigurationError, match='voltage_offset must lie between -5 and 5 V'):
        Configuration.from_flat({**CONSTANTS, 'motor.initial.voltage_offset': -7.0})


def measured(record: Recording, **values: object) -> MotorView:
    """Return the motor of a record whose speed is measured."""
    named = {'motor.speed_source': 'measured', 'motor.context_nodes': NODES}
    return observed(record, record.speed_rad_s[0], **named, **values).motors['motor']


def test_a_doubt_about_kt_is_relative_to_the_load_itself() -> None:
    record = recorded(LIFTING, LIVELY, 2.0, 3)
    torque_constant = CONSTANTS['motor.torque_constant']
    record = replace(record, torque_nm=record.torque_nm / torque_constant)
    stds = []
    for doubt in (0.0, 0.005):
        values = {'torque.quantity': 'current', 'motor.torque_constant_relative_std': doubt}
        value, std, _ = told(measured(record, **values), 'load_torque')
        stds.append(std / abs(value))
    assert stds[0] < 0.002
    assert stds[1] == pytest.approx(0.005, rel=0.2)


def test_what_is_stated_of_a_load_is_relative_to_it() -> None:
    stated = {'motor.initial.load_torque': -0.01, 'motor.initial_relative_std.load_torque': 0.5}
    configuration = Configuration.from_flat({**CONSTANTS, **LOADED, **stated})
    estimate = initial_estimate(configuration, configuration.motors['motor'])
    assert estimate.value[0, -1] == pytest.approx(-0.01)
    assert estimate.std[0, -1] == pytest.approx(0.005)


def test_a_stated_offset_of_zero_is_no_data_sheet_to_be_far_from() -> None:
    nodes = ['inductance', 'resistance', 'voltage_offset']
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    values = {'motor.context_nodes': nodes, 'motor.initial_relative_std.voltage_offset': 0.1}
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    for k, stamp in enumerate(record.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(record.voltage_v[0, k]))
        speed = float(record.speed_rad_s[0, k])
        observer.torque('motor', stamp, float(record.torque_nm[0, k]), speed)
    assert not observer.incidents
    assert np.isfinite(observer.estimates()['motor'].value).all()


@pytest.mark.slow
def test_beside_a_load_a_lost_voltage_is_doubted_as_ever() -> None:
    plant = replace(LIFTING, coulomb_friction=0.03, brush_drop=0.6)
    record = recorded(plant, 'R[8,10]D[0.02,0.2]', 3.0, 2)
    nodes = {'motor.context_nodes': [*NODES, 'brush_drop']}
    motor = observed(record, **{**LOADED, **nodes}).motors['motor']
    assert told(motor, 'brush_drop')[2] is not Verdict.IDENTIFIED
    assert told(motor, 'load_torque')[2] is not Verdict.IDENTIFIED
