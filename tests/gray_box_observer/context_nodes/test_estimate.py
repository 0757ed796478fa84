from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes import Estimate, Verdict, VerdictSettings
from gray_box_observer.context_nodes.estimate import unsettled
from gray_box_observer.white_box.interface import Parameter

PARAMETER = Parameter('resistance', 'ohm', 3.0, 0.1, 100.0, 'R.')


@pytest.mark.parametrize(
    ('value', 'std', 'verdict'),
    [
        (1.0, 0.02, Verdict.IDENTIFIED),
        (1.0, 0.021, Verdict.CONVERGING),
        (1.0, 0.3, Verdict.CONVERGING),
        (1.0, 0.31, Verdict.UNEXCITED),
        (1.0, float('nan'), Verdict.UNEXCITED),
        (0.1, 1e-9, Verdict.IMPLAUSIBLE),
        (100.0, 1e-9, Verdict.IMPLAUSIBLE),
        (99.9, 1e-9, Verdict.IMPLAUSIBLE),
        (99.0, 1e-9, Verdict.IDENTIFIED),
    ],
)
def test_a_verdict_follows_from_value_and_standard_deviation(
    value: float, std: float, verdict: Verdict
) -> None:
    judged = VerdictSettings().judge((PARAMETER,), np.array([[value]]), np.array([[std]]))
    assert judged == ((verdict,),)


@pytest.mark.parametrize(
    ('value', 'std', 'most', 'verdict'),
    [
        (1.0, 0.01, 1e-3, Verdict.IDENTIFIED),
        (1.0, 0.1, 1e-3, Verdict.NEGLIGIBLE),
        (0.1, 1e-9, 1e-3, Verdict.NEGLIGIBLE),
        (0.1, 1e-9, 1e-2, Verdict.IMPLAUSIBLE),
        (1.0, 0.1, 1e-2, Verdict.CONVERGING),
        (1.0, 0.1, float('inf'), Verdict.CONVERGING),
    ],
)
def test_what_takes_little_of_the_voltage_is_negligible_where_it_is_not_identified(
    value: float, std: float, most: float, verdict: Verdict
) -> None:
    rules = VerdictSettings()
    values, stds, shares = (np.array([[number]]) for number in (value, std, most))
    assert rules.judge((PARAMETER,), values, stds, most=shares) == ((verdict,),)
    assert rules.judge_motor((PARAMETER,), [value], [std], [most]) == (verdict,)


@pytest.mark.parametrize(
    ('std', 'most'),
    [(np.ones((1, 2)), None), (np.ones((3, 2)), np.ones((1, 2))), (np.ones((3, 1)), None)],
)
def test_arrays_of_other_shapes_are_not_judged(std: np.ndarray, most: np.ndarray | None) -> None:
    with pytest.raises(ValueError, match=r'is (shorter|longer) than argument'):
        VerdictSettings().judge((PARAMETER,) * 2, np.ones((3, 2)), std, most=most)


@pytest.mark.parametrize('broken', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('entry', ['value', 'covariance'])
def test_one_number_that_is_not_finite_is_seen(entry: str, broken: float) -> None:
    numbers = {'value': np.ones((2, 2)), 'covariance': np.ones((2, 2, 2))}
    verdicts = ((Verdict.CONVERGING,) * 2,) * 2
    assert Estimate(0, (PARAMETER,) * 2, *numbers.values(), verdicts).is_finite
    numbers[entry][1, 0] = broken
    assert not Estimate(0, (PARAMETER,) * 2, *numbers.values(), verdicts).is_finite


def test_frozen_goes_before_every_other_verdict() -> None:
    judged = VerdictSettings().judge(
        (PARAMETER,) * 2, np.ones((3, 2)), np.ones((3, 2)), is_frozen=True
    )
    assert judged == ((Verdict.FROZEN,) * 2,) * 3


def test_a_motor_is_identified_when_all_its_parameters_are() -> None:
    good = (Verdict.IDENTIFIED, Verdict.IDENTIFIED)
    bad = (Verdict.IDENTIFIED, Verdict.CONVERGING)
    estimate = Estimate(0, (PARAMETER,) * 2, np.ones((2, 2)), np.ones((2, 2, 2)), (good, bad))
    assert [estimate.identified(motor) for motor in range(2)] == [True, False]


def test_the_standard_deviation_is_the_root_of_the_diagonal() -> None:
    covariance = np.array([[[4.0, 1.0], [1.0, 9.0]]])
    estimate = Estimate(
        0, (PARAMETER,) * 2, np.ones((1, 2)), covariance, ((Verdict.CONVERGING,) * 2,)
    )
    np.testing.assert_array_equal(estimate.std, [[2.0, 3.0]])


@pytest.mark.parametrize(
    ('value', 'std', 'verdict'),
    [
        (0.5, 0.005, 'identified'),
        (-0.5, 0.02, 'identified'),
        (0.05, 0.02, 'converging'),
        (-0.5, 0.08, 'converging'),
        (0.0, 0.005, 'negligible'),
        (0.02, 0.004, 'negligible'),
        (0.02, 1e-4, 'identified'),
    ],
)
def test_a_parameter_of_either_sign_is_judged_against_the_voltage(
    value: float, std: float, verdict: str
) -> None:
    share = 1.0 / 10.0  # of 10 V
    assert VerdictSettings().judge_signed(value, std, share).value == verdict


def test_of_a_voltage_that_is_not_known_a_parameter_of_either_sign_is_judged_by_itself() -> None:
    rules = VerdictSettings()
    assert rules.judge_signed(0.5, 0.005, 0.0) is Verdict.IDENTIFIED
    assert rules.judge_signed(0.0, 1e-6, 0.0) is Verdict.CONVERGING


def test_what_counts_as_known_converges_while_the_newest_samples_do_not_bear_it_out() -> None:
    known = {verdict for verdict in Verdict if unsettled(verdict) is not verdict}
    assert known == {Verdict.IDENTIFIED, Verdict.NEGLIGIBLE}
    assert {unsettled(verdict) for verdict in known} == {Verdict.CONVERGING}
