"""The question of the delay, put to the motors of a group one after another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gray_box_observer.delay.watch import DelayEstimate, DelayWatch
from gray_box_observer.samples.raw_history import MotorHistory, RawHistory

SPACING = 8
"""Samples of the group between two pieces of work: a search must not cost more than all the motors'
estimates."""


class DelayRound:
    """Watches the delays of a group of motors, of which none is estimated: one motor at a time.

    Args:
        motors: how many.
        make: makes the watch of one.
        applied_s: the delay that was declared for all of them.
    """

    def __init__(self, motors: int, make: Callable[[int], DelayWatch], applied_s: float) -> None:
        self._make = make
        self._watches: list[DelayWatch | None] = [None] * motors
        self._query_counts = [0] * motors
        self._idle = DelayEstimate(applied_s, False)
        self._turn = 0
        self._count = 0

    def update(self, history: RawHistory, stamp_ns: int, *, is_awaited: bool = False) -> None:
        """Go on by one sample of the group; every so often a piece of work is done.

        Args:
            history: raw measurements of the group.
            stamp_ns: stamp of the sample.
            is_awaited: as in :meth:`DelayWatch.update`; of many motors somebody always waits, and
                it is not asked.
        """
        self._count += 1
        if self._count % SPACING:
            return
        watch = self.watch(self._turn)
        motor_history = MotorHistory(history, self._turn)
        watch.update(motor_history, stamp_ns, self._count - self._query_counts[self._turn])
        self._query_counts[self._turn] = self._count
        if not watch.searching:
            self._turn = (self._turn + 1) % len(self._watches)

    def watch(self, motor: int) -> DelayWatch:
        """Return the watch of one motor."""
        watch = self._watches[motor]
        if watch is None:
            watch = self._watches[motor] = self._make(motor)
        return watch

    def estimate_of(self, motor: int) -> DelayEstimate:
        """Return what is known of one motor."""
        watch = self._watches[motor]
        return self._idle if watch is None else watch.estimate

    def state(self, motor: int) -> dict[str, Any]:
        """What was found of one motor, for a checkpoint."""
        return self.watch(motor).state()

    def restore(self, plain: dict[str, Any], motor: int) -> None:
        """Take back what :meth:`state` gave."""
        self.watch(motor).restore(plain)
