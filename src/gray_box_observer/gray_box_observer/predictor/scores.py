"""Skill of the prediction: errors made before the truth came, against rivals without cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gray_box_observer.samples.spread import spread
from gray_box_observer.white_box.interface import Array

RIVALS = ('predictor', 'persistence', 'white_box')


@dataclass(frozen=True, slots=True)
class Skill:
    """Scores of one motor.

    Attributes:
        samples: predictions scored.
        nmae: mean absolute error as a fraction of the standard deviation of the remembered torque.
        skill_vs_persistence: ``1 - MAE / MAE of "torque stays what it was"``; above 0 is better.
        skill_vs_white_box: the same against the white box's own rollout with the present
            parameters, which sees voltages only, like the predictor. With perfect physics that
            rollout is the limit.
    """

    samples: int
    nmae: float | None
    skill_vs_persistence: float | None
    skill_vs_white_box: float | None

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values for JSON and diagnostics."""
        return {name: getattr(self, name) for name in self.__slots__}


class Scores:
    """Sums over the newest predictions of a group of motors.

    Args:
        motors: number of motors.
        window: predictions remembered; older ones are forgotten.
    """

    def __init__(self, motors: int, window: int = 6000) -> None:
        # time first, for rows are written; and what is not written yet takes no memory
        self._predictions = {rival: np.zeros((window, motors)) for rival in RIVALS}
        self._torque = np.zeros((window, motors))
        self._window = window
        self._count = 0

    def add(self, torque_nm: Array, predictions: Mapping[str, Array]) -> None:
        """Score one sample: measured torque and each rival's, (motor,); NaN is not scored."""
        row = self._count % self._window
        for rival, values in self._predictions.items():
            values[row] = predictions[rival]
        self._torque[row] = torque_nm
        self._count += 1

    def skill(self, motor: int) -> Skill:
        """Return the scores of one motor over the samples that every rival predicted."""
        rows = slice(min(self._count, self._window))
        torque_nm = self._torque[rows, motor].copy()
        errors = {
            rival: np.abs(values[rows, motor] - torque_nm)
            for rival, values in self._predictions.items()
        }
        is_scored = np.logical_and.reduce([np.isfinite(error) for error in errors.values()])
        count = int(is_scored.sum())
        if count < 2:
            return Skill(count, None, None, None)
        mae = {rival: float(np.mean(error[is_scored])) for rival, error in errors.items()}
        spread_nm = spread(torque_nm[np.isfinite(torque_nm)])
        return Skill(
            count,
            None if spread_nm is None else mae['predictor'] / spread_nm,
            1.0 - mae['predictor'] / mae['persistence'] if mae['persistence'] > 0.0 else None,
            1.0 - mae['predictor'] / mae['white_box'] if mae['white_box'] > 0.0 else None,
        )
