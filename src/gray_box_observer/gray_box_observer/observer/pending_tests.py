"""Tests of the fit that are due or have begun: what an estimate waits for, and what comes later.

An estimate that nobody believes yet, or that has moved, waits for its test. Any other goes out
first, and its motor is tested behind the sample: at once, or, where it comes alone and its next
estimate is never far, in pieces (`deferred_fit_test.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate, RotorUpdate
from gray_box_observer.delay import DelayRound, DelayWatch
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.fit_schedule import FitSchedule
from gray_box_observer.observer.deferred_fit_test import DeferredFitTest
from gray_box_observer.observer.parameter_belief import ParameterBelief


class PendingTests:
    """Tests the fit of motors that are observed by one form, each when that is due.

    Args:
        belief: in their parameters; a test changes it.
        schedule: says whose test is due.
        delay: what is known of their delays.
        keep: keeps what is believed of some motors after a test, by their index on the motor axis.
            Their estimates had gone out before.
        note: is told of a motor that was tested, and whether its belief is another than has gone
            out.
    """

    def __init__(
        self,
        belief: ParameterBelief,
        schedule: FitSchedule,
        delay: DelayWatch | DelayRound,
        keep: Callable[[Estimate, Any], object],
        note: Callable[[int, bool], None],
    ) -> None:
        self._belief = belief
        self._schedule = schedule
        self._delay = delay
        self._keep = keep
        self._note = note
        nodes = belief.context_nodes
        self._is_alone = nodes.theta.shape[0] == 1
        is_fitted = isinstance(nodes, RotorUpdate | MeasuredSpeedUpdate)
        self._is_in_pieces = self._is_alone and not is_fitted
        self._tests_due: list[tuple[int, bool]] = []  # motor, and whether its newest samples alone
        self._open_test: DeferredFitTest | None = None
        self._unscheduled_estimate: Estimate | None = None  # of a motor alone; it has gone out

    @property
    def is_waiting(self) -> bool:
        """Whether something is left to be asked or tested before the next sample."""
        return bool(self._tests_due) or self._unscheduled_estimate is not None

    def begin_sample(self, interval_s: float) -> None:
        """Note that a sample has come, behind which there is time for a piece of a test.

        Args:
            interval_s: time since the one before; 0: not known.
        """
        if self._open_test is not None:
            self._open_test.begin_sample()

    def run(self) -> None:
        """Do what the last sample has left: a piece of the test that has begun, and what is due."""
        if self._unscheduled_estimate is not None:
            self._ask()
        if self._open_test is not None:
            test, self._open_test = self._open_test, None  # one that fails is given up
            test.advance()
            self._open_test = test
        if self._tests_due:
            self._do_due()

    def complete_due(self) -> None:
        """Do what is due, and no piece of the test that has begun."""
        if self._unscheduled_estimate is not None:
            self._ask()
        if self._tests_due:
            self._do_due()

    def _ask(self) -> None:
        """Ask whether a test is due of the one motor whose newest estimate has gone out."""
        estimate, self._unscheduled_estimate = self._unscheduled_estimate, None
        assert estimate is not None
        motors = self._schedule.due(self._belief.context_nodes.replay, estimate, _FIRST)
        self._tests_due += [(motor, False) for motor in motors]

    def _do_due(self) -> None:
        """Do tests that are due, or begin one whose result counts with the next estimate."""
        tests, self._tests_due = self._tests_due, []
        for motor, is_recent in tests:
            if is_recent:
                self._test_newest(motor)
            elif not self._is_in_pieces:
                self._test_due(motor)
            else:
                self.end(is_out=True)
                work = self._belief.begin_test(motor, self._delay.estimate_of(motor))
                if work is not None:
                    self._open_test = DeferredFitTest(work)

    def _test_due(self, motor: int) -> None:
        """Test one motor whose estimate has gone out."""
        self._keep(self.test(motor, is_out=True), slice(motor, motor + 1))

    def _test_newest(self, motor: int) -> None:
        """Test the newest samples of a rotor, where they are no plain noise."""
        if self._belief.leaves_noise_alone(motor):
            self._note(motor, False)
            return
        estimate = self.test(motor, is_out=True, is_recent=True)
        self._keep(estimate, slice(motor, motor + 1))

    def begin_estimate(self, estimate: Estimate, motors: NDArray[np.intp]) -> None:
        """Test what a new estimate waits for; what it does not wait for is due behind the sample.

        Args:
            estimate: of the motors that have changed, as their rule gives it.
            motors: their places on the motor axis.
        """
        self.end(is_out=False)
        if self._is_alone and self._schedule.is_settled(estimate):
            self._unscheduled_estimate = estimate
            return
        for motor in self._schedule.due(self._belief.context_nodes.replay, estimate, motors):
            if self._schedule.is_urgent(motor):
                own_estimate = estimate if self._is_alone else None
                self.test(motor, is_out=False, estimate=own_estimate)
            else:
                self._tests_due.append((motor, False))

    def schedule_newest(self) -> None:
        """Ask of a motor with a rotor whether its newest samples alone are to be tested."""
        replay = self._belief.context_nodes.replay
        if not self._tests_due and self._schedule.is_stale(replay, 0):
            self._tests_due.append((0, True))

    def test(
        self,
        motor: int,
        *,
        is_out: bool,
        is_recent: bool = False,
        estimate: Estimate | None = None,
    ) -> Estimate:
        """Test the fit of one motor at once; return its estimate as far as that allows.

        Args:
            motor: its place on the motor axis.
            is_out: whether its present estimate has gone out already.
            is_recent: whether its newest samples alone are tested.
            estimate: of this motor alone, as its rule gives it now; None: the rule is asked.
        """
        delay = self._delay.estimate_of(motor)
        belief, has_changed = self._belief.test(
            motor, delay, is_recent=is_recent, estimate=estimate
        )
        self._note(motor, is_out and has_changed)
        return belief

    def end(self, *, is_out: bool) -> bool:
        """Let the result of the test that has begun count; tell whether it changes the belief.

        Args:
            is_out: whether the present estimate has gone out already.
        """
        if self._open_test is None:
            return False
        test, self._open_test = self._open_test, None
        estimate, has_changed = self._belief.follow(0, test.result())
        self._note(0, is_out and has_changed)
        if is_out:
            self._keep(estimate, slice(None))
        return has_changed

    def later_result(self) -> FitResult | None:
        """Return the result of the test that has begun; it counts with the next estimate."""
        test, self._open_test = self._open_test, None  # one that fails is given up
        result = None if test is None else test.result()
        self._open_test = test
        return result

    def restore(self, later_result: FitResult | None, motor: int = 0) -> None:
        """Take back the result of a motor alone that does not count yet, where there is one.

        Args:
            later_result: it; None: there is none.
            motor: whose, by its place on the motor axis.
        """
        if self._is_alone and later_result is not None:
            self._open_test = DeferredFitTest(later_result)

    def finish(self) -> list[int]:
        """Make tests that wait, for no samples will come; return the motors: none waits here."""
        return []

    def late_count(self, motor: int) -> int:
        """Return how many samples ago a test was due that has not been made: none waits here."""
        return 0

    def give_up(self) -> None:
        """Forget all of it: the samples were paired by another delay."""
        self._tests_due = []
        self._open_test = None
        self._unscheduled_estimate = None


_FIRST = np.arange(1)
