"""A residual analysis says what a residual is, whatever made it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_motor_records import (
    RESISTANCE_OHM,
    TRUTH,
    WHITE_BOX,
    Record,
    current_of,
    current_of_free_rotor,
    noise,
    steps,
)
from scipy.stats import chi2

from gray_box_observer.context_nodes.measured_speed import output_fit
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test import FitVerdict, fitted_residual
from gray_box_observer.fit_test.fitted_residual import LAGS, ljung_box
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.policy import (
    FEW_PERIODS,
    RATIO_SPREAD,
    RATIO_WARNING,
    WHITENESS_WARNING,
    judge,
)
from gray_box_observer.fit_test.projection import Projection, bandwidth, long_run_covariance
from gray_box_observer.fit_test.residual_analysis import analyse

SAMPLES = 4000
STD_A = 0.05


def _record(seed: int, **noisy: float) -> Record:
    voltage_v = steps(SAMPLES, seed)
    return Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, STD_A, seed + 100, **noisy))


@pytest.mark.parametrize('seed', range(5))
def test_white_noise_on_the_right_physics_leaves_nothing_to_explain(seed: int) -> None:
    analysis = analyse(WHITE_BOX, TRUTH, _record(seed).stretch)
    assert analysis.ratio == pytest.approx(1.0, abs=0.06)
    assert analysis.whiteness < 2.0
    assert all(score.score < 12.0 for score in analysis.scores)
    assert analysis.floor_a == pytest.approx(STD_A, rel=0.06)


def test_errors_in_time_show_where_the_current_is_steep() -> None:
    record = _record(1)
    assert analyse(WHITE_BOX, TRUTH, record.stretch).jitter == 0.0
    late = np.random.default_rng(2).normal(0.0, 0.1, SAMPLES)
    scattered = Record(
        record.voltage_v, record.current_a - late * np.gradient(current_of(record.voltage_v))
    )
    assert analyse(WHITE_BOX, TRUTH, scattered.stretch).jitter == pytest.approx(0.1, rel=0.4)


@pytest.mark.parametrize('samples', [64, 79, 80, 81, 82, 100, 128])
def test_few_samples_are_analysed_in_numbers(samples: int) -> None:
    whole = _record(3)
    analysis = analyse(
        WHITE_BOX, TRUTH, Record(whole.voltage_v[:samples], whole.current_a[:samples]).stretch
    )
    assert np.isfinite(
        [analysis.ratio, analysis.whiteness, analysis.jitter, analysis.moving_noise_a]
    ).all()


def test_what_is_no_number_is_no_fit() -> None:
    analysis = analyse(WHITE_BOX, TRUTH, _record(1).stretch)
    for part in ('ratio', 'whiteness', 'jitter'):
        unknown = replace(analysis, **{part: np.nan})
        verdict = judge(
            unknown, np.full(2, 0.01), SAMPLES, speed_measured=False, stamps_exact=True
        ).verdict
        assert verdict is FitVerdict.MISFIT, part


@pytest.mark.parametrize(
    ('whiteness', 'verdict'), [(4.0, FitVerdict.OK), (6.0, FitVerdict.WARNING)]
)
def test_a_warning_by_whiteness_is_rarer_than_a_motor_is_tested(whiteness, verdict) -> None:
    white = replace(analyse(WHITE_BOX, TRUTH, _record(1).stretch), whiteness=whiteness, scores=())
    judgement = judge(white, np.full(2, 0.01), SAMPLES, speed_measured=True, stamps_exact=True)
    assert judgement.verdict is verdict
    # half a million tests, of two wheels over a year
    false_rate = chi2.sf(LAGS * WHITENESS_WARNING, LAGS)
    assert false_rate < 1e-3 / 500_000


SLOW_INDUCTANCE_H = 0.4
SLOW = np.array([[1.0 / SLOW_INDUCTANCE_H, RESISTANCE_OHM / SLOW_INDUCTANCE_H]])
"""A motor whose current forgets an error in 200 samples."""


def _restarts(every: int, odd_readings_a: dict[int, float]) -> SampleWindow:
    """Return a run of the slow motor that begins anew many times, some readings behind that odd."""
    voltage_v = steps(SAMPLES, 1)
    current_a = current_of(voltage_v, SLOW_INDUCTANCE_H) + noise(SAMPLES, STD_A, 60)
    for behind, error_a in odd_readings_a.items():
        current_a[every + behind :: every] += error_a
    whole = Record(voltage_v, current_a).stretch
    return whole.restarted(np.arange(SAMPLES - 1)[None] % every == every - 1)


@pytest.mark.parametrize('every', [100, 500])
def test_a_run_that_begins_anew_many_times_leaves_a_white_residual(every: int) -> None:
    """The noise of one reading would last for 200 samples, behind each restart anew."""
    analysis = analyse(WHITE_BOX, SLOW, _restarts(every, {}))
    assert analysis.whiteness < 2.0
    assert analysis.ratio == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize('odd_readings_a', [{0: 8.0 * STD_A}, {20: 5.0}, {3: -5.0, 40: 5.0}])
def test_odd_readings_behind_a_restart_colour_no_residual(odd_readings_a: dict[int, float]) -> None:
    """The first reading is corrected by those that follow; later ones correct nothing."""
    assert analyse(WHITE_BOX, SLOW, _restarts(1000, odd_readings_a)).whiteness < 3.0


def test_a_run_that_begins_anew_answers_a_voltage_as_its_readings_let_it() -> None:
    stretch = _restarts(500, {})
    run = free_run(WHITE_BOX, SLOW, stretch)
    further_v = np.sin(0.02 * np.arange(SAMPLES - 1))
    response_a = run.response(further_v[None])[0]
    moved = free_run(WHITE_BOX, SLOW, replace(stretch, voltage_v=stretch.voltage_v + further_v))
    settled = slice(500, None)  # the first state is fitted to the whole run
    change_a = moved.current_a - run.current_a
    np.testing.assert_allclose(change_a[settled], response_a[settled], atol=2e-3)
    assert np.abs(response_a[settled]).max() > 0.1


def test_a_speed_that_a_fit_gives_is_not_tested_more_strictly_than_it_is_believed() -> None:
    assert WHITENESS_WARNING > output_fit.COLOURED
    assert RATIO_WARNING >= output_fit.POOR


@pytest.mark.parametrize('samples', [64, 256, 1024])
def test_a_ratio_that_comes_by_chance_is_no_warning(samples: int) -> None:
    ratios = []
    for seed in range(200):
        residual = np.random.default_rng(seed).standard_normal(samples)
        ratios.append(float(np.sqrt(np.mean(residual**2))) / difference_noise(residual))
    assert np.std(ratios) * np.sqrt(samples) == pytest.approx(RATIO_SPREAD / 5.5, rel=0.3)
    white = analyse(WHITE_BOX, TRUTH, _record(1).stretch)
    for far, verdict in ((5.0, FitVerdict.OK), (20.0, FitVerdict.WARNING)):
        ratio = max(1.0 + far / np.sqrt(samples), 1.25 if far < 6.0 else 1.35)
        found = replace(white, samples=samples, ratio=ratio, scores=())
        judgement = judge(found, np.full(2, 0.01), 64, speed_measured=True, stamps_exact=True)
        assert judgement.verdict is verdict


def test_an_offset_of_the_current_stands_out_though_the_residual_stays_small() -> None:
    record = _record(1)
    offset = Record(record.voltage_v, record.current_a + STD_A)
    analysis = analyse(WHITE_BOX, TRUTH, offset.stretch)
    assert analysis.scores[0].score > 100.0
    assert 'current_offset' in {score.effect.name for score in analysis.scores}


def test_noise_with_a_memory_widens_the_standard_deviations_and_is_no_effect() -> None:
    analysis = analyse(WHITE_BOX, TRUTH, _record(2, memory=0.9).stretch)
    white = analyse(WHITE_BOX, TRUTH, _record(2).stretch)
    assert analysis.whiteness > 100.0
    assert np.isfinite(analysis.robust_std).all()
    assert np.isnan(white.robust_std).all()
    assert all(score.score < 20.0 for score in analysis.scores)


def test_robust_standard_deviations_are_those_of_repeated_fits() -> None:
    shifts = []
    stds = []
    for seed in range(30):
        voltage_v = steps(SAMPLES, 3)
        current_a = current_of(voltage_v) + noise(SAMPLES, STD_A, seed, memory=0.8)
        analysis = analyse(WHITE_BOX, TRUTH, Record(voltage_v, current_a).stretch)
        fit = Record(voltage_v, current_a).stretch
        shifts.append(_fitted_shift(fit))
        stds.append(analysis.robust_std)
    assert np.mean(stds, axis=0) == pytest.approx(np.std(shifts, axis=0), rel=0.4)


def _fitted_shift(stretch: object) -> np.ndarray:
    """One Gauss-Newton step from the truth, in logarithms of the parameters."""
    from gray_box_observer.fit_test.free_run import free_run

    run = free_run(WHITE_BOX, TRUTH, stretch)  # type: ignore[arg-type]
    moved = np.linalg.lstsq(run.jacobian, run.residual_a, rcond=None)[0]
    return np.array([-moved[1], moved[2] - moved[1]])


def test_a_rotor_that_nobody_measures_leaves_a_large_and_coloured_residual() -> None:
    voltage_v = steps(SAMPLES, 4)
    current_a = current_of_free_rotor(voltage_v) + noise(SAMPLES, STD_A, 5)
    analysis = analyse(WHITE_BOX, TRUTH, Record(voltage_v, current_a).stretch)
    assert analysis.ratio > 4.5
    assert analysis.whiteness > 100.0


def test_quantised_readings_do_not_look_free_of_noise() -> None:
    step_a = 0.4
    voltage_v = steps(SAMPLES, 6)
    exact = current_of(voltage_v) + noise(SAMPLES, 0.01, 7)
    analysis = analyse(
        WHITE_BOX, TRUTH, Record(voltage_v, np.round(exact / step_a) * step_a).stretch
    )
    assert analysis.floor_a >= step_a / np.sqrt(12.0) * 0.999
    assert analysis.ratio < 1.25


def test_the_ljung_box_statistic_is_about_one_for_white_noise() -> None:
    values = [ljung_box(noise(2000, 1.0, seed)) for seed in range(50)]
    assert np.mean(values) == pytest.approx(1.0, abs=0.15)


def test_correlations_that_many_columns_leave_are_no_colour() -> None:
    """Hats on 128 knots take off what neighbours of white noise have in common."""
    count = 2000
    knots = 128
    places = np.linspace(0.0, knots - 1.0, count)
    hats = np.maximum(1.0 - np.abs(places[:, None] - np.arange(knots)), 0.0)
    raw = []
    mended = []
    for seed in range(20):
        projection = Projection(hats, noise(count, 1.0, seed), np.ones(count), 2)
        raw.append(ljung_box(projection.remainder))
        of_white = projection.correlations_of_white(LAGS)
        mended.append(ljung_box(projection.remainder, of_white=of_white))
    assert np.mean(raw) > 2.0
    assert np.mean(mended) == pytest.approx(1.0, abs=0.3)


def test_three_deviations_of_a_covariance_from_few_periods_hold_what_three_should() -> None:
    count = 128
    records = 5000
    generator = np.random.default_rng(1)
    sizes = []
    for _ in range(records):
        terms = generator.standard_normal((count, 1))
        std = np.sqrt(long_run_covariance(terms - terms.mean())[0, 0])
        sizes.append(abs(float(terms.sum())) / std)
    widening = 1.0 + FEW_PERIODS * bandwidth(count) / count
    outside = [float(np.mean(np.array(sizes) > 3.0 * factor)) for factor in (1.0, widening)]
    assert outside[0] > 0.015, 'it is too small by itself: 0.3 % should lie outside'
    assert outside[1] < 0.005


@pytest.mark.parametrize(('memory', 'inflation'), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0)])
def test_the_long_run_covariance_is_that_of_sums(memory: float, inflation: float) -> None:
    count = 4096
    values = [
        long_run_covariance(noise(count, 1.0, seed, memory)[:, None])[0, 0] / count
        for seed in range(20)
    ]
    assert np.mean(values) == pytest.approx(inflation, rel=0.25)


def test_a_free_run_that_never_moves_says_nothing_of_the_stamps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where values cannot be run, or nothing drives the motor, no part of the run is steep."""
    current_a = np.zeros(SAMPLES)
    current_a[-100:] = noise(100, 1.0, 1)
    stretch = Record(np.zeros(SAMPLES), current_a).stretch
    rest = np.zeros(SAMPLES)
    intervals = np.zeros(SAMPLES - 1)
    creep = 1e-170 * np.maximum(np.arange(SAMPLES) - SAMPLES + 100, 0)  # whose square is zero
    run = FreeRun(
        stretch, 1.0, creep, current_a, np.zeros((SAMPLES, 3)), intervals, intervals, rest + 1.0
    )

    def at_once(*_: object) -> Pieces[FreeRun]:
        yield 0
        return run

    monkeypatch.setattr(fitted_residual, 'free_run_in_pieces', at_once)
    assert analyse(WHITE_BOX, TRUTH, stretch).jitter == 0.0
