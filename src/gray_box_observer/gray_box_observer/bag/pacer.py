"""When recorded messages are due in present time, with a rate, pauses and single steps."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

BURST = 50
"""Messages that may come at once where their number a second is limited: a thread wakes too late
for single ones."""


class Pacer:
    """Holds a replaying thread back until its next message is due; methods are thread-safe.

    Args:
        rate: Recorded seconds per second; 0 or less for as fast as possible.
        is_paused: Whether to begin paused.
        max_messages_per_s: Where it is as fast as possible: no more than so many a second; 0 for no
            limit.
        clock: Monotonic seconds.
    """

    def __init__(
        self,
        rate: float,
        *,
        is_paused: bool = False,
        max_messages_per_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._rate = rate
        self._limit_per_s = max_messages_per_s
        self._allowance = float(BURST)
        self._clock = clock
        self._condition = threading.Condition()
        self._is_paused = is_paused
        self._is_stopped = False
        self._steps = 0
        self._anchor_ns = 0
        self._anchor_s = self._allowed_s = clock()

    @property
    def is_paused(self) -> bool:
        """Whether only single steps are let through."""
        return self._is_paused

    def restart(self, log_time_ns: int) -> None:
        """Begin at this recorded time, now."""
        with self._condition:
            self._anchor(log_time_ns)

    def pause(self) -> None:
        """Let nothing through until `resume`."""
        with self._condition:
            if not self._is_paused:
                self._anchor(self._position_ns())
                self._is_paused = True
                self._condition.notify_all()

    def resume(self) -> None:
        """Go on from where the recorded time stood."""
        with self._condition:
            if self._is_paused:
                self._is_paused = False
                self._steps = 0
                self._anchor(self._anchor_ns)
                self._condition.notify_all()

    def step(self) -> bool:
        """Let the next message through at once; only while paused. False if it is not paused."""
        with self._condition:
            if self._is_paused:
                self._steps += 1
                self._condition.notify_all()
            return self._is_paused

    def stop(self) -> None:
        """Let `wait` return at once, from now on."""
        with self._condition:
            self._is_stopped = True
            self._condition.notify_all()

    def wait(
        self,
        log_time_ns: int,
        tick: Callable[[int], None] | None = None,
        tick_period_s: float = 0.01,
    ) -> bool:
        """Block until the message of this recorded time is due; False once stopped.

        Args:
            log_time_ns: The message's recorded time.
            tick: Called with the present recorded time while waiting, for a clock.
            tick_period_s: How often.
        """
        while True:
            with self._condition:
                if self._is_stopped:
                    return False
                if self._steps:
                    self._steps -= 1
                    self._anchor(log_time_ns)
                    return True
                if self._is_paused:
                    self._condition.wait()
                    continue
                left_s = self._left_s(log_time_ns)
                if left_s <= 0:
                    self._allowance -= 1.0
                    return True
                if (
                    tick is None or self._rate <= 0
                ):  # without a rate no recorded time passes while waiting
                    self._condition.wait(min(left_s, 1.0))
                    continue
                self._condition.wait(min(left_s, tick_period_s))
                now_ns = min(self._position_ns(), log_time_ns)
            tick(now_ns)  # outside the lock: a slow listener must not block a service

    def _left_s(self, log_time_ns: int) -> float:
        """Seconds until the message of this recorded time is due; 0 or less if it is."""
        if self._rate > 0:
            return (log_time_ns - self._position_ns()) * 1e-9 / self._rate
        if self._limit_per_s <= 0:
            return 0.0
        now_s = self._clock()
        # What was not used is soon forgotten: catching up after a halt would flood the readers.
        self._allowance = min(
            BURST, self._allowance + (now_s - self._allowed_s) * self._limit_per_s
        )
        self._allowed_s = now_s
        return (1.0 - self._allowance) / self._limit_per_s

    def _anchor(self, log_time_ns: int) -> None:
        self._anchor_ns = log_time_ns
        self._anchor_s = self._clock()

    def _position_ns(self) -> int:
        """The recorded time that it is now."""
        if self._is_paused or self._rate <= 0:
            return self._anchor_ns
        return self._anchor_ns + round((self._clock() - self._anchor_s) * self._rate * 1e9)
