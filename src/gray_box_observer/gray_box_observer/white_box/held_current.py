"""The current of a motor whose brushes may hold it, beside a measured speed.

``V_b sign(i)`` bends sharply: where less than V_b is left for the winding, the current comes to
zero and stays there. All else is linear in the current. So on either side of zero it moves in
closed form for as long as the speed stays, and an interval is gone through in a few parts. A
softened sign would ask for hundreds of steps there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motion import Interval, Linear, RateAt, joined

PARTS = 8
"""Parts of an interval, each with the speed of its middle."""

FAR_A = 1e4
"""Current at which a softened sign is one to 1e-12."""


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """The rate of a current on one side of zero, as it is at zero; shape (motor, k).

    Attributes:
        rate: of the current.
        by_coordinate: its derivatives, shape (coordinate, motor, k).
    """

    rate: Any
    by_coordinate: Any


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """How a current moves for some time, with a rate that is linear in it.

    Attributes:
        decay: what is left of a deviation.
        end: the current there.
        by_coordinate: its derivatives.
    """

    decay: Any
    end: Any
    by_coordinate: Any


def held_current_motion(ops: Any, rate_at: RateAt, start: Array, interval: Interval) -> Linear:
    """Move currents on, each from its own start.

    Args:
        ops: as for :func:`~gray_box_observer.white_box.flow.flow`.
        rate_at: of the current alone.
        start: shape (motor, k).
        interval: with the measured speed.
    """
    parts = interval.parts(PARTS)
    whole = _moved(ops, rate_at, start, next(parts))
    for part in parts:
        whole = joined(whole, _moved(ops, rate_at, whole.value[0], part))
    return whole


def _moved(ops: Any, rate_at: RateAt, start: Array, part: Interval) -> Linear:
    """Move currents on while the speed stays: to zero, and beyond it where the brushes let them."""
    speed = 0.5 * (part.speed_rad_s + part.end_speed_rad_s)
    far = 0.0 * start + FAR_A
    near, further, other = (rate_at([at], speed) for at in (far, 2.0 * far, -far))
    slope = ops.minimum(further.by_state[0][0], -1e-12)
    by_current = (further.by_coordinate[0] - near.by_coordinate[0]) / FAR_A
    above = _Side(near.value[0] - FAR_A * slope, near.by_coordinate[0] - FAR_A * by_current)
    below = _Side(other.value[0] + FAR_A * slope, other.by_coordinate[0] + FAR_A * by_current)
    rests = _Side(0.0 * start, 0.0 * by_current)
    away = _where(ops, below.rate < 0.0, below, rests)
    away = _where(ops, above.rate > 0.0, above, away)
    own = _where(ops, start < 0.0, below, away)
    own = _where(ops, start > 0.0, above, own)
    comes = start * own.rate < 0.0
    ratio = ops.where(comes, own.rate / ops.where(comes, own.rate + slope * start, 1.0), 1.0)
    after_s = ops.log(ratio) / slope
    passes = comes & (after_s < part.length_s)
    first_s = ops.where(passes, after_s, part.length_s)
    first = _way(ops, start, own, slope, by_current, first_s)
    then = _way(ops, 0.0 * start, away, slope, by_current, part.length_s - first_s)
    # a deviation shifts the instant of zero, and what it leaves goes on at the other rate
    after_zero = then.decay * away.rate / ops.where(passes, own.rate, 1.0)
    is_held = (start == 0.0) & (own.rate == 0.0)
    return Linear(
        [ops.where(passes, then.end, first.end)],
        [[ops.where(passes, after_zero * first.decay, ops.where(is_held, 0.0, first.decay))]],
        [
            ops.where(
                passes, after_zero * first.by_coordinate + then.by_coordinate, first.by_coordinate
            )
        ],
    )


def _way(ops: Any, start: Any, side: _Side, slope: Any, by_current: Any, time_s: Any) -> _Way:
    """Return how currents move on one side of zero."""
    decay = ops.exp(slope * time_s)
    reach_s = (decay - 1.0) / slope
    along = start * time_s * decay + side.rate * (time_s * decay - reach_s) / slope
    return _Way(
        decay,
        start * decay + reach_s * side.rate,
        reach_s * side.by_coordinate + along * by_current,
    )


def _where(ops: Any, condition: Any, then: _Side, otherwise: _Side) -> _Side:
    """Choose entry by entry."""
    return _Side(
        ops.where(condition, then.rate, otherwise.rate),
        ops.where(condition, then.by_coordinate, otherwise.by_coordinate),
    )
