"""A published speed that stands still: none is measured, an encoder failed, or a shaft is held."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, recorded

from dc_motor_sim.simulation import Recording
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.fit_test.still_speed import stands_still
from gray_box_observer.observer.motor_forms.motor_form import FormKind
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

BACK_EMF = 0.02
BOX = MotorWhiteBox(
    ('inductance', 'resistance'), 0.02, {'back_emf_constant': BACK_EMF}, speed_measured=True
)


def feed(
    observer: Observer, record: Recording, torque_nm: np.ndarray, speed_rad_s: np.ndarray
) -> None:
    for k, stamp_ns in enumerate(record.stamp_ns.tolist()):
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, k]))
        observer.torque('motor', stamp_ns, float(torque_nm[k]), float(speed_rad_s[k]))


def observed(
    record: Recording, torque_nm: np.ndarray, speed_rad_s: np.ndarray, **values: object
) -> Observer:
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    feed(observer, record, torque_nm, speed_rad_s)
    return observer


@pytest.mark.slow
@pytest.mark.parametrize('reading', [0.0, 7.0])
def test_a_rotor_that_turns_under_a_speed_that_stands_still_is_found(
    reading: float, tmp_path: Path
) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, 1)
    still = np.full(record.stamp_ns.size, reading)
    observer = observed(record, record.torque_nm[0], still)
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.speed_reason.startswith('the measured speed stands still; a rotor explains')
    assert motor.estimate.identified(0)
    assert motor.estimate.value[0, 1] == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)

    path = tmp_path / 'motor.safetensors'
    checkpoint.save(observer, path)
    after = Observer(Configuration.from_flat(CONSTANTS))
    checkpoint.load(after, path)
    last_ns = int(record.stamp_ns[-1])
    for one in (observer, after):
        one.torque('motor', last_ns + 1_000_000, 0.0)  # from now on nobody publishes a speed
        one.voltage('motor', last_ns + 1_000_000, 0.0)
    assert after.motors['motor'].white_box.speed_source == 'rotor'
    assert observer.counts('motor').rejected.total() == 0
    assert np.array_equal(after.motors['motor'].estimate.value, motor.estimate.value)
    for one in (observer, after):
        choice = one.motors['motor'].observer.form_choice
        assert choice.may_take(FormKind('measured'))
        assert not choice.may_take(FormKind('torque_constant'))
        assert not choice.speed_is_open


def held_torque(record: Recording) -> np.ndarray:
    """Return noisy torques of the same motor with its shaft held."""
    current_a = np.zeros(record.stamp_ns.size)
    decay = math.exp(-1e-3 * GEAR_MOTOR.resistance / GEAR_MOTOR.inductance)
    for k, voltage_v in enumerate(record.voltage_v[0, :-1].tolist()):
        level_a = voltage_v / GEAR_MOTOR.resistance
        current_a[k + 1] = level_a + (current_a[k] - level_a) * decay
    current_a += 0.01 * current_a.std() * np.random.default_rng(1).normal(size=current_a.size)
    return GEAR_MOTOR.torque_constant * current_a


@pytest.mark.parametrize('source', ['auto', 'measured'])
def test_of_a_shaft_that_is_held_a_speed_of_zero_is_believed_where_it_is_stated(
    source: str,
) -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    still = np.zeros(record.stamp_ns.size)
    stated = {'motor.speed_source': source, 'motor.context_nodes': ['inductance', 'resistance']}
    motor = observed(record, held_torque(record), still, **stated).motors['motor']
    assert motor.white_box.speed_source == 'measured'
    assert motor.estimate.value[0, 1] == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)
    assert motor.estimate.identified(0) == (source == 'measured')


@pytest.mark.parametrize('friction', [1e-4, 5e-4])
def test_a_light_rotor_in_thick_oil_is_not_taken_for_a_shaft_that_is_held(friction: float) -> None:
    """Its law without a transient is V = (R + Kb Kt / B) i."""
    motor = replace(GEAR_MOTOR, inertia=1e-6, viscous_friction=friction, coulomb_friction=0.0)
    record = recorded(motor, 'R[-12,12]D[0.05,0.3]', 8.0, 3)
    every = slice(None, None, 10)
    coarse = replace(
        record, stamp_ns=record.stamp_ns[every], voltage_v=record.voltage_v[:, every],
        torque_nm=record.torque_nm[:, every],
    )  # fmt: skip
    still = np.zeros(coarse.stamp_ns.size)
    view = observed(coarse, coarse.torque_nm[0], still).motors['motor']
    verdicts = dict(zip(view.white_box.context_nodes, view.estimate.verdicts[0], strict=False))
    is_right = view.estimate.value[0, 1] == pytest.approx(motor.resistance, rel=0.05)
    assert is_right or verdicts['resistance'].value != 'identified'


def test_after_the_change_no_torque_waits_for_a_speed() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 3.0, 1)
    observer = Observer(Configuration.from_flat(CONSTANTS))
    signals = zip(record.stamp_ns.tolist(), record.voltage_v[0], record.torque_nm[0], strict=True)
    has_speed = True
    for stamp_ns, voltage_v, torque_nm in signals:
        observer.voltage('motor', stamp_ns, float(voltage_v))
        observer.torque('motor', stamp_ns, float(torque_nm), 0.0 if has_speed else math.nan)
        has_speed = observer.motors['motor'].white_box.speed_source == 'measured'
    assert not has_speed
    assert observer.counts('motor').rejected.total() == 0


def test_a_speed_that_is_asked_for_stays() -> None:
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, 1)
    asked = {'motor.speed_source': 'measured'}
    still = np.zeros(record.stamp_ns.size)
    motor = observed(record, record.torque_nm[0], still, **asked).motors['motor']
    assert motor.white_box.speed_source == 'measured'
    assert motor.fit.verdict.value == 'misfit'


def test_a_speed_stands_still_whose_back_emf_is_a_thousandth_of_the_voltage() -> None:
    theta = np.array([[1e-3, 1.0]])
    content = np.zeros((4, 1, 100))
    content[1] = 10.0
    for range_v, is_still in ((0.0, True), (0.009, True), (0.011, False)):
        content[3, 0] = 5.0
        content[3, 0, 50] += range_v / BACK_EMF
        assert stands_still(BOX, theta, content) == is_still
