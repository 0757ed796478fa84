"""Free runs of a motor through the histories of a window: residuals, and how they answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.filter_readings import FilterReadings
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    LAG,
    LateReadings,
    Unknowns,
    load_over_intervals,
    load_slopes,
)
from gray_box_observer.context_nodes.rotor.noise_filter import NoiseFilter, ReadingNoise, rests
from gray_box_observer.context_nodes.rotor.noise_memory import without_memory
from gray_box_observer.context_nodes.rotor.rotor_trajectory import PATIENCE, STATES, Run, run
from gray_box_observer.context_nodes.rotor.window import FEWEST, History, Window
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

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

WORK_A_FILTER = 1
"""Work of a reading where noise of the voltage is taken off."""

PATIENCE_WITH_SPEED = 2 * PATIENCE
"""Steps an interval on average beyond which a run is given up whose speed is measured: a rotor at
rest beside a noisy voltage takes many, and that it is no faster shows."""


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
        noise: of voltages and readings, which is taken off residuals and derivatives; None: none.
    """

    window: Window
    runs: tuple[Run, ...]
    starts: Array
    p: Array
    by_logarithm: Array
    torque_constant: float
    is_bounded: bool
    noise: ReadingNoise | None = None

    @property
    def work(self) -> int:
        """Work of the runs and of what is made of them, see :mod:`pieces`."""
        outputs = 1 if self.window.speed_output is None else len(State)
        outputs += 0 if self.window.unknowns.current_sensor is None else WORK_A_LAG
        outputs += 0 if self.noise is None else WORK_A_FILTER
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

    @property
    def misread_a(self) -> list[Array]:
        """Measured less predicted currents, shape (k + 1,) each, one a history."""
        pairs = zip(self.window.histories, self.read_a, strict=True)
        return [history.current_a - read_a for history, read_a in pairs]

    @cached_property
    def _measured_residuals(self) -> tuple[tuple[Array, ...], ...]:
        """Measured less predicted values, one array an output, of every history."""
        parts = zip(self.window.histories, self.runs, self._late, self.read_a, strict=True)
        return tuple(
            _residuals(history, path, late, read_a, self.window.unknowns)
            for history, path, late, read_a in parts
        )

    @cached_property
    def residual_a(self) -> Array:
        """Measured less predicted current, shape (reading,).

        Where the speed is an output, that of the speed follows in every history, in the unit of
        the current's noise. What noise of the voltage does is taken off, where that is known.
        """
        if self.noise is None:
            return np.concatenate([one for parts in self._measured_residuals for one in parts])
        pairs = zip(self._noise_filters, self._measured_residuals, strict=True)
        return np.concatenate(
            [self._without_noise(own, np.stack(parts)[:, :, None]) for own, parts in pairs]
        )[:, 0]

    def without_noise(self, rows: Array, row: int) -> Array:
        """Return signals of a history's readings as its residual is: noise of the voltage off.

        Args:
            rows: shape (reading, column).
            row: which history.
        """
        if self.noise is None:
            return rows
        outputs = len(self._measured_residuals[row])
        return self._without_noise(
            self._noise_filters[row], rows.reshape(outputs, -1, rows.shape[1])
        )

    def response(self, voltages_v: Array, row: int) -> Array:
        """Return by how much small voltages move the states of a history, (k + 1, column, state).

        Args:
            voltages_v: shape (k, column): over every interval.
            row: which history.
        """
        return self._noise_filters[row].response(voltages_v)

    @property
    def noise_information(self) -> Array:
        """What noise alone adds to products of derivatives by parameters, (parameter, parameter).

        Of white readings of unit variance; 0 where no noise of the voltage is known.
        """
        parameters = self.by_logarithm.shape[1]
        result = np.zeros((parameters, parameters))
        if self.noise is not None:
            for own in self._noise_filters:
                result += own.noise_information(self._noisy_outputs, self.by_logarithm)
        return result

    def probable_speed(self, row: int) -> Array:
        """Return the speed in a history in rad/s, as it probably is, shape (k + 1,).

        Noise of the voltage has moved that of the run; what the readings tell of it is added.

        Args:
            row: which history.
        """
        speed: Array = self.runs[row].states[:, State.SPEED]
        if self.noise is None:
            return speed
        rows = np.stack(self._measured_residuals[row])[: self._noisy_outputs, :, None]
        return speed + self._noise_filters[row].deviations(rows)[:, State.SPEED]

    @cached_property
    def derivatives(self) -> tuple[Array, ...]:
        """Derivatives of the readings by all unknowns, one a history.

        Shape (reading, unknown + parameter) each: by the unknowns of the history, first states
        before all, then by the logarithms of the parameters.
        """
        parts = zip(self.runs, self._late, self._filter, self._loads, strict=True)
        derivatives = tuple(
            _derivatives(path, late, behind, knots, self.by_logarithm, self.window)
            for path, late, behind, knots in parts
        )
        if self.noise is None:
            return derivatives
        unknowns = self.starts.shape[1]
        result = []
        filters = zip(self._noise_filters, derivatives, self._measured_residuals, strict=True)
        for own, by_unknown, parts_a in filters:
            slopes_a = by_unknown.reshape(len(parts_a), -1, by_unknown.shape[1])
            white = self._without_noise(own, slopes_a)
            rows = np.stack(parts_a)[: self._noisy_outputs, :, None]
            moves = own.slopes(rows, self.by_logarithm)
            moves = moves.reshape(-1, moves.shape[2])
            white[: moves.shape[0], unknowns:] -= moves
            result.append(white)
        return tuple(result)

    @property
    def _noisy_outputs(self) -> int:
        """How many outputs the noise of the voltage is taken off of."""
        assert self.noise is not None
        return len(State) if self.window.speed_output and self.noise.follows_speed else 1

    @cached_property
    def _noise_filters(self) -> tuple[NoiseFilter, ...]:
        """What takes the noise of the voltage off, one a history."""
        assert self.noise is not None
        output = self.window.speed_output
        is_at_rest = rests(self.speed_rad_s) | (not self.noise.turns_rotor)
        begin = 0
        filters = []
        for history, late in zip(self.window.histories, self._late, strict=True):
            count = history.current_a.size
            own_rest = is_at_rest[begin : begin + count]
            begin += count
            filters.append(
                NoiseFilter(
                    history.interval_s,
                    self.noise.variances_v2(history.interval_s),
                    own_rest[1:] & own_rest[:-1],
                    np.zeros(count, dtype=bool) if late is None else late.is_covered,
                    0.0 if output is None else output.unit_a_s,
                    self.noise.current_a,
                    self.p,
                    self.torque_constant,
                    self.mean_speed_rad_s,
                )
            )
        return tuple(filters)

    def _without_noise(self, own: NoiseFilter, rows: Array) -> Array:
        """Return rows of a history without the noise, (output, sample, column) as one.

        Args:
            own: of the history.
            rows: shape (output, sample, column).
        """
        count = self._noisy_outputs
        parts = [own.white_rows(rows[:count]), *rows[count:, None]]
        return np.concatenate([one.reshape(-1, rows.shape[2]) for one in parts])

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

    def beyond_starts(self, columns: Array, row: int) -> Array:
        """Return what the unknowns of a history cannot explain of signals of its readings.

        Args:
            columns: shape (reading, column).
            row: which history.
        """
        starts = self.by_start[row]
        return np.asarray(columns - starts @ np.linalg.lstsq(starts, columns, rcond=1e-9)[0])

    def readings_of(self, states: Array, row: int) -> Array:
        """Return what both sensors read of small changes of the states, shape (reading,).

        Where the current lags, what its sensor keeps is left out.

        Args:
            states: shape (k + 1, state): of one history.
            row: which history.
        """
        late = self._late[row]
        output = self.window.speed_output
        current = without_memory(states[:, State.CURRENT], self.window.unknowns.memory)
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

    @cached_property
    def mean_speed_rad_s(self) -> float:
        """Mean size of the speed."""
        return float(np.mean(np.abs(self.speed_rad_s)))

    @cached_property
    def speed_rad_s(self) -> Array:
        """Shape (sample,)."""
        return np.concatenate([run.states[:, State.SPEED] for run in self.runs])


