"""Stamps of even samples that were rounded are told from stamps that are merely uneven."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gray_box_observer.samples.stamp_rounding import stamp_rounding

SAMPLES = 1000


def rounded_intervals(rate_hz: float, step_s: float) -> np.ndarray:
    stamp_s = np.arange(SAMPLES) / rate_hz
    return np.diff(np.round(stamp_s / step_s) * step_s)


@pytest.mark.parametrize(
    ('rate_hz', 'step_s'), [(300.0, 1e-3), (400.0, 1e-3), (60.0, 1e-3), (30.0, 0.01), (7e3, 1e-5)]
)
def test_step_and_period_of_rounded_stamps_are_found(rate_hz: float, step_s: float) -> None:
    grid = stamp_rounding(rounded_intervals(rate_hz, step_s))
    assert grid is not None
    assert grid.step_s == pytest.approx(step_s, rel=1e-3)
    assert grid.period_s == pytest.approx(1.0 / rate_hz, rel=1e-4)


def test_stamps_that_fall_on_whole_steps_are_not_rounded() -> None:
    assert stamp_rounding(rounded_intervals(500.0, 1e-3)) is None


def test_steps_that_are_fine_beside_the_interval_do_not_matter() -> None:
    assert stamp_rounding(rounded_intervals(30.0, 5e-4)) is None


@pytest.mark.parametrize(
    'kept',
    [
        np.random.default_rng(1).random(SAMPLES) > 0.1,
        np.arange(SAMPLES) != 500,
        np.arange(SAMPLES) % 4 != 3,
        (np.arange(SAMPLES) < 300) | (np.arange(SAMPLES) > 800),
        (np.arange(SAMPLES) < 1) | (np.arange(SAMPLES) > 900),
    ],
    ids=['at random', 'one', 'every fourth', 'a pause', 'an early row'],
)
def test_lost_samples_are_no_rounding(kept: np.ndarray) -> None:
    assert stamp_rounding(np.diff(np.flatnonzero(kept) * 1e-3)) is None


def test_a_long_interval_now_and_then_is_no_rounding() -> None:
    interval_s = np.full(SAMPLES, 1e-3)
    interval_s[[100, 600]] *= 1.05
    assert stamp_rounding(interval_s) is None


def test_whole_steps_that_lost_samples_would_leave_too_are_not_told() -> None:
    assert stamp_rounding(rounded_intervals(900.0, 1e-3)) is None


@pytest.mark.parametrize('absurd', [math.nan, math.inf, 0.0])
def test_of_absurd_intervals_nothing_is_told(absurd: float) -> None:
    interval_s = rounded_intervals(300.0, 1e-3)
    interval_s[10] = absurd
    assert stamp_rounding(interval_s) is None


def test_stamps_that_jitter_are_no_rounding() -> None:
    stamp_s = np.arange(SAMPLES) * 1e-3 + np.random.default_rng(2).uniform(0.0, 5e-4, SAMPLES)
    assert stamp_rounding(np.diff(stamp_s)) is None


def test_of_few_samples_nothing_is_told() -> None:
    assert stamp_rounding(rounded_intervals(300.0, 1e-3)[:20]) is None
    assert stamp_rounding(np.zeros(0)) is None
