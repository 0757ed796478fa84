"""The fit of the whole motor: where it starts, where it ends, and what it claims to know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rotor_motors import BOX, INITIAL, NODES, THETA, content_of, recorded
from rotor_records import GEAR_MOTOR, LIVELY
from rotor_records import recorded as recorded_motor

from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.natural_scale import shares_of_scale
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE

VAGUE = LogPrior(np.log(INITIAL[0]), np.eye(THETA.size) / 25.0)


def fitted(samples: np.ndarray, start: np.ndarray | None = None) -> tuple[Fit, Window]:
    window = Window.from_samples(BOX, samples)
    starts = [*weak_starts(BOX, window)] if start is None else [start]
    fit = completed(fit_window(BOX, window, VAGUE, starts))
    assert fit is not None
    return fit, window


def off(fit: Fit) -> np.ndarray:
    """How far the fit is off, in standard deviations."""
    covariance = np.linalg.inv(fit.information + VAGUE.precision)
    return (fit.logarithms - np.log(THETA)) / np.sqrt(np.diag(covariance))


@pytest.mark.slow
def test_the_weak_form_is_a_start_without_any_guess() -> None:
    window = Window.from_samples(BOX, content_of(recorded()))
    starts = np.array([*weak_starts(BOX, window)])
    assert np.min(np.abs(starts[:, 1] / THETA[1] - 1.0)) < 0.05
    assert np.min(np.abs(starts[:, 2] / THETA[2] - 1.0)) < 0.1


@pytest.mark.parametrize('seed', [1, 2, 3, 4])
@pytest.mark.parametrize('is_stated', [False, True])
def test_the_weak_form_knows_what_brushes_drop_by_the_sign_of_the_current(
    seed: int, is_stated: bool
) -> None:
    """Without that R is 10 to 15 % too large in most of its starts."""
    drop_v = 0.8
    plant = replace(GEAR_MOTOR, brush_drop=drop_v)
    samples = content_of(recorded_motor(plant, LIVELY, 3.0, seed))
    stated_box = replace(BOX, known={**BOX.known, 'brush_drop': drop_v})
    open_box = replace(BOX, context_nodes=(*NODES, 'brush_drop'))
    box = stated_box if is_stated else open_box
    starts = np.array([*weak_starts(box, Window.from_samples(box, samples))])
    assert np.median(np.abs(starts[:, 1] / plant.resistance - 1.0)) < 0.08
    if not is_stated:
        assert np.min(np.abs(starts[:, 5] / drop_v - 1.0)) < 0.15


def test_a_window_gives_every_parameter_within_its_deviation() -> None:
    fit, window = fitted(content_of(recorded()))
    z = off(fit)
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(z**2)) < 2.0
    np.testing.assert_allclose(fit.theta[:3], THETA[:3], rtol=0.02)
    assert fit.noise_a / window.spread_a == pytest.approx(0.01, rel=0.5)


def test_outliers_and_restarts_do_not_bend_the_fit() -> None:
    samples = content_of(recorded()).copy()
    rng = np.random.default_rng(3)
    samples[2, rng.choice(samples.shape[1], 20, replace=False)] *= -30.0
    samples[0, [700, 1500, 1504]] = 0.0
    fit, window = fitted(samples)
    assert len(window.histories) == 3
    assert np.abs(off(fit)).max() < 4.5
    np.testing.assert_allclose(fit.theta[:3], THETA[:3], rtol=0.02)


@pytest.mark.parametrize('factor', [0.2, 5.0])
def test_a_start_that_is_far_off_ends_at_the_same_place(factor: float) -> None:
    samples = content_of(recorded())
    near, _ = fitted(samples, THETA)
    far, _ = fitted(samples, THETA * np.array([1.0, factor, 1.0, 1.0, 1.0]))
    assert np.abs(near.logarithms - far.logarithms).max() < 0.02


def test_a_short_winding_that_a_data_sheet_knows_holds_nothing_else_up() -> None:
    """No step leads to a shorter one than samples tell, but one that is there may stay."""
    samples = content_of(recorded()).copy()
    window = Window.from_samples(BOX, _merged(samples, 20))
    known = THETA * np.array([0.005, 1.0, 1.0, 1.0, 1.0])
    precision = np.diag([1e4, 0.04, 0.04, 0.04, 0.04])
    start = known * np.array([1.0, 1.35, 1.0, 1.0, 1.0])
    fit = completed(fit_window(BOX, window, LogPrior(np.log(known), precision), [start]))
    assert fit is not None
    assert fit.theta[0] == pytest.approx(known[0], rel=0.1)
    assert fit.theta[1] == pytest.approx(THETA[1], rel=0.1)


def _merged(samples: np.ndarray, count: int) -> np.ndarray:
    """Return every so many-th sample, with the mean voltage of its interval."""
    last = samples[:, : samples.shape[1] // count * count].reshape(4, -1, count)
    result = last[:, :, -1].copy()
    result[0] = last[0].sum(axis=1)
    result[1] = last[1].mean(axis=1)
    result[0, 0] = 0.0
    return result


def test_a_data_sheet_decides_what_samples_leave_open() -> None:
    short = content_of(recorded())[:, :60]
    window = Window.from_samples(BOX, short)
    mean = np.log(1.2 * THETA)
    precision = np.diag([25.0, 1e8, 25.0, 25.0, 25.0])
    fit = completed(fit_window(BOX, window, LogPrior(mean, precision), [THETA]))
    assert fit is not None
    assert fit.theta[1] == pytest.approx(1.2 * THETA[1], rel=1e-3)


def test_a_vanishing_effect_is_a_small_share_of_its_scale() -> None:
    window = Window.from_samples(BOX, content_of(recorded()))
    there = shares_of_scale(BOX, THETA, window)
    gone = shares_of_scale(BOX, THETA * np.array([1.0, 1.0, 1e6, 1e-6, 1e-6]), window)
    assert (there < 2.0).all()
    assert (gone[2:] < 1e-5).all()


def test_motors_that_hardly_move_are_fitted_without_overflow() -> None:
    samples = content_of(recorded()).copy()
    samples[1] = 0.0
    samples[2] = np.random.default_rng(0).normal(0.0, 1e-4, samples.shape[1])
    window = Window.from_samples(BOX, samples)
    with np.errstate(all='ignore'):
        fit = completed(fit_window(BOX, window, VAGUE, [INITIAL[0], *weak_starts(BOX, window)]))
    assert fit is None or np.isfinite(fit.logarithms).all()


def test_a_window_counts_the_samples_that_it_was_made_of() -> None:
    samples = content_of(recorded())[:, :200].copy()
    samples[INTERVAL, [3, 5, 9, 190, 195]] = 0.0  # histories too short to be fitted
    window = Window.from_samples(BOX, samples)
    assert [history.place for history in window.histories] == [9]
    assert window.count == 200
    tail = window.tail(100)
    newest = samples[:, -tail.count :]
    assert tail.current_a.size == 100
    assert tail.current_a.tolist() == np.asarray(BOX.state(newest[TORQUE, :100])).tolist()
