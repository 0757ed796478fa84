"""The newest raw voltages and torques, as they came in, so that they can be paired again.

Pairing forgets how a sample's mean voltage was made. Whoever asks whether voltage and torque are shifted against each
other needs the stamps themselves. Bounded, in the order of arrival; what is read out depends on stamps alone, so that
live topics and a replayed bag give the same signals.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.sample import NANOSECONDS_PER_SECOND
from gray_box_observer.white_box.base import Array

TORQUES = 4096
"""Torques read out at most: about what the recursive rule remembers for its fits."""

VOLTAGES = 4 * TORQUES
"""Voltages read out at most: a command may come more often than torque."""

SLACK = 1024
"""Kept beyond what is read out, so that what arrived in another order does not change where the signals begin."""

Event = tuple[Literal['voltage', 'torque', 'speed'], int, tuple[float, ...]]
"""Signal, stamp in ns, and its values as :class:`Pairing` takes them."""


@dataclass(frozen=True, slots=True)
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
        """Integral of the held voltage up to given times, in V s, but for a constant; same shape."""
        areas = self.voltage_v[:-1] * np.diff(self.voltage_time_s)
        total = np.concatenate([[0.0], np.cumsum(areas)])
        at = np.maximum(np.searchsorted(self.voltage_time_s, time_s, side='right') - 1, 0)
        integral: Array = total[at] + self.voltage_v[at] * (time_s - self.voltage_time_s[at])
        return integral


class RawHistory:
    """Bounded memory of the raw measurements that pairing has taken, in the order of stamps; of a group, arrays.

    Attributes:
        restarts: how often the clock was set back: what came before does not belong to what is remembered.
    """

    def __init__(self) -> None:
        self._voltages: deque[tuple[int, Any]] = deque(maxlen=VOLTAGES + SLACK)
        self._torques: deque[tuple[int, Any, Any]] = deque(maxlen=TORQUES + SLACK)
        self._speeds: deque[tuple[int, float]] = deque(maxlen=TORQUES + SLACK)
        self.restarts = 0

    def __len__(self) -> int:
        return len(self._voltages) + len(self._torques) + len(self._speeds)

    def voltage(self, stamp_ns: int, voltage_v: Any) -> None:
        """Remember one voltage in V."""
        self._voltages.append((stamp_ns, voltage_v))

    def torque(self, stamp_ns: int, torque_nm: Any, speed_rad_s: Any = math.nan) -> None:
        """Remember one torque in N m, with the speed in rad/s that came with it."""
        self._torques.append((stamp_ns, torque_nm, speed_rad_s))

    def speed(self, stamp_ns: int, speed_rad_s: float) -> None:
        """Remember one speed in rad/s, where speed is a signal of its own."""
        self._speeds.append((stamp_ns, speed_rad_s))

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
        """Yield everything remembered in the order of stamps, voltage first and its stamps taken as that much later."""
        rows: list[tuple[int, int, Event]] = []
        rows += [(at + delay_ns, 0, ('voltage', at, (volt,))) for at, volt in self._voltages]
        rows += [(at, 1, ('speed', at, (speed,))) for at, speed in self._speeds]
        rows += [(at, 2, ('torque', at, (torque, speed))) for at, torque, speed in self._torques]
        rows.sort(key=lambda row: row[:2])
        return (event for _, _, event in rows)

    def of(self, motor: int) -> RawHistory:
        """Return what is remembered of one motor of a group; what cannot be used of it is left out."""
        made = RawHistory()
        made.restarts = self.restarts
        made._voltages.extend((at, float(volt[motor])) for at, volt in self._voltages if volt[motor] == volt[motor])
        made._torques.extend(
            (at, float(torque[motor]), float(speed[motor]) if isinstance(speed, np.ndarray) else math.nan)
            for at, torque, speed in self._torques
            if torque[motor] == torque[motor]
        )
        return made

    def signals(self, until_ns: int, delay_ns: int) -> RawSignals | None:
        """Read out what is known for certain once the torque of a stamp is complete under a delay.

        Args:
            until_ns: stamp of the newest complete torque.
            delay_ns: by how much voltage was taken to act later than it was stamped.

        Returns:
            The signals, None where there are less than two torques or no voltage.
        """
        torques = _columns(self._torques, 3, until_ns, TORQUES)
        voltages = _columns(self._voltages, 2, until_ns - delay_ns, VOLTAGES)
        if len(torques[0]) < 2 or not len(voltages[0]):
            return None
        time_s, torque, speed = (torques[0] - until_ns) / NANOSECONDS_PER_SECOND, torques[1], torques[2]
        if self._speeds:
            own = _columns(self._speeds, 2, until_ns, TORQUES)
            own_s = (own[0] - until_ns) / NANOSECONDS_PER_SECOND
            speed = np.interp(time_s, own_s, own[1]) if len(own_s) else np.full_like(torque, np.nan)
        return RawSignals(time_s, torque, speed, (voltages[0] - until_ns) / NANOSECONDS_PER_SECOND, voltages[1])


def _columns(rows: Iterable[Any], width: int, until_ns: int, most: int) -> tuple[NDArray[Any], ...]:
    """Stamps and values of the newest rows up to a stamp, in order."""
    kept = [row for row in islice(reversed(rows), most + SLACK) if row[0] <= until_ns][:most]  # type: ignore[call-overload]
    kept.reverse()
    stamps = np.array([row[0] for row in kept], dtype=np.int64)
    return (stamps, *(np.array([row[j] for row in kept], dtype=float) for j in range(1, width)))
