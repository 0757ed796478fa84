"""The observer over one record, and what it has claimed on the way."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from common.motion import FloatArray
from common.rotor.records import NODES, Record
from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

MOTOR = 'motor'
FALSE_STDS, FALSE_SHARE = 3.0, 0.02
"""An estimate is false that is called identified and off by more than both of these."""

NEAR = 0.02


@dataclass(frozen=True, slots=True)
class Trial:
    """What became of one record.

    Attributes:
        error: shape (parameter,): relative error at the end.
        z: shape (parameter,): error in standard deviations at the end.
        nees: squared error in the covariance at the end, over the number of parameters.
        bound: shape (parameter,): relative.
        identified: shape (parameter,): verdicts at the end.
        claims, false: identified parameters over all estimates, and those of them that were false.
        near_s: seconds from which R stayed within NEAR; infinite where it never did.
        sample_us: processor time a sample.
        fit: verdict of the residual analysis at the end.
    """

    error: FloatArray
    z: FloatArray
    nees: float
    bound: FloatArray
    identified: FloatArray
    claims: int
    false: int
    near_s: float
    sample_us: float
    fit: str


def run_trial(record: Record) -> Trial:
    """Run the observer without predictor over a record."""
    motor = record.motor
    parameters = {f'{MOTOR}.{name}': value for name, value in record.parameters.items()}
    observer = Observer(Configuration.from_flat(parameters), None)
    stamps = np.round(np.arange(record.measured_a.size) * record.interval_s * 1e9).astype(int)
    torque = record.measured_a * motor.torque_constant
    estimates: list[tuple[float, Estimate]] = []
    begun = time.process_time()
    volts = [*record.voltage_v.tolist(), 0.0]
    for stamp, volt, reading, speed in zip(
        stamps.tolist(), volts, torque.tolist(), record.readings_rad_s, strict=True
    ):
        observer.voltage(MOTOR, stamp, volt)
        results = observer.torque(MOTOR, stamp, reading, speed)
        estimates += [(stamp * 1e-9, one.estimate) for one in results if one.estimate is not None]
    cpu_s = time.process_time() - begun
    last = observer.estimates()[MOTOR]
    places = _places(last, record)
    off = last.value[0, places] - record.truth
    covariance = last.covariance[0][np.ix_(places, places)]
    resistances = [estimate.value[0, NODES.index('resistance')] for _, estimate in estimates]
    near = np.abs(np.array(resistances) / motor.resistance - 1.0) <= NEAR
    away = np.flatnonzero(~near)
    first = 0 if away.size == 0 else int(away[-1]) + 1
    near_s = estimates[first][0] if first < len(estimates) else np.inf
    counts = np.array([_claims(estimate, record) for _, estimate in estimates])
    claims, false = counts.reshape(-1, 2).sum(axis=0).tolist()
    with np.errstate(divide='ignore', invalid='ignore'):
        error = off / record.truth
    return Trial(
        error,
        off / np.sqrt(np.diagonal(covariance)),
        float(off @ np.linalg.solve(covariance, off)) / off.size,
        record.bound(),
        np.array([last.verdicts[0][place] is Verdict.IDENTIFIED for place in places], dtype=float),
        claims,
        false,
        near_s,
        1e6 * cpu_s / stamps.size,
        observer.fit(MOTOR).verdict.value,
    )


def _places(estimate: Estimate, record: Record) -> list[int]:
    """Return where the parameters of a record stand: an effect may have been added to them."""
    names = [parameter.name for parameter in estimate.parameters]
    return [names.index(node) for node in NODES[: record.truth.size]]


def _claims(estimate: Estimate, record: Record) -> tuple[int, int]:
    """Count what an estimate calls identified, and what of that is false, as all it has added."""
    identified = np.array([v is Verdict.IDENTIFIED for v in estimate.verdicts[0]])
    places = _places(estimate, record)
    off = np.abs(estimate.value[0, places] - record.truth)
    wrong = np.ones(identified.size, dtype=bool)
    wrong[places] = (off > FALSE_STDS * estimate.std[0, places]) & (
        off > FALSE_SHARE * record.truth
    )
    return int(identified.sum()), int((identified & wrong).sum())
