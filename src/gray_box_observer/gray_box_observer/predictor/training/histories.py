"""The samples of a job as signal histories: stretches through which the physics can run freely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.predictor.training.synthetic_sequences import Sequences
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

SHORTEST = 24
"""Samples of the newest history, at least, by which networks are compared."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Consecutive samples of a group of motors, all but the first, which is where they start.

    Attributes:
        sequences: what was held over the intervals, and the current at the start.
        current_a: shape (motor, time): measured at the ends of the intervals.
        number: shape (time,): which sample each is, counted since the beginning.
        is_cut: whether it goes on from samples that are not here, so that nobody knows what a
            memory would hold.
    """

    sequences: Sequences
    current_a: Array
    number: NDArray[np.int64]
    is_cut: bool = False


def histories(white_box: MotorWhiteBox, job: Mapping[str, Any]) -> list[History]:
    """Cut the samples of a job where any motor's history began, and where samples are left out."""
    edges = [*_beginnings(job).tolist(), job['number'].size]
    return [_history(white_box, job, first, end) for first, end in pairwise(edges)]


def newest_history(white_box: MotorWhiteBox, job: Mapping[str, Any]) -> History | None:
    """Return the last of :func:`histories`; None where there is hardly any since it began."""
    first = int(_beginnings(job)[-1])
    end = job['number'].size
    return _history(white_box, job, first, end) if end - first >= SHORTEST else None


def _beginnings(job: Mapping[str, Any]) -> NDArray[np.int64]:
    """Where histories begin, the first sample among them."""
    begins: NDArray[np.bool_] = np.any(~(job['interval_s'] > 0.0), axis=0)
    begins |= np.diff(job['number'], prepend=-2) != 1
    return np.flatnonzero(begins)


def _history(white_box: MotorWhiteBox, job: Mapping[str, Any], first: int, end: int) -> History:
    """Samples from one to before another."""
    current = white_box.state(job['torque_nm'][:, first:end])
    speed = job['speed_rad_s'][:, first : end - 1]  # what was known when the interval began
    voltage_v, interval_s = (job[name][:, first + 1 : end] for name in ('voltage_v', 'interval_s'))
    sequences = Sequences(white_box, job['theta'], voltage_v, interval_s, speed, current[:, 0])
    is_cut = bool(np.all(job['interval_s'][:, first] > 0.0))
    return History(sequences, current[:, 1:], job['number'][first + 1 : end], is_cut)
