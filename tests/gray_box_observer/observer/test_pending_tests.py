"""Which tests of the fit an estimate waits for, and which come behind the sample."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gray_box_observer.context_nodes import Estimate, MeasuredSpeedUpdate
from gray_box_observer.delay import DelayEstimate, DelayRound
from gray_box_observer.observer.deferred_fit_test import DeferredFitTest
from gray_box_observer.observer.parameter_belief import ParameterBelief
from gray_box_observer.observer.pending_tests import PendingTests

ESTIMATE = cast(Estimate, 'as the rule gives it')
DELAY = DelayEstimate(0.0, is_estimated=False)


class Schedule:
    """Motors that are due, and what is said of them."""

    def __init__(self) -> None:
        self.due_motors: list[int] = []
        self.urgent_motors: set[int] = set()
        self.settled = False
        self.stale = False

    def due(self, replay: object, estimate: object, motors: np.ndarray) -> list[int]:
        """Return those of some motors that are due."""
        return [motor for motor in self.due_motors if motor in motors]

    def is_settled(self, estimate: object) -> bool:
        """Tell of the motor whether its test can wait for the results."""
        return self.settled

    def is_urgent(self, motor: int) -> bool:
        """Tell whether the estimate waits for the test."""
        return motor in self.urgent_motors

    def is_stale(self, replay: object, motor: int) -> bool:
        """Tell whether the newest samples are to be tested."""
        return self.stale


class Bench:
    """Tests of so many motors, and what was done, in order."""

    def __init__(self, motors: int, nodes: type = SimpleNamespace) -> None:
        self.log: list[Any] = []
        self.is_noise = False
        self.given_estimates: list[object] = []
        self.schedule = Schedule()
        stated = {'theta': np.ones((motors, 2)), 'replay': None, '__init__': lambda self: None}
        rule = type('Rule', (nodes,), stated)
        belief = SimpleNamespace(
            context_nodes=rule(),
            test=self._test,
            begin_test=self._begin,
            follow=self._follow,
            leaves_noise_alone=lambda motor: self.is_noise,
        )
        self.tests = PendingTests(
            cast(ParameterBelief, belief),
            cast(Any, self.schedule),
            cast(DelayRound, SimpleNamespace(estimate_of=lambda motor: DELAY)),
            lambda estimate, motors: self.log.append(('keep', estimate, motors)),
            lambda motor, has_news: self.log.append(('note', motor, has_news)),
        )

    def _test(
        self, motor: int, delay: object, *, is_recent: bool, estimate: object
    ) -> tuple[Any, bool]:
        assert delay is DELAY
        self.given_estimates.append(estimate)
        self.log.append(('newest' if is_recent else 'test', motor))
        return f'tested {motor}', True

    def _begin(self, motor: int, delay: object) -> Any:
        assert delay is DELAY
        self.log.append(('begin', motor))

        def pieces() -> Any:
            self.log.append('piece')
            yield 1
            return 'result'

        return pieces()

    def _follow(self, motor: int, result: object) -> tuple[Any, bool]:
        self.log.append(('follow', motor, result))
        return f'followed {motor}', True

    def estimated(self, *motors: int) -> list[Any]:
        """Let the estimates of motors change; return what that has done."""
        self.log.clear()
        self.tests.begin_estimate(ESTIMATE, np.array(motors))
        return list(self.log)

    def run(self) -> list[Any]:
        """Do what is left of the sample; return what that was."""
        self.log.clear()
        self.tests.run()
        return list(self.log)


def test_of_a_group_only_who_is_urgent_is_waited_for() -> None:
    bench = Bench(3)
    bench.schedule.due_motors = [2, 0, 1]
    bench.schedule.urgent_motors = {0}
    assert bench.estimated(0, 2) == [('test', 0), ('note', 0, False)]
    assert bench.tests.is_waiting
    bench.schedule.due_motors = []
    later = [('test', 2), ('note', 2, True), ('keep', 'tested 2', slice(2, 3))]
    assert bench.run() == later
    assert not bench.tests.is_waiting
    assert bench.run() == []


def test_a_motor_alone_is_tested_by_the_estimate_that_waits() -> None:
    bench = Bench(1)
    bench.schedule.due_motors = [0]
    bench.schedule.urgent_motors = {0}
    assert bench.estimated(0) == [('test', 0), ('note', 0, False)]
    assert bench.given_estimates == [ESTIMATE], 'its rule is not asked twice'
    group = Bench(2)
    group.schedule.due_motors = [1]
    group.schedule.urgent_motors = {1}
    assert group.estimated(0, 1) == [('test', 1), ('note', 1, False)]
    assert group.given_estimates == [None], 'that is of all of them'


def test_of_a_motor_alone_that_is_settled_the_question_waits_too() -> None:
    bench = Bench(1)
    bench.schedule.due_motors = [0]
    bench.schedule.settled = True
    assert bench.estimated(0) == []
    assert bench.tests.is_waiting
    assert bench.run() == [('begin', 0)]
    bench.tests.begin_sample(0.001)
    assert bench.run() == ['piece']
    follow = [('follow', 0, 'result'), ('note', 0, False)]
    assert bench.estimated(0) == follow, 'it counts with the next estimate'


def test_a_piece_comes_before_what_is_due_and_is_left_out_where_samples_are_learnt_again() -> None:
    bench = Bench(1)
    bench.schedule.due_motors = [0]
    bench.schedule.settled = True
    bench.estimated(0)
    bench.run()
    bench.tests.begin_sample(0.001)
    bench.schedule.stale = True
    bench.tests.schedule_newest()
    bench.log.clear()
    bench.tests.complete_due()
    assert [entry[0] for entry in bench.log] == ['newest', 'note', 'keep']
    bench.tests.schedule_newest()
    assert [entry if entry == 'piece' else entry[0] for entry in bench.run()] == [
        'piece', 'newest', 'note', 'keep',
    ]  # fmt: skip


def test_a_motor_whose_next_estimate_may_be_far_is_tested_at_once() -> None:
    bench = Bench(1, MeasuredSpeedUpdate)
    bench.schedule.due_motors = [0]
    assert bench.estimated(0) == []
    assert [entry[0] for entry in bench.run()] == ['test', 'note', 'keep']


@pytest.mark.parametrize('is_stale', [False, True])
def test_the_newest_samples_alone_are_tested_where_they_are_stale_and_nothing_is_due(
    is_stale: bool,
) -> None:
    bench = Bench(2)
    bench.schedule.stale = is_stale
    for _ in range(2):
        bench.tests.schedule_newest()
    done = [entry[0] for entry in bench.run()]
    assert done == (['newest', 'note', 'keep'] if is_stale else [])


def test_newest_samples_that_leave_noise_alone_need_no_test() -> None:
    bench = Bench(1)
    bench.is_noise = True
    bench.schedule.stale = True
    bench.tests.schedule_newest()
    assert bench.run() == [('note', 0, False)]


def test_giving_up_leaves_nothing() -> None:
    bench = Bench(1)
    bench.schedule.due_motors = [0]
    bench.schedule.settled = True
    bench.estimated(0)
    bench.run()
    bench.estimated(0)
    bench.schedule.stale = True
    bench.tests.schedule_newest()
    bench.tests.give_up()
    assert not bench.tests.is_waiting
    assert bench.tests.later_result() is None
    assert bench.run() == []


def test_a_test_of_many_pieces_is_done_before_the_next_estimate_of_the_default_block() -> None:
    work = iter(range(49))

    def pieces() -> Any:
        yield from work
        return 'result'

    test = DeferredFitTest(pieces())
    for _ in range(31):
        test.begin_sample()
        test.advance()
        test.advance()
    assert next(work, None) is None, 'nothing holds the estimate up'
    assert test.result() == 'result'
