"""The motion of a motor whose rotor is held by friction, in closed form.

Friction that is stronger than the motor holds the rotor: the speed stays near zero, and comes to
rest in a small part of an interval. There its balance is in rest at any instant, and the speed
follows the current (a quasi-steady state; Kokotovic, Khalil and O'Reilly 1986). What is left is the
balance of the current alone, which is nearly straight. So a whole interval is one step, however
steep the softened sign is. Compiled code (`native/held_rotor.h`) does the same.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.rotor.straight_motion import RateAt
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import Linear
from gray_box_observer.white_box.interface import Array

FEWEST_DECAYS = 10.0
"""Time constants of the speed in a length, from which the speed is taken to follow the current."""

MOST_CORRECTIONS = 8
"""Steps of Newton's method in which the speed has to come to rest."""

AT_REST = 1e-9
"""Speed in rad/s by which it may still be off."""

FOLLOWING = 1e-4
"""Share of the current's rate that may be left out, or of that which the current has at which
friction gives way."""

NEARLY_NONE = 1e-6
"""Exponent below which its series serves."""


def may_be_held(here: Linear, length_s: float) -> bool:
    """Tell whether the speed comes to rest in a length, by the rate at its start."""
    return bool(-here.by_state[State.SPEED][State.SPEED] * length_s >= FEWEST_DECAYS)


def held_motion(
    rate_at: RateAt, start: list[float], length_s: float, friction_rad_s2: float
) -> Linear | None:
    """Move on by a length over which friction holds the rotor; None where it does not.

    Args:
        rate_at: rate at given states.
        start: the states.
        length_s: how far.
        friction_rad_s2: what dry friction takes of the acceleration of a rotor that turns; 0 beside
            brushes, which bend the current's own balance.
    """
    begin = _at_rest(rate_at, start, length_s)
    if begin is None:
        return None
    from_speed, first = begin
    own, by_speed = first.by_state[State.CURRENT]
    decay, turns = _following(first)
    slope = own + by_speed * turns
    if not slope <= 0.0:  # the current runs away
        return None
    is_none = -slope * length_s < NEARLY_NONE
    left = math.exp(slope * length_s)
    reach = length_s if is_none else math.expm1(slope * length_s) / slope
    rate = first.value[State.CURRENT]
    slip_a = by_speed * (start[State.SPEED] - from_speed) / decay
    step = reach * rate
    current = start[State.CURRENT] + step + left * slip_a
    end = _at_rest(rate_at, [current, from_speed + turns * step], length_s)
    if end is None:
        return None
    to_speed, last = end
    gives_way_a = friction_rad_s2 / abs(first.by_state[State.SPEED][State.CURRENT])
    size = abs(rate) + abs(slope) * max(gives_way_a, abs(start[State.CURRENT]), abs(current))
    off = last.value[State.CURRENT] - rate - slope * (current - start[State.CURRENT])
    late = by_speed * turns * rate / decay
    if not abs(off) + abs(late) + abs(slip_a) / length_s <= FOLLOWING * size:
        return None
    last_decay, last_turns = _following(last)
    follows = by_speed / decay
    begins = _pushes(first, follows)
    ends = _pushes(last, last.by_state[State.CURRENT][State.SPEED] / last_decay)
    change = 0.5 * length_s if is_none else (length_s * left - reach) / (slope * reach)
    by_current = reach * begins + change * (ends - begins)
    by_coordinate = np.array(last.by_coordinate[State.SPEED]) / last_decay + last_turns * by_current
    lag_rad_s = last_turns * last.value[State.CURRENT] / last_decay
    return Linear(
        [current, to_speed - lag_rad_s],
        [[left, left * follows], [last_turns * left, last_turns * left * follows]],
        [by_current, by_coordinate],
    )


def _at_rest(rate_at: RateAt, states: list[float], length_s: float) -> tuple[float, Linear] | None:
    """Let the speed come to rest under a current; None where it does not, or too slowly.

    Returns:
        The speed in rad/s, and the rate there.
    """
    current, speed = states
    for _ in range(MOST_CORRECTIONS):
        there = rate_at([current, speed])
        decay = -there.by_state[State.SPEED][State.SPEED]
        if not decay * length_s >= FEWEST_DECAYS:
            return None
        imbalance = there.value[State.SPEED]
        if abs(imbalance) <= AT_REST * decay:
            return speed, there
        speed += imbalance / decay
    return None


def _following(there: Linear) -> tuple[float, float]:
    """Return how fast the speed comes to rest in 1/s, and how it answers the current at rest."""
    by_current, own = there.by_state[State.SPEED]
    return -own, by_current / -own


def _pushes(there: Linear, follows: float) -> Array:
    """Return how every coordinate pushes the current, by way of the speed too."""
    by_current, by_speed = (np.array(slopes) for slopes in there.by_coordinate)
    pushes: Array = by_current + follows * by_speed
    return pushes
