"""Samples of one motor, cut into signal histories."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    SpeedOutput,
    Unknowns,
)
from gray_box_observer.context_nodes.rotor.voltage_parts import VoltageParts
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE, moves_of
from gray_box_observer.samples.voltage_level import noise_range
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

FEWEST = 8
"""Samples of a signal history that tells more than where it begins."""

MOST_HISTORIES = 64
"""Signal histories of a window; of more, the longest count."""

REACH = (100.0, 10.0)
"""Times the largest reading, and times the largest voltage over Kb, beyond which a run is given
up."""


LEAST_REACH_V = 1.0
"""Back-EMF that a rotor may have beside that, whatever the voltage: it may have turned before."""


NOTHING_MORE = Unknowns()
"""Where first states alone are free."""

MOVE = 0.1
"""Share of its range by which a voltage has moved."""


@dataclass(frozen=True, eq=False)
class History:
    """Samples between two restarts.

    Attributes:
        current_a: shape (k + 1,): measured.
        voltage_v: shape (k,): mean over every interval.
        interval_s: shape (k,).
        speed_rad_s: shape (k + 1,): measured; None where it is not looked at.
        place: of its first sample among those that the window was made of.
        held_v: shape (k + 1,): voltage in force at every sample; None: it is not told.
        moment_v: shape (k,): first moment of the voltage over every interval; None likewise.
    """

    current_a: Array
    voltage_v: Array
    interval_s: Array
    speed_rad_s: Array | None = None
    place: int = 0
    held_v: Array | None = None
    moment_v: Array | None = None

    @cached_property
    def parts(self) -> VoltageParts | None:
        """Parts of intervals with a constant voltage; None where it moves within none."""
        if self.held_v is None or self.moment_v is None:
            return None
        return VoltageParts.of_intervals(
            self.voltage_v, self.interval_s, self.held_v, self.moment_v
        )


@dataclass(frozen=True, eq=False)
class Window:
    """Samples of one motor.

    Attributes:
        histories: in the order of time.
        unknowns: what is free in every history.
        count: newest samples that it was made of, with those of histories too short to be fitted.
        voltage_elsewhere_v: largest that has driven the motor outside of these histories.
    """

    histories: tuple[History, ...]
    unknowns: Unknowns = NOTHING_MORE
    count: int = 0
    voltage_elsewhere_v: float = 0.0

    @classmethod
    def from_samples(
        cls, white_box: MotorWhiteBox, samples: Array, unknowns: Unknowns | None = None
    ) -> Window:
        """Cut samples where their signal history starts anew.

        Args:
            white_box: of the motor.
            samples: shape (signal, n), as a replay buffer gives them of one motor.
            unknowns: what is free in every history; None: its first states.
        """
        unknowns = unknowns or NOTHING_MORE
        count = samples.shape[1]
        has_speed = unknowns.speed_output is not None
        signals = SPEED + 1 if has_speed else SPEED
        finite = np.isfinite(samples[:signals]).all(axis=0)
        places = np.flatnonzero(finite)
        samples = samples[:, finite]
        current = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
        begins = np.flatnonzero(samples[INTERVAL] <= 0.0)
        edges = sorted({0, *begins.tolist(), current.size})
        held_v, moment_v = moves_of(samples)
        result = [
            History(
                current[begin:end],
                samples[VOLTAGE, begin + 1 : end],
                samples[INTERVAL, begin + 1 : end],
                samples[SPEED, begin:end] if has_speed else None,
                int(places[begin]),
                held_v[begin:end],
                moment_v[begin + 1 : end],
            )
            for begin, end in pairwise(edges)
            if end - begin >= FEWEST
        ]
        if len(result) > MOST_HISTORIES:
            shortest = sorted(history.current_a.size for history in result)[-MOST_HISTORIES]
            result = [history for history in result if history.current_a.size >= shortest]
        return cls(tuple(result[-MOST_HISTORIES:]), unknowns, count)

    @property
    def speed_output(self) -> SpeedOutput | None:
        """How the measured speed is fitted as an output; None: it is not looked at."""
        return self.unknowns.speed_output

    @cached_property
    def current_a(self) -> Array:
        """Shape (sample,): every reading."""
        return np.concatenate([history.current_a for history in self.histories] or [np.empty(0)])

    @cached_property
    def spread_a(self) -> float:
        """Standard deviation of the readings."""
        return float(np.std(self.current_a)) if self.current_a.size else 0.0

    @cached_property
    def largest_voltage_v(self) -> float:
        """Largest absolute voltage."""
        voltages_v = [float(np.abs(h.voltage_v).max()) for h in self.histories]
        return max([self.voltage_elsewhere_v, *voltages_v])

    @cached_property
    def quantisation_std_a(self) -> float:
        """Standard deviation that the step of the readings leaves; 0 where there is none."""
        return float(quantisation_step(self.current_a[None])[0]) * STEP_TO_STD

    @cached_property
    def reading_noise_a(self) -> float:
        """Standard deviation of noise that the second differences of the readings show."""
        return difference_noise(self.current_a)

    @cached_property
    def interval_s(self) -> float:
        """Median of all intervals."""
        return float(median(self.intervals_s))

    @cached_property
    def intervals_s(self) -> Array:
        """Every interval, shape (interval,)."""
        return np.concatenate([history.interval_s for history in self.histories])

    @cached_property
    def currents(self) -> Any:
        """Which of a window's residuals are those of currents: an index of them."""
        if self.speed_output is None:
            return slice(None)
        parts = [np.repeat([True, False], one.current_a.size) for one in self.histories]
        return np.concatenate(parts)

    @cached_property
    def moves(self) -> int:
        """How often the voltage has moved by a part of its range, without a pause.

        Noise of its own is no move.
        """
        level = np.concatenate([h.voltage_v for h in self.histories] or [np.zeros(1)])
        if level.size == 1:
            return 0
        least = max(MOVE * float(np.ptp(level)), noise_range(level, self.largest_voltage_v))
        count = 0
        moved_at = -1
        reference = float(level[0])
        for k in (np.flatnonzero(np.diff(level)) + 1).tolist():
            volt = float(level[k])
            if abs(volt - reference) > least:
                count += k > moved_at + 1
                moved_at = k
                reference = volt
        return count

    def tail(self, samples: int) -> Window:
        """Return the newest samples of the newest history."""
        last = self.histories[-1]
        keep = min(samples, last.current_a.size)
        behind = max(self.count - last.place - last.current_a.size, 0)
        part = History(
            last.current_a[-keep:],
            last.voltage_v[1 - keep :],
            last.interval_s[1 - keep :],
            None if last.speed_rad_s is None else last.speed_rad_s[-keep:],
            held_v=None if last.held_v is None else last.held_v[-keep:],
            moment_v=None if last.moment_v is None else last.moment_v[1 - keep :],
        )
        return Window((part,), self.unknowns, keep + behind)

    def delayed(self, delay_s: float) -> Window:
        """Return the samples with voltages that act later by a delay."""
        late = [
            replace(
                one,
                voltage_v=delayed_voltage(one.voltage_v, one.interval_s, delay_s),
                held_v=None,
                moment_v=None,
            )
            for one in self.histories
        ]
        return replace(self, histories=tuple(late))

    def limits(self, back_emf_constant: float) -> Array:
        """Return the states at which a run is given up, shape (state,)."""
        largest = float(np.abs(self.current_a).max(initial=0.0)) + 1e-9
        fastest = (self.largest_voltage_v + LEAST_REACH_V) / back_emf_constant
        return np.array([REACH[0] * largest, REACH[1] * fastest])


def delayed_voltage(voltage_v: Array, interval_s: Array, delay_s: float) -> Array:
    """Return the means over every interval of a voltage that acts later, shape (k,), in V.

    Args:
        voltage_v: shape (k,): mean over every interval, as it is stamped.
        interval_s: shape (k,).
        delay_s: by how much it acts later; the first one has been held before.
    """
    time_s = np.concatenate([[0.0], np.cumsum(interval_s)])
    volt_seconds = np.concatenate([[0.0], np.cumsum(voltage_v * interval_s)])
    before_s = time_s - delay_s
    late = np.interp(before_s, time_s, volt_seconds) + voltage_v[0] * np.minimum(before_s, 0.0)
    return np.asarray(np.diff(late) / np.maximum(interval_s, 1e-12), dtype=float)
