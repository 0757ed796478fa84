"""Where a fit begins of a motor whose rotor friction holds first, under a voltage that rises.

As long as the rotor is held, voltage and current are in proportion: their ratio is the resistance.
The current at which that ends is what breaks the rotor away, and tells its dry friction. The
weak-form start (:mod:`~gray_box_observer.context_nodes.rotor.weak_start`) hardly sees either: under
a voltage that has not turned, R, L, 1/J and the first speed explain each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

FEWEST = 16
"""Samples of a hold that tells a resistance."""

LONGER = 1.25
"""Factor from the length of one hold that is tried to that of the next."""

UNSETTLED = 4
"""Of a hold the first part by this number, in which the current comes to follow the voltage."""

NO_CURRENT = 4.0
"""Standard deviations of the readings' noise up to which a history begins without a current."""

RISES = 0.25
"""Share of its newest voltage from which a hold begins at most."""

LINEAR = 1.25
"""Noise about a line, over that of the readings, up to which the current follows the voltage."""

OFFSET = 0.1
"""Share of the newest current by which the line may pass above the origin: a rotor that begins to
turn bends it."""

LEAST_NOISE = 1e-3
"""Smallest noise that is believed, as a share of the current's spread."""

SHARP = 0.1
"""Relative standard deviation of a resistance that is worth a start."""

DRY_FRICTION = 'coulomb_friction'


def breakaway_starts(
    white_box: MotorWhiteBox, window: Window, starts: Sequence[Array]
) -> Iterator[Array]:
    """Yield starts whose resistance and dry friction are those of a rotor that is held first.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
        starts: shape (parameter,) each: what they tell of L/R and of R J is kept.
    """
    hold = _first_hold(white_box, window)
    if hold is None:
        return
    nodes = white_box.context_nodes
    resistance, breakaway_a = hold
    lower, upper = bounds(white_box.parameters)
    for start in starts:
        values = dict(zip(nodes, start.tolist(), strict=True))
        ratio = resistance / values['resistance']
        values['resistance'] = resistance
        values[DRY_FRICTION] = float(white_box.torque_constant) * breakaway_a
        values['inertia'] /= ratio
        if 'inductance' in values:
            values['inductance'] *= ratio
        yield np.clip(np.array([values[name] for name in nodes]), 1.01 * lower, 0.99 * upper)


def begins_held(white_box: MotorWhiteBox, window: Window) -> bool:
    """Tell whether friction holds the rotor first, and the voltage tells the resistance by that.

    Args:
        white_box: of one motor with a rotor.
        window: the samples.
    """
    return _first_hold(white_box, replace(window, histories=window.histories[:1])) is not None


def _first_hold(white_box: MotorWhiteBox, window: Window) -> tuple[float, float] | None:
    """Return resistance and breakaway current of the first history that begins with a hold.

    None where none does, or where resistance and dry friction are not both identified.
    """
    if not {DRY_FRICTION, 'resistance'} <= set(white_box.context_nodes):
        return None
    noise_a = max(window.reading_noise_a, LEAST_NOISE * window.spread_a)
    holds = (_hold(history, noise_a) for history in window.histories)
    return next((hold for hold in holds if hold is not None), None)


def _hold(history: History, noise_a: float) -> tuple[float, float] | None:
    """Return resistance and breakaway current of a hold that a history begins with; None: of none.

    Args:
        history: the samples.
        noise_a: standard deviation of the current's noise.
    """
    current = history.current_a
    if abs(current[0]) > NO_CURRENT * noise_a:
        return None
    count = FEWEST
    hold = None
    while count < current.size:
        begin = count // UNSETTLED
        line = _line(history.voltage_v[begin:count], current[begin + 1 : count + 1], noise_a)
        if line is None and hold is not None:
            break
        slope, std = line or (0.0, math.inf)
        rises = abs(history.voltage_v[0]) < RISES * abs(history.voltage_v[count - 1])
        if rises and std < SHARP * slope:
            last = slice(count - FEWEST // 2, count + 1)
            hold = 1.0 / slope, abs(float(median(current[last])))
        count = math.ceil(LONGER * count)
    return hold


def _line(voltage_v: Array, current_a: Array, noise_a: float) -> tuple[float, float] | None:
    """Return slope of a current over its voltage, and deviation, in A/V; None: it is no line."""
    volt = voltage_v - voltage_v.mean()
    squares = float(volt @ volt)
    if not squares > 0.0:
        return None
    off = current_a - current_a.mean()
    slope = float(volt @ off) / squares
    rest = off - slope * volt
    if float(rest @ rest) > (LINEAR * noise_a) ** 2 * rest.size:
        return None
    offset_a = float(current_a.mean()) - slope * float(voltage_v.mean())
    if offset_a * current_a[-1] > OFFSET * current_a[-1] ** 2:
        return None
    return slope, noise_a / math.sqrt(squares)
