"""Samples of one motor, cut into signal histories, and its free run through them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    SpeedOutput,
    current_by_unknown,
    load_over_intervals,
    load_slopes,
    speed_readings,
)
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run, run
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.white_box.declaration import State
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


MOVE = 0.1
"""Share of its range by which a voltage has moved."""


@dataclass(frozen=True, slots=True)
class History:
    """Samples between two restarts.

    Attributes:
        current_a: shape (k + 1,): measured.
        voltage_v: shape (k,): mean over every interval.
        interval_s: shape (k,).
        speed_rad_s: shape (k + 1,): measured; None where it is not looked at.
        place: of its first sample among those that the window was made of.
    """

    current_a: Array
    voltage_v: Array
    interval_s: Array
    speed_rad_s: Array | None = None
    place: int = 0


@dataclass(frozen=True)
class Window:
    """Samples of one motor.

    Attributes:
        histories: in the order of time.
        speed_output: how the measured speed is fitted as an output; None: it is not looked at.
    """

    histories: tuple[History, ...]
    speed_output: SpeedOutput | None = None

    @classmethod
    def from_samples(
        cls, white_box: MotorWhiteBox, samples: Array, speed_output: SpeedOutput | None = None
    ) -> Window:
        """Cut samples where their signal history starts anew.

        Args:
            white_box: of the motor.
            samples: shape (signal, n), as a replay buffer gives them of one motor.
            speed_output: how their speed is fitted; None: it is not.
        """
        signals = SPEED if speed_output is None else SPEED + 1
        finite = np.isfinite(samples[:signals]).all(axis=0)
        places = np.flatnonzero(finite)
        samples = samples[:, finite]
        current = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
        begins = np.flatnonzero(samples[INTERVAL] <= 0.0)
        edges = np.unique([0, *begins.tolist(), current.size])
        result = [
            History(
                current[begin:end],
                samples[VOLTAGE, begin + 1 : end],
                samples[INTERVAL, begin + 1 : end],
                None if speed_output is None else samples[SPEED, begin:end],
                int(places[begin]),
            )
            for begin, end in pairwise(edges.tolist())
            if end - begin >= FEWEST
        ]
        if len(result) > MOST_HISTORIES:
            shortest = sorted(history.current_a.size for history in result)[-MOST_HISTORIES]
            result = [history for history in result if history.current_a.size >= shortest]
        return cls(tuple(result[-MOST_HISTORIES:]), speed_output)

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
        return max((float(np.abs(h.voltage_v).max()) for h in self.histories), default=0.0)

    @cached_property
    def quantisation_std_a(self) -> float:
        """Standard deviation that the step of the readings leaves; 0 where there is none."""
        return float(quantisation_step(self.current_a[None])[0]) * STEP_TO_STD

    @cached_property
    def currents(self) -> Any:
        """Which of a window's residuals are those of currents: an index of them."""
        if self.speed_output is None:
            return slice(None)
        parts = [np.repeat([True, False], one.current_a.size) for one in self.histories]
        return np.concatenate(parts)

    @cached_property
    def moves(self) -> int:
        """How often the voltage has moved by a part of its range, without a pause."""
        level = np.concatenate([h.voltage_v for h in self.histories] or [np.zeros(1)])
        least = MOVE * float(np.ptp(level))
        count, moved_at, reference = 0, -1, float(level[0])
        for k in (np.flatnonzero(np.diff(level)) + 1).tolist():
            volt = float(level[k])
            if abs(volt - reference) > least:
                count += k > moved_at + 1
                moved_at, reference = k, volt
        return count

    def tail(self, samples: int) -> Window:
        """Return the newest samples of the newest history."""
        last = self.histories[-1]
        keep = min(samples, last.current_a.size)
        part = History(
            last.current_a[-keep:],
            last.voltage_v[1 - keep :],
            last.interval_s[1 - keep :],
            None if last.speed_rad_s is None else last.speed_rad_s[-keep:],
        )
        return Window((part,), self.speed_output)

    def limits(self, back_emf_constant: float) -> Array:
        """Return the states at which a run is given up, shape (state,)."""
        largest = float(np.abs(self.current_a).max(initial=0.0)) + 1e-9
        fastest = (self.largest_voltage_v + LEAST_REACH_V) / back_emf_constant
        return np.array([REACH[0] * largest, REACH[1] * fastest])


@dataclass(frozen=True, slots=True)
class FreeRuns:
    """Free runs through every history of a window, at given values.

    Attributes:
        runs: one a history.
        residual_a: shape (reading,): measured less predicted current; where the speed is an output,
            that of the speed follows in every history, in the unit of the current's noise.
        by_start: derivatives of these by the unknowns of their history, first states before all,
            shape (reading, unknown), one a history.
        by_parameter: shape (reading, parameter): by the logarithms of the parameters.
        is_bounded: whether all of them stayed within their limits; nothing else is valid if not.
    """

    runs: tuple[Run, ...]
    residual_a: Array
    by_start: tuple[Array, ...]
    by_parameter: Array
    is_bounded: bool

    def of_output(self, state: State) -> Array:
        """Return the residuals of one output, shape (sample,), in the unit of the current."""
        begin, parts = 0, []
        for path, by_start in zip(self.runs, self.by_start, strict=True):
            first = begin + state * path.states.shape[0]
            parts.append(self.residual_a[first : first + path.states.shape[0]])
            begin += by_start.shape[0]
        return np.concatenate(parts)

    @property
    def speed_rad_s(self) -> Array:
        """Shape (sample,)."""
        return np.concatenate([run.states[:, State.SPEED] for run in self.runs])


