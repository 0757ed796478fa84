"""Leaky integrators: against closed forms, and four ways to the same traces compared."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.predictor.lag_features import (
    LADDER,
    LONGEST,
    SIGNALS,
    advance,
    along,
    blank,
    cleared,
    ending,
    presumed,
)


def signals(count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voltage, speed and uneven intervals of two motors."""
    random = np.random.default_rng(1)
    return (
        random.normal(5.0, 3.0, (2, count)),
        random.normal(0.0, 50.0, (2, count)),
        random.uniform(0.5, 2.0, (2, count)),
    )


def test_a_held_signal_is_approached_as_by_a_first_order_lag() -> None:
    after = advance(blank(1), np.array([3.0]), np.array([-7.0]), np.array([40.0]))
    np.testing.assert_allclose(after[0], np.outer([3.0, -7.0], 1.0 - np.exp(-40.0 / LADDER)))


def test_how_an_interval_is_cut_makes_no_difference() -> None:
    held = (np.array([3.0]), np.array([-7.0]))
    start = np.full((1, SIGNALS, LADDER.size), 1.5)
    cut = start
    for part in (0.25, 3.0, 11.0):
        cut = advance(cut, *held, np.array([part]))
    np.testing.assert_allclose(cut, advance(start, *held, np.array([14.25])), rtol=1e-12)


def test_streaming_and_a_whole_history_and_its_end_at_once_agree() -> None:
    voltage, speed, intervals = signals()
    streamed = blank(2)
    whole = along(voltage, speed, intervals, blank(2))
    for k in range(voltage.shape[1]):
        streamed = advance(streamed, voltage[:, k], speed[:, k], intervals[:, k])
        np.testing.assert_allclose(whole[:, k], streamed, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ending(voltage, speed, intervals), streamed, rtol=1e-9, atol=1e-9)


def test_no_more_than_the_longest_memory_matters() -> None:
    voltage, speed, _ = signals(2 * LONGEST)
    intervals = np.ones_like(voltage)
    late = ending(*(signal[:, LONGEST:] for signal in (voltage, speed, intervals)))
    np.testing.assert_allclose(
        late, ending(voltage, speed, intervals), atol=4e-4 * np.abs(speed).max()
    )


def test_what_is_lost_is_presumed_to_have_been_as_what_comes() -> None:
    held = np.full((1, 500), 4.0)
    np.testing.assert_allclose(
        presumed(held, -held)[0], np.outer([4.0, -4.0], np.ones(LADDER.size))
    )
    stepped = np.concatenate([np.zeros((1, 2)), np.full((1, 300), 8.0)], axis=1)
    assert presumed(stepped, stepped)[0, 0] == pytest.approx(8.0 * (LADDER - 2.0) / LADDER)


def test_only_the_motors_that_begin_anew_are_cleared() -> None:
    traces = np.ones((2, SIGNALS, LADDER.size))
    after = cleared(traces, np.array([False, True]))
    np.testing.assert_array_equal(after[0], traces[0])
    np.testing.assert_array_equal(after[1], 0.0)
    assert cleared(traces, np.array([False, False])) is traces
