from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.samples.rhythm import LEARNT, Rhythm


def after(intervals: np.ndarray) -> Rhythm:
    rhythm = Rhythm()
    for interval_s in (0.0, *intervals):
        rhythm.update(float(interval_s))
    return rhythm


def test_regular_samples_are_all_there() -> None:
    rhythm = after(np.full(1000, 0.01))
    assert (rhythm.missing_count, rhythm.pauses) == (0, 0)
    assert rhythm.usual_s == pytest.approx(0.01, rel=0.03)


def test_every_sample_that_was_dropped_is_missing() -> None:
    random = np.random.default_rng(5)
    stamps = np.arange(20000)[
        np.concatenate([np.ones(LEARNT + 1, dtype=bool), random.random(20000 - LEARNT - 1) > 0.1])
    ]
    assert after(0.01 * np.diff(stamps)).missing_count == stamps[-1] + 1 - stamps.size


def test_jitter_of_a_third_of_an_interval_loses_nothing() -> None:
    stamps = np.arange(5000) + np.random.default_rng(6).uniform(-0.3, 0.3, 5000)
    assert after(np.diff(stamps)).missing_count == 0


def test_a_new_signal_history_is_a_pause_and_nothing_missing() -> None:
    rhythm = after(np.concatenate([np.full(100, 0.01), [0.0], np.full(100, 0.01), [0.0]]))
    assert (rhythm.missing_count, rhythm.pauses) == (0, 2)


def test_another_rate_becomes_the_usual_one() -> None:
    rhythm = after(np.concatenate([np.full(1000, 0.001), np.full(1000, 0.01)]))
    assert rhythm.usual_s == pytest.approx(0.01, rel=0.03)
    before = rhythm.missing_count
    for _ in range(1000):
        rhythm.update(0.01)
    assert rhythm.missing_count == before


def test_a_periodic_signal_loses_samples_and_one_that_comes_at_random_does_not() -> None:
    random = np.random.default_rng(7)
    kept = np.flatnonzero(random.random(3000) > 0.05)
    periodic = after(0.01 * np.diff(kept))
    assert periodic.loses(0.02)
    assert periodic.loses(0.19)
    assert not periodic.loses(0.015)
    assert not periodic.loses(0.25), 'a silence'
    assert not after(random.exponential(0.01, 3000)).loses(0.05)
    assert not after(np.full(5, 0.01)).loses(0.02), 'no habit yet'
