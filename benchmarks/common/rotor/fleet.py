"""Many rotors in the same messages: what they cost, and what is known of them at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.rotor.records import Record
from common.rotor.runs import FALSE_SHARE, FALSE_STDS, NEAR
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

PARTS = 10
"""Parts of a record whose processor time is taken by itself."""


@dataclass(frozen=True)
class Fleet:
    """What became of motors that were observed together.

    Attributes:
        cores: shape (part,): processor time over that of the record, in the order of time.
        near: share of the motors whose R is within NEAR of the truth at the end.
        identified: share of the motors whose R is identified at the end.
        claims, false: identified values of L and R at the end, and those of them that are false.
        worst_s: longest processor time of a sample, but for the first one.
    """

    cores: tuple[float, ...]
    near: float
    identified: float
    claims: int
    false: int
    worst_s: float


def run_fleet(records: Sequence[Record], motors: int) -> Fleet:
    """Observe motors in the same messages, their records over and over, without predictor."""
    fleet = [records[place % len(records)] for place in range(motors)]
    names = tuple(f'm{place}' for place in range(motors))
    parameters: dict[str, object] = {'motors': [*names], 'predictor': False}
    for name, record in zip(names, fleet, strict=True):
        parameters |= {f'{name}.{key}': value for key, value in record.parameters.items()}
    observer = Observer(Configuration.from_flat(parameters), None)
    voltage_v = np.array([[*record.voltage_v, 0.0] for record in fleet]).T.copy()
    torque_nm = np.array([r.measured_a * r.motor.torque_constant for r in fleet]).T.copy()
    interval_s = fleet[0].interval_s
    stamps = np.round(np.arange(len(torque_nm)) * interval_s * 1e9).astype(int).tolist()
    length = len(stamps) // PARTS
    cores = []
    worst_s = 0.0
    begun_s = time.process_time()
    for k, stamp_ns in enumerate(stamps):
        before_s = time.process_time()
        observer.ingest('voltage', names, stamp_ns, voltage_v[k])
        observer.ingest('torque', names, stamp_ns, torque_nm[k])
        worst_s = max(worst_s, time.process_time() - before_s) if k else 0.0
        if (k + 1) % length == 0:
            now_s = time.process_time()
            cores.append((now_s - begun_s) / (length * interval_s))
            progress = f'{motors} motors, {stamp_ns * 1e-9:.0f} s: {cores[-1]:.2f} cores'
            print(progress, file=sys.stderr)
            begun_s = time.process_time()
    return _judged(observer, names, fleet, tuple(cores), worst_s)


def _judged(
    observer: Observer,
    names: Sequence[str],
    fleet: Sequence[Record],
    cores: tuple[float, ...],
    worst_s: float,
) -> Fleet:
    """Compare what is known at the end with the truth."""
    estimates = observer.estimates()
    near = identified = claims = false = 0
    for name, record in zip(names, fleet, strict=True):
        estimate = estimates[name]
        off = np.abs(estimate.value[0, :2] - record.truth[:2])
        is_identified = np.array([v is Verdict.IDENTIFIED for v in estimate.verdicts[0][:2]])
        is_wrong = (off > FALSE_STDS * estimate.std[0, :2]) & (off > FALSE_SHARE * record.truth[:2])
        near += bool(off[1] <= NEAR * record.truth[1])
        identified += bool(is_identified[1])
        claims += int(is_identified.sum())
        false += int((is_identified & is_wrong).sum())
    count = len(names)
    return Fleet(cores, near / count, identified / count, claims, false, worst_s)
