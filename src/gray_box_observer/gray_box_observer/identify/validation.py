"""What some bags taught, frozen and judged on another: predictor, white box and a rival.

The rival stands in for persistence, which repeats the torque measured last and so is no free run.
What a free run can repeat is what the training data had at the same voltage (and speed, where it is
measured): a motor without dynamics, ``T = a + b V (+ c w)``, fitted to the training bags by least
squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.context_nodes import ContextUpdate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.errors import BagError
from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.whole_run import fit_percent, white_box_torque
from gray_box_observer.identify import offline_run
from gray_box_observer.observer.observer import Result
from gray_box_observer.samples import ReplayBuffer
from gray_box_observer.samples.spread import spread
from gray_box_observer.white_box.interface import Array

FEWEST = 10
"""Samples of a motor that a judgement needs."""

RIDGE = 1e-12
"""Added to the normal equations, relative to their size: a voltage that never changes must not
break them."""


@dataclass(slots=True, eq=False)
class StaticMap:
    """Torque as an affine function of voltage and speed, by least squares.

    Attributes:
        normal: shape (4, 4): sums of products of 1, voltage, speed and torque.
    """

    normal: Array = field(default_factory=lambda: np.zeros((4, 4)))

    def add(self, voltage_v: float, speed_rad_s: float, torque_nm: float) -> None:
        """Learn one sample."""
        row = np.array(
            [1.0, voltage_v, speed_rad_s if np.isfinite(speed_rad_s) else 0.0, torque_nm]
        )
        self.normal += np.outer(row, row)

    def __call__(self, voltage_v: Array, speed_rad_s: Array) -> Array:
        """Return the torque at voltages and speeds, shape (n,) each."""
        matrix = self.normal[:3, :3]
        scale = np.sqrt(np.maximum(matrix.diagonal(), 1e-300))
        scaled_matrix = matrix / np.outer(scale, scale) + RIDGE * np.eye(3)
        weights = np.linalg.solve(scaled_matrix, self.normal[:3, 3] / scale) / scale
        speed = np.where(np.isfinite(speed_rad_s), speed_rad_s, 0.0)
        torque_nm: Array = weights[0] + weights[1] * voltage_v + weights[2] * speed
        return torque_nm


class Training:
    """Listens to the results of the training bags, and teaches the rival of every motor."""

    def __init__(self) -> None:
        self.maps: dict[str, StaticMap] = {}

    def __call__(self, result: Result) -> None:
        """Take one result."""
        sample = result.sample
        if sample.interval_s[0] > 0.0:
            static_map = self.maps.setdefault(result.motor, StaticMap())
            static_map.add(
                float(sample.voltage_v[0]), float(sample.speed_rad_s[0]), float(sample.torque_nm[0])
            )


@dataclass(frozen=True)
class Score:
    """How well one free run fits.

    Attributes:
        rmse: root mean square error, in N m.
        nmae: mean absolute error over the standard deviation of the measured torque.
        fit_percent: variation explained, in per cent (NRMSE).
    """

    rmse: float | None
    nmae: float | None
    fit_percent: float | None

    @classmethod
    def judge(cls, measured_nm: Array, predicted_nm: Array) -> Score:
        """Judge a run, shape (n,); samples that either has no number for are left out."""
        is_usable = np.isfinite(measured_nm) & np.isfinite(predicted_nm)
        if not is_usable.any():
            return cls(None, None, None)
        error = predicted_nm[is_usable] - measured_nm[is_usable]
        spread_nm = spread(measured_nm[is_usable])
        nmae = None if spread_nm is None else float(np.mean(np.abs(error))) / spread_nm
        return cls(float(np.sqrt(np.mean(error**2))), nmae, fit_percent(measured_nm, predicted_nm))

    def to_dict(self) -> dict[str, float | None]:
        """Return plain values for JSON."""
        return {'rmse': self.rmse, 'nmae': self.nmae, 'fit_percent': self.fit_percent}


@dataclass(frozen=True)
class Validation:
    """Judgement of one motor on data that taught it nothing.

    Attributes:
        bag: what it was judged on.
        samples: how many it rests on.
        predictor: of the predictor; None where there is none.
        white_box: of the white box alone.
        persistence: of the static map that stands for persistence.
        fit: what the residual analysis of the white box's free run says, as plain values.
    """

    bag: str
    samples: int
    predictor: Score | None
    white_box: Score
    persistence: Score
    fit: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; top figures are the predictor's or the white box's."""
        best = self.white_box if self.predictor is None else self.predictor
        return {
            'bag': self.bag,
            'samples': self.samples,
            'predictor': self.predictor is not None,
            **best.to_dict(),
            'fit': dict(self.fit),
            'white_box': {**self.white_box.to_dict(), 'fit': dict(self.fit)},
            'persistence': {**self.persistence.to_dict(), 'fit': None},
        }


