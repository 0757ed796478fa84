"""The way of a voltage from the command of the driver to the current that the sensor shows.

A driver gives nothing for commands within its dead zone. One that coasts opens the winding there:
nobody knows the voltage then, and no current flows. A sensor that lags by first order shows
the current of a voltage that lags alike, for what is linear may change places. The white box holds
its voltage over an interval, and a voltage that lags moves within it. Its place takes the constant
voltage that brings a winding of the same time constant L/R to the same end
(docs/METHOD.md, Which effects). A moving average of the readings is undone instead: two in a row
tell the newest value in it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    LARGEST_SIGNAL,
    ArrayRule,
    check_array,
    number,
)
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE, forget_moves
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box.interface import Array

LONGEST = 2048
"""Newest commands that are remembered, for trials of other forms."""

SETTLED = 12.0
"""Time constants of a lag after which nothing depends any more on where it began: 6e-6 is left."""

NEGLIGIBLE = 1e-9

SHORTEST = 1e-4
"""Shortest interval, in time constants of the winding, of whose mean a share is worked out."""


class VoltagePath:
    """Makes of commands the voltages that the white box takes, and of readings its torques.

    Where a signal history begins, what lags is unknown for some time. Samples that come meanwhile
    begin a history each: they teach nothing.

    Args:
        dead_zone_v: shape (motor,): commands up to which nothing drives a motor; 0: there are none.
        lag: of the current sensor, of one motor alone; None: there is none.
        coasts: whether such commands open the winding, of one motor alone, without a lag.
    """

    def __init__(
        self, dead_zone_v: Array, lag: CurrentLag | None = None, *, coasts: bool = False
    ) -> None:
        self._dead_zone_v = dead_zone_v
        is_average = lag is not None and lag.is_average
        self._lag = None if is_average else lag
        self._average = lag if is_average else None
        self._coasts = coasts
        self._lagging_v = np.zeros(dead_zone_v.shape)
        self._since_s = np.zeros(dead_zone_v.shape)  # the signal history began
        self._reading_nm = np.zeros(dead_zone_v.shape)  # the newest one, as it came
        self._commands_v: deque[float] = deque(maxlen=LONGEST)
        self._readings_nm: deque[float] = deque(maxlen=LONGEST)  # where they are averaged

    @property
    def has_lag(self) -> bool:
        """Whether the current of the white box lags, as that of the sensor does."""
        return self._lag is not None

    @property
    def has_filter(self) -> bool:
        """Whether the current sensor lags, or averages its readings."""
        return self.has_lag or self._average is not None

    @property
    def _needs_one_before(self) -> bool:
        """Whether a sample leans on the one before, and on no other."""
        return self._average is not None or (self._lag is not None and not self._lag.settles)

    def newest_share(self, interval_s: float) -> float:
        """Return the weight of the newest value in a reading after an interval in s."""
        average = self._average
        return 1.0 if average is None else -math.expm1(-interval_s / average.lag_s)

    def voltage(self, interval_s: Array, command_v: Array) -> Array:
        """Return the voltage over the next interval in V; changes nothing.

        Args:
            interval_s: shape (motor,): in s; 0 where a signal history begins.
            command_v: shape (motor,): over the interval.
        """
        return self._voltage_and_end(self._lagging_v, interval_s, command_v)[0]

    def known_interval(self, interval_s: Array, command_v: Array) -> Array:
        """Return the next interval in s, shape (motor,); 0 where its voltage is not known.

        Args:
            interval_s: as in :meth:`voltage`.
            command_v: likewise.
        """
        if self._coasts:
            return np.where(self._opens(command_v), 0.0, interval_s)
        if self._needs_one_before:  # the sample before it belongs to the history
            return np.where((interval_s > 0.0) & (self._since_s > 0.0), interval_s, 0.0)
        if self._lag is None:
            return interval_s
        since_s = self._since_s + interval_s
        is_known = (interval_s > 0.0) & (since_s > SETTLED * self._lag.lag_s)
        return np.where(is_known, interval_s, 0.0)

    def voltage_after(
        self, ahead: tuple[Array, Array] | None, interval_s: Array, command_v: Array
    ) -> Array:
        """Return the voltage over the interval after the next in V; changes nothing.

        Args:
            ahead: interval and command of the next, shape (motor,) each; None: there is none.
            interval_s: shape (motor,): of the one after.
            command_v: likewise.
        """
        lagging_v = self._lagging_v
        if ahead is not None:
            lagging_v = self._voltage_and_end(lagging_v, *ahead)[1]
        return self._voltage_and_end(lagging_v, interval_s, command_v)[0]

    def follow(self, sample: Sample, *, is_kept: bool) -> Sample:
        """Go on by a sample; return it with the voltage.

        Args:
            sample: with the command.
            is_kept: whether it is remembered elsewhere, and its command here.
        """
        if is_kept and self._is_alone:
            self._commands_v.append(float(sample.voltage_v[0]))
        interval_s = sample.interval_s
        known_interval_s = self.known_interval(interval_s, sample.voltage_v)
        if not self.has_filter:
            voltage_v = _outside(sample.voltage_v, self._dead_zone_v)
            return sample._replace(
                voltage_v=voltage_v, interval_s=known_interval_s, held_v=voltage_v, moment_v=None
            )
        voltage_v, self._lagging_v = self._voltage_and_end(
            self._lagging_v, interval_s, sample.voltage_v
        )
        self._since_s = np.where(interval_s > 0.0, self._since_s + interval_s, 0.0)
        torque_nm = sample.torque_nm
        if self._average is not None:
            if is_kept:
                self._readings_nm.append(float(torque_nm[0]))
            torque_nm = _newest_values(self._average, interval_s, self._reading_nm, torque_nm)
            self._reading_nm = sample.torque_nm
        return sample._replace(
            voltage_v=voltage_v,
            torque_nm=torque_nm,
            interval_s=known_interval_s,
            held_v=voltage_v,
            moment_v=None,
        )

    def follow_content(self, content: Array) -> Array:
        """Begin anew with samples, shape (signal, 1, n); return them with the voltages."""
        path_content, self._lagging_v, self._since_s = self._driven_to_end(content)
        self._reading_nm = content[TORQUE, :, -1].copy()
        self._commands_v.clear()
        self._commands_v.extend(content[VOLTAGE, 0].tolist())
        self._readings_nm.clear()
        if self._average is not None:
            self._readings_nm.extend(content[TORQUE, 0].tolist())
        return path_content

    def driven(self, content: Array) -> Array:
        """Return samples, shape (signal, motor, n), with the voltages; changes nothing."""
        return self._driven_to_end(content)[0]

    def is_open(self, content: Array) -> NDArray[np.bool_]:
        """Tell before which samples the winding was open, shape (motor, n).

        Args:
            content: shape (signal, motor, n): the samples, as they were measured.
        """
        if not self._coasts:
            return np.zeros(content.shape[1:], dtype=bool)
        opens: NDArray[np.bool_] = self._opens(content[VOLTAGE]) & (content[INTERVAL] > 0.0)
        return opens

    def opens(self, command_v: Array) -> bool:
        """Tell whether commands, shape (motor,), open every winding."""
        return self._coasts and bool(self._opens(command_v).all())

    def _opens(self, command_v: Array) -> NDArray[np.bool_]:
        """Tell of commands of one motor, any shape, whether they open its winding."""
        opens: NDArray[np.bool_] = np.abs(command_v) <= self._dead_zone_v[0]
        return opens

    @property
    def _is_alone(self) -> bool:
        """Whether the path is of one motor: others have no trials, and need no commands."""
        return self._dead_zone_v.size == 1

    def commanded(self, content: Array) -> Array:
        """Return the newest samples, shape (signal, 1, n), with their commands and readings."""
        content = content.copy()
        for signal, values in ((VOLTAGE, self._commands_v), (TORQUE, self._readings_nm)):
            count = min(content.shape[2], len(values))
            if count:
                content[signal, 0, -count:] = list(values)[-count:]
        forget_moves(content)
        return content

    def _driven_to_end(self, content: Array) -> tuple[Array, Array, Array]:
        """Return samples with the voltages, and what has come of the path by their end.

        That is what lags in V, and how long the signal history has lasted in s, shape (motor,).
        """
        is_open = self.is_open(content)
        content = content.copy()
        content[INTERVAL][is_open] = 0.0
        voltage_v = _outside(content[VOLTAGE], self._dead_zone_v[:, None])
        content[VOLTAGE] = voltage_v
        forget_moves(content)
        lag = self._lag
        nothing = np.zeros(content.shape[1])
        if not self.has_filter:
            return content, nothing, nothing
        interval_s = content[INTERVAL].copy()
        interval_s[:, 0] = 0.0
        since_s = _since_start(interval_s)
        if lag is None:
            assert self._average is not None
            before_nm = np.roll(content[TORQUE], 1, axis=1)
            content[TORQUE] = _newest_values(self._average, interval_s, before_nm, content[TORQUE])
            content[INTERVAL] = np.where(since_s > interval_s, interval_s, 0.0)
            return content, nothing, since_s[:, -1]
        begins = interval_s <= 0.0
        remainder = np.where(begins, 0.0, _remainder(interval_s, lag))
        inputs = (1.0 - remainder) * voltage_v
        lagging_v = recurrence(remainder, inputs[None], voltage_v[None, :, 0])[0]
        share = np.where(begins, 0.0, _share(interval_s, lag))
        content[VOLTAGE] = voltage_v + share * (lagging_v[:, :-1] - voltage_v)
        forget_moves(content)
        settled_s = SETTLED * lag.lag_s if lag.settles else interval_s
        content[INTERVAL] = np.where(since_s > settled_s, interval_s, 0.0)
        return content, lagging_v[:, -1], since_s[:, -1]

    def _voltage_and_end(
        self, start_v: Array, interval_s: Array, command_v: Array
    ) -> tuple[Array, Array]:
        """Return the voltage over an interval, and what lags at its end, in V.

        Args:
            start_v: shape (motor,): what lags at its start.
            interval_s: as in :meth:`voltage`.
            command_v: likewise.
        """
        voltage_v = _outside(command_v, self._dead_zone_v)
        lag = self._lag
        if lag is None:
            return voltage_v, start_v
        start_v = np.where(interval_s > 0.0, start_v, voltage_v)
        end_v = voltage_v + (start_v - voltage_v) * _remainder(interval_s, lag)
        return voltage_v + _share(interval_s, lag) * (start_v - voltage_v), end_v

    def state(self, motor: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything of one motor, as plain values and arrays."""
        plain = {
            'lagging_v': float(self._lagging_v[motor]),
            'since_s': float(self._since_s[motor]),
        }
        if not self._is_alone:
            return plain, {}
        arrays = {'commands': np.array(self._commands_v, dtype=float)}
        if self._average is not None:
            plain['reading_nm'] = float(self._reading_nm[motor])
            arrays['readings'] = np.array(self._readings_nm, dtype=float)
        return plain, arrays

    def restore(
        self, plain: Mapping[str, Any], arrays: Mapping[str, Array], motor: int, count: int
    ) -> None:
        """Take back what :meth:`state` gave.

        Args:
            plain: of a state.
            arrays: of the same; of a motor in a group they hold no commands.
            motor: its place on the motor axis.
            count: newest samples that are remembered elsewhere.

        Raises:
            CheckpointError: it is no state that a path could have been in.
        """
        lagging_v = number(plain, 'lagging_v', -LARGEST_SIGNAL, LARGEST_SIGNAL)
        since_s = number(plain, 'since_s', 0.0, LARGEST)
        self._commands_v.clear()
        self._readings_nm.clear()
        if self._is_alone and 'commands' in arrays:
            least = min(count, LONGEST) if self.has_filter else 0
            self._commands_v.extend(_saved_signal('commands', arrays, least))
        elif self.has_filter:
            raise CheckpointError('voltage_path/commands is missing')
        if self._average is not None:
            self._readings_nm.extend(_saved_signal('readings', arrays, min(count, LONGEST)))
            reading_nm = number(plain, 'reading_nm', -LARGEST_SIGNAL, LARGEST_SIGNAL)
            self._reading_nm = np.array([reading_nm])
        self._lagging_v[motor] = lagging_v
        self._since_s[motor] = since_s


