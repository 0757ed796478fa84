"""Tests of rotors that are sampled together: they have a share of the time, and take turns in it.

An estimate that is not believed yet waits for its test there. Between two of these, newest samples
are looked at: a motor that has become another one is found sooner than its next estimate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import Estimate, RotorGroup
from gray_box_observer.context_nodes.pieces import SharedBudget
from gray_box_observer.observer.pending_tests import PendingTests

LOOKS_A_TEST = 8
"""Looks at newest samples for every test, where both wait: they then take the time of one in three.
"""

WORK_OF_LOOK = 1300
"""Work of a look whether newest samples leave noise alone, see
:mod:`~gray_box_observer.context_nodes.pieces`."""

WORK_OF_TEST, WORK_A_TESTED = 3000, 7
"""Work of a test, and of each of its samples."""


class RotorGroupTests(PendingTests):
    """Tests the fit of rotors that are sampled together; arguments are those of PendingTests."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        nodes = self._belief.context_nodes
        assert isinstance(nodes, RotorGroup)
        self._budget = SharedBudget(nodes.core_share)
        self._waiting_motors: dict[int, None] = {}  # in the order of their estimates
        self._looks = 0  # since the last test

    @property
    def is_waiting(self) -> bool:
        """Whether something is left to be asked or tested before the next sample."""
        return self._budget.credit > 0.0

    def begin_sample(self, interval_s: float) -> None:
        """Note that a sample has come, so long after the one before; 0: not known."""
        self._budget.grant(interval_s)

    def begin_estimate(self, estimate: Estimate, motors: NDArray[np.intp]) -> None:
        """Test what has moved; other new estimates wait for their turn.

        Args:
            estimate: of the motors that have changed, as their rule gives it.
            motors: their places on the motor axis.
        """
        replay = self._belief.context_nodes.replay
        for motor in self._schedule.due(replay, estimate, motors):
            if self._schedule.has_moved(motor):
                self.test(motor, is_out=False)
                self._waiting_motors.pop(motor, None)
            else:
                self._waiting_motors[motor] = None

    def schedule_newest(self) -> None:
        """Newest samples are looked at in turn, whoever asks."""

    def run(self) -> None:
        """Test and look as long as there is time."""
        stale_motors: list[int] | None = None
        while self._budget.credit > 0.0:
            if self._waiting_motors and (self._looks >= LOOKS_A_TEST or stale_motors == []):
                motor = next(iter(self._waiting_motors))
                del self._waiting_motors[motor]
                self._looks = 0
                self._test_due(motor)
                continue
            if stale_motors is None:
                stale_motors = self._schedule.stale(self._belief.context_nodes.replay)
            if stale_motors:
                self._looks += 1
                self._budget.credit -= WORK_OF_LOOK
                self._test_newest(stale_motors.pop(0))
            elif not self._waiting_motors:
                return

    def complete_due(self) -> None:
        """Nothing waits for a sample that is learnt again."""

    def test(
        self,
        motor: int,
        *,
        is_out: bool,
        is_recent: bool = False,
        estimate: Estimate | None = None,
    ) -> Estimate:
        """Test the fit of one motor at once; see :meth:`PendingTests.test`."""
        tested_count = self._belief.tested_count(motor)
        self._budget.credit -= WORK_OF_TEST + WORK_A_TESTED * tested_count
        return super().test(motor, is_out=is_out, is_recent=is_recent, estimate=estimate)

    def give_up(self) -> None:
        """Forget what waits."""
        super().give_up()
        self._waiting_motors = {}
