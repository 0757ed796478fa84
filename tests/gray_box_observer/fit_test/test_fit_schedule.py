"""When the fit of a motor is tested: by counts of samples, of one motor as of many."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gray_box_observer.context_nodes.estimate import Estimate, Verdict
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.fit_result import PASSING, FitResult
from gray_box_observer.fit_test.fit_schedule import (
    LONGEST_SOON,
    RECENT_WAIT,
    SHORT,
    SHORTEST_WAIT,
    UNASKED,
    FitSchedule,
    wait_after,
)
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.saved_test import LONGEST_WAIT, check_saved_test

FEWEST = 64
THETA = np.array([8e-3, 2.0])
BELIEVED = Verdict.IDENTIFIED
OPEN = Verdict.CONVERGING


class Streams:
    """As many samples of every motor, none of them to be forgotten."""

    def __init__(self, motors: int, received: int) -> None:
        self.received = np.full(motors, received)

    def begin(self, motors: np.ndarray) -> np.ndarray:
        """Place before the oldest sample that counts."""
        return np.zeros_like(motors)

    def received_of(self, motor: int) -> int:
        """Place of one motor's newest sample."""
        return int(self.received[motor])

    def begin_of(self, motor: int) -> int:
        """The same place of one motor."""
        return 0


def estimate_of(motors: int, verdict: Verdict = BELIEVED, factor: float = 1.0) -> Estimate:
    value = np.tile(factor * THETA, (motors, 1))
    covariance = np.zeros((motors, 2, 2))
    return Estimate(0, (), value, covariance, ((verdict, verdict),) * motors)


def result_at(place: int, verdict: FitVerdict, wait: int, misfits: int = 0) -> FitResult:
    judgement = Judgement(verdict, np.ones(2), np.zeros((2, 2)))
    assessment = FitAssessment(verdict)
    has_fitted = verdict is FitVerdict.OK
    return FitResult(
        assessment, judgement, THETA, place, 0, wait, 1.0, misfits, 0.0, has_fitted=has_fitted
    )


def is_due(
    schedule: FitSchedule, received: int, verdict: Verdict = BELIEVED, factor: float = 1.0
) -> bool:
    estimate = estimate_of(1, verdict, factor)
    return schedule.due(Streams(1, received), estimate, np.arange(1)) == [0]


@pytest.fixture
def schedule() -> FitSchedule:
    """Of one motor."""
    return FitSchedule(np.array([FEWEST]), 2)


def test_a_motor_is_first_tested_when_something_would_be_believed(schedule: FitSchedule) -> None:
    assert not is_due(schedule, FEWEST - 1)
    assert is_due(schedule, FEWEST)
    assert not is_due(schedule, UNASKED - 1, OPEN)
    assert is_due(schedule, UNASKED, OPEN)


def test_a_motor_that_has_passed_waits_unless_what_is_believed_has_moved(
    schedule: FitSchedule,
) -> None:
    schedule.follow(0, result_at(1000, FitVerdict.OK, 800))
    assert not is_due(schedule, 1799)
    assert is_due(schedule, 1800)
    assert not schedule.is_urgent(0)
    assert not is_due(schedule, 1000 + SHORTEST_WAIT, OPEN, factor=1.2)
    assert not is_due(schedule, 1000 + SHORTEST_WAIT - 1, factor=1.2)
    assert is_due(schedule, 1000 + SHORTEST_WAIT, factor=1.2)
    assert schedule.is_urgent(0)


def test_a_misfit_that_has_become_another_motor_is_asked_ever_less(schedule: FitSchedule) -> None:
    for misfits, soon in ((1, SHORTEST_WAIT), (PASSING + 1, 2 * SHORTEST_WAIT), (90, LONGEST_SOON)):
        schedule.follow(0, result_at(1000, FitVerdict.MISFIT, LONGEST_WAIT, misfits))
        assert not is_due(schedule, 1000 + soon - 1, OPEN, factor=1.2)
        assert is_due(schedule, 1000 + soon, OPEN, factor=1.2)


