"""Robots whose motors come in one message, and what the observer makes of each motor."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.rotor.records import Record, draw
from common.rotor.runs import FALSE_SHARE, FALSE_STDS
from common.trust.motors import gear_motor
from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

JUDGED = ('inductance', 'resistance')
"""Parameters whose claims are judged: those that a robot's controller is tuned for."""


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
    speed = _readings(records, case, seed)
    truth = {
        name: np.array([getattr(record.motor, node) for node in JUDGED])
        for name, record in zip(names, records, strict=True)
    }
    claims = np.zeros(2, dtype=int)
    begun = time.process_time()
    for place in range(torque.shape[1]):
        stamp_ns = round(place / case.rate_hz * 1e9)
        results = observer.ingest('voltage', names, stamp_ns, voltage[:, place])
        speeds = None if speed is None else speed[:, place]
        results += observer.ingest('torque', names, stamp_ns, torque[:, place], speeds)
        for result in (one for group in results for one in group):
            if result.estimate is not None:
                claims += _claims(result.estimate, truth[result.motor])
    cpu_s = time.process_time() - begun
    observer.finish()
    ends = {name: observer.estimates()[name] for name in names}
    near = [abs(_error(ends[name], truth[name], 1)) <= FALSE_SHARE for name in names]
    known = [_claims(ends[name], truth[name], JUDGED[1:]).tolist() == [1, 0] for name in names]
    misfits = sum(observer.fit(name).verdict is FitVerdict.MISFIT for name in names)
    sample_us = 1e6 * cpu_s / torque.size
    return RobotTrial(sum(known), sum(near), misfits, int(claims[0]), int(claims[1]), sample_us)


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


def _readings(records: Sequence[Record], case: RobotCase, seed: int) -> FloatArray | None:
    """Return measured speeds, shape (motor, sample); None where there are none."""
    if case.speed_noise is None:
        return None
    rng = np.random.default_rng([23, seed])
    speed = np.array([record.speed_rad_s for record in records])
    std = case.speed_noise * speed.std(axis=1, keepdims=True)
    result: FloatArray = speed + std * rng.normal(size=speed.shape)
    return result


def _place(estimate: Estimate, node: str) -> int:
    return [parameter.name for parameter in estimate.parameters].index(node)


def _error(estimate: Estimate, truth: FloatArray, place: int) -> float:
    value = estimate.value[0, _place(estimate, JUDGED[place])]
    return float(value / truth[place] - 1.0)


def _claims(
    estimate: Estimate, truth: FloatArray, nodes: Sequence[str] = JUDGED
) -> np.ndarray[tuple[int], np.dtype[np.int_]]:
    """Return how many parameters are identified, and how many of them are false."""
    counts = np.zeros(2, dtype=int)
    for node in nodes:
        place = _place(estimate, node)
        if estimate.verdicts[0][place] is not Verdict.IDENTIFIED:
            continue
        own_truth = truth[JUDGED.index(node)]
        off = abs(estimate.value[0, place] - own_truth)
        is_false = off > max(FALSE_STDS * estimate.std[0, place], FALSE_SHARE * own_truth)
        counts += np.array([1, int(is_false)])
    return counts
