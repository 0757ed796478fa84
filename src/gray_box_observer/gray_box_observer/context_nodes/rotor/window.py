"""Samples of one motor, cut into signal histories, and its free run through them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.filter_readings import FilterReadings
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    LAG,
    LateReadings,
    SpeedOutput,
    Unknowns,
    load_over_intervals,
    load_slopes,
)
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run, run
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.samples.voltage_level import noise_range
from gray_box_observer.white_box.declaration import TERMS, State
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


WORK_A_RUN, STEPS_A_WORK = 1000, 4
"""Work of a run, however few its samples are, and steps of the integration that are one piece of
work; a reading is another one."""

WORK_A_LAG = 6
"""Work of a reading of a current sensor that lags, with its derivatives."""

INDUCTANCE = tuple(TERMS).index('inductance')
RESISTANCE = tuple(TERMS).index('resistance')
"""Places of 1/L and R/L among the coordinates."""

LEAST_LAG = 0.1
"""Share of lag and L/R together that a search begins with for the lag, at least."""

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
    """

    current_a: Array
    voltage_v: Array
    interval_s: Array
    speed_rad_s: Array | None = None
    place: int = 0


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
        result = [
            History(
                current[begin:end],
                samples[VOLTAGE, begin + 1 : end],
                samples[INTERVAL, begin + 1 : end],
                samples[SPEED, begin:end] if has_speed else None,
                int(places[begin]),
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
        )
        return Window((part,), self.unknowns, keep + behind)

    def delayed(self, delay_s: float) -> Window:
        """Return the samples with voltages that act later by a delay."""
        late = [
            replace(one, voltage_v=delayed_voltage(one.voltage_v, one.interval_s, delay_s))
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


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Free runs through every history of a window, at given values.

    Derivatives are made of the runs when they are asked for: a search asks for those of the steps
    that it keeps.

    Attributes:
        window: the samples.
        runs: one a history.
        starts: shape (history, unknown): where each begins.
        p: shape (coordinate,): coordinates of the motor.
        by_logarithm: shape (coordinate, parameter): derivatives of the coordinates by the
            logarithms of the parameters.
        torque_constant: Kt in N m/A.
        is_bounded: whether all of them stayed within their limits; nothing else is valid if not.
    """

    window: Window
    runs: tuple[Run, ...]
    starts: Array
    p: Array
    by_logarithm: Array
    torque_constant: float
    is_bounded: bool

    @property
    def work(self) -> int:
        """Work of the runs and of what is made of them, see :mod:`pieces`."""
        outputs = 1 if self.window.speed_output is None else len(State)
        outputs += 0 if self.window.unknowns.current_sensor is None else WORK_A_LAG
        readings = outputs * sum(int(path.states.shape[0]) for path in self.runs)
        return WORK_A_RUN + readings + sum(path.steps for path in self.runs) // STEPS_A_WORK

    @cached_property
    def _loads(self) -> tuple[Array | None, ...]:
        """Derivatives by the knots of the load, where there are any, one a history."""
        load = self.window.unknowns.load
        pairs = zip(self.window.histories, self.runs, strict=True)
        return tuple(load_slopes(path, history.interval_s, load) for history, path in pairs)

    @cached_property
    def _late(self) -> tuple[LateReadings | None, ...]:
        """When the speed sensor reads, where there is one, one a history."""
        if self.window.speed_output is None:
            return (None,) * len(self.runs)
        return tuple(
            LateReadings.along(history.interval_s, start)
            for history, start in zip(self.window.histories, self.starts, strict=True)
        )

    @cached_property
    def _filter(self) -> tuple[FilterReadings | None, ...]:
        """What the current sensor reads where it lags, one a history."""
        unknowns = self.window.unknowns
        sensor = unknowns.current_sensor
        if sensor is None:
            return (None,) * len(self.runs)
        place = unknowns.current_lag
        histories = zip(self.window.histories, self.runs, self.starts, strict=True)
        return tuple(
            FilterReadings(
                path.states,
                history.interval_s,
                float(start[place]),
                float(start[place + 1]),
                self.p,
                self.torque_constant,
                sensor.is_digital,
            )
            for history, path, start in histories
        )

    @property
    def resistance_ohm(self) -> float:
        """R in ohm."""
        return float(self.p[RESISTANCE] / self.p[INDUCTANCE])

    @property
    def winding_s(self) -> float:
        """L/R in s."""
        return 1.0 / float(self.p[RESISTANCE])

    @property
    def read_a(self) -> tuple[Array, ...]:
        """Currents that the sensor reads but for its noise, shape (k + 1,) each, one a history."""
        return tuple(
            path.states[:, State.CURRENT] if behind is None else behind.current_a
            for path, behind in zip(self.runs, self._filter, strict=True)
        )

    @cached_property
    def residual_a(self) -> Array:
        """Measured less predicted current, shape (reading,).

        Where the speed is an output, that of the speed follows in every history, in the unit of
        the current's noise.
        """
        parts = zip(self.window.histories, self.runs, self._late, self.read_a, strict=True)
        return np.concatenate(
            [
                residual
                for history, path, late, read_a in parts
                for residual in _residuals(history, path, late, read_a, self.window.unknowns)
            ]
        )

    @cached_property
    def derivatives(self) -> tuple[Array, ...]:
        """Derivatives of the readings by all unknowns, one a history.

        Shape (reading, unknown + parameter) each: by the unknowns of the history, first states
        before all, then by the logarithms of the parameters.
        """
        parts = zip(self.runs, self._late, self._filter, self._loads, strict=True)
        return tuple(
            _derivatives(path, late, behind, knots, self.by_logarithm, self.window)
            for path, late, behind, knots in parts
        )

    @property
    def by_start(self) -> tuple[Array, ...]:
        """Derivatives of the readings by the unknowns of their history, one a history.

        Shape (reading, unknown) each.
        """
        unknowns = self.starts.shape[1]
        return tuple(of_history[:, :unknowns] for of_history in self.derivatives)

    @property
    def by_parameter(self) -> Array:
        """Derivatives by the logarithms of the parameters, shape (reading, parameter)."""
        unknowns = self.starts.shape[1]
        return np.concatenate([of_history[:, unknowns:] for of_history in self.derivatives])

    def readings_of(self, states: Array, row: int) -> Array:
        """Return what both sensors read of small changes of the states, shape (reading,).

        Where the current lags, what its sensor keeps is left out.

        Args:
            states: shape (k + 1, state): of one history.
            row: which history.
        """
        late = self._late[row]
        output = self.window.speed_output
        current = states[:, State.CURRENT]
        if late is None or output is None:
            return current
        speed = late.is_covered * output.unit_a_s * late.of_signal(states[:, State.SPEED])
        return np.concatenate([current, speed])

    def of_output(self, state: State) -> Array:
        """Return the residuals of one output, shape (sample,), in the unit of the current."""
        begin = 0
        parts = []
        outputs = 1 if self.window.speed_output is None else len(State)
        for path in self.runs:
            count = path.states.shape[0]
            parts.append(self.residual_a[begin + state * count :][:count])
            begin += outputs * count
        return np.concatenate(parts)

    @property
    def speed_rad_s(self) -> Array:
        """Shape (sample,)."""
        return np.concatenate([run.states[:, State.SPEED] for run in self.runs])


def free_runs(
    white_box: MotorWhiteBox,
    theta: Array,
    window: Window,
    starts: Array,
    *,
    is_compiled: bool = True,
) -> FreeRuns:
    """Run freely through every history.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.
        starts: shape (history, unknown): first states, and what else is free
            (:mod:`~gray_box_observer.context_nodes.rotor.history_unknowns`).
        is_compiled: whether compiled code is used where there is any.
    """
    p = coordinates(white_box, theta)
    by_logarithm = slopes(white_box, p)
    limits = window.limits(float(white_box.known['back_emf_constant']))
    torque_constant = float(white_box.torque_constant)
    runs = []
    for history, start in zip(window.histories, starts, strict=True):
        load = load_over_intervals(start[window.unknowns.loads], history.interval_s)
        result = run(
            torque_constant, p, start[:STATES], history.voltage_v, history.interval_s, limits, load,
            is_compiled=is_compiled,
        )  # fmt: skip
        runs.append(result)
        if not result.is_bounded:
            break
    is_bounded = runs[-1].is_bounded if runs else True
    return FreeRuns(
        window, tuple(runs), starts, p, by_logarithm, torque_constant, is_bounded=is_bounded
    )


def _residuals(
    history: History,
    path: Run,
    late: LateReadings | None,
    read_a: Array,
    unknowns: Unknowns,
) -> tuple[Array, ...]:
    """Return what a run leaves of a history's readings, one array an output."""
    output = unknowns.speed_output
    current = history.current_a - read_a
    if unknowns.current_sensor is not None:
        current = unknowns.current_sensor.whitened(current)
    if output is None or late is None or history.speed_rad_s is None:
        return (current,)
    off = history.speed_rad_s - late.of_signal(path.states[:, State.SPEED])
    return current, late.is_covered * output.unit_a_s * off


def _derivatives(
    path: Run,
    late: LateReadings | None,
    behind: FilterReadings | None,
    load_by_knot: Array | None,
    by_logarithm: Array,
    window: Window,
) -> Array:
    """Derivatives of a history's readings, shape (reading, unknown + parameter)."""
    output = window.speed_output
    count = path.states.shape[0]
    unknowns = window.unknowns.count
    outputs = 1 if output is None or late is None else len(State)
    result = np.zeros((outputs, count, unknowns + by_logarithm.shape[1]))
    result[:, :, :STATES] = path.slopes[:, :outputs, :STATES].swapaxes(0, 1)
    result[:, :, unknowns:] = path.slopes[:, :outputs, STATES:].swapaxes(0, 1) @ by_logarithm
    if load_by_knot is not None:
        result[:, :, window.unknowns.loads] = load_by_knot[:, :outputs].swapaxes(0, 1)
    if output is None or late is None:
        return result.reshape(count, -1)
    sensor = window.unknowns.current_sensor
    if sensor is not None and behind is not None:
        place = window.unknowns.current_lag
        own = [place, place + 1]
        others = np.delete(np.arange(result.shape[2]), own)
        by_reading = sensor.whitened(
            behind.derivatives(result[:, :, others].swapaxes(0, 1), by_logarithm)
        )
        result[State.CURRENT][:, others] = by_reading[:, :-2]
        result[State.CURRENT][:, own] = by_reading[:, -2:]
    speed = late.of_signal(result[State.SPEED])
    speed[:, LAG] = late.by_lag(path.states[:, State.SPEED])
    speed *= (late.is_covered * output.unit_a_s)[:, None]
    result[State.SPEED] = speed
    return result.reshape(outputs * count, -1)


def rotor_current(white_box: MotorWhiteBox, theta: Array, samples: Array) -> Array:
    """Run freely from the first reading of every history, whose speed is guessed from its voltage.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        samples: shape (signal, n): interval in s, voltage in V and torque in N m.

    Returns:
        Shape (n,): current in A; NaN where the values cannot be run.
    """

    def run_of(window: Window) -> FreeRuns | None:
        runs = free_runs(white_box, theta, window, guessed_starts(white_box, theta, window))
        return runs if runs.is_bounded else None

    return current_of_histories(white_box, samples, run_of)


def current_of_histories(
    white_box: MotorWhiteBox, samples: Array, run_of: Callable[[Window], FreeRuns | None]
) -> Array:
    """Run through every history by itself; only its first reading is taken over.

    Args:
        white_box: of one motor with a rotor.
        samples: shape (signal, n): interval in s, voltage in V and torque in N m.
        run_of: runs a window of one history, and leaves out no reading; None: it cannot be run.

    Returns:
        Shape (n,): current in A; NaN where a history cannot be run.
    """
    result = np.full(samples.shape[1], np.nan)
    current = np.asarray(white_box.state(samples[TORQUE]), dtype=float)
    begins = np.flatnonzero(samples[INTERVAL] <= 0.0).tolist()
    for begin, end in pairwise(sorted({0, *begins, current.size})):
        between = slice(begin + 1, end)
        history = History(current[begin:end], samples[VOLTAGE, between], samples[INTERVAL, between])
        result[begin] = current[begin]
        if end - begin > 1:
            runs = run_of(Window((history,)))
            if runs is not None:
                result[begin:end] = history.current_a - runs.residual_a
    return result


def guessed_starts(white_box: MotorWhiteBox, theta: Array, window: Window) -> Array:
    """First states from the back-EMF that voltage and resistance leave, (history, unknown)."""
    values = white_box.values(theta)
    starts = np.zeros((len(window.histories), window.unknowns.count))
    limit = window.largest_voltage_v
    for row, history in enumerate(window.histories):
        few = slice(0, FEWEST)
        current = float(median(history.current_a[few]))
        emf = float(median(history.voltage_v[few])) - values['resistance'] * current
        starts[row, State.CURRENT] = history.current_a[0]
        starts[row, State.SPEED] = np.clip(emf, -limit, limit) / values['back_emf_constant']
        if history.speed_rad_s is not None:
            starts[row, State.SPEED] = median(history.speed_rad_s[few])
    sensor = window.unknowns.current_sensor
    if sensor is not None:
        place = window.unknowns.current_lag
        winding_s = values['inductance'] / values['resistance']
        starts[:, place] = max(sensor.sum_s - winding_s, LEAST_LAG * sensor.sum_s)
        starts[:, place + 1] = starts[:, State.CURRENT]
    return starts