def _saved_signal(name: str, arrays: Mapping[str, Array], least: int) -> list[float]:
    """Return the saved values of a signal.

    Args:
        name: what they are called.
        arrays: of a state.
        least: how many there must be.

    Raises:
        CheckpointError: they are missing, or none that there could have been.
    """
    if name not in arrays:
        raise CheckpointError(f'voltage_path/{name} is missing')
    signal = arrays[name]
    check_array(f'voltage_path/{name}', signal, ArrayRule((None,), -LARGEST_SIGNAL, LARGEST_SIGNAL))
    if not least <= signal.size <= LONGEST:
        raise CheckpointError(
            f'voltage_path/{name} holds {signal.size} {name}, expected {least} to {LONGEST}'
        )
    values: list[float] = signal.tolist()
    return values


def _newest_values(
    average: CurrentLag, interval_s: Array, before_nm: Array, reading_nm: Array
) -> Array:
    """Return the newest values in moving averages in N m, shape of the readings.

    Args:
        average: which the sensor makes.
        interval_s: between two readings; 0 where a signal history begins: there the reading itself
            is taken.
        before_nm: the readings before.
        reading_nm: the readings.
    """
    kept_share = np.where(interval_s > 0.0, np.exp(-interval_s / average.lag_s), 0.0)
    values: Array = (reading_nm - kept_share * before_nm) / (1.0 - kept_share)
    return values


