"""The newest raw voltages and torques, as they came in, so that they can be paired again.

Pairing forgets how a sample's mean voltage was made. Whoever asks whether voltage and torque are
shifted against each other needs the stamps themselves. Bounded, each signal in the order of its
stamps; what is read out depends on stamps alone, so that live topics and a replayed bag give the
same signals.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.samples.sample import NANOSECONDS_PER_SECOND
from gray_box_observer.white_box.interface import Array

TORQUES = 4096
"""Torques read out at most: about what the recursive rule remembers for its fits."""

VOLTAGES = 4 * TORQUES
"""Voltages read out at most: a command may come more often than torque."""

SLACK = 1024
"""Kept beyond what is read out, so that what arrived in another order does not change where the
signals begin."""

BLOCK = 256
"""Rows of a group for which room is made at once."""

Event = tuple[Literal['voltage', 'torque', 'speed'], int, tuple[float, ...]]
"""Signal, stamp in ns, and its values as :class:`Pairing` takes them."""


@dataclass(frozen=True, slots=True, eq=False)
class RawSignals:
    """Voltage and torque of one motor over a stretch of time, each with stamps of its own.

    Attributes:
        time_s: shape (n,): instants of the torques; the last is 0.
        torque_nm: shape (n,).
        speed_rad_s: shape (n,): NaN where none was measured.
        voltage_time_s: shape (m,): stamps of the voltages on the same scale.
        voltage_v: shape (m,): each holds from its stamp on.
    """

    time_s: Array
    torque_nm: Array
    speed_rad_s: Array
    voltage_time_s: Array
    voltage_v: Array

    def voltage_integral(self, time_s: Array) -> Array:
        """Integral of the held voltage up to given times, in V s, up to a constant; same shape."""
        areas = self.voltage_v[:-1] * np.diff(self.voltage_time_s)
        total = np.concatenate([[0.0], np.cumsum(areas)])
        at = np.maximum(np.searchsorted(self.voltage_time_s, time_s, side='right') - 1, 0)
        integral: Array = total[at] + self.voltage_v[at] * (time_s - self.voltage_time_s[at])
        return integral

    def between(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Return the voltage between given times, ascending, shape (k + 1,), in V.

        Returns:
            Mean and first moment (:meth:`HeldVoltage.moment`) of every interval, shape (k,), and
            what is held just before every time, shape (k + 1,).
        """
        areas_vs = self.voltage_v[:-1] * np.diff(self.voltage_time_s)
        total_vs = np.concatenate([[0.0], np.cumsum(areas_vs)])
        doubled_vs2 = (total_vs[:-1] + 0.5 * areas_vs) * np.diff(self.voltage_time_s)
        total_vs2 = np.concatenate([[0.0], np.cumsum(doubled_vs2)])
        at = np.maximum(np.searchsorted(self.voltage_time_s, time_s, side='left') - 1, 0)
        since_s = time_s - self.voltage_time_s[at]
        held_v: Array = self.voltage_v[at]
        integral_vs = total_vs[at] + held_v * since_s
        integral_vs2 = total_vs2[at] + (total_vs[at] + 0.5 * held_v * since_s) * since_s
        length_s = np.diff(time_s)
        mean_v = np.diff(integral_vs) / length_s
        ends_vs = 0.5 * (integral_vs[1:] + integral_vs[:-1])
        moment_v = (ends_vs - np.diff(integral_vs2) / length_s) / length_s
        return mean_v, moment_v, held_v


