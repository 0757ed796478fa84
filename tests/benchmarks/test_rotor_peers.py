"""Rivals of the rotor's rule and of its prediction: they are given a fair chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('filterpy', reason='needs the peers of requirements/bench.txt')

from common.rotor.batch import Signals, arx_fit, arx_run, batch_fit, free_run_at_rest
from common.rotor.joint_filters import (
    START_FACTOR,
    JointExtended,
    JointSettings,
    JointUnscented,
    joint_start,
    run_joint,
)
from common.rotor.records import NODES, Record, draw
from common.rotor.robot_prediction import RobotLog, robot_logs
from common.rotor.speed_records import SpeedSensor, draw_with_speed
from common.trust.motors import gear_motor

from gray_box_observer.white_box import MotorWhiteBox


@pytest.fixture(scope='module')
def record() -> Record:
    return draw(gear_motor, 1001, 1000.0, 1.0)


def white_box(record: Record) -> MotorWhiteBox:
    motor = record.motor
    known = {'back_emf_constant': motor.back_emf_constant}
    return MotorWhiteBox(NODES, motor.torque_constant, known)


def signals(record: Record) -> Signals:
    count = record.voltage_v.size
    return Signals(np.full(count, record.interval_s), record.voltage_v, record.measured_a)


def test_the_batch_fit_finds_the_motor(record: Record) -> None:
    theta = batch_fit(white_box(record), [signals(record)], [joint_start(record)])
    assert (np.abs(theta / record.truth - 1.0) < 5.0 * record.bound() + 1e-3).all()
    run = free_run_at_rest(white_box(record), theta, signals(record))
    assert np.abs(run - record.current_a).mean() < 0.02 * record.current_a.std()


def test_a_linear_motor_is_an_arx_model() -> None:
    rng = np.random.default_rng(1)
    voltage = np.repeat(rng.uniform(-5.0, 5.0, 30), 10)
    current = np.zeros(301)
    for k in range(2, 301):
        current[k] = 1.2 * current[k - 1] - 0.4 * current[k - 2]
        current[k] += 0.3 * voltage[k - 1] - 0.1 * voltage[k - 2]
    part = Signals(np.full(300, 1e-3), voltage, current)
    weights = arx_fit([part], 2)
    np.testing.assert_allclose(weights, [1.2, -0.4, 0.3, -0.1], atol=1e-9)
    np.testing.assert_allclose(arx_run(weights, part), current, atol=1e-9)


@pytest.mark.parametrize('kind', [JointExtended, JointUnscented])
def test_a_joint_filter_comes_nearer_than_it_began(kind, record: Record) -> None:
    run = run_joint(kind, record, JointSettings(process_std=3e-2))
    assert run.sample_us > 0.0
    assert (np.abs(run.error[:3]) < 0.5 * (START_FACTOR - 1.0)).all()


def test_the_transition_of_the_extended_filter_is_the_derivative_of_its_motion(
    record: Record,
) -> None:
    problem = JointExtended(record, JointSettings()).problem
    p = problem.values(problem.start.tolist())
    state = np.array([0.5, 0.3 * 12.0 / problem.kb])
    volt = 6.0
    size = np.array([1e-4, 1e-2])
    _, _, at_i, at_w = problem.moved(*state, p, volt)
    told = problem.transition(at_i, at_w, p, volt)
    for column in range(2):
        step = np.zeros(2)
        step[column] = size[column]
        ends = [problem.moved(*(state + sign * step), p, volt)[:2] for sign in (1.0, -1.0)]
        slope = np.subtract(*ends) / (2.0 * size[column])
        np.testing.assert_allclose(told[:, column], slope, rtol=0.02, atol=1e-6)
    slopes = np.empty((2, len(NODES)))
    for column in range(len(NODES)):
        moved = []
        for sign in (1.0, -1.0):
            logarithms = problem.start.copy()
            logarithms[column] += sign * 1e-4
            moved.append(problem.moved(*state, problem.values(logarithms.tolist()), volt)[:2])
        slopes[:, column] = np.subtract(*moved) / 2e-4
    largest = np.abs(slopes).max(axis=1, keepdims=True)
    assert (np.abs(told[:, 2:] - slopes) < 0.2 * largest).all()


def test_a_record_may_ask_for_the_rotor_too() -> None:
    sensor = SpeedSensor('fine', noise=0.005)
    asked = draw_with_speed(sensor, 1, 1000.0, 0.5, NODES)
    assert asked.parameters['context_nodes'] == list(NODES)
    assert asked.bound().size == asked.truth.size == len(NODES)
    plain = draw_with_speed(sensor, 1, 1000.0, 0.5)
    np.testing.assert_allclose(plain.bound(), asked.bound()[:2])


def test_a_robots_log_is_read_without_its_dead_sensor(tmp_path: Path) -> None:
    rows = [f'{0.001 * k:.3f} 2 0 0 {k}.0 {2 * k}.0 0.1 0.2 0 0\n' for k in range(4)]
    for robot in ('18', '19'):
        (tmp_path / f'vel_step_{robot}.txt').write_text('% a log\n' + ''.join(rows))
    logs = robot_logs(tmp_path)
    assert [(log.robot, log.side) for log in logs] == [
        ('18', 'left'), ('19', 'left'), ('19', 'right'),
    ]  # fmt: skip
    right: RobotLog = logs[-1]
    np.testing.assert_allclose(right.signals.voltage_v, [0.0, 2.0, 4.0])
    np.testing.assert_allclose(right.current_a, 0.2)
