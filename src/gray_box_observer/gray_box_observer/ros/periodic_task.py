"""Periodic work that delays no message, and that no stream of messages crowds out."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from rclpy.timer import Timer

from gray_box_observer.errors import ConfigurationError, GrayBoxError

LATE = 1.5
"""Periods after which it is done beside a message, whenever the timer will come."""

NEAR_S = 0.1
"""A timer that comes so soon after a message leaves the work to the messages, for so long: another
one is near."""


class PeriodicTask:
    """A periodic task: runs after a message while the next is far, or by a timer if none come.

    A timer knows nothing of messages: what it does just before one comes keeps that one waiting.
    And the events executor of rclpy 7.1 serves messages and timers in the order in which they came,
    so that under more messages than can be served timers fall behind by as much as messages do:
    just when diagnostics are needed.

    Args:
        period_s: the timer's.
        action: what to do.
    """

    def __init__(self, period_s: float, action: Callable[[], None]) -> None:
        self._period_s = period_s
        self._near_s = min(NEAR_S, 0.5 * period_s)
        self._action = action
        self._done_s = time.monotonic()
        self._met_s = self._done_s - NEAR_S
        self._left_s: float | None = None
        """When it was left to the messages; None: it was not."""

    def do(self) -> None:
        """Do it."""
        self._left_s = None
        self._done_s = time.monotonic()
        self._action()

    def on_timer(self) -> None:
        """For the timer: run, or leave it to messages if one is near and none stayed away.

        A timer that has fallen behind finds it done: not once more for that.
        """
        now_s = time.monotonic()
        if now_s - self._done_s < 0.5 * self._period_s:
            return
        if self._left_s is not None or now_s - self._met_s >= self._near_s:
            self.do()
        else:
            self._left_s = now_s

    def on_message(self, *, quiet: bool) -> bool:
        """Do it if it is due or late; tell whether it was done. For whoever has served a message.

        Args:
            quiet: whether the next message is far, as far as anybody knows. Where that is never so
                (messages that lead to nothing), it is not waited for.
        """
        self._met_s = time.monotonic()
        is_due = self._left_s is not None and (quiet or self._met_s - self._left_s >= self._near_s)
        if not is_due and self._met_s - self._done_s <= LATE * self._period_s:
            return False
        self.do()
        return True


class PeriodicTasks:
    """Tasks by name, one of which may be done beside a message.

    Args:
        start: makes a timer of a period and what it calls.
        end: ends a timer.
        stop: is told when a task is the first to find that a device has failed.
    """

    def __init__(
        self,
        start: Callable[[float, Callable[[], None]], Timer],
        end: Callable[[Timer], object],
        stop: Callable[[GrayBoxError], None],
    ) -> None:
        self._start = start
        self._end = end
        self._stop = stop
        self._timers: dict[str, Timer] = {}
        self.by_name: dict[str, PeriodicTask] = {}

    def add(self, name: str, period_s: float, action: Callable[[], None]) -> None:
        """Have something done every so often."""
        task = self.by_name[name] = PeriodicTask(period_s, partial(self._do, action))
        self._timers[name] = self._start(period_s, task.on_timer)

    def remove(self, name: str) -> None:
        """Have it done no more, if it was."""
        if name in self._timers:
            self._end(self._timers.pop(name))
            del self.by_name[name]

    def do_due(self, *, quiet: bool) -> None:
        """Do one thing that is due, if any; the next one comes behind the other messages."""
        for name, task in self.by_name.items():
            if task.on_message(quiet=quiet):
                self.by_name[name] = self.by_name.pop(name)
                return

    def _do(self, action: Callable[[], None]) -> None:
        try:
            action()
        except ConfigurationError as error:
            self._stop(error)
