"""Which segments of the past are kept, and that they are what was measured."""

from __future__ import annotations

import numpy as np

from gray_box_observer.predictor.residual_model import BINS
from gray_box_observer.predictor.training.segments import (
    SEGMENT,
    WORTH,
    Segment,
    SegmentStore,
    maps,
)


def segment(first: int, voltage_v: float, motors: int = 1, spread_v: float = 0.0) -> Segment:
    """A motor whose torque is a hundredth of a voltage that hardly moves."""
    random = np.random.default_rng(first)
    signals = np.zeros((4, motors, SEGMENT))
    signals[0] = 0.01
    signals[1] = voltage_v + spread_v * random.uniform(-1.0, 1.0, (motors, SEGMENT))
    signals[2] = 0.01 * signals[1]
    return Segment(first, signals, np.full(motors, np.nan))


def filled(store: SegmentStore, *voltages_v: float) -> list[float]:
    """Add segments one after another; return the voltages of those that are kept."""
    at = store.end
    for k, voltage_v in enumerate(voltages_v):
        store.add(segment(at + k * SEGMENT, voltage_v))
    return [float(kept.signals[1, 0, 0]) for kept in store.segments]


def test_an_hour_in_one_regime_drives_out_its_own_segments_and_no_others() -> None:
    store = SegmentStore(5)
    kept = filled(store, 10.0, 5.0, -8.0, *(2.0 for _ in range(700)))
    assert sorted(kept) == [-8.0, 2.0, 2.0, 5.0, 10.0]
    assert sorted(filled(store, -3.0)) == [-8.0, -3.0, 2.0, 5.0, 10.0]


def test_a_regime_passed_through_is_worth_more_than_one_more_of_the_same() -> None:
    store = SegmentStore(3)
    for k in range(3):
        store.add(segment(k * SEGMENT, 10.0))
    passing = segment(3 * SEGMENT, 10.0)
    passing.signals[1:3, :, 100:200] *= -1.0
    store.add(passing)
    for k in range(4, 20):
        store.add(segment(k * SEGMENT, 10.0))
    assert 3 * SEGMENT in [kept.first for kept in store.segments]


def test_a_single_spike_is_hardly_a_regime() -> None:
    spiked = segment(0, 10.0)
    spiked.signals[2, 0, 7] = -0.1
    counted = maps(
        [spiked.signals, segment(SEGMENT, 10.0).signals, segment(2 * SEGMENT, 2.0).signals]
    )
    lost = np.log1p(counted.sum(axis=0) / WORTH).sum() - np.log1p(
        (counted.sum(axis=0) - counted) / WORTH
    ).sum((1, 2))
    assert lost[0] < lost[1] + 0.05 < 0.5 * lost[2]


def test_the_map_counts_every_sample_of_every_motor_once() -> None:
    counted = maps([segment(k, 7.0 * k, motors=3, spread_v=4.0).signals for k in range(4)])
    assert counted.shape == (4, 3, BINS**2)
    np.testing.assert_array_equal(counted.sum(axis=2), SEGMENT)


def test_each_motor_is_measured_by_its_own_size() -> None:
    both = [segment(k, voltage_v, motors=2) for k, voltage_v in enumerate((10.0, 10.0, 1.0))]
    for kept in both:
        kept.signals[1:3, 1] *= 1e-3  # the same motor, a thousand times smaller
    np.testing.assert_array_equal(*maps([kept.signals for kept in both]).transpose(1, 0, 2))


def test_equal_segments_go_the_oldest_first() -> None:
    store = SegmentStore(2)
    filled(store, 3.0, 3.0, 3.0, 3.0)
    assert [kept.first for kept in store.segments] == [2 * SEGMENT, 3 * SEGMENT]
    assert store.end == 4 * SEGMENT


def test_a_store_without_room_keeps_nothing_and_a_signal_that_is_not_finite_is_no_regime() -> None:
    store = SegmentStore(0)
    filled(store, 3.0)
    assert store.segments == []
    blank = segment(0, 5.0)
    blank.signals[2] = np.nan
    assert maps([blank.signals]).sum() == SEGMENT


def test_arrays_give_the_same_store_back() -> None:
    store = SegmentStore(3)
    other = SegmentStore(3)
    other.restore(store.state())
    assert other.segments == []
    filled(store, 10.0, 5.0, 2.0, 2.0)
    other.restore(store.state())
    for one in (store, other):
        filled(one, 2.0, -4.0)
    for mine, theirs in zip(store.segments, other.segments, strict=True):
        assert mine.first == theirs.first
        np.testing.assert_array_equal(mine.signals, theirs.signals)
        np.testing.assert_array_equal(mine.start_nm, theirs.start_nm)