def test_the_wait_follows_the_samples_and_doubles_after_misfits() -> None:
    passed, misfit = (result_at(0, verdict, 1500) for verdict in (FitVerdict.OK, FitVerdict.MISFIT))
    assert wait_after(None, FitVerdict.OK, 10) == SHORTEST_WAIT
    assert wait_after(None, FitVerdict.WARNING, 700) == 700
    assert wait_after(misfit, FitVerdict.OK, 9000) == LONGEST_WAIT
    assert wait_after(passed, FitVerdict.MISFIT, 700) == SHORTEST_WAIT
    assert wait_after(result_at(0, FitVerdict.MISFIT, 100), FitVerdict.MISFIT, 700) == 200
    assert wait_after(misfit, FitVerdict.MISFIT, 700) == LONGEST_WAIT


def test_newest_samples_are_tested_only_of_a_motor_that_has_passed(schedule: FitSchedule) -> None:
    late = Streams(1, 1000 + RECENT_WAIT)
    assert not schedule.is_stale(late, 0)
    schedule.begin_test(0, 1000)
    schedule.follow(0, result_at(1000, FitVerdict.MISFIT, LONGEST_WAIT))
    assert not schedule.is_stale(late, 0)
    schedule.follow(0, result_at(1000, FitVerdict.WARNING, LONGEST_WAIT))
    assert schedule.is_stale(late, 0)
    assert not schedule.is_stale(Streams(1, 999 + RECENT_WAIT), 0)


def test_of_many_rotors_those_are_looked_at_that_have_waited_longest() -> None:
    motors = 1000
    many = FitSchedule(np.full(motors, FEWEST), 2, motors)
    assert many.stale(Streams(motors, 5000)) == []
    for motor in range(motors):
        many.begin_test(motor, 2000 - motor)
        many.follow(motor, result_at(2000 - motor, FitVerdict.OK, LONGEST_WAIT))
    many.follow(999, result_at(1001, FitVerdict.MISFIT, LONGEST_WAIT))
    first = many.stale(Streams(motors, 2000 + RECENT_WAIT))
    assert first == [998, 997, 996, 995, 994, 993, 992, 991]
    for motor in first:
        many.begin_test(motor, 2000 + RECENT_WAIT)
    assert many.stale(Streams(motors, 2000 + RECENT_WAIT))[0] == 990
    assert many.stale(Streams(motors, 1000 + RECENT_WAIT)) == []


@pytest.mark.parametrize('fit', [FitVerdict.OK, FitVerdict.MISFIT, None])
def test_a_motor_alone_is_asked_as_one_that_comes_with_another(fit: FitVerdict | None) -> None:
    """Of one motor plain numbers tell mostly that nothing is due; of several it takes arrays."""
    alone = FitSchedule(np.array([FEWEST]), 2)
    both = FitSchedule(np.full(2, FEWEST), 2)
    if fit is not None:
        for schedule, motor in ((alone, 0), (both, 0), (both, 1)):
            schedule.follow(motor, result_at(100, fit, 300))
    for received in (10, FEWEST, UNASKED, 163, 164, 399, 400):
        for verdict in (BELIEVED, OPEN):
            for factor in (0.8, 0.95, 1.05, 1.2, np.nan):
                estimate = estimate_of(2, verdict, factor)
                expected = both.due(Streams(2, received), estimate, np.arange(2)) == [0]
                assert is_due(alone, received, verdict, factor) is expected


def test_only_what_was_tested_and_fitted_may_wait_for_its_next_test(schedule: FitSchedule) -> None:
    assert not schedule.is_settled(estimate_of(1))
    schedule.follow(0, result_at(1000, FitVerdict.OK, 800))
    assert schedule.is_settled(estimate_of(1))
    assert schedule.is_settled(estimate_of(1, OPEN, factor=1.2))
    assert not schedule.is_settled(estimate_of(1, factor=1.2))
    schedule.follow(0, result_at(1000, FitVerdict.MISFIT, 800))
    assert not schedule.is_settled(estimate_of(1))
    schedule.follow(0, result_at(1000, FitVerdict.OK, 800))
    schedule.forget()
    assert not schedule.is_settled(estimate_of(1))


