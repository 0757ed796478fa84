"""What a judgement leaves of an estimate, in plain numbers, beside the formulas on arrays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gray_box_observer.context_nodes.recursive.negligible import SIGMAS
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.effects import EFFECTS
from gray_box_observer.fit_test.evidence import NO_EVIDENCE, WINDOW, Evidence
from gray_box_observer.fit_test.policy import (
    FEW_PERIODS,
    MATERIAL,
    NOTICEABLE,
    SAFETY,
    SCORE_DOUBT,
    SCORE_MEASURED,
    SCORE_UNMEASURED,
    STANDING,
    UNIFORM_STD,
    WHITENESS_DOUBT,
    WHITENESS_WIDENS,
    Judgement,
    is_dubious,
    judge,
)
from gray_box_observer.fit_test.projection import UNKNOWN, Amount, bandwidth
from gray_box_observer.fit_test.residual_analysis import (
    EffectScore,
    ResidualAnalysis,
)
from gray_box_observer.fit_test.stamp_errors import (
    STAMP_STD,
    STAMP_STDS,
    StampError,
    StampErrors,
)

SAMPLES = 1000
NO_ERROR = StampError(np.zeros(2), UNKNOWN)
STD = np.array([1e-3, 2e-3])


def analysis(**findings: object) -> ResidualAnalysis:
    """A residual that shows nothing, but for what is given."""
    nothing = ResidualAnalysis(
        samples=SAMPLES,
        floor_a=1.0,
        ratio=1.0,
        whiteness=1.0,
        scores=(),
        robust_std=np.full(2, np.nan),
        stamps=StampErrors(NO_ERROR, NO_ERROR, NO_ERROR),
        intervals=5.0,
        jitter=0.0,
        moving_noise_a=0.0,
        open_shifts=np.empty((0, 2)),
        smoothing_shifts=np.empty((0, 2)),
        persistence=0.0,
        has_noisy_voltage=False,
        evidence=NO_EVIDENCE,
    )
    return replace(nothing, **findings)  # type: ignore[arg-type]


def judgement_of(samples: int = SAMPLES, **findings: object) -> Judgement:
    return judge(analysis(**findings), STD, samples, speed_measured=True, stamps_exact=True)


@pytest.mark.parametrize(
    ('ratio', 'whiteness', 'expected'),
    [(1.0, 1.0, False), (2.0, 1.0, True), (1.0, 4.0, True), (np.nan, 1.0, True)],
)
def test_a_residual_that_is_large_or_coloured_or_no_number_is_dubious(
    ratio: float, whiteness: float, *, expected: bool
) -> None:
    assert is_dubious(analysis(ratio=ratio, whiteness=whiteness)) is expected


def judgement(seed: int, parameters: int) -> Judgement:
    random = np.random.default_rng(seed)
    root = random.normal(size=(parameters, parameters))
    return Judgement(FitVerdict.WARNING, random.uniform(1.0, 5.0, parameters), 0.01 * root @ root.T)


@pytest.mark.parametrize('parameters', [1, 3, 7])
def test_a_covariance_grows_by_factors_and_by_the_spread_of_logarithms(parameters: int) -> None:
    limit = judgement(parameters, parameters)
    random = np.random.default_rng(9)
    values = random.lognormal(size=parameters)
    root = random.normal(size=(parameters, parameters))
    covariance = root @ root.T
    scale = np.diag(limit.factor)
    unit = np.diag(values)
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
    values = [2.0, 0.5, 1.0]
    share = [0.1, 0.3, 0.0]
    reach = [0.02, 0.01, 0.0]
    furthest = np.array(values) * (1.0 + SIGMAS * np.sqrt(np.diagonal(limit.spread)))
    expected = furthest * share + limit.factor * reach
    largest = limit.largest_shares(values, share, reach)
    np.testing.assert_allclose(largest[:2], expected[:2], rtol=1e-12)
    assert largest[2] == np.inf  # of what no share is known


def test_an_effect_that_stands_out_and_moves_little_widens_by_what_it_moves() -> None:
    shift = np.array([0.5 * MATERIAL, -2.0 * NOTICEABLE])
    score = EffectScore(EFFECTS['current_offset'], 2.0 * SCORE_MEASURED, shift, np.ones(1))
    weak = replace(score, score=0.5 * SCORE_MEASURED)
    assert not judgement_of(scores=(weak,)).widens
    limit = judgement_of(scores=(score, score))
    assert limit.verdict is FitVerdict.WARNING
    np.testing.assert_allclose(limit.spread, np.outer(shift, shift), rtol=1e-12)


@pytest.mark.parametrize('samples', [SAMPLES // 2, SAMPLES, 16 * SAMPLES])
def test_a_coloured_residual_widens_by_the_samples_that_an_estimate_rests_on(samples: int) -> None:
    robust_std = np.array([0.05, 0.08])
    limit = judgement_of(samples, whiteness=1.1 * WHITENESS_WIDENS, robust_std=robust_std)
    few = 1.0 + FEW_PERIODS * bandwidth(SAMPLES) / SAMPLES
    share = 0.25 if samples == 16 * SAMPLES else 1.0
    np.testing.assert_allclose(limit.factor, SAFETY * few * share * robust_std / STD, rtol=1e-12)
    assert not limit.spread.any()


def scores_of(score: float) -> tuple[EffectScore, ...]:
    """An effect that would move the parameters a lot."""
    shift = np.full(2, 5.0 * MATERIAL)
    return (EffectScore(EFFECTS['current_offset'], score, shift, np.ones(1)),)


@pytest.mark.parametrize('is_doubted', [False, True])
def test_half_of_a_score_lets_a_misfit_stand(is_doubted: bool) -> None:
    less = analysis(scores=scores_of(0.5 * (1.0 + STANDING) * SCORE_MEASURED))
    again = judge(less, STD, SAMPLES, speed_measured=True, stamps_exact=True, is_doubted=is_doubted)
    assert again.verdict is (FitVerdict.MISFIT if is_doubted else FitVerdict.OK)


@pytest.mark.parametrize('whiteness', [1.0, 1.1 * WHITENESS_DOUBT])
def test_under_colour_an_effect_must_stand_out_further_where_no_speed_is_measured(
    whiteness: float,
) -> None:
    score = 0.5 * (SCORE_UNMEASURED + SCORE_DOUBT)
    robust_std = np.full(2, 1e-3)
    coloured = analysis(scores=scores_of(score), whiteness=whiteness, robust_std=robust_std)
    limit = judge(coloured, STD, SAMPLES, speed_measured=False, stamps_exact=True)
    assert (limit.verdict is FitVerdict.MISFIT) == (whiteness == 1.0)


@pytest.mark.parametrize('is_drifting', [False, True])
def test_a_winding_that_heats_may_leave_no_colour(is_drifting: bool) -> None:
    coloured = analysis(whiteness=1.1 * WHITENESS_DOUBT, robust_std=np.full(2, 1e-3))
    limit = judge(
        coloured, STD, SAMPLES, speed_measured=True, stamps_exact=True, is_drifting=is_drifting
    )
    assert limit.verdict is (FitVerdict.MISFIT if is_drifting else FitVerdict.WARNING)


@pytest.mark.parametrize('is_mature', [False, True])
def test_a_small_error_of_the_stamps_counts_once_more_than_a_window_tells_of_it(
    is_mature: bool,
) -> None:
    """It is not shown, and leaves L open by 2 %."""
    shift = np.array([-0.4, 0.0])
    told = Amount(0.5 * STAMP_STDS * STAMP_STD, STAMP_STD)
    evidence = Evidence({}, WINDOW + 1.0 if is_mature else 100.0)
    stamps = StampErrors(StampError(shift, told), NO_ERROR, NO_ERROR)
    doubted = analysis(stamps=stamps, evidence=evidence)
    limit = judge(doubted, STD, SAMPLES, speed_measured=True, stamps_exact=False)
    size = told.likely(STAMP_STD).size
    expected = size * size * np.outer(shift, shift) if is_mature else np.zeros((2, 2))
    np.testing.assert_allclose(limit.spread, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ('mean', 'std', 'expected'),
    [(0.0, 0.01, 0.03), (0.02, 0.01, 0.067), (0.2, 0.01, UNIFORM_STD), (0.0, np.inf, UNIFORM_STD)],
)
def test_where_l_over_r_is_short_r_is_open_as_far_as_the_instant_of_a_step_is(
    mean: float, std: float, expected: float
) -> None:
    """L is by all of an interval, whatever the data tell."""
    instant = StampError(np.array([-1.0, 0.1]), Amount(mean, std))
    delay = StampError(np.array([-3.0, -0.5]), Amount(0.0, 1e-6))
    findings = analysis(stamps=StampErrors(delay, NO_ERROR, instant), intervals=0.5)
    limit = judge(findings, STD, SAMPLES, speed_measured=True, stamps_exact=False)
    std_of_r = math.sqrt(limit.spread[1, 1])
    assert std_of_r == pytest.approx(0.1 * expected, rel=0.02)
    assert math.sqrt(limit.spread[0, 0]) >= 3.0 * UNIFORM_STD
    exact = judge(findings, STD, SAMPLES, speed_measured=True, stamps_exact=True)
    assert not exact.spread.any()


@pytest.mark.parametrize(('samples', 'intervals', 'is_open'), [
    (400, 1.0, True), (400, 1.3, False), (600, 1.0, False), (600, 0.6, True),
])  # fmt: skip
def test_of_few_samples_a_part_of_l_over_r_may_be_a_delay(
    samples: int, intervals: float, *, is_open: bool
) -> None:
    """A voltage 0.3 intervals late made L 35 % too large, known to 2 %, and its fit was `ok`."""
    found = analysis(samples=samples, intervals=intervals)
    spread = judge(found, STD, samples, speed_measured=True, stamps_exact=False).spread
    assert spread[1, 1] == 0.0
    assert spread[0, 0] == pytest.approx((UNIFORM_STD / intervals) ** 2 if is_open else 0.0)
    exact = judge(found, STD, samples, speed_measured=True, stamps_exact=True).spread
    assert not exact.any()


@pytest.mark.parametrize('mean', [0.02, 0.13])
def test_an_instant_that_shows_as_late_counts_whatever_l_over_r_is(mean: float) -> None:
    """Of a voltage 0.3 intervals late the readings told 0.13, and R was 3 % too small, and sure."""
    instant = StampError(np.array([-0.6, 0.1]), Amount(mean, 5e-3))
    found = analysis(stamps=StampErrors(NO_ERROR, NO_ERROR, instant), intervals=2.0)
    limit = judge(found, STD, SAMPLES, speed_measured=True, stamps_exact=False)
    is_shown = mean > STAMP_STDS * 5e-3
    expected = 0.1 * min(3.0 * mean, UNIFORM_STD) if is_shown else 0.0
    assert math.sqrt(limit.spread[1, 1]) == pytest.approx(expected, rel=0.02)
