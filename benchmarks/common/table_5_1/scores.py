"""The two scores of a prediction, and the predictions that cost nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.table_5_1.recordings import Series
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import flow, to_coordinates
from gray_box_observer.white_box.interface import Array

WARM_UP = 65
"""Leading samples that nobody is scored on: one that starts the signal history, and 64 voltages of
context."""


@dataclass(frozen=True, slots=True)
class Score:
    """How wrong a prediction is, set by set.

    Attributes:
        difference_nm: shape (set,): mean of ``|D(T predicted) - D(T)|``, D the first difference
            (thesis 4.24, 5.1.1).
        error_percent: shape (set,): mean absolute error of the torque in % of the set's torque
            standard deviation.
    """

    difference_nm: Array
    error_percent: Array


def score(series: Series, predicted_nm: Array) -> Score:
    """Score a prediction, shape (set, sample); one that is not finite scores infinity."""
    torque = series.torque_nm[:, WARM_UP:]
    predicted = predicted_nm[:, WARM_UP:]
    with np.errstate(invalid='ignore'):
        difference = np.abs(np.diff(predicted, axis=1) - np.diff(torque, axis=1)).mean(axis=1)
        error = np.abs(predicted - torque).mean(axis=1) / torque.std(axis=1)
    return Score(np.nan_to_num(difference, nan=np.inf), 100.0 * np.nan_to_num(error, nan=np.inf))


def persistence(series: Series) -> Array:
    """Torque stays what it was a sample ago, shape (set, sample); needs measured torque."""
    return np.concatenate([series.torque_nm[:, :1], series.torque_nm[:, :-1]], axis=1)


def constant(torque_nm: float, series: Series) -> Array:
    """One torque for ever, shape (set, sample): what a network says that has saturated."""
    return np.full_like(series.torque_nm, torque_nm)


def rollout(white_box: MotorWhiteBox, theta: Array, series: Series) -> Array:
    """Torque that the white box makes of the voltages alone; shape (set, sample).

    Args:
        white_box: the physics.
        theta: shape (parameter,).
        series: what is predicted; of its torque only the first sample is used.
    """
    count = len(series.names)
    p = to_coordinates(np.tile(theta, (count, 1)))
    interval = np.full((count, 1), series.interval_s)
    no_speed = np.zeros((count, 1))
    states = [white_box.state(series.torque_nm[:, :1])]
    torque = np.empty_like(series.torque_nm)
    torque[:, 0] = series.torque_nm[:, 0]
    for k in range(1, torque.shape[1]):
        voltage = series.voltage_v[:, k : k + 1]
        states = list(flow(white_box, p, states, voltage, no_speed, no_speed, interval).value)
        torque[:, k] = white_box.output(states[State.CURRENT])[:, 0]
    return torque
