"""Work that comes round by the clock: it shall keep no message waiting, and messages shall not crowd it out."""

from __future__ import annotations

import time
from collections.abc import Callable

LATE = 1.5
"""Periods after which it is done beside a message, whenever the timer will come."""

NEAR_S = 0.1
"""A timer that comes so soon after a message leaves the work to the messages: another one is near."""


class Chore:
    """Something to do every so often: right after a message, while the next is far; by the timer where none come.

    A timer knows nothing of messages: what it does just before one comes keeps that one waiting. And the events
    executor of rclpy 7.1 serves messages and timers in the order in which they came, so that under more messages than
    can be served timers fall behind by as much as messages do: just when diagnostics are needed.

    Args:
        period_s: the timer's.
        action: what to do.
    """

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_s = period_s
        self._action = action
        self._done_s = time.monotonic()
        self._met_s = self._done_s - NEAR_S
        self._due = False

    def do(self) -> None:
        """Do it."""
        self._due = False
        self._done_s = time.monotonic()
        self._action()

    def ring(self) -> None:
        """Do it, or leave it to the messages, where one is near and none failed to come last time; for the timer."""
        if self._due or time.monotonic() - self._met_s >= NEAR_S:
            self.do()
        else:
            self._due = True

    def meet(self, *, quiet: bool) -> bool:
        """Do it if it is due or late; tell whether it was done. For whoever has served a message.

        Args:
            quiet: whether the next message is far, as far as anybody knows.
        """
        self._met_s = time.monotonic()
        if not (self._due and quiet) and self._met_s - self._done_s <= LATE * self._period_s:
            return False
        self.do()
        return True
