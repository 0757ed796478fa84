"""Voltages that move within a sample interval, for drivers and sensors that keep their own time.

A current whose L/R is no longer than a few samples tells when a voltage has moved, not only its
mean. With the voltages in force at both ends of an interval the mean tells the instant of one move.
There the interval is cut in two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.rotor_trajectory import Run
from gray_box_observer.white_box.interface import Array

LEAST_MOVE = 0.003
"""Move of a voltage within an interval, as a share of the largest one, from which its instant
counts."""

LEAST_PART = 1e-3
"""Share of an interval that is a part, at least."""

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
        cls, voltage_v: Array, interval_s: Array, held_v: Array
    ) -> VoltageParts | None:
        """Cut intervals where the voltage has moved; None where it has moved in none of them.

        Args:
            voltage_v: shape (k,): mean over every interval.
            interval_s: shape (k,).
            held_v: shape (k + 1,): in force at the end of every interval, and where the first
                begins.
        """
        share = _shares_before(voltage_v, held_v)
        is_cut = share > 0.0
        if not is_cut.any():
            return None
        places = np.arange(is_cut.size) + np.cumsum(is_cut)  # of the last part of every interval
        result_v = np.empty(is_cut.size + int(is_cut.sum()))
        length_s = np.empty_like(result_v)
        result_v[places] = np.where(is_cut, held_v[1:], voltage_v)
        length_s[places] = np.where(is_cut, (1.0 - share) * interval_s, interval_s)
        first = places[is_cut] - 1
        result_v[first] = held_v[:-1][is_cut]
        length_s[first] = (share * interval_s)[is_cut]
        return cls(result_v, length_s, is_cut)

    def repeated(self, values: Array | None) -> Array | None:
        """Return what holds over every interval for every part, shape (part,); None: nothing."""
        return None if values is None else np.repeat(values, 1 + self.is_cut)

    def over_intervals(self, path: Run) -> Run:
        """Return a run through the parts as one through the intervals."""
        last = np.arange(self.is_cut.size) + np.cumsum(self.is_cut)
        nodes = np.concatenate([[0], last + 1])
        transitions = path.transitions[last]
        before = path.transitions[last[self.is_cut] - 1]
        transitions[self.is_cut] = transitions[self.is_cut] @ before
        return replace(
            path, states=path.states[nodes], slopes=path.slopes[nodes], transitions=transitions
        )


def _shares_before(voltage_v: Array, held_v: Array) -> Array:
    """Return which share of an interval lies before its voltage moves; 0: it does not move.

    Args:
        voltage_v: shape (k,): mean over every interval.
        held_v: shape (k + 1,): in force at the end of every interval, and where the first begins.
    """
    move_v = np.diff(held_v)
    is_far = np.abs(move_v) > LEAST_MOVE * float(np.abs(held_v).max(initial=0.0))
    share = np.where(is_far, held_v[1:] - voltage_v, 0.0) / np.where(is_far, move_v, 1.0)
    is_within = (share > LEAST_PART) & (share < 1.0 - LEAST_PART)
    return np.where(is_within, share, 0.0)


def equivalent_voltage(voltage_v: Array, held_v: Array, lengths: Array) -> Array:
    """Return constant voltages that leave a winding as those do that move, shape (k,), in V.

    Args:
        voltage_v: shape (k,): mean over every interval.
        held_v: shape (k + 1,): in force at the end of every interval, and where the first begins.
        lengths: shape (k,): of the intervals, in time constants L/R.
    """
    share = _shares_before(voltage_v, held_v)
    x = np.maximum(lengths, LEAST_LENGTH)
    weight = (np.exp(-(1.0 - share) * x) - np.exp(-x)) / -np.expm1(-x)
    moving_v = held_v[1:] + weight * (held_v[:-1] - held_v[1:])
    return np.where(share > 0.0, moving_v, voltage_v)
