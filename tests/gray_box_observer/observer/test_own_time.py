"""Voltages and torques whose publishers keep their own time: the voltage moves between samples."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, recording_of

from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

STEPS = 5
"""Steps of the simulation in a sample interval of 1 ms."""

SAMPLES = 3000


@cache
def _recorded(phase: int) -> Recording:
    """Record a gear motor in small steps; its voltage moves so many steps behind a sample."""
    rng = np.random.default_rng(5)
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'external', seed=6, sample_rate_hz=1e3 * STEPS,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    holds = np.concatenate([np.full(n, rng.uniform(-12.0, 12.0)) for n in rng.integers(2, 300, 99)])
    taken = []
    for step in range(SAMPLES * STEPS):
        if step % STEPS == phase:
            simulation.command('motor', float(holds[step // STEPS % holds.size]))
        taken.append(simulation.step())
    return recording_of(taken)


def _observed(phase: int) -> Observer:
    record = _recorded(phase)
    observer = Observer(Configuration.from_flat(CONSTANTS))
    for step, stamp_ns in enumerate(record.stamp_ns.tolist()):
        if step % STEPS == phase:
            observer.voltage('motor', stamp_ns, float(record.voltage_v[0, step]))
        if step % STEPS == 0:
            observer.torque('motor', stamp_ns, float(record.torque_nm[0, step]))
    observer.finish()
    return observer


@pytest.mark.parametrize('phase', [1, 3])
def test_a_motor_whose_voltage_moves_between_samples_is_known_as_well(phase: int) -> None:
    observer = _observed(phase)
    assert observer.fit('motor').verdict is FitVerdict.OK
    estimate = observer.estimates()['motor']
    other = _observed(0).estimates()['motor']
    names = [parameter.name for parameter in estimate.parameters]
    for name, most in (('resistance', 1.5), ('inductance', 3.0)):
        place = names.index(name)
        value = float(estimate.value[0, place])
        std = float(estimate.std[0, place])
        assert estimate.verdicts[0][place] is Verdict.IDENTIFIED
        assert abs(value - getattr(GEAR_MOTOR, name)) < 3.0 * std
        assert std < most * float(other.std[0, place])
