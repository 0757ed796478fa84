"""Robots whose motors come in one message, and what the observer makes of each motor."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.claims import claims, is_known, is_near, noisy_readings
from common.rotor.records import Record, draw
from common.trust.motors import gear_motor
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration


@dataclass(frozen=True, slots=True)
class RobotCase:
    """How the motors of a robot are measured and computed.

    Attributes:
        motors: how many come in one message.
        rate_hz: of the samples.
        duration_s: of the record.
        speed_noise: of the measured speed, as a share of its spread; None: it is not measured.
        group_from: parameter of the observer; None: its default.
    """

    motors: int
    rate_hz: float
    duration_s: float
    speed_noise: float | None
    group_from: int | None


@dataclass(frozen=True, slots=True)
class RobotTrial:
    """What came of one robot.

    Attributes:
        known: motors whose R is identified and right at the end.
        near: motors whose R is right, whatever its verdict.
        misfits: motors that the white box does not explain, at the end.
        claims, false: identified L and R over all estimates, and those of them that were false.
        sample_us: processor time of a motor's sample.
    """

    known: int
    near: int
    misfits: int
    claims: int
    false: int
    sample_us: float


def run_robot(case: RobotCase, seed: int) -> RobotTrial:
    """Draw a robot, record it, and run the observer without predictor over the record.

    Args:
        case: how it is measured and computed.
        seed: of the robot; every motor has one of its own.
    """
    first = seed * case.motors
    records = [
        draw(gear_motor, first + place, case.rate_hz, case.duration_s)
        for place in range(case.motors)
    ]
    names = tuple(f'joint{place}' for place in range(case.motors))
    observer = Observer(_configuration(names, records, case), None)
    voltage = np.array([[*record.voltage_v, 0.0] for record in records])
    torque = np.array([one.measured_a * one.motor.torque_constant for one in records])
    rng = np.random.default_rng([23, seed])
    true_speed = np.array([record.speed_rad_s for record in records])
    speed = noisy_readings(true_speed, case.speed_noise, rng)
    motors = {name: record.motor for name, record in zip(names, records, strict=True)}
    counts = np.zeros(2, dtype=int)
    begun = time.process_time()
    for place in range(torque.shape[1]):
        stamp_ns = round(place / case.rate_hz * 1e9)
        results = observer.ingest('voltage', names, stamp_ns, voltage[:, place])
        speeds = None if speed is None else speed[:, place]
        results += observer.ingest('torque', names, stamp_ns, torque[:, place], speeds)
        for result in (one for group in results for one in group):
            if result.estimate is not None:
                counts += claims(result.estimate, motors[result.motor])
    cpu_s = time.process_time() - begun
    observer.finish()
    ends = {name: observer.estimates()[name] for name in names}
    near = [is_near(ends[name], motor) for name, motor in motors.items()]
    known = [is_known(ends[name], motor) for name, motor in motors.items()]
    misfits = sum(observer.fit(name).verdict is FitVerdict.MISFIT for name in names)
    sample_us = 1e6 * cpu_s / torque.size
    return RobotTrial(sum(known), sum(near), misfits, int(counts[0]), int(counts[1]), sample_us)


def _configuration(
    names: Sequence[str], records: Sequence[Record], case: RobotCase
) -> Configuration:
    """Return what the observer is told: Kt, Kb, and that the stamps are exact."""
    parameters: dict[str, object] = {'motors': list(names)}
    if case.group_from is not None:
        parameters['group_from'] = case.group_from
    for name, record in zip(names, records, strict=True):
        own = {key: value for key, value in record.parameters.items() if key != 'speed_source'}
        parameters |= {f'{name}.{key}': value for key, value in own.items()}
    return Configuration.from_flat(parameters)
