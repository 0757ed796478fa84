"""What is free in every signal history beside the parameters: its first states, and more.

Where the measured speed is an output of the motor, its lag is free, and so is a load that varies:
it takes a part of the acceleration that runs straight between knots and walks at random over them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run, by_knot
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.interface import Array

LAG = STATES
"""Place of the speed's lag in s among the unknowns of a history, behind the first states."""

LOADS = slice(STATES + 1, None)
"""Places of the load's knots, in rad/s2."""

LATEST = 5.0
"""Standard deviation of the speed's lag before anything is known of it, in sample intervals."""


@dataclass(frozen=True)
class SpeedOutput:
    """How a window's measured speed is taken for an output of the motor.

    Attributes:
        unit_a_s: noise of the current over that of the speed, in A s/rad: one unit for both.
        knots: of the load over a signal history; 0: the load is constant.
        walk: variance that a load gains in a second, in (rad/s2)^2/s.
    """

    unit_a_s: float
    knots: int = 0
    walk: float = 0.0

    @property
    def unknowns(self) -> int:
        """How many unknowns a history has."""
        return STATES + 1 + self.knots

    def precision(self, start_std: Array, interval_s: Array) -> Array:
        """Return what is known of a history's unknowns beforehand, shape (unknown, unknown).

        Args:
            start_std: shape (state,): of the first states.
            interval_s: shape (k,): its intervals.
        """
        result = np.zeros((self.unknowns, self.unknowns))
        lag_std = LATEST * float(median(interval_s))
        result[: LAG + 1, : LAG + 1] = np.diag([*start_std**-2.0, lag_std**-2.0])
        if self.knots:
            length = float(interval_s.sum())
            steps = np.diff(np.eye(self.knots), axis=0)
            spacing = length / (self.knots - 1)
            level = np.eye(self.knots) / (self.walk * self.knots * max(length, 1e-9))
            result[LOADS, LOADS] = steps.T @ steps / (self.walk * spacing) + level / self.knots
        return result


def knot_places(interval_s: Array, knots: int) -> Array:
    """Return where the middle of every interval lies among knots at even times, shape (k,)."""
    end = np.cumsum(interval_s)
    middle = end - 0.5 * interval_s
    places: Array = middle / end[-1] * (knots - 1)
    return places


def load_over_intervals(unknowns: Array, interval_s: Array) -> Array | None:
    """Return the load of a history, shape (k,), in rad/s2; None where it has no knots."""
    loads = unknowns[LOADS]
    if loads.size == 0:
        return None
    places = knot_places(interval_s, loads.size)
    return np.asarray(np.interp(places, np.arange(loads.size), loads), dtype=float)


@dataclass(frozen=True, eq=False)
class LateReadings:
    """When a speed sensor that lags reads, along a history.

    Attributes:
        left: shape (k + 1,): sample before the instant that is read.
        share: shape (k + 1,): of the interval behind it that has passed by then.
        interval_s: shape (k + 1,): length of that interval.
        is_covered: shape (k + 1,): whether the instant lies within the history.
    """

    left: NDArray[np.intp]
    share: Array
    interval_s: Array
    is_covered: NDArray[np.bool_]

    @classmethod
    def along(cls, interval_s: Array, unknowns: Array) -> LateReadings:
        """Find the instants that are read, late by the lag of a history.

        Args:
            interval_s: shape (k,).
            unknowns: shape (unknown,): of the history.
        """
        time_s = np.concatenate([[0.0], np.cumsum(interval_s)])
        instant = time_s - unknowns[LAG]
        left = np.clip(np.searchsorted(time_s, instant, side='right') - 1, 0, interval_s.size - 1)
        edge = 1e-9 * interval_s[0]
        behind_s = interval_s[left]
        return cls(
            left,
            (instant - time_s[left]) / behind_s,
            behind_s,
            (instant >= time_s[0] - edge) & (instant <= time_s[-1] + edge),
        )

    def of_signal(self, signal: Array) -> Array:
        """Read a signal that runs straight between samples, shape (k + 1, ...)."""
        weight = self.share if signal.ndim == 1 else self.share[:, None]
        result: Array = (1.0 - weight) * signal.take(self.left, axis=0)
        result += weight * signal.take(self.left + 1, axis=0)
        return result

    def by_lag(self, signal: Array) -> Array:
        """Differentiate a signal that is read by the lag, shape (k + 1,)."""
        result: Array = -(signal[self.left + 1] - signal[self.left]) / self.interval_s
        return result


def load_slopes(path: Run, interval_s: Array, unknowns: Array) -> Array | None:
    """Derivatives of the states by the load's knots, shape (k + 1, state, knot); None: no load."""
    knots = unknowns[LOADS].size
    return by_knot(path, knot_places(interval_s, knots), knots) if knots else None
