"""How far a test lets estimates be believed: compiled code says what plain numbers say."""

from __future__ import annotations

import shutil
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gray_box_observer.context_nodes.estimate import Verdict, VerdictSettings
from gray_box_observer.context_nodes.native import widened_estimate
from gray_box_observer.context_nodes.native.verdict_rules import MOST_JUDGED
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.estimate_limit import EstimateLimit
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import bounds

BOX = MotorWhiteBox(('inductance', 'resistance', 'hysteresis', 'brush_drop'), 0.01)
COUNT = len(BOX.parameters)

needs_it = pytest.mark.skipif(
    widened_estimate.library() is None, reason='built without a C compiler'
)


def result_of(factor: Any, spread: Any, verdict: FitVerdict = FitVerdict.OK) -> FitResult:
    """What a test has left that widens so."""
    judgement = Judgement(verdict, np.asarray(factor, float), np.asarray(spread, float))
    return FitResult(
        FitAssessment(verdict), judgement, np.ones(COUNT), 0, 0, 0, 0.0, 0, 0.0, has_fitted=True
    )


def nodes_with(share: Any, reach: Any) -> Any:
    """A rule that tells these shares of the voltage of each of some motors."""
    return SimpleNamespace(
        verdict_rules=VerdictSettings(), voltage_shares=lambda motor: (share[motor], reach[motor])
    )