def beyond_start(content: Array, path_content: Array, settle_s: float) -> Array:
    """Return the samples that lie more than some time behind where their signal history begins.

    Forms whose voltages settle at different times are compared by them.

    Args:
        content: shape (signal, 1, n): samples, as they were measured.
        path_content: the same, with the voltages.
        settle_s: the time in s; 0: all of them.
    """
    if settle_s <= 0.0:
        return path_content
    interval_s = content[INTERVAL, 0].copy()
    interval_s[0] = 0.0
    is_late = _since_start(interval_s[None])[0] > settle_s
    part = path_content[:, :, is_late].copy()
    begins = np.diff(np.flatnonzero(is_late), prepend=-1) > 1
    part[INTERVAL, 0, begins] = 0.0
    part[INTERVAL, 0, :1] = 0.0
    return part


def _since_start(interval_s: Array) -> Array:
    """Return how long the signal history has lasted at every sample, shape (motor, n), in s."""
    lasts = np.where(interval_s > 0.0, 1.0, 0.0)
    since_s: Array = recurrence(lasts, interval_s[None], np.zeros((1, len(lasts))))[0, :, 1:]
    return since_s


def _outside(command_v: Array, dead_zone_v: Array) -> Array:
    """Return a command as the white box takes it: within the dead zone it drives nothing.

    What the dead zone takes off a larger one is an effect of the white box.

    Args:
        command_v: in V, any shape.
        dead_zone_v: of each motor, to be broadcast against it.
    """
    driving_v: Array = np.where(np.abs(command_v) > dead_zone_v, command_v, 0.0)
    return driving_v


