from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes import Estimate, Verdict, VerdictSettings
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


def test_frozen_goes_before_every_other_verdict() -> None:
    judged = VerdictSettings().judge(
        (PARAMETER,) * 2, np.ones((3, 2)), np.ones((3, 2)), is_frozen=True
    )
    assert judged == ((Verdict.FROZEN,) * 2,) * 3


def test_a_motor_is_identified_when_all_its_parameters_are() -> None:
    good, bad = (Verdict.IDENTIFIED, Verdict.IDENTIFIED), (Verdict.IDENTIFIED, Verdict.CONVERGING)
    estimate = Estimate(0, (PARAMETER,) * 2, np.ones((2, 2)), np.ones((2, 2, 2)), (good, bad))
    assert [estimate.identified(motor) for motor in range(2)] == [True, False]


def test_the_standard_deviation_is_the_root_of_the_diagonal() -> None:
    covariance = np.array([[[4.0, 1.0], [1.0, 9.0]]])
    estimate = Estimate(
        0, (PARAMETER,) * 2, np.ones((1, 2)), covariance, ((Verdict.CONVERGING,) * 2,)
    )
    np.testing.assert_array_equal(estimate.std, [[2.0, 3.0]])
