"""The observer's rule beside joint Kalman filters and a batch fit, on the same records."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.rotor.batch import Signals, batch_fit
from common.rotor.joint_filters import (
    JointExtended,
    JointSettings,
    JointUnscented,
    joint_start,
    run_joint,
)
from common.rotor.records import NODES, Record
from gray_box_observer.context_nodes import RotorUpdate
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedFilter
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

OWN = 'context nodes'
BATCH = 'batch output error (scipy)'


@dataclass(frozen=True, slots=True)
class PeerRun:
    """What became of one method over one record.

    Attributes:
        error: shape (parameter,): relative, at the end.
        sample_us: processor time a sample; of a batch fit, of its whole work.
    """

    error: FloatArray
    sample_us: float


def own_run(record: Record) -> PeerRun:
    """Learn a record by the rule of the rotor, and follow its speed."""
    box = _white_box(record)
    nodes = RotorUpdate(box, np.array([[one.initial for one in box.parameters]]))
    follower = SpeedFilter(box)
    torque = record.measured_a * record.motor.torque_constant
    step_ns = round(1e9 * record.interval_s)
    signals = zip(
        [0.0, *record.voltage_v.tolist()], torque.tolist(), record.measured_a.tolist(), strict=True
    )
    samples = [
        (Sample.of_one_motor(k * step_ns, record.interval_s if k else 0.0, volt, reading), current)
        for k, (volt, reading, current) in enumerate(signals)
    ]
    noise_a = 0.0
    theta = nodes.theta[0]
    begun = time.process_time()
    for k, (sample, current) in enumerate(samples):
        if nodes.learn(sample):
            noise_a = nodes.noise_a
            theta = nodes.theta[0]
        follower.step(
            theta, noise_a, record.interval_s if k else 0.0, float(sample.voltage_v[0]), current
        )
    sample_us = 1e6 * (time.process_time() - begun) / len(samples)
    return PeerRun(nodes.theta[0] / record.truth - 1.0, sample_us)


def batch_run(record: Record) -> PeerRun:
    """Fit all samples at once, from where the filters begin."""
    count = record.voltage_v.size
    signals = Signals(np.full(count, record.interval_s), record.voltage_v, record.measured_a)
    begun = time.process_time()
    theta = batch_fit(_white_box(record), [signals], [joint_start(record)])
    sample_us = 1e6 * (time.process_time() - begun) / count
    return PeerRun(theta / record.truth - 1.0, sample_us)


def peer_runs(records: Sequence[Record], settings: JointSettings) -> dict[str, list[PeerRun]]:
    """Run every method over every record; by the method's title."""
    runs: dict[str, list[PeerRun]] = {OWN: [own_run(record) for record in records]}
    for kind in (JointExtended, JointUnscented):
        joint = [run_joint(kind, record, settings) for record in records]
        runs[kind.title] = [PeerRun(one.error, one.sample_us) for one in joint]
    runs[BATCH] = [batch_run(record) for record in records]
    return runs


def _white_box(record: Record) -> MotorWhiteBox:
    motor = record.motor
    known = {'back_emf_constant': motor.back_emf_constant}
    return MotorWhiteBox(NODES, motor.torque_constant, known)
