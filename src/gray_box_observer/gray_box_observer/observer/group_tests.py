"""Tests of rotors that are sampled together: they have a share of the time, and take turns in it.

An estimate that is not believed yet waits for its test there, and so does one that was tested.
Between two of these, newest samples are looked at: a motor that has become another one is found
sooner than its next estimate. Of an estimate that has moved nothing is believed while it waits,
where there is no time at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import Estimate, RotorGroup
from gray_box_observer.context_nodes.pieces import SharedBudget
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.observer.pending_tests import PendingTests

LOOKS_A_TEST = 8
"""Looks at newest samples for every test, where both wait."""

WORK_OF_LOOK = 1300
"""Work of a look whether newest samples leave noise alone, see
:mod:`~gray_box_observer.context_nodes.pieces`."""

WORK_OF_TEST, WORK_A_TESTED = 3000, 7
"""Work of a test, and of each of its samples."""


class RotorGroupTests(PendingTests):
    """Tests the fit of rotors that are sampled together; arguments are those of PendingTests.

    Tests have as large a share of a core as the group's fits.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        nodes = self._belief.context_nodes
        assert isinstance(nodes, RotorGroup)
        self._nodes = nodes
        self._budget = SharedBudget(nodes.core_share)
        self._waiting_motors: dict[int, int] = {}  # since which sample of theirs, in order
        self._stale_motors: list[int] | None = None  # to be looked at, of the newest sample
        self._looks = 0  # since the last test

    @property
    def is_waiting(self) -> bool:
        """Whether there may be something to be tested before the next sample."""
        return self._budget.credit > 0.0 and not self._nodes.is_frozen

    def begin_sample(self, interval_s: float) -> None:
        """Note that a sample has come, so long after the one before; 0: not known."""
        if not self._nodes.is_frozen:
            self._budget.grant(interval_s)
            self._stale_motors = None

    def begin_estimate(self, estimate: Estimate, motors: NDArray[np.intp]) -> None:
        """Let new estimates wait for their tests, those first that nobody believes.

        Args:
            estimate: of the motors that have changed, as their rule gives it.
            motors: their places on the motor axis.
        """
        self._queue(self._schedule.due(self._nodes.replay, estimate, motors))

    def _queue(self, motors: list[int]) -> None:
        """Let motors wait for their tests, those first of which nothing is believed."""
        urgent_motors: dict[int, int] = {}
        for motor in motors:
            since = self._waiting_motors.get(motor, self._nodes.replay.received_of(motor))
            if self._schedule.has_moved(motor) and self.is_waiting:
                self.test(motor, is_out=False)
            elif self._schedule.is_urgent(motor):
                if self._schedule.has_moved(motor):
                    self._belief.withhold(motor)
                urgent_motors[motor] = since
            else:
                self._waiting_motors.setdefault(motor, since)
        others = {m: k for m, k in self._waiting_motors.items() if m not in urgent_motors}
        was_urgent = {m: k for m, k in others.items() if self._schedule.is_urgent(m)}
        calm = {m: k for m, k in others.items() if m not in was_urgent}
        self._waiting_motors = {**was_urgent, **urgent_motors, **calm}

    def schedule_newest(self) -> None:
        """Newest samples are looked at in turn, whoever asks."""

    def run(self) -> None:
        """Test and look as long as there is time; once a sample, whoever asks for it."""
        while self.is_waiting:
            if self._stale_motors is None:
                self._stale_motors = self._schedule.stale(self._nodes.replay)
            is_turn = self._looks >= LOOKS_A_TEST or not self._stale_motors
            if self._waiting_motors and is_turn:
                self._looks = 0
                self._test_next()
            elif self._stale_motors:
                self._looks += 1
                self._budget.credit -= WORK_OF_LOOK
                self._test_newest(self._stale_motors.pop(0))
            else:
                return

    def _test_next(self) -> None:
        """Test the motor that waits first."""
        motor = next(iter(self._waiting_motors))
        del self._waiting_motors[motor]
        self._test_due(motor)

    def complete_due(self) -> None:
        """Nothing waits for a sample that is learnt again."""

    def finish(self) -> list[int]:
        """Test all that waits, for no samples will come; return whom."""
        motors = list(self._waiting_motors)
        while self._waiting_motors:
            self._test_next()
        return motors

    def test(
        self,
        motor: int,
        *,
        is_out: bool,
        is_recent: bool = False,
        estimate: Estimate | None = None,
    ) -> Estimate:
        """Test the fit of one motor at once; see :meth:`PendingTests.test`."""
        self._waiting_motors.pop(motor, None)
        tested_count = self._belief.tested_count(motor)
        self._budget.credit -= WORK_OF_TEST + WORK_A_TESTED * tested_count
        return super().test(motor, is_out=is_out, is_recent=is_recent, estimate=estimate)

    def late_count(self, motor: int) -> int:
        """Return how many samples ago a test of one motor was due that has not been made."""
        since = self._waiting_motors.get(motor)
        return 0 if since is None else self._nodes.replay.received_of(motor) - since

    def restore(self, later_result: FitResult | None, motor: int = 0) -> None:
        """Let a motor wait for its test again, where one was due when it was saved."""
        one = np.array([motor])
        self._queue(self._schedule.due(self._nodes.replay, self._nodes.estimate(one), one))

    def give_up(self) -> None:
        """Forget what waits."""
        super().give_up()
        self._waiting_motors = {}