class _Numbers:
    """Bounded rows of a stamp in ns and plain numbers; read out at once, as a sample waits.

    The oldest are forgotten, many at once; stamps rise.
    """

    def __init__(self, width: int, most: int) -> None:
        self._width = width
        self._most = most
        self._stamps = array('q')
        self._values = array('d')  # row after row

    @classmethod
    def from_arrays(cls, stamps: NDArray[np.int64], values: Array, most: int) -> _Numbers:
        """Remember rows, values of shape (value, row), in one piece; no more than ``most``."""
        rows = cls(values.shape[0], most)
        rows._stamps.frombytes(stamps.tobytes())
        rows._values.frombytes(values.T.tobytes())
        return rows

    def __len__(self) -> int:
        return min(len(self._stamps), self._most)

    def append(self, stamp_ns: int, *values: float) -> None:
        """Remember a row."""
        if len(self._stamps) == 2 * self._most:
            del self._stamps[: self._most], self._values[: self._most * self._width]
        self._stamps.append(stamp_ns)
        self._values.extend(values)

    def rows(self) -> Iterable[tuple[Any, ...]]:
        """Every row in order."""
        first = len(self._stamps) - len(self)
        columns = (self._values[first * self._width + k :: self._width] for k in range(self._width))
        return zip(self._stamps[first:], *columns, strict=True)

    def clear(self) -> None:
        """Forget every row."""
        del self._stamps[:], self._values[:]

    def until(self, stamp_ns: int, most: int) -> tuple[NDArray[np.int64], Array]:
        """Return stamps and values, (value, row), of the newest rows up to a stamp, bounded."""
        first = len(self._stamps) - len(self)
        end = bisect_right(self._stamps, stamp_ns, first)
        first = max(first, end - most)
        values = np.array(self._values[first * self._width : end * self._width])
        return np.array(self._stamps[first:end]), values.reshape(-1, self._width).T.copy()


