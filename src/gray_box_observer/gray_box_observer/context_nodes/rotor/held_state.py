"""The motion of a motor with a rotor where friction or brushes hold a state, in closed form.

Friction that is stronger than the motor holds the rotor: the speed stays near zero, and comes to
rest in a small part of an interval. There its balance is in rest at any instant, and the speed
follows the current (a quasi-steady state; Kokotovic, Khalil and O'Reilly 1986). What is left is the
balance of the current alone, which is nearly straight. So a whole interval is one step, however
steep the softened sign is. Brushes hold the current likewise, where less voltage is left for the
winding than they drop: the current follows the speed. Compiled code (`native/held_state.h`) does
the same.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.rotor.straight_motion import RateAt
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motion import Linear

FEWEST_DECAYS = 10.0
"""Time constants of the held state in a length, from which it is taken to follow the other one."""

MOST_CORRECTIONS = 8
"""Steps of Newton's method in which the held state has to come to rest."""

AT_REST = 1e-9
"""Speed in rad/s, or current in A, by which it may still be off."""

FOLLOWING = 1e-4
"""Share of the other state's rate that may be left out, or of that which it has where the held
state gives way."""

NEARLY_NONE = 1e-6
"""Exponent below which its series serves."""


def may_be_held(here: Linear, state: State, length_s: float) -> bool:
    """Tell whether a state comes to rest in a length, by the rate at its start."""
    return bool(-here.by_state[state][state] * length_s >= FEWEST_DECAYS)


def held_motion(
    rate_at: RateAt, start: list[float], state: State, length_s: float, holding_rate: float
) -> Linear | None:
    """Move on by a length over which a state is held; None where it is not.

    Args:
        rate_at: rate at given states.
        start: the states.
        state: that is held: SPEED by friction, CURRENT by brushes.
        length_s: how far.
        holding_rate: what friction takes of the acceleration of a rotor that turns, or brushes of
            the rate of a current that flows; 0 where the other state's own balance is bent, too.
    """
    free = State(1 - state)
    begin = _at_rest(rate_at, start, state, length_s)
    if begin is None:
        return None
    from_state, first = begin
    by_held = first.by_state[free][state]
    own = first.by_state[free][free]
    decay, turns = _following(first, state)
    slope = own + by_held * turns
    if not slope <= 0.0:  # the free state runs away
        return None
    is_none = -slope * length_s < NEARLY_NONE
    left = math.exp(slope * length_s)
    reach = length_s if is_none else math.expm1(slope * length_s) / slope
    rate = first.value[free]
    slip = by_held * (start[state] - from_state[state]) / decay
    step = reach * rate
    to_free = start[free] + step + left * slip
    to_held = from_state[state] + turns * step
    states = [to_free, to_held] if state is State.SPEED else [to_held, to_free]
    end = _at_rest(rate_at, states, state, length_s)
    if end is None:
        return None
    to_state, last = end
    gives_way = holding_rate / max(abs(first.by_state[state][free]), 1e-300)
    size = abs(rate) + abs(slope) * max(gives_way, abs(start[free]), abs(to_free))
    off = last.value[free] - rate - slope * (to_free - start[free])
    late = by_held * turns * rate / decay
    if not abs(off) + abs(late) + abs(slip) / length_s <= FOLLOWING * size:
        return None
    last_decay, last_turns = _following(last, state)
    follows = by_held / decay
    begins = _pushes(first, state, follows)
    ends = _pushes(last, state, last.by_state[free][state] / last_decay)
    change = 0.5 * length_s if is_none else (length_s * left - reach) / (slope * reach)
    by_coordinate = {free: reach * begins + change * (ends - begins)}
    by_coordinate[state] = (
        np.array(last.by_coordinate[state]) / last_decay + last_turns * by_coordinate[free]
    )
    lag = last_turns * last.value[free] / last_decay
    value = {free: to_free, state: to_state[state] - lag}
    answers = {free: left, state: left * follows}
    return Linear(
        [value[one] for one in State],
        [[(1.0 if one is free else last_turns) * answers[by] for by in State] for one in State],
        [by_coordinate[one] for one in State],
    )


def _at_rest(
    rate_at: RateAt, states: list[float], state: State, length_s: float
) -> tuple[list[float], Linear] | None:
    """Let a state come to rest beside the other one; None where it does not, or too slowly.

    Returns:
        The states, and the rate there.
    """
    rest = [*states]
    for _ in range(MOST_CORRECTIONS):
        there = rate_at(rest)
        decay = -there.by_state[state][state]
        if not decay * length_s >= FEWEST_DECAYS:
            return None
        imbalance = there.value[state]
        if abs(imbalance) <= AT_REST * decay:
            return rest, there
        rest[state] += imbalance / decay
    return None


def _following(there: Linear, state: State) -> tuple[float, float]:
    """Return how fast a state comes to rest in 1/s, and how it answers the other one at rest."""
    decay = -there.by_state[state][state]
    return decay, there.by_state[state][1 - state] / decay


def _pushes(there: Linear, state: State, follows: float) -> Array:
    """Return how every coordinate pushes the free state, by way of the held one too."""
    pushes: Array = np.array(there.by_coordinate[1 - state])
    return pushes + follows * np.array(there.by_coordinate[state])
