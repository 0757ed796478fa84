"""Work that comes round by the clock and must not be crowded out by messages."""

from __future__ import annotations

import time
from collections.abc import Callable

LATE = 1.5
"""Periods after which whoever comes along does what the timer has not done."""


class Chore:
    """Something to do every so often: by a timer, and by the way where the timer is late.

    The events executor of rclpy 7.1 serves messages and timers in the order in which they came, so that under more
    messages than can be served timers fall behind by as much as messages do: just when diagnostics are needed.

    Args:
        period_s: the timer's.
        action: what to do.
    """

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_s = period_s
        self._action = action
        self._done_s = time.monotonic()

    def do(self) -> None:
        """Do it; for the timer."""
        self._done_s = time.monotonic()
        self._action()

    def catch_up(self) -> None:
        """Do it if the timer is late."""
        if time.monotonic() - self._done_s > LATE * self._period_s:
            self.do()