class _Record:
    """What came of one motor in the bag that is judged on: one row a sample."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, ...]] = []

    def __call__(self, result: Result) -> None:
        sample = result.sample
        prediction = result.prediction
        predicted_nm = np.nan if prediction is None else float(prediction.torque_nm[0])
        values = (sample.interval_s, sample.voltage_v, sample.torque_nm, sample.speed_rad_s)
        self.rows.append((*(float(value[0]) for value in values), predicted_nm))


def validate(
    bag: Path,
    outcome: offline_run.Outcome,
    training: Training,
    progress: offline_run.Progress = lambda count: None,
    limits: ReadLimits | None = None,
) -> dict[str, Validation]:
    """Judge what was learnt, frozen, on a bag that taught it nothing.

    Args:
        bag: rosbag2 folder or bare MCAP file.
        outcome: of the training bags; its observer stays frozen.
        training: what has listened to them.
        progress: called with the number of messages read since it was last called.
        limits: what of the bag may be held in memory at one time.

    Raises:
        BagError: the bag cannot be read, or lacks the topics or one of the motors.
    """
    observer = outcome.observer
    observer.freeze(True)
    records: dict[str, _Record] = {name: _Record() for name in observer.motors}

    def listen(result: Result) -> None:
        if result.motor in records:  # others were not taught
            records[result.motor](result)

    earlier_rejections = {name: observer.counts(name).rejected for name in records}
    offline_run.feed([bag], observer.configuration, outcome, listen, progress, limits)
    records = {name: record for name, record in records.items() if name not in observer.incidents}
    for name, record in records.items():
        if len(record.rows) < FEWEST:
            new = observer.counts(name).rejected - earlier_rejections[name]
            because = ', '.join(sorted(f'{reason.value}: {count}' for reason, count in new.items()))
            rejection_note = f' (rejected: {because})' if because else ''
            raise BagError(
                f'--validate {bag}: {len(record.rows)} usable samples of motor '
                f'{name}{rejection_note}, '
                f'expected {FEWEST} at '
                'least: it must hold the signals that the training bags hold'
            )
        if name not in training.maps:
            raise BagError(
                f'--validate {bag}: no two training samples of motor {name} follow each other '
                'within gap_s: '
                'are the stamps in another unit?'
            )
    validations = {
        name: observer.contain(
            observer.group_of(name),
            partial(_judge, name, bag, outcome, record.rows, training.maps[name]),
        )
        for name, record in records.items()
    }
    return {name: validation for name, validation in validations.items() if validation is not None}


def _judge(
    name: str,
    bag: Path,
    outcome: offline_run.Outcome,
    rows: Sequence[Sequence[float]],
    rival: StaticMap,
) -> Validation:
    """Judge one motor."""
    motor = outcome.observer.motors[name]
    interval_s, voltage_v, torque_nm, speed_rad_s, predicted_nm = np.array(rows).T
    white_box_nm = white_box_torque(
        motor.white_box, motor.theta[0], interval_s, voltage_v, torque_nm, speed_rad_s
    )
    follows = interval_s > 0.0
    measured_nm = np.where(
        follows, torque_nm, np.nan
    )  # where a history begins the run is set to the measurement
    has_predictor = outcome.observer.skill(name) is not None
    return Validation(
        bag=str(bag),
        samples=int(np.count_nonzero(follows)),
        predictor=Score.judge(measured_nm, predicted_nm) if has_predictor else None,
        white_box=Score.judge(measured_nm, white_box_nm),
        persistence=Score.judge(measured_nm, rival(voltage_v, speed_rad_s)),
        fit=_fit(outcome, name, rows).to_dict(),
    )


@dataclass(frozen=True)
class _Heard:
    """Samples that were heard and not learnt, as a fit test asks for them."""

    replay: ReplayBuffer

    def is_drifting(self, motor: int) -> bool:
        """Tell whether what heats drifts: what was frozen does not."""
        return False

    def present_since(self, motor: int) -> int:
        """Return from where the motor is the present one: all of these samples are of one."""
        return 0


def _fit(outcome: offline_run.Outcome, name: str, rows: Sequence[Sequence[float]]) -> FitAssessment:
    """Test whether the white box, as it was frozen, explains the data that it is judged on."""
    motor = outcome.observer.motors[name]
    content = np.nan_to_num(np.array(rows).T[:4, None, :])
    replay = ReplayBuffer(1, content.shape[2])
    replay.refill(content)
    quantity = outcome.observer.configuration['torque.quantity']
    monitor = FitMonitor([motor.configuration], [motor.white_box], quantity)
    delay = DelayEstimate(motor.delay.applied_s, motor.delay.is_estimated)  # not that of training
    monitor.test(cast(ContextUpdate, _Heard(replay)), motor.estimate, 0, delay)
    return monitor.assessment(0)
