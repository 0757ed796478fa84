"""Voltages that move within a sample interval, for drivers and sensors that keep their own time.

A current whose L/R is no longer than a few samples tells when a voltage has moved, not only its
mean. There the interval is cut in two. One move is exact: the voltages in force at both ends and
the mean tell its instant, and the first moment says that it was one. Of several moves mean and
first moment are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.rotor_trajectory import Run
from gray_box_observer.white_box.interface import Array

LEAST_MOMENT = 4e-4
"""First moment of a voltage within an interval, as a share of the largest one, from which it
counts."""

SAME_MOMENT = 0.01
"""Share by which a first moment may differ from that of a single move."""

HALF_MOMENT = 4.0
"""Voltage to either side of the mean over a first moment, of an interval that is cut in its middle.
"""

LEAST_LENGTH = 1e-6
"""Time constants L/R in an interval, at least: in less the mean voltage is all that counts."""


@dataclass(frozen=True, eq=False)
class VoltageParts:
    """Parts of intervals over which a voltage is constant.

    Attributes:
        voltage_v: shape (part,).
        interval_s: shape (part,): how long each lasts.
        is_cut: shape (k,): which intervals have two parts; the others have one.
    """

    voltage_v: Array
    interval_s: Array
    is_cut: NDArray[np.bool_]

    @classmethod
    def of_intervals(
        cls, voltage_v: Array, interval_s: Array, held_v: Array, moment_v: Array
    ) -> VoltageParts | None:
        """Cut intervals where the voltage has moved; None where it has moved in none of them.

        Args:
            voltage_v: shape (k,): mean over every interval.
            interval_s: shape (k,).
            held_v: shape (k + 1,): in force at the end of every interval, and where the first
                begins.
            moment_v: shape (k,): first moment of every interval.
        """
        if not moment_v.any():
            return None
        share, first_v, second_v = _two_parts(voltage_v, moment_v, held_v)
        is_cut = share > 0.0
        if not is_cut.any():
            return None
        places = _last_parts(is_cut)
        result_v = np.empty(is_cut.size + int(is_cut.sum()))
        length_s = np.empty_like(result_v)
        result_v[places] = second_v
        length_s[places] = (1.0 - share) * interval_s
        first = places[is_cut] - 1
        result_v[first] = first_v[is_cut]
        length_s[first] = (share * interval_s)[is_cut]
        return cls(result_v, length_s, is_cut)

    @property
    def range_v(self) -> Array:
        """By how much the voltage moves within every interval, shape (k,)."""
        last = _last_parts(self.is_cut)
        moves_v = np.abs(self.voltage_v[last] - self.voltage_v[last - 1])
        return np.where(self.is_cut, moves_v, 0.0)

    def repeated(self, values: Array | None) -> Array | None:
        """Return what holds over every interval for every part, shape (part,); None: nothing."""
        return None if values is None else np.repeat(values, 1 + self.is_cut)

    def over_intervals(self, path: Run) -> Run:
        """Return a run through the parts as one through the intervals."""
        last = _last_parts(self.is_cut)
        nodes = np.concatenate([[0], last + 1])
        transitions = path.transitions[last]
        before = path.transitions[last[self.is_cut] - 1]
        transitions[self.is_cut] = transitions[self.is_cut] @ before
        return replace(
            path, states=path.states[nodes], slopes=path.slopes[nodes], transitions=transitions
        )


def _last_parts(is_cut: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the place of the last part of every interval, shape (k,)."""
    return np.arange(is_cut.size) + np.cumsum(is_cut)


def _two_parts(voltage_v: Array, moment_v: Array, held_v: Array) -> tuple[Array, Array, Array]:
    """Return the share of intervals before their voltage moves, and the voltages of both parts.

    Args:
        voltage_v: shape (k,): mean over every interval.
        moment_v: shape (k,): first moment of every interval.
        held_v: shape (k + 1,): in force at the end of every interval, and where the first begins.

    Returns:
        Shape (k,) each. Where nothing moves the share is 0, and the second voltage the mean.
    """
    largest_v = float(np.abs(held_v).max(initial=0.0))
    moves = np.abs(moment_v) > LEAST_MOMENT * largest_v
    move_v = np.diff(held_v)
    is_far = np.abs(move_v) > LEAST_MOMENT * largest_v
    share = np.where(is_far, held_v[1:] - voltage_v, 0.0) / np.where(is_far, move_v, 1.0)
    is_once = moves & (share > 0.0) & (share < 1.0)
    once_v = 0.5 * move_v * share * (1.0 - share)
    is_once &= np.abs(once_v - moment_v) <= SAME_MOMENT * np.abs(moment_v)
    half_v = HALF_MOMENT * moment_v
    share = np.where(is_once, share, 0.5 * moves)
    first_v = np.where(is_once, held_v[:-1], voltage_v - half_v)
    second_v = np.where(is_once, held_v[1:], np.where(moves, voltage_v + half_v, voltage_v))
    return share, first_v, second_v


def equivalent_voltage(voltage_v: Array, moment_v: Array, held_v: Array, lengths: Array) -> Array:
    """Return constant voltages that leave a winding as those do that move, shape (k,), in V.

    Args:
        voltage_v: shape (k,): mean over every interval.
        moment_v: shape (k,): first moment of every interval.
        held_v: shape (k + 1,): in force at the end of every interval, and where the first begins.
        lengths: shape (k,): of the intervals, in time constants L/R.
    """
    share, first_v, second_v = _two_parts(voltage_v, moment_v, held_v)
    x = np.maximum(lengths, LEAST_LENGTH)
    weight = (np.exp(-(1.0 - share) * x) - np.exp(-x)) / -np.expm1(-x)
    return np.where(share > 0.0, second_v + weight * (first_v - second_v), voltage_v)