def test_of_many_motors_who_has_waited_longest_is_tested_first() -> None:
    many = FitSchedule(np.full(3, FEWEST), 2)
    everybody = np.arange(3)
    for motor, place in enumerate((300, 100, 200)):
        many.follow(motor, result_at(place, FitVerdict.OK, 100))
    for motor in (1, 2, 0):
        assert many.due(Streams(3, 400), estimate_of(3), everybody) == [motor]
        many.follow(motor, result_at(400, FitVerdict.OK, 100))
    assert many.due(Streams(3, 400), estimate_of(3), everybody) == []


@pytest.mark.parametrize('result', [None, result_at(1000, FitVerdict.OK, 800)])
def test_a_restored_schedule_asks_at_the_same_samples(
    schedule: FitSchedule, result: FitResult | None
) -> None:
    if result is not None:
        schedule.follow(0, result)
    other = FitSchedule(np.array([FEWEST]), 2)
    other.follow(0, result_at(50, FitVerdict.MISFIT, 64, 3))
    other.restore(schedule.state(0, 1200), 0, 1200, result)
    for received in (63, 64, 200, 256, 1799, 1800):
        for factor in (1.0, 1.2):
            expected = is_due(schedule, received, factor=factor)
            assert is_due(other, received, factor=factor) is expected
            assert other.is_urgent(0) is schedule.is_urgent(0)


def test_a_test_that_stands_ahead_of_what_is_remembered_can_be_saved_and_restored() -> None:
    """The samples of a measured speed end with the last fit of the whole motor."""
    schedule = FitSchedule(np.array([64]), 2)
    schedule.begin_test(0, 512)
    schedule.follow(0, result_at(512, FitVerdict.OK, 512))
    state = schedule.state(0, 320)
    result = result_at(512, FitVerdict.OK, 512).state(320)
    assert (state['tested_at'], result['place']) == (192, 192)
    check_saved_test({**state, **result}, 2)
    restored = FitSchedule(np.array([64]), 2)
    restored.restore(state, 0, 320, FitResult.restored(result, 320))
    assert restored.state(0, 320) == state


@pytest.mark.parametrize(
    ('name', 'absurd', 'culprit'),
    [
        ('delay_s', math.inf, 'delay_s'),
        ('delay_s', 'late', 'delay_s'),
        ('evidence', {'samples': -1.0, 'amounts': {}}, 'samples'),
        ('evidence', [], 'evidence'),
        ('begin', 1.5, 'begin'),
        ('present_since', 'now', 'present_since'),
        ('untested_spread', [[1.0]], 'untested_spread'),
        ('untested_spread', [[1.0, 2.0], [2.0, 1.0]], 'untested_spread'),
        ('untested_spread', [['2.0', '2.0'], ['2.0', '2.0']], 'untested_spread'),
        ('untested_spread', [[True, False], [False, True]], 'untested_spread'),
        ('spread', [['0.0', '0.0'], ['0.0', '0.0']], 'spread'),
    ],
)
def test_a_checkpoint_with_an_absurd_test_is_refused(
    name: str, absurd: object, culprit: str
) -> None:
    schedule = FitSchedule(np.array([64]), 2)
    plain = schedule.state(0, 320) | result_at(300, FitVerdict.OK, 512).state(320)
    check_saved_test(plain, 2)
    with pytest.raises(CheckpointError, match=culprit):
        check_saved_test({**plain, name: absurd}, 2)


@pytest.mark.parametrize(
    ('shift', 'wait', 'waits_for_it'),
    [(0.0, SHORT, False), (0.002, SHORT, False), (0.01, SHORT, True), (0.01, 2 * SHORT, False)],
)
def test_an_estimate_waits_for_a_short_test_by_which_a_doubt_may_go(
    schedule: FitSchedule, shift: float, wait: int, waits_for_it: bool
) -> None:
    result = result_at(FEWEST, FitVerdict.OK, wait)
    spread = np.diag([0.0, shift**2])
    schedule.follow(0, replace(result, judgement=Judgement(FitVerdict.OK, np.ones(2), spread)))
    assert schedule.is_urgent(0) == waits_for_it
    assert schedule.is_settled(estimate_of(1)) != waits_for_it