def _remainder(interval_s: Array, lag: CurrentLag) -> Array:
    """Return what an interval leaves of the lagging voltage at its start: nothing of a mean's."""
    return np.zeros_like(interval_s) if lag.is_mean else np.exp(-interval_s / lag.lag_s)


def _share(interval_s: Array, lag: CurrentLag) -> Array:
    """Return how much of the lagging voltage at an interval's start the constant one has.

    It is ``(e^(-t/lag) - e^(-t/T)) / ((1/T - 1/lag) T (1 - e^(-t/T)))`` with T the time constant
    of the winding: what starts 1 V above its end moves the winding as so many constant volts do.
    The mean of an interval falls straight: ``(1 - (1 + x) e^-x) / (x (1 - e^-x))`` with
    ``x = t / T``.
    """
    if lag.is_mean:
        x = np.maximum(interval_s / lag.winding_s, SHORTEST)
        share: Array = (-np.expm1(-x) - x * np.exp(-x)) / (x * -np.expm1(-x))
        return share
    fast, slow = sorted((1.0 / lag.lag_s, 1.0 / lag.winding_s), reverse=True)
    apart = np.maximum((fast - slow) * interval_s, NEGLIGIBLE)
    progress_s = interval_s * np.exp(-slow * interval_s) * -np.expm1(-apart) / apart
    of_constant = -lag.winding_s * np.expm1(-interval_s / lag.winding_s)
    return np.asarray(progress_s / np.maximum(of_constant, 1e-300))