def free_runs(
    white_box: MotorWhiteBox,
    theta: Array,
    window: Window,
    starts: Array,
    *,
    noise: ReadingNoise | None = None,
    is_compiled: bool = True,
) -> FreeRuns:
    """Run freely through every history.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        window: the samples.
        starts: shape (history, unknown): first states, and what else is free
            (:mod:`~gray_box_observer.context_nodes.rotor.history_unknowns`).
        noise: of voltages and readings, which is taken off; None: none.
        is_compiled: whether compiled code is used where there is any.
    """
    p = coordinates(white_box, theta)
    by_logarithm = slopes(white_box, p)
    limits = window.limits(float(white_box.known['back_emf_constant']))
    torque_constant = float(white_box.torque_constant)
    patience = PATIENCE if window.speed_output is None else PATIENCE_WITH_SPEED
    runs = []
    for history, start in zip(window.histories, starts, strict=True):
        load = load_over_intervals(start[window.unknowns.loads], history.interval_s)
        result = _run(
            torque_constant, p, start[:STATES], history, limits, load,
            patience=patience, is_compiled=is_compiled,
        )  # fmt: skip
        runs.append(result)
        if not result.is_bounded:
            break
    is_bounded = runs[-1].is_bounded if runs else True
    return FreeRuns(
        *(window, tuple(runs), starts, p, by_logarithm, torque_constant),
        is_bounded=is_bounded,
        noise=noise,
    )


def _run(
    torque_constant: float,
    p: Array,
    start: Array,
    history: History,
    limits: Array,
    load_rad_s2: Array | None,
    *,
    patience: int,
    is_compiled: bool,
) -> Run:
    """Run freely through one history; see :func:`run`."""
    parts = history.parts
    if parts is None:
        return run(
            torque_constant, p, start, history.voltage_v, history.interval_s, limits, load_rad_s2,
            patience=patience, is_compiled=is_compiled,
        )  # fmt: skip
    result = run(
        torque_constant, p, start, parts.voltage_v, parts.interval_s, limits,
        parts.repeated(load_rad_s2), patience=patience, is_compiled=is_compiled,
    )  # fmt: skip
    return parts.over_intervals(result) if result.is_bounded else result


def _residuals(
    history: History,
    path: Run,
    late: LateReadings | None,
    read_a: Array,
    unknowns: Unknowns,
) -> tuple[Array, ...]:
    """Return what a run leaves of a history's readings, one array an output."""
    output = unknowns.speed_output
    current = without_memory(history.current_a - read_a, unknowns.memory)
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
    memory = window.unknowns.memory
    if output is None or late is None:
        return without_memory(result.reshape(count, -1), memory)
    if behind is not None:
        place = window.unknowns.current_lag
        own = [place, place + 1]
        others = np.delete(np.arange(result.shape[2]), own)
        by_reading = without_memory(
            behind.derivatives(result[:, :, others].swapaxes(0, 1), by_logarithm), memory
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
