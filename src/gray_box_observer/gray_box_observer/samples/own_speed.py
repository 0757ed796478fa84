"""Speed where it is a signal of its own: linear between its samples."""

from __future__ import annotations

import math
from collections import deque

from gray_box_observer.samples.held_voltage import MAX_WAITING_VOLTAGES


class OwnSpeed:
    """The speeds that torque has not come up to yet, of one motor.

    Attributes:
        newest_ns: stamp of the newest; None before the first of the signal history.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin a new signal history."""
        self._future_speeds: deque[tuple[int, float]] = deque()
        self.newest_ns: int | None = None

    def update(self, stamp_ns: int, speed_rad_s: float) -> None:
        """Take one speed in rad/s, newer than all before."""
        self.newest_ns = stamp_ns
        self._future_speeds.append((stamp_ns, speed_rad_s))
        if len(self._future_speeds) > MAX_WAITING_VOLTAGES:
            self._future_speeds.popleft()

    def at(self, stamp_ns: int, gap_ns: int) -> float:
        """Speed in rad/s at a torque's stamp, stamps never going back; NaN: unknown.

        Linear between samples, held after the last, or into a gap, for a gap at most.
        """
        while len(self._future_speeds) > 1 and self._future_speeds[1][0] <= stamp_ns:
            self._future_speeds.popleft()
        if not self._future_speeds or self._future_speeds[0][0] > stamp_ns:
            return math.nan
        before_ns, before = self._future_speeds[0]
        if len(self._future_speeds) == 1 or self._future_speeds[1][0] - before_ns > gap_ns:
            return before if stamp_ns - before_ns <= gap_ns else math.nan
        after_ns, after = self._future_speeds[1]
        return before + (after - before) * (stamp_ns - before_ns) / (after_ns - before_ns)
