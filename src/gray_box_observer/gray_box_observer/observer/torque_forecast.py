"""The torque that is to come of a group of motors, from the voltages that are known or planned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.observer.motor_group import Group
from gray_box_observer.samples.sample import nanoseconds
from gray_box_observer.white_box.interface import Array


@dataclass(frozen=True, slots=True)
class Forecast:
    """Torque expected of one motor at a stamp that is still to come."""

    motor: str
    stamp_ns: int
    torque_nm: float


def torque_at(group: Group, stamp_ns: int) -> Array | None:
    """Predict the torques at a stamp to come, shape (motor,); NaN: unknown. Changes nothing.

    None where the voltage is not known up to the stamp.
    """
    ahead = group.pairing.ahead(stamp_ns)
    if group.observer is None or ahead is None:
        return None
    prediction = group.observer.predict(*(np.atleast_1d(value) for value in ahead))
    return None if prediction is None else prediction.torque_nm


def torque_after_hold(group: Group, horizon_s: float) -> tuple[int, Array] | None:
    """Predict the torques, (motor,), after the newest voltage has been held; with their stamp.

    Args:
        group: the motors.
        horizon_s: how long the voltage is held.

    Returns:
        None where no voltage has come, nothing predicts, or torque has been learnt beyond it.
    """
    observer = group.observer
    pairing = group.pairing
    newest = pairing.newest_voltage
    if observer is None or newest is None:
        return None
    since_ns, voltage_v = newest
    ahead = pairing.ahead(since_ns)
    if ahead is None and since_ns != pairing.newest_sample_ns:
        return None
    torque_nm = observer.forecast_held(ahead, horizon_s, voltage_v)
    return None if torque_nm is None else (since_ns + nanoseconds(horizon_s), torque_nm)


def precompute(group: Group) -> None:
    """Work out the next prediction in advance, where its stamp can be foretold."""
    newest = group.pairing.newest_voltage
    is_foreseeable = newest is not None and newest[0] == group.pairing.newest_sample_ns
    if group.observer is not None and newest is not None and is_foreseeable:
        group.observer.precompute_forecast(newest[1])
