"""Where no form explains the data, the rotor that is nearest stands in, and nothing is believed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import (
    CONSTANTS,
    GEAR_MOTOR,
    LIVELY,
    feed,
    observed,
    recorded,
    recording_of,
    told,
)

from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 4000
LARGEST_LOAD_NM = 6e-3
SHORTEST_LOAD, LONGEST_LOAD = 100, 300


@cache
def jerked() -> Recording:
    """A gear motor whose load jumps now and then: none of the forms has that."""
    rng = np.random.default_rng(1)
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'R[-12,12]D[0.05,0.3]', seed=1, sample_rate_hz=1000.0,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    samples = []
    next_load = 0
    for k in range(SAMPLES):
        if k >= next_load:
            load_nm = float(rng.uniform(-LARGEST_LOAD_NM, LARGEST_LOAD_NM))
            simulation.set_parameters({'motor': replace(GEAR_MOTOR, load_torque=load_nm)})
            next_load = k + int(rng.uniform(SHORTEST_LOAD, LONGEST_LOAD))
        samples.append(simulation.step())
    return recording_of(samples)


@pytest.mark.slow
def test_the_nearest_rotor_stands_in_and_nothing_is_identified() -> None:
    motor = observed(jerked()).motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert 'does not explain the data' in motor.speed_reason
    verdicts = motor.estimate.verdicts[0]
    assert Verdict.IDENTIFIED not in verdicts and Verdict.NEGLIGIBLE not in verdicts
    resistance, _, _ = told(motor, 'resistance')
    assert resistance == pytest.approx(GEAR_MOTOR.resistance, rel=0.05)


@pytest.mark.slow
def test_it_is_believed_once_its_load_is_constant() -> None:
    observer = Observer(Configuration.from_flat(CONSTANTS))
    begin_ns = feed(observer, [jerked()])
    feed(observer, [recorded(GEAR_MOTOR, LIVELY, 10.0, 4)], begin_ns)
    motor = observer.motors['motor']
    resistance, std, verdict = told(motor, 'resistance')
    assert motor.fit.verdict is FitVerdict.OK
    assert verdict is Verdict.IDENTIFIED
    assert abs(resistance - GEAR_MOTOR.resistance) < max(4.0 * std, 0.005)


def test_a_motor_that_kt_i_nearly_explains_keeps_it() -> None:
    heavy = replace(GEAR_MOTOR, inertia=1.0)  # it never turns
    record = recorded(heavy, LIVELY, 2.0, 1)
    torque = record.torque_nm + 2e-3 * np.sin(0.05 * np.arange(record.torque_nm.size))
    motor = observed(replace(record, torque_nm=torque)).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.white_box.speed_source == 'torque_constant'
