"""Whether a driver seems to open the winding at a command of 0, and lets the motor coast.

One that shorts the winding brakes: the back-EMF drives a current against the rotation, as large as
that of a start. Where the winding is open no current flows, and nobody knows its voltage.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.fit_test.suspects import root_mean_square
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
from gray_box_observer.white_box.interface import Array, WhiteBox

FIRST, LAST = 2, 5
"""Intervals after a command has become 0 at whose ends no current may flow: it has died by then,
and the rotor turns yet. Before that it may not flow against the command: a shorted winding lets it,
also where the rotor then stops within an interval or two."""

FEWEST = 2
"""Such commands from which that tells something."""

DRIVEN = 0.3
"""Voltage before, over the root mean square of those that drive: a controller that has braked has
left little speed."""

QUIET = 0.1
"""Current at these ends, over that of a motor that is driven: root mean squares."""


def seems_to_coast(white_box: WhiteBox, samples: Array, fewest: int = FEWEST) -> bool:
    """Tell whether no current flows where a command of 0 finds the motor turning.

    Args:
        white_box: of one motor.
        samples: shape (signal, n): the newest of it.
        fewest: such commands from which that tells something.
    """
    voltage_v = samples[VOLTAGE]
    current_a = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
    places = np.arange(voltage_v.size)
    is_driven = voltage_v != 0.0
    if not is_driven.any():
        return False
    last_driven = np.maximum.accumulate(np.where(is_driven, places, -1))
    last_begun = np.maximum.accumulate(np.where(samples[INTERVAL] > 0.0, -1, places))
    least_v = DRIVEN * root_mean_square(voltage_v[is_driven])
    was_fast = (last_driven > last_begun) & (np.abs(voltage_v[last_driven]) > least_v)
    since = np.where(was_fast, places - last_driven, 0)
    is_early = (since >= FIRST) & (since <= LAST)
    if np.count_nonzero(since == FIRST) < fewest:
        return False
    braking_a = np.minimum(current_a * np.sign(voltage_v[last_driven]), 0.0)
    most_a = QUIET * root_mean_square(current_a[is_driven])
    is_first = (since > 0) & (since < FIRST)
    return root_mean_square(current_a[is_early]) < most_a and (
        root_mean_square(braking_a[is_first]) < most_a
    )