@needs_it
def test_compiled_code_limits_as_plain_numbers_do_to_the_last_bit() -> None:
    random = np.random.default_rng(3)
    lower, upper = bounds(BOX.parameters)
    union = set()
    for trial in range(300):
        value = np.exp(random.uniform(np.log(lower), np.log(upper)))
        value[trial % COUNT] = (lower, upper, value)[trial % 3][trial % COUNT]
        shape = random.normal(size=(COUNT, COUNT)) * value[:, None]
        covariance = np.exp(random.uniform(-18.0, 0.0)) * shape @ shape.T
        if trial % 50 == 0:
            covariance[1, 1] = (np.nan, -1.0)[trial % 100 // 50]
        factors = 0.1 * random.normal(size=(COUNT, COUNT))
        spread = factors @ factors.T * random.integers(0, 2) * np.exp(random.uniform(-18.0, 0.0))
        factor = np.exp(random.uniform(0.0, 2.0, COUNT))
        share = random.uniform(0.0, 2e-3, (2, COUNT)) / value * random.integers(0, 2, COUNT)
        nodes = nodes_with(share, random.uniform(0.0, 2e-3, (2, COUNT)))
        places = random.integers(0, 2, COUNT)
        verdicts = tuple((Verdict.IDENTIFIED, Verdict.UNEXCITED)[place] for place in places)
        verdict = (FitVerdict.OK, FitVerdict.MISFIT)[trial % 7 == 0]
        limit = EstimateLimit(BOX.parameters, result_of(factor, spread, verdict))
        by_hand = EstimateLimit(BOX.parameters, result_of(factor, spread, verdict))
        by_hand._native.is_compiled = False
        own = covariance.copy()
        other = covariance.copy()
        remainder = limit.apply(nodes, 1, value, own, verdicts)
        assert remainder == by_hand.apply(nodes, 1, value, other, verdicts)
        assert own.tobytes() == other.tobytes()
        assert own.tobytes() != covariance.tobytes()
        union.update(remainder)
    assert union == set(Verdict) - {Verdict.FROZEN}


def test_the_compiled_code_is_built() -> None:
    if shutil.which('cc') is None and shutil.which('gcc') is None:
        pytest.skip('no C compiler')
    assert widened_estimate.library() is not None, 'ros_ws/setup.sh builds it'


def test_more_parameters_than_it_has_room_for_are_left_to_plain_numbers() -> None:
    parameters = BOX.parameters * 4
    assert len(parameters) > MOST_JUDGED
    count = len(parameters)
    judgement = Judgement(FitVerdict.OK, 2.0 * np.ones(count), np.zeros((count, count)))
    limit = EstimateLimit(parameters, replace(result_of(1.0, 0.0), judgement=judgement))
    assert not limit._native.is_compiled
    nothing = np.zeros((1, count))
    covariance = np.eye(count)
    verdicts = (Verdict.IDENTIFIED,) * count
    limit.apply(nodes_with(nothing, nothing), 0, np.ones(count), covariance, verdicts)
    np.testing.assert_array_equal(covariance, 4.0 * np.eye(count))


def test_without_a_test_nothing_is_identified_and_the_covariance_stays() -> None:
    limit = EstimateLimit(BOX.parameters, None)
    covariance = np.eye(COUNT)
    verdicts = (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE, Verdict.UNEXCITED, Verdict.IMPLAUSIBLE)
    remainder = limit.apply(nodes_with([], []), 0, np.ones(COUNT), covariance, verdicts)
    assert remainder == (Verdict.CONVERGING,) * 2 + verdicts[2:]
    np.testing.assert_array_equal(covariance, np.eye(COUNT))
    assert not (limit.is_open or limit.widens)


def test_a_test_that_widens_nothing_leaves_all_believed() -> None:
    limit = EstimateLimit(BOX.parameters, result_of(np.ones(COUNT), np.zeros((COUNT, COUNT))))
    assert limit.is_open


def test_what_fits_on_a_weak_basis_is_not_identified() -> None:
    fitting = result_of(np.ones(COUNT), np.zeros((COUNT, COUNT)))
    identified = (Verdict.IDENTIFIED,) * COUNT
    nodes = nodes_with([], [])
    names = [parameter.name for parameter in BOX.parameters]
    for open_names in ((), names[:1], names):
        limit = EstimateLimit(BOX.parameters, fitting, open_parameters=open_names)
        assert limit.is_open == (not open_names)
        left = limit.apply(nodes, 0, np.ones(COUNT), np.eye(COUNT), identified)
        count = len(open_names)
        assert left == (Verdict.CONVERGING,) * count + (Verdict.IDENTIFIED,) * (COUNT - count)


def test_a_frozen_motor_stays_frozen_and_is_known_less_well() -> None:
    limit = EstimateLimit(BOX.parameters, result_of(3.0 * np.ones(COUNT), np.eye(COUNT)))
    covariance = np.eye(COUNT)
    nothing = np.zeros((1, COUNT))
    frozen = (Verdict.FROZEN,) * COUNT
    value = 2.0 * np.ones(COUNT)
    assert limit.apply(nodes_with(nothing, nothing), 0, value, covariance, frozen) == frozen
    np.testing.assert_array_equal(covariance, 13.0 * np.eye(COUNT))


def test_verdicts_follow_the_rule_from_one_estimate_to_the_next() -> None:
    limit = EstimateLimit(BOX.parameters, result_of(1.5 * np.ones(COUNT), np.zeros((COUNT, COUNT))))
    nothing = np.zeros((1, COUNT))
    nodes = nodes_with(nothing, nothing)
    value = np.sqrt(np.multiply(*bounds(BOX.parameters)))

    def limited(relative_std: float, verdict: Verdict) -> tuple[Verdict, ...]:
        covariance = np.diag((relative_std * value) ** 2)
        return limit.apply(nodes, 0, value, covariance, (verdict,) * COUNT)

    assert set(limited(1e-3, Verdict.IDENTIFIED)) == {Verdict.IDENTIFIED}
    assert set(limited(1e-3, Verdict.CONVERGING)) == {Verdict.CONVERGING}
    assert set(limited(1e-3, Verdict.IDENTIFIED)) == {Verdict.IDENTIFIED}
    assert set(limited(0.1, Verdict.IDENTIFIED)) == {Verdict.CONVERGING}
    nodes.verdict_rules = VerdictSettings(identified_relative_std=0.2)
    assert set(limited(0.1, Verdict.IDENTIFIED)) == {Verdict.IDENTIFIED}
