"""Training through the observer itself: one recording fed over and over, then frozen."""

from __future__ import annotations

from typing import Any

import numpy as np

from common.table_5_1.recordings import Series
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array

MOTOR = 'motor'
PAUSE_NS = 3_600_000_000_000
"""Between two passes: far more than the gap after which the observer starts its signal history
anew."""


class NoTraining:
    """A trainer that never trains: predictions go on with the network that was restored."""

    busy = is_resting = False
    failure: str | None = None

    def submit(self, job: dict[str, Any]) -> None:
        """Ignore the job."""

    def collect(self) -> dict[str, Any] | None:
        """There is nothing."""
        return None

    def close(self) -> None:
        """There is nothing to stop."""


def train(
    configuration: Configuration, series: Series, passes: int, *, network: bool = True
) -> Observer:
    """Feed one recording to a fresh observer, pass after pass; its predictor trains in between.

    Args:
        configuration: of the observer.
        series: the recording, of one set.
        passes: how often it is played.
        network: whether the network learns too; the context nodes always do.
    """
    observer = Observer(configuration, InlineTraining if network else _no_training)
    for k in range(passes):
        _feed(observer, series, 0, k * (int(series.stamp_ns[-1]) + PAUSE_NS))
    return observer


def predict(trained: Observer, tests: Series) -> Array:
    """Torque that the trained, frozen observer forecasts on every set; shape (set, sample), N m."""
    learnt = {MOTOR: trained.motors[MOTOR].state()}
    predicted = np.full(tests.torque_nm.shape, np.nan)
    for j in range(len(tests.names)):
        frozen = Observer(trained.configuration, _no_training)
        frozen.restore(learnt)
        frozen.freeze(True)
        for result in _feed(frozen, tests, j, 0):
            if result.prediction is not None:
                k = int(np.searchsorted(tests.stamp_ns, result.sample.stamp_ns))
                predicted[j, k] = result.prediction.torque_nm[0]
        frozen.close()
    return predicted


def theta(observer: Observer) -> Array:
    """Identified parameters, shape (parameter,)."""
    values: Array = observer.motors[MOTOR].theta[0]
    return values


def _no_training(_job: dict[str, Any]) -> NoTraining:
    return NoTraining()


def _feed(observer: Observer, series: Series, which: int, offset_ns: int) -> list[Result]:
    """Play one set: each stamp with the voltage held from there on, and the torque there."""
    held = np.append(series.voltage_v[which, 1:], series.voltage_v[which, -1])
    results = []
    for stamp, voltage, torque in zip(series.stamp_ns, held, series.torque_nm[which], strict=True):
        results += observer.voltage(MOTOR, int(stamp) + offset_ns, float(voltage))
        results += observer.torque(MOTOR, int(stamp) + offset_ns, float(torque))
    return results