def free_runs(
    white_box: MotorWhiteBox, theta: Array, window: Window, starts: Array, *, compiled: bool = True
) -> FreeRuns:
    """Run freely through every history.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.
        starts: shape (history, unknown): first states, and where the speed is an output its other
            unknowns (:mod:`~gray_box_observer.context_nodes.rotor.history_unknowns`).
        compiled: whether compiled code is used where there is any.
    """
    p = coordinates(white_box, theta)
    by_logarithm = slopes(white_box, p)
    limits = window.limits(float(white_box.known['back_emf_constant']))
    runs = []
    for history, start in zip(window.histories, starts, strict=True):
        torque_constant = float(white_box.torque_constant)
        load = load_over_intervals(start, history.interval_s)
        result = run(
            torque_constant, p, start[:STATES], history.voltage_v, history.interval_s, limits, load,
            compiled=compiled,
        )  # fmt: skip
        runs.append(result)
        if not result.is_bounded:
            nothing = np.empty(0)
            return FreeRuns(tuple(runs), nothing, (), nothing, is_bounded=False)
    read = [
        _readings(history, result, start, window.speed_output)
        for history, result, start in zip(window.histories, runs, starts, strict=True)
    ]
    return FreeRuns(
        tuple(runs),
        np.concatenate([residual for residual, _, _ in read]),
        tuple(by_start for _, by_start, _ in read),
        np.concatenate([by_coordinate @ by_logarithm for _, _, by_coordinate in read]),
        is_bounded=True,
    )


def _readings(
    history: History, path: Run, start: Array, output: SpeedOutput | None
) -> tuple[Array, Array, Array]:
    """Return what a run leaves of a history's readings, and their derivatives by all unknowns."""
    residual = history.current_a - path.states[:, State.CURRENT]
    slope = path.slopes[:, State.CURRENT]
    if output is None or history.speed_rad_s is None:
        return residual, slope[:, :STATES], slope[:, STATES:]
    knots = load_slopes(path, history.interval_s, start)
    read = speed_readings(path, history.interval_s, start, knots)
    counts = (read.is_covered * output.unit_a_s)[:, None]
    off = counts[:, 0] * (history.speed_rad_s - read.speed_rad_s)
    return (
        np.concatenate([residual, off]),
        np.concatenate([current_by_unknown(path, knots), counts * read.by_unknown]),
        np.concatenate([slope[:, STATES:], counts * read.by_coordinate]),
    )


def rotor_current(white_box: MotorWhiteBox, theta: Array, samples: Array) -> Array:
    """Run freely from the first reading of every history, whose speed is guessed from its voltage.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        samples: shape (signal, n): interval in s, voltage in V and torque in N m.

    Returns:
        Shape (n,): current in A; NaN where the values cannot be run.
    """
    result = np.full(samples.shape[1], np.nan)
    current = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
    begins = np.flatnonzero(samples[INTERVAL] <= 0.0).tolist()
    for begin, end in pairwise(sorted({0, *begins, current.size})):
        between = slice(begin + 1, end)
        history = History(current[begin:end], samples[VOLTAGE, between], samples[INTERVAL, between])
        window = Window((history,))
        result[begin] = current[begin]
        if end - begin > 1:
            runs = free_runs(white_box, theta, window, guessed_starts(white_box, theta, window))
            if runs.is_bounded:
                result[begin:end] = history.current_a - runs.residual_a
    return result


def guessed_starts(white_box: MotorWhiteBox, theta: Array, window: Window) -> Array:
    """First states from the back-EMF that voltage and resistance leave, (history, unknown)."""
    values = {name: float(value) for name, value in white_box.known.items()}
    values |= dict(zip(white_box.context_nodes, theta.tolist(), strict=True))
    output = window.speed_output
    unknowns = STATES if output is None else output.unknowns
    starts = np.zeros((len(window.histories), unknowns))
    limit = window.largest_voltage_v
    for row, history in enumerate(window.histories):
        few = slice(0, FEWEST)
        current = float(np.median(history.current_a[few]))
        emf = float(np.median(history.voltage_v[few])) - values['resistance'] * current
        starts[row, State.CURRENT] = history.current_a[0]
        starts[row, State.SPEED] = np.clip(emf, -limit, limit) / values['back_emf_constant']
        if history.speed_rad_s is not None:
            starts[row, State.SPEED] = np.median(history.speed_rad_s[few])
    return starts
