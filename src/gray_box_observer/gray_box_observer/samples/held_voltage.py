"""Voltage of a signal history: every sample holds from its stamp to the stamp of the next one.

Values are plain floats for one motor and arrays of shape (motor,) for a group; stamps are those from which they act.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from gray_box_observer.samples.rhythm import Rhythm
from gray_box_observer.samples.sample import seconds

MAX_WAITING_VOLTAGES = 10_000


class HeldVoltage:
    """The voltage in force, and those that torque has not come up to yet.

    Args:
        blank: a value that says nothing, for a voltage that is not known.

    Attributes:
        newest_ns: from when on the newest voltage acts; None before the first of the signal history.
    """

    def __init__(self, blank: Any) -> None:
        self._blank = blank
        self._rhythm = Rhythm()
        self.restart()

    def restart(self) -> None:
        """Begin a new signal history; what is habit stays so."""
        self._coming: deque[tuple[int, Any]] = deque()
        self._held_v: Any = self._blank
        self._held_ns: int | None = None  # since when that is in force
        self.newest_ns: int | None = None

    def __len__(self) -> int:
        return len(self._coming)

    @property
    def newest_v(self) -> Any:
        """The newest voltage in V; blank where it is not known."""
        return self._coming[-1][1] if self._coming else self._held_v

    @property
    def known(self) -> bool:
        """Whether the newest voltage is known."""
        return bool(self._coming) or self._held_v is not self._blank

    def known_at(self, stamp_ns: int) -> bool:
        """Whether it is known what was in force at the stamp of the last torque."""
        return self._held_v is not self._blank or (bool(self._coming) and self._coming[0][0] <= stamp_ns)

    @property
    def patience_s(self) -> float:
        """For how long a voltage, of one motor of a group, may be missing before it is overdue, in s."""
        return self._rhythm.silence_s if self._rhythm.regular else math.inf

    def take(self, stamp_ns: int, voltage_v: Any) -> None:
        """Let a voltage be in force from a stamp on that is newer than all before."""
        if self.newest_ns is not None:
            self._rhythm.take(seconds(stamp_ns - self.newest_ns))
        self.newest_ns = stamp_ns
        self._coming.append((stamp_ns, voltage_v))
        if len(self._coming) > MAX_WAITING_VOLTAGES:  # torque is silent: only the newest voltages can still matter
            self._held_ns, self._held_v = self._coming.popleft()

    def mean(self, start_ns: int, end_ns: int) -> Any:
        """Mean of the voltage over an interval that begins with the last torque, where it was known."""
        held_v, cursor_ns, integral_vns = self._held_v, start_ns, 0.0
        for since_ns, voltage_v in self._coming:
            if since_ns >= end_ns:
                break
            if since_ns > cursor_ns:
                integral_vns += held_v * (since_ns - cursor_ns)
                cursor_ns = since_ns
            held_v = voltage_v
        if cursor_ns == start_ns:
            return held_v  # unchanged over the interval: exact, no division
        return (integral_vns + held_v * (end_ns - cursor_ns)) / (end_ns - start_ns)

    def unknown_until_ns(self, start_ns: int, end_ns: int, torque: Rhythm) -> int | None:
        """Return when voltage is known again where it was not between two torques; None: it always was.

        Later than the second of them where no voltage has come by then. A voltage that is old while torque comes was
        not changed, unless it always came regularly and is overdue.
        """
        if not (self._rhythm.regular or torque.silent(seconds(end_ns - start_ns))):
            return None
        silent, since_ns, until_ns = self._rhythm.silent, self._held_ns, None
        if since_ns is None or not silent(seconds(max(end_ns, self.newest_ns or end_ns) - since_ns)):
            return None  # where the whole is not silent no part of it is
        for voltage_ns, _ in self._coming:
            if silent(seconds(voltage_ns - since_ns)):
                until_ns = voltage_ns
            since_ns = voltage_ns
            if since_ns >= end_ns:
                return until_ns
        return end_ns + 1 if silent(seconds(end_ns - since_ns)) else until_ns

    def step_to(self, stamp_ns: int, *, lost: bool) -> tuple[Any, Any]:
        """Go on to the stamp of a torque.

        Args:
            stamp_ns: the stamp.
            lost: nobody knows any more what is in force there.

        Returns:
            The voltage in force before the stamp, and one that begins there; blank where there is none.
        """
        while self._coming and self._coming[0][0] < stamp_ns:
            self._held_ns, self._held_v = self._coming.popleft()
        if lost:
            self._held_v = self._blank
        begins = bool(self._coming) and self._coming[0][0] == stamp_ns
        return self._held_v, self._coming[0][1] if begins else self._blank
