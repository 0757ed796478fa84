"""Thinning keeps what the eye would miss."""

from __future__ import annotations

import itertools

import numpy as np

from gray_box_observer.report.thinning import Segment, segments, thinned


def test_a_short_series_stays_whole():
    times = np.linspace(0.0, 1.0, 50)
    assert np.array_equal(thinned(times, np.sin(times), drawn_whole=50), np.arange(50))


def test_the_extremes_of_every_bucket_stay_against_a_plain_loop():
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 7.0, 5_000))
    values = rng.normal(size=5_000)
    buckets = 40
    kept = set(thinned(times, values, drawn_whole=100, buckets=buckets).tolist())
    edges = times[0] + np.arange(buckets + 1) / buckets * (times[-1] - times[0])
    wanted = {0, len(times) - 1}
    for low, high in itertools.pairwise(edges):
        inside = np.flatnonzero((times >= low) & ((times < high) | (high == edges[-1])))
        wanted |= {int(inside[np.argmin(values[inside])]), int(inside[np.argmax(values[inside])])}
    assert kept == wanted


def test_one_lonely_peak_in_a_million_samples_survives():
    times = np.arange(1e6) * 1e-3
    values = np.zeros(1_000_000)
    values[123_457] = 1.0
    values[654_321] = -1.0
    kept = thinned(times, values)
    assert {123_457, 654_321} <= set(kept.tolist())
    assert len(kept) < 10_000
    assert np.all(np.diff(kept) > 0)


def test_a_gap_of_missing_values_stays_a_gap():
    times = np.arange(10_000.0)
    values = np.ones(10_000)
    values[3_000:4_000] = np.nan
    kept = thinned(times, values, drawn_whole=100, buckets=50)
    assert np.isnan(values[kept]).any()
    assert np.isfinite(values[kept]).any()


def test_a_series_without_a_finite_value_or_without_duration_is_thinned_too():
    assert len(thinned(np.arange(1_000.0), np.full(1_000, np.nan), 100, 10)) <= 12
    assert len(thinned(np.zeros(1_000), np.arange(1_000.0), 100, 10)) <= 22


def test_equal_verdicts_join_and_last_until_the_next():
    times = np.array([0.0, 1.0, 2.0, 5.0])
    joined = segments(times, ['unexcited', 'unexcited', 'converging', 'identified'])
    assert joined == [
        Segment(0.0, 2.0, 'unexcited'),
        Segment(2.0, 5.0, 'converging'),
        Segment(5.0, 5.0, 'identified'),
    ]
    assert segments(np.empty(0), []) == []
