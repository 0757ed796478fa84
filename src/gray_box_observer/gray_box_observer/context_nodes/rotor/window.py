"""Samples of one motor, cut into signal histories, and its free run through them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run, run
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
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
    """

    current_a: Array
    voltage_v: Array
    interval_s: Array


@dataclass(frozen=True)
class Window:
    """Samples of one motor.

    Attributes:
        histories: in the order of time.
    """

    histories: tuple[History, ...]

    @classmethod
    def from_samples(cls, white_box: MotorWhiteBox, samples: Array) -> Window:
        """Cut samples where their signal history starts anew.

        Args:
            white_box: of the motor.
            samples: shape (signal, n), as a replay buffer gives them of one motor.
        """
        finite = np.isfinite(samples[: TORQUE + 1]).all(axis=0)
        samples = samples[:, finite]
        current = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
        begins = np.flatnonzero(samples[INTERVAL] <= 0.0)
        edges = np.unique([0, *begins.tolist(), current.size])
        result = [
            History(
                current[begin:end],
                samples[VOLTAGE, begin + 1 : end],
                samples[INTERVAL, begin + 1 : end],
            )
            for begin, end in pairwise(edges.tolist())
            if end - begin >= FEWEST
        ]
        if len(result) > MOST_HISTORIES:
            shortest = sorted(history.current_a.size for history in result)[-MOST_HISTORIES]
            result = [history for history in result if history.current_a.size >= shortest]
        return cls(tuple(result[-MOST_HISTORIES:]))

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
            last.current_a[-keep:], last.voltage_v[1 - keep :], last.interval_s[1 - keep :]
        )
        return Window((part,))

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
        residual_a: shape (sample,): measured less predicted current.
        by_start: derivatives of the current by the first states of its history, shape (k + 1,
            state), one a history.
        by_parameter: shape (sample, parameter): by the logarithms of the parameters.
        is_bounded: whether all of them stayed within their limits; nothing else is valid if not.
    """

    runs: tuple[Run, ...]
    residual_a: Array
    by_start: tuple[Array, ...]
    by_parameter: Array
    is_bounded: bool

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
        starts: shape (history, state): first states.
        compiled: whether compiled code is used where there is any.
    """
    p = coordinates(white_box, theta)
    by_logarithm = slopes(white_box, p)
    limits = window.limits(float(white_box.known['back_emf_constant']))
    runs = []
    for history, start in zip(window.histories, starts, strict=True):
        torque_constant = float(white_box.torque_constant)
        result = run(
            torque_constant, p, start, history.voltage_v, history.interval_s, limits,
            compiled=compiled,
        )  # fmt: skip
        runs.append(result)
        if not result.is_bounded:
            nothing = np.empty(0)
            return FreeRuns(tuple(runs), nothing, (), nothing, is_bounded=False)
    slope = [result.slopes[:, State.CURRENT] for result in runs]
    residual = [
        history.current_a - result.states[:, State.CURRENT]
        for history, result in zip(window.histories, runs, strict=True)
    ]
    return FreeRuns(
        tuple(runs),
        np.concatenate(residual),
        tuple(one[:, :STATES] for one in slope),
        np.concatenate([one[:, STATES:] @ by_logarithm for one in slope]),
        is_bounded=True,
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
    """First states from the back-EMF that voltage and resistance leave, (history, state)."""
    values = {name: float(value) for name, value in white_box.known.items()}
    values |= dict(zip(white_box.context_nodes, theta.tolist(), strict=True))
    starts = np.empty((len(window.histories), STATES))
    limit = window.largest_voltage_v
    for row, history in enumerate(window.histories):
        few = slice(0, FEWEST)
        current = float(np.median(history.current_a[few]))
        emf = float(np.median(history.voltage_v[few])) - values['resistance'] * current
        starts[row, State.CURRENT] = history.current_a[0]
        starts[row, State.SPEED] = np.clip(emf, -limit, limit) / values['back_emf_constant']
    return starts
