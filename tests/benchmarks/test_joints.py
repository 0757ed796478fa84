"""The benchmark of joints: its friction, its loads, and one joint through the observer."""

from __future__ import annotations

from dataclasses import replace

import joints
import numpy as np
import pytest
from common.joints import joint_records
from common.joints.bristle_friction import BristleFriction
from common.joints.drawn_joints import Conditions, Joint, draw_joint
from common.joints.joint_records import joint_record, simulate
from common.trust.trial import Trial

POSITION = Conditions(follows_angle=True, rate_hz=200.0, noise=0.0, has_speed=False)


def drawn(load: str, **changes: float) -> Joint:
    joint = draw_joint(np.random.default_rng(4))
    return replace(joint, **{'load': load, 'load_torque_nm': 0.0, 'fan_nm_s2': 0.0} | changes)


@pytest.mark.parametrize('has_load', [False, True])
def test_power_is_lost_in_winding_friction_and_load(has_load: bool) -> None:
    """Over the run, less what inductance and inertia hold at its end."""
    stall_nm = drawn('none').motor.torque_constant * drawn('none').supply_v
    stall_nm /= drawn('none').motor.resistance
    fan = 0.2 * stall_nm / drawn('none').no_load_speed_rad_s ** 2 if has_load else 0.0
    joint = drawn('fan', fan_nm_s2=fan, static_friction=1.0)
    motor = joint.motor
    voltage, current, speed = simulate(joint, replace(POSITION, rate_hz=5000.0), _rng())
    delivered = np.mean(voltage * current)
    lost = motor.resistance * np.mean(current**2) + motor.viscous_friction * np.mean(speed**2)
    lost += motor.coulomb_friction * np.mean(np.abs(speed)) + fan * np.mean(np.abs(speed) ** 3)
    assert lost == pytest.approx(delivered, rel=0.05)


def test_brushes_take_what_the_user_does_not_know() -> None:
    """At the same voltage they lose what they drop times the current, whatever its sign."""
    plain = drawn('none', static_friction=1.0)
    joint = replace(plain, motor=replace(plain.motor, brush_drop=0.8))
    motor = joint.motor
    voltage, current, speed = simulate(joint, replace(POSITION, rate_hz=5000.0), _rng())
    delivered = np.mean(voltage * current)
    lost = motor.resistance * np.mean(current**2) + motor.viscous_friction * np.mean(speed**2)
    lost += motor.coulomb_friction * np.mean(np.abs(speed))
    assert lost + 0.8 * np.mean(np.abs(current)) == pytest.approx(delivered, rel=0.05)
    record = joint_record(0, has_brushes=True)
    assert 0.2 <= record.truth['brush_drop'] <= 1.0
    assert set(record.parameters) == {'motor.torque_constant', 'motor.back_emf_constant'}


@pytest.mark.parametrize(('share', 'moves'), [(0.9, False), (1.1, True)])
def test_friction_holds_a_shaft_until_it_breaks(share: float, moves: bool) -> None:
    joint = drawn('none', static_friction=1.0)
    friction = BristleFriction(joint, 1e-4)
    step_s = 1e-4
    pull_nm = share * joint.motor.coulomb_friction
    angle_rad = speed_rad_s = 0.0
    for _ in range(5000):
        speed_rad_s += step_s * (pull_nm - friction.torque(speed_rad_s)) / joint.motor.inertia
        friction.move(speed_rad_s)
        angle_rad += step_s * speed_rad_s
    assert (angle_rad > 100.0 * joint.give_rad) == moves
    if not moves:
        assert abs(speed_rad_s) < 1e-6 * joint.no_load_speed_rad_s


def test_a_record_says_what_its_user_knows_and_what_is_true() -> None:
    record = joint_record(3)
    assert set(record.parameters) == {'motor.torque_constant', 'motor.back_emf_constant'}
    assert record.scenario.name == 'constant'
    assert record.truth['load_torque'] != 0.0
    assert record.truth['quadratic_friction'] == 0.0
    again = joint_record(3)
    assert record.readings.voltage_v.size == again.readings.voltage_v.size
    assert np.array_equal(record.torque_nm, again.torque_nm)


def test_an_arm_rests_behind_its_moves_where_gravity_holds_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing integrates its error: the voltage stays, and holds no other one than R i + V_b."""
    monkeypatch.setattr(joint_records, 'ARM_S', 8.0)
    record = joint_record(11, has_brushes=True, is_arm=True)
    readings = record.readings
    assert not record.scenario.speed
    assert record.scenario.name == 'gravity'
    voltage = readings.voltage_v[:7998].reshape(-1, 31)
    current = readings.current_a[1:7999].reshape(-1, 31)
    rests = np.ptp(voltage, axis=1) < 4e-3 * np.abs(voltage).max()
    assert 0.2 < rests.mean() < 0.8
    level_a = current[rests].mean(axis=1)
    drop_v = record.truth['brush_drop'] * np.sign(level_a)
    rest_v = voltage[rests].mean(axis=1) - record.truth['resistance'] * level_a - drop_v
    assert np.median(np.abs(rest_v)) < 2e-3 * np.abs(voltage).max()
    assert np.unique(level_a.round(1)).size > 4


def test_rows_and_figures_count_joints() -> None:
    known = Trial('fan', 1, verdicts={'resistance': 'identified'}, errors={'resistance': 0.01})
    false = replace(
        known, false_at_end=['resistance'], false_longest_s=2.0, effects=['varying_load']
    )
    trials = [joints.JointTrial('fan', True, known), joints.JointTrial('fan', True, false)]
    assert joints.rows(trials) == [['speed measured, load: fan', *'212001011']]
    values = {figure.name: figure.value for figure in joints.figures(trials)}
    assert values['  R identified and right, in %'] == 50.0
    assert values['  false at the end, in %'] == 50.0


@pytest.mark.slow
@pytest.mark.parametrize(
    'seed',
    [
        pytest.param(0, id='usual'),
        pytest.param(68, id='noise of the speed, L/R shorter than an interval'),
        pytest.param(86, id='noise of the speed, constant load'),
        pytest.param(22, id='breaks at 1.1 times its friction'),
        pytest.param(110, id='breaks at 1.04 times its friction'),
        pytest.param(94, id='fan'),
        pytest.param(99, id='gives by 8 mrad'),
    ],
)
def test_of_a_drawn_joint_nothing_false_is_believed(seed: int) -> None:
    trial = joints.try_joint(seed).trial
    assert trial.failure == ''
    assert trial.false_at_end == []


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)
