"""Which samples a test of the fit rests on."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.evidence import WINDOW
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.window_test import MotorUnderTest
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample

SAMPLES, SINCE_CHANGE = 300, 40


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
    nodes = cast(Any, SimpleNamespace(replay=replay))
    motor = MotorUnderTest(nodes, cast(Any, None), 0, DelayEstimate(0.0, False), before)
    assert motor.count(WINDOW) == count
    assert motor.newest(motor.count(WINDOW)).shape[2] == count
