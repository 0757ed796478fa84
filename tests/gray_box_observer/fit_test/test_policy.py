"""What a judgement leaves of an estimate, in plain numbers, beside the formulas on arrays."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes.recursive.negligible import SIGMAS
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.policy import Judgement


def judgement(seed: int, parameters: int) -> Judgement:
    random = np.random.default_rng(seed)
    root = random.normal(size=(parameters, parameters))
    return Judgement(FitVerdict.WARNING, random.uniform(1.0, 5.0, parameters), 0.01 * root @ root.T)


@pytest.mark.parametrize('parameters', [1, 3, 7])
def test_a_covariance_grows_by_factors_and_by_the_spread_of_logarithms(parameters: int) -> None:
    limit, random = judgement(parameters, parameters), np.random.default_rng(9)
    values, root = random.lognormal(size=parameters), random.normal(size=(parameters, parameters))
    covariance = root @ root.T
    scale, unit = np.diag(limit.factor), np.diag(values)
    expected = scale @ covariance @ scale + unit @ limit.spread @ unit
    widened = limit.widened(values.tolist(), covariance.tolist())
    np.testing.assert_allclose(widened, expected, rtol=1e-12)
    assert np.array_equal(widened, np.transpose(widened))


def test_a_judgement_that_limits_nothing_leaves_the_covariance() -> None:
    nothing = Judgement(FitVerdict.OK, np.ones(2), np.zeros((2, 2)))
    covariance = [[4.0, 1.0], [1.0, 9.0]]
    assert not nothing.widens
    assert nothing.widened([2.0, 3.0], covariance) == covariance


def test_a_share_of_the_voltage_is_at_most_that_of_the_furthest_value() -> None:
    limit = judgement(2, 3)
    values, share, reach = [2.0, 0.5, 1.0], [0.1, 0.3, 0.0], [0.02, 0.01, 0.0]
    furthest = np.array(values) * (1.0 + SIGMAS * np.sqrt(np.diagonal(limit.spread)))
    expected = furthest * share + limit.factor * reach
    largest = limit.largest_shares(values, share, reach)
    np.testing.assert_allclose(largest[:2], expected[:2], rtol=1e-12)
    assert largest[2] == np.inf  # of what no share is known
