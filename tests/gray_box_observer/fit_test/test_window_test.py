"""Which samples a test of the fit rests on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from linear_motor_records import (
    INTERVAL_S,
    TORQUE_CONSTANT,
    Record,
    current_of,
    noise,
    steps,
)

from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test import window_test
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.evidence import WINDOW
from gray_box_observer.fit_test.fit_result import PASSING, FitResult
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.window_test import WindowTest
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 300
SINCE_CHANGE = 40
FEW = 500


def result(verdict: FitVerdict, *, has_fitted: bool) -> FitResult:
    judgement = Judgement(verdict, np.ones(2), np.zeros((2, 2)))
    return FitResult(
        FitAssessment(verdict), judgement, np.ones(2), SAMPLES, 0, 64, 1.0, 1, 0.0, has_fitted
    )


@pytest.mark.parametrize(
    ('before', 'count'),
    [
        (None, SINCE_CHANGE),
        (result(FitVerdict.MISFIT, has_fitted=True), SINCE_CHANGE),
        (result(FitVerdict.MISFIT, has_fitted=False), SAMPLES),
        (result(FitVerdict.WARNING, has_fitted=False), SAMPLES),
    ],
)
def test_a_motor_that_never_fitted_is_tested_by_all_its_samples_whatever_it_took_for_a_change(
    before: FitResult | None, count: int
) -> None:
    replay = ReplayBuffer(1, 2 * SAMPLES)
    for k in range(SAMPLES):
        replay.append(Sample.of_one_motor(10_000_000 * (k + 1), 0.01, 1.0, 0.01))
    replay.forget(SINCE_CHANGE)
    answers = {'is_drifting': lambda _: False, 'present_since': lambda _: 0}
    nodes = cast(Any, SimpleNamespace(replay=replay, **answers))
    motor = MotorUnderTest.view(nodes, cast(Any, None), 0, DelayEstimate(0.0, False), before)
    assert motor.count(WINDOW) == count
    assert motor.newest(motor.count(WINDOW)).shape[2] == count


def test_a_lasting_misfit_that_tells_more_stands_and_what_later_samples_tell_is_kept() -> None:
    voltage_v = steps(2 * FEW, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(2 * FEW, 0.05, 7))
    motor = record.observed(stamps_exact=True).motors['motor']
    test = WindowTest(motor.configuration, motor.white_box, 'current')
    rich = replace(
        result(FitVerdict.MISFIT, has_fitted=True),
        assessment=FitAssessment(FitVerdict.MISFIT, 9.0, 9.0, (), 100 * FEW),
        place=FEW,
        misfits=PASSING + 1,
    )
    replay = ReplayBuffer(1, 2 * FEW)
    stretch = record.stretch
    for k in range(2 * FEW - 1):
        torque_nm = float(TORQUE_CONSTANT * stretch.state[0, k + 1])
        replay.append(Sample.of_one_motor(k, INTERVAL_S, float(voltage_v[k]), torque_nm))
    answers = {'is_drifting': lambda _: False, 'present_since': lambda _: 0}
    nodes = cast(Any, SimpleNamespace(replay=replay, **answers))
    later = MotorUnderTest.view(nodes, motor.estimate, 0, DelayEstimate(0.0, False), rich)
    tested = test.test(later, FEW)
    assert tested.assessment is rich.assessment
    assert (tested.place, tested.wait) == (2 * FEW - 1, 2 * rich.wait)
    assert tested.evidence.samples == FEW
    assert rich.outweighs(FEW, 1.0, speed_is_fitted=False)
    assert not rich.outweighs(FEW, 1.0, speed_is_fitted=True)  # its speed was the measured one
    of_fitted_speed = replace(rich, speed_is_fitted=True)
    assert of_fitted_speed.outweighs(FEW, 1.0, speed_is_fitted=False)
    assert of_fitted_speed.outweighs(FEW, 1.0, speed_is_fitted=True)
    few_told = replace(rich, assessment=FitAssessment(FitVerdict.MISFIT, 9.0, 9.0, (), FEW))
    assert not test.test(replace(later, before=few_told), FEW).is_lasting_misfit


def test_a_test_in_pieces_tests_the_samples_with_which_it_began() -> None:
    voltage_v = steps(2 * FEW, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(2 * FEW, 0.05, 7))
    motor = record.observed(stamps_exact=True).motors['motor']
    test = WindowTest(motor.configuration, motor.white_box, 'current')
    replay = ReplayBuffer(1, FEW)
    stretch = record.stretch

    def append(k: int) -> None:
        torque_nm = float(TORQUE_CONSTANT * stretch.state[0, k + 1])
        replay.append(Sample.of_one_motor(k, INTERVAL_S, float(voltage_v[k]), torque_nm))

    for k in range(FEW):
        append(k)
    answers = {'is_drifting': lambda _: False, 'present_since': lambda _: 0}
    nodes = cast(Any, SimpleNamespace(replay=replay, **answers))
    delay = DelayEstimate(0.0, False)
    subject = MotorUnderTest.view(nodes, motor.estimate, 0, delay, None).snapshot()
    at_once = test.test(subject, FEW)
    assert at_once.place == FEW
    pieces = test.pieces(subject, FEW)
    count = 0
    while True:
        for _ in range(FEW):  # the memory moves, and takes the room of the oldest
            append((FEW + count) % (2 * FEW - 1))
            count += 1
        try:
            next(pieces)
        except StopIteration as end:
            assert _digest(end.value) == _digest(at_once)
            break
    block = Configuration.from_flat({})['recursive.block']
    assert 5 < count // FEW < block, 'the rest would hold up the next estimate'


def test_newest_samples_that_leave_noise_alone_are_analysed_no_further(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    voltage_v = steps(FEW, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(FEW, 0.05, 7))
    motor = record.observed(stamps_exact=True).motors['motor']
    nodes = motor.observer.context_nodes
    test = WindowTest(motor.configuration, motor.white_box, 'current')
    before = result(FitVerdict.OK, has_fitted=True)
    healthy = MotorUnderTest.view(nodes, motor.estimate, 0, DelayEstimate(0.0, False), before)
    wrong = replace(motor.estimate, value=1.3 * motor.estimate.value)
    changed = test.test_change(replace(healthy, estimate=wrong), FEW)
    assert changed is not None
    assert changed.assessment.verdict is FitVerdict.MISFIT
    monkeypatch.setattr(window_test, 'analysis_in_pieces', None)
    assert test.test_change(healthy, FEW) is None


def _digest(result: FitResult) -> tuple[object, ...]:
    """Return a result as what can be compared to the last bit."""
    judgement = result.judgement
    arrays = (judgement.factor, judgement.spread, result.theta)
    return (
        result.assessment,
        result.evidence,
        *(array.tobytes() for array in arrays),
        *(result.place, result.begin, result.wait, result.range_v, result.noise_a),
    )