class _Arrays:
    """The same of a group: blocks of rows, written round and round, so that nothing ever moves.

    A value that no row of a block has had, such as a speed that nobody measures, takes no room.
    """

    def __init__(self, width: int, most: int, motors: int) -> None:
        self._width = width
        self._most = most
        self._motors = motors
        self._stamps = np.empty(most, dtype=np.int64)
        self._blocks: list[list[Array | None]] = []
        self._count = 0  # rows that ever came since it was empty

    def __len__(self) -> int:
        return min(self._count, self._most)

    def append(self, stamp_ns: int, *values: Any) -> None:
        """Remember a row: arrays of shape (motor,), or NaN where there is no value."""
        row = self._count % self._most
        self._count += 1
        self._stamps[row] = stamp_ns
        number, row = divmod(row, BLOCK)
        if number == len(self._blocks):
            self._blocks.append([None] * self._width)
        block = self._blocks[number]
        for k, value in enumerate(values):
            column = block[k]
            if column is None:
                if not isinstance(value, np.ndarray):
                    continue
                column = block[k] = np.full((BLOCK, self._motors), math.nan)
            column[row] = value

    def _order(self) -> NDArray[np.intp]:
        """Places of the rows, the oldest first."""
        return np.arange(self._count - len(self), self._count) % self._most

    def rows(self) -> Iterable[tuple[Any, ...]]:
        """Every row in order, copied."""
        order = self._order()
        return zip(
            self._stamps[order].tolist(),
            *([self._value(k, place) for place in order.tolist()] for k in range(self._width)),
            strict=True,
        )

    def _value(self, k: int, place: int) -> Any:
        column = self._blocks[place // BLOCK][k]
        return math.nan if column is None else column[place % BLOCK].copy()

    def _column(self, k: int, motor: int) -> Array:
        nothing = np.full(BLOCK, math.nan)
        columns = [block[k] for block in self._blocks]
        return np.concatenate([nothing if c is None else c[:, motor] for c in columns])

    def clear(self) -> None:
        """Forget every row."""
        self._count = 0
        self._blocks.clear()

    def select_motor(self, motor: int) -> _Numbers:
        """Rows of one motor that have its first value, copied at once, as a sample waits."""
        if not self._count:
            return _Numbers(self._width, self._most)
        order = self._order()
        values = np.array([self._column(k, motor)[order] for k in range(self._width)])
        usable = ~np.isnan(values[0])
        return _Numbers.from_arrays(self._stamps[order][usable], values[:, usable], self._most)


class RawHistory:
    """Bounded memory of the paired raw measurements in the order of stamps; groups as arrays.

    Args:
        motors: how many they are of.

    Attributes:
        restarts: how often the clock was set back: what came before does not belong to what is
            remembered.
    """

    def __init__(self, motors: int = 1) -> None:
        voltages = VOLTAGES + SLACK
        torques = TORQUES + SLACK
        single = motors == 1
        self._voltages: _Numbers | _Arrays = (
            _Numbers(1, voltages) if single else _Arrays(1, voltages, motors)
        )
        self._torques: _Numbers | _Arrays = (
            _Numbers(2, torques) if single else _Arrays(2, torques, motors)
        )
        self._speeds = _Numbers(1, torques)
        self.restarts = 0

    def __len__(self) -> int:
        return len(self._voltages) + len(self._torques) + len(self._speeds)

    def voltage(self, stamp_ns: int, voltage_v: Any) -> None:
        """Remember one voltage in V."""
        self._voltages.append(stamp_ns, voltage_v)

    def torque(self, stamp_ns: int, torque_nm: Any, speed_rad_s: Any = math.nan) -> None:
        """Remember one torque in N m, with the speed in rad/s that came with it."""
        self._torques.append(stamp_ns, torque_nm, speed_rad_s)

    def speed(self, stamp_ns: int, speed_rad_s: float) -> None:
        """Remember one speed in rad/s, where speed is a signal of its own."""
        self._speeds.append(stamp_ns, speed_rad_s)

    def clear(self) -> None:
        """Forget everything."""
        self._voltages.clear()
        self._torques.clear()
        self._speeds.clear()

    def restart(self) -> None:
        """Forget everything, because the clock was set back."""
        self.clear()
        self.restarts += 1

    def events(self, delay_ns: int) -> Iterator[Event]:
        """Yield everything in the order of stamps, voltage first, its stamps moved by a delay."""
        rows: list[tuple[int, int, Event]] = []
        rows += [(at + delay_ns, 0, ('voltage', at, (volt,))) for at, volt in self._voltages.rows()]
        rows += [(at, 1, ('speed', at, (speed,))) for at, speed in self._speeds.rows()]
        rows += [
            (at, 2, ('torque', at, (torque, speed))) for at, torque, speed in self._torques.rows()
        ]
        rows.sort(key=lambda row: row[:2])
        return (event for _, _, event in rows)

    def select_motor(self, motor: int) -> RawHistory:
        """Return the remembered rows of one motor of a group, without unusable ones."""
        history = RawHistory()
        history.restarts = self.restarts
        if not isinstance(self._torques, _Arrays) or not isinstance(self._voltages, _Arrays):
            raise GrayBoxError('a single motor has signals of its own, expected .signals')
        history._voltages = self._voltages.select_motor(motor)
        history._torques = self._torques.select_motor(motor)
        return history

    def signals(self, until_ns: int, delay_ns: int) -> RawSignals | None:
        """Read out what is known for certain once the torque of a stamp is complete under a delay.

        Args:
            until_ns: stamp of the newest complete torque.
            delay_ns: by how much voltage was taken to act later than it was stamped.

        Returns:
            The signals, None where there are less than two torques or no voltage.
        """
        if not isinstance(self._torques, _Numbers) or not isinstance(self._voltages, _Numbers):
            raise GrayBoxError(
                'a group has the signals of its motors, expected .select_motor(motor).signals'
            )
        stamps, (torque, speed) = self._torques.until(until_ns, TORQUES)
        since, (voltage,) = self._voltages.until(until_ns - delay_ns, VOLTAGES)
        if stamps.size < 2 or not since.size:
            return None
        time_s = (stamps - until_ns) / NANOSECONDS_PER_SECOND
        if len(self._speeds):
            own, (own_speed,) = self._speeds.until(until_ns, TORQUES)
            own_s = (own - until_ns) / NANOSECONDS_PER_SECOND
            speed = (
                np.interp(time_s, own_s, own_speed) if own.size else np.full_like(torque, np.nan)
            )
        return RawSignals(
            time_s, torque, speed, (since - until_ns) / NANOSECONDS_PER_SECOND, voltage
        )


class SignalHistory(Protocol):
    """The history of one motor: its own, or its part of a group's."""

    @property
    def restarts(self) -> int:
        """How often the clock was set back."""

    def signals(self, until_ns: int, delay_ns: int) -> RawSignals | None:
        """As :meth:`RawHistory.signals`."""


class MotorHistory:
    """One motor of a group's history; its rows are copied only where they are read out.

    Args:
        history: of the group.
        motor: its place in it.
    """

    def __init__(self, history: RawHistory, motor: int) -> None:
        self._history = history
        self._motor = motor

    @property
    def restarts(self) -> int:
        """As :attr:`RawHistory.restarts`."""
        return self._history.restarts

    def signals(self, until_ns: int, delay_ns: int) -> RawSignals | None:
        """As :meth:`RawHistory.signals`."""
        return self._history.select_motor(self._motor).signals(until_ns, delay_ns)
