"""The bound: against published values, its limit in time, and the offline reference."""

from __future__ import annotations

import numpy as np
import pytest
from common.cases import CASES, simulate
from common.cramer_rao import bound, bound_over_time

STATED_PERCENT = {
    'training': (0.042, 0.019, 0.14),
    'long holds': (0.076, 0.032, 0.052),
    'short holds': (0.039, 0.034, 0.053),
}
"""A minute at 100 Hz and 1 % noise, for the excitation of some other seeds."""


@pytest.mark.slow
@pytest.mark.parametrize('name', STATED_PERCENT)
def test_the_bound_is_the_one_that_the_project_states(name: str) -> None:
    case = next(case for case in CASES if case.name == name)
    clean = simulate(case, range(3))
    percent = 100.0 * np.mean([bound(clean.record(seed, 0.01)) for seed in clean.seeds], axis=0)
    np.testing.assert_allclose(percent, STATED_PERCENT[name], rtol=0.35)


def test_the_bound_scales_with_the_noise_and_only_falls_with_time() -> None:
    clean = simulate(CASES[2], [1], 20.0)
    one, two = (clean.record(1, noise) for noise in (0.01, 0.02))
    np.testing.assert_allclose(bound(two), 2.0 * bound(one), rtol=1e-9)
    over_time = bound_over_time(one, np.arange(200, 2000, 50))
    assert np.all(np.diff(over_time, axis=0) <= 0.0)
    np.testing.assert_allclose(bound_over_time(one, np.array([1999]))[0], bound(one))


def test_too_few_samples_tell_nothing() -> None:
    record = simulate(CASES[2], [1], 1.0).record(1, 0.01)
    assert np.all(np.isinf(bound_over_time(record, np.array([2]))))


@pytest.mark.slow
def test_offline_least_squares_reaches_the_bound() -> None:
    least_squares = pytest.importorskip(
        'common.least_squares', reason='needs the peers of requirements/bench.txt'
    )
    clean = simulate(CASES[2], range(12), 20.0)
    multiples = []
    for seed in clean.seeds:
        record = clean.record(seed, 0.01, either_way=True)
        theta, covariance = least_squares.output_error(record, record.stamp_ns.size)
        multiples.append((theta / CASES[2].truth - 1.0) / bound(record))
        stated = np.sqrt(np.diagonal(covariance)) / CASES[2].truth
        np.testing.assert_allclose(stated, bound(record), rtol=0.1)
    assert 0.7 < np.sqrt(np.mean(np.square(multiples))) < 1.35
