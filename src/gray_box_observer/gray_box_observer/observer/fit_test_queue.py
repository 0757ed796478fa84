"""Tests of the fit that are asked for, done one behind the other, a piece a sample.

A test takes as long as several samples at 1 kHz: predictions would wait for it. How far it is goes
by samples and their intervals, so that every door leads to the same verdict at the same sample.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gray_box_observer.context_nodes.pieces import Pieces, completed

WORK_A_SECOND = 1_500_000
"""Work between two samples, for the time between them: half of what could be done."""


class FitTestQueue:
    """Does tests of the motors of a group.

    Args:
        start: begins the test of a motor, by its place on the motor axis, and whether its newest
            samples alone are tested.
    """

    def __init__(self, start: Callable[[int, bool], Pieces[None]]) -> None:
        self._start = start
        self._requests: deque[tuple[int, bool]] = deque()
        self._work: Pieces[None] | None = None
        self._credit = 0.0
        self._has_new_sample = False

    @property
    def is_empty(self) -> bool:
        """Whether nothing is left to be done."""
        return self._work is None and not self._requests

    def ask(self, motor: int, *, is_recent: bool = False) -> None:
        """Have a motor tested.

        Args:
            motor: its place on the motor axis.
            is_recent: whether its newest samples alone are tested.
        """
        self._requests.append((motor, is_recent))

    def begin_sample(self, interval_s: float) -> None:
        """Note that another sample has come, so long after the one before; 0: not known."""
        self._credit = max(1.0, WORK_A_SECOND * interval_s)
        self._has_new_sample = True

    def advance(self) -> None:
        """Do what the newest sample allows: a piece at least, and nothing when asked again."""
        while self._credit > 0.0 and not self.is_empty:
            if self._work is None:
                self._work = self._start(*self._requests.popleft())
            try:
                self._credit -= next(self._work)
            except StopIteration:
                self._work = None

    def rest(self) -> None:
        """Do all that is left where no sample has come since this was last called: none may."""
        if not self._has_new_sample:
            self.complete()
        self._has_new_sample = False

    def complete_begun(self) -> None:
        """Do the rest of the test that has begun."""
        if self._work is not None:
            work, self._work = self._work, None
            completed(work)

    def complete(self) -> None:
        """Do all that is left."""
        self.complete_begun()
        while self._requests:
            completed(self._start(*self._requests.popleft()))

    def clear(self) -> None:
        """Do nothing of what is left."""
        self._work = None
        self._requests.clear()
