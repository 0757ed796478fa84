"""What is free in every signal history beside the parameters: its first states, and more.

Where the measured speed is an output of the motor, its lag is free. So is a load that varies: it
takes a part of the acceleration that runs straight between knots and walks at random over them. A
current sensor may lag, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run, by_knot
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array

LAG = STATES
"""Place of the speed's lag in s among the unknowns of a history whose speed is an output."""

LATEST = 5.0
"""Standard deviation of a sensor's lag before anything is known of it, in sample intervals."""


@dataclass(frozen=True)
class SpeedOutput:
    """How a window's measured speed is taken for an output of the motor.

    Attributes:
        unit_a_s: noise of the current over that of the speed, in A s/rad: one unit for both.
    """

    unit_a_s: float


@dataclass(frozen=True)
class LoadWalk:
    """A load that walks at random, straight between knots.

    Attributes:
        knots: over a signal history.
        walk: variance that it gains in a second, in (rad/s2)^2/s.
    """

    knots: int
    walk: float

    def precision(self, length_s: float) -> Array:
        """Return what is known of the knots beforehand, shape (knot, knot), in (s2/rad)^2.

        Args:
            length_s: of the history.
        """
        steps = np.diff(np.eye(self.knots), axis=0)
        spacing_s = length_s / (self.knots - 1)
        level = np.eye(self.knots) / (self.walk * self.knots * max(length_s, 1e-9))
        return np.asarray(
            steps.T @ steps / (self.walk * spacing_s) + level / self.knots, dtype=float
        )


@dataclass(frozen=True)
class CurrentSensor:
    """A current sensor behind a filter of first order.

    Attributes:
        sum_s: lag and L/R together in s, about: where a search begins the lag is what L/R leaves.
        memory: correlation of its noise at two samples in a row: noise before a filter passes it,
            too.
        is_digital: whether the filter is a moving average of the samples, in which every one
            weighs less than the next by the same factor.
        is_sure: whether no other kind of filter, nor a current that is merely late, explains the
            samples nearly as well.
    """

    sum_s: float
    memory: float = 0.0
    is_digital: bool = False
    is_sure: bool = False


@dataclass(frozen=True)
class Unknowns:
    """What is free in every history of a window, in the order of these.

    First states, the speed's lag, knots of the load, lag and first reading of the current sensor.

    Attributes:
        speed_output: how the measured speed is fitted; None: it is not looked at.
        load: that varies; None: none does.
        current_sensor: that lags; None: it does not.
        noise_memory: where its lag is in the voltage already: memory of the current's noise
            (:mod:`~gray_box_observer.context_nodes.rotor.noise_memory`).
    """

    speed_output: SpeedOutput | None = None
    load: LoadWalk | None = None
    current_sensor: CurrentSensor | None = None
    noise_memory: float = 0.0

    @property
    def memory(self) -> float:
        """Memory of the current's noise."""
        return self.noise_memory if self.current_sensor is None else self.current_sensor.memory

    @property
    def loads(self) -> slice:
        """Places of the load's knots, in rad/s2."""
        begin = STATES + (self.speed_output is not None)
        return slice(begin, begin + (0 if self.load is None else self.load.knots))

    @property
    def current_lag(self) -> int:
        """Place of the current sensor's lag in s; that of its first reading in A is the next."""
        return int(self.loads.stop)

    @property
    def count(self) -> int:
        """How many there are."""
        return self.current_lag + (0 if self.current_sensor is None else 2)

    def precision(self, start_std: Array, interval_s: Array) -> Array:
        """Return what is known of them beforehand, shape (unknown, unknown).

        Args:
            start_std: shape (state,): of the first states.
            interval_s: shape (k,): intervals of the history.
        """
        result = np.zeros((self.count, self.count))
        result[:STATES, :STATES] = np.diag(start_std**-2.0)
        if self.speed_output is not None:
            result[LAG, LAG] = (LATEST * float(median(interval_s))) ** -2.0
        if self.load is not None:
            result[self.loads, self.loads] = self.load.precision(float(interval_s.sum()))
        if self.current_sensor is not None:
            place = self.current_lag
            result[place, place] = (LATEST * float(median(interval_s))) ** -2.0
            result[place + 1, place + 1] = start_std[State.CURRENT] ** -2.0
        return result


def knot_places(interval_s: Array, knots: int) -> Array:
    """Return where the middle of every interval lies among knots at even times, shape (k,)."""
    end = np.cumsum(interval_s)
    middle = end - 0.5 * interval_s
    places: Array = middle / end[-1] * (knots - 1)
    return places


def load_over_intervals(loads: Array, interval_s: Array) -> Array | None:
    """Return the load of a history, shape (k,), in rad/s2; None where it has no knots.

    Args:
        loads: shape (knot,): at its knots.
        interval_s: shape (k,).
    """
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


def load_slopes(path: Run, interval_s: Array, load: LoadWalk | None) -> Array | None:
    """Derivatives of the states by the load's knots, shape (k + 1, state, knot); None: no load."""
    if load is None:
        return None
    return by_knot(path, knot_places(interval_s, load.knots), load.knots)
