"""Fewer samples are kept while a voltage is held: their time is whole, and none is moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gray_box_observer.errors import CheckpointError
from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.sample_merger import ALL_KEPT, HELD_A_SPAN, SampleMerger

INTERVAL_S = 1e-3


def samples_of(voltage_v: np.ndarray, begins: int = 0) -> list[Sample]:
    """Return samples of a millisecond each; the torque counts them."""
    return [
        Sample.of_one_motor(k, INTERVAL_S if k > begins else 0.0, float(volt), float(k))
        for k, volt in enumerate(voltage_v)
    ]


def kept(merger: SampleMerger, samples: list[Sample]) -> list[Sample]:
    """Return what is passed on of some samples."""
    return [one for sample in samples for one in merger.step(sample)]


def check_goes_on_alike(samples: list[Sample], place: int) -> None:
    """Check that what is saved at a place of some samples passes the rest on as if it were not."""
    through = SampleMerger()
    kept(through, samples[:place])
    restored = SampleMerger.restored(through.state())
    rest = [kept(one, samples[place:]) for one in (through, restored)]
    assert [np.hstack(one[1:4]).tolist() for one in rest[0]] == [
        np.hstack(one[1:4]).tolist() for one in rest[1]
    ]
    assert through.state() == restored.state()


def test_samples_of_a_voltage_that_moves_pass_as_they_are() -> None:
    rng = np.random.default_rng(1)
    samples = samples_of(np.repeat(rng.uniform(-9.0, 9.0, 20), ALL_KEPT))
    passed = kept(SampleMerger(), samples)
    assert len(passed) == len(samples)
    assert all(one is other for one, other in zip(passed, samples, strict=True))


def test_of_a_voltage_that_is_held_ever_fewer_are_kept_and_their_time_is_whole() -> None:
    held = np.full(20_000, 6.0) + 0.01 * np.random.default_rng(2).normal(size=20_000)
    samples = samples_of(np.append(held, -6.0))
    passed = kept(SampleMerger(), samples)
    growth = np.log(20_000 / ALL_KEPT) * HELD_A_SPAN
    assert len(passed) == pytest.approx(ALL_KEPT + growth, rel=0.05)
    torques = np.array([float(one.torque_nm[0]) for one in passed])
    intervals_s = np.array([float(one.interval_s[0]) for one in passed])
    voltages_v = np.array([float(one.voltage_v[0]) for one in passed])
    assert np.diff(torques) * INTERVAL_S == pytest.approx(intervals_s[1:])
    assert (np.diff(np.diff(torques[:-2])) >= 0.0).all()
    assert torques[-2:].tolist() == [19_999.0, 20_000.0]  # up to where the voltage moved
    assert voltages_v @ intervals_s == pytest.approx((held[1:].sum() - 6.0) * INTERVAL_S)


def test_one_wrong_reading_leaves_the_voltage_that_moves_as_it_is() -> None:
    merger = SampleMerger()
    kept(merger, samples_of(np.array([1.0, 1.0, 1e6, 1.0])))
    moving = samples_of(1.0 + 0.02 * (np.arange(2000) % 2), begins=-1)
    assert kept(merger, moving) == moving


def test_a_gap_begins_anew() -> None:
    merger = SampleMerger()
    kept(merger, samples_of(np.full(700, 6.0)))
    after_gap = samples_of(np.full(600, 6.0))
    passed = kept(merger, after_gap)
    assert passed[: ALL_KEPT + 1] == after_gap[: ALL_KEPT + 1]
    assert len(passed) < 600


@pytest.mark.parametrize('place', [0, 300, 900, 905])
def test_what_is_restored_goes_on_alike(place: int) -> None:
    samples = samples_of(np.append(np.full(1500, 6.0), np.full(100, 3.0)))
    check_goes_on_alike(samples, place)


@pytest.mark.parametrize(
    ('name', 'value'),
    [('held_count', -1), ('level_v', float('nan')), ('span', {}), ('largest_v', -1.0)],
)
def test_a_state_that_could_not_have_been_is_refused(name: str, value: Any) -> None:
    merger = SampleMerger()
    kept(merger, samples_of(np.full(900, 6.0)))
    with pytest.raises(CheckpointError):
        SampleMerger.restored({**merger.state(), name: value})


@pytest.mark.parametrize('share', [0.004, 0.01])
def test_the_noise_of_a_measured_voltage_is_no_move(share: float) -> None:
    rng = np.random.default_rng(3)
    level = np.repeat([9.0, -4.0, 6.0, 8.0], 5000)
    samples = samples_of(level + 9.0 * share * rng.normal(size=level.size))
    passed = kept(SampleMerger(), samples)
    assert len(passed) < 5 * (ALL_KEPT + np.log(5000 / ALL_KEPT) * HELD_A_SPAN)
    stamps = {one.stamp_ns for one in passed}
    for move in (5000, 10_000, 15_000):  # behind each all are kept for a while
        assert set(range(move + 2, move + ALL_KEPT)) <= stamps


def longest_span_s(voltage_v: np.ndarray) -> float:
    """Return the longest interval of samples that follow full steps of 12 V."""
    steps = np.repeat([12.0, -12.0], 500)
    passed = kept(SampleMerger(), samples_of(np.append(steps, voltage_v)))
    return max(float(one.interval_s[0]) for one in passed)


@pytest.mark.parametrize('size_v', [0.12, 0.17])
def test_small_moves_of_a_command_are_no_noise(size_v: float) -> None:
    moves = np.random.default_rng(2).choice([-size_v, size_v], size=20_000)
    assert longest_span_s(6.0 + np.repeat(moves, 3)) <= INTERVAL_S * 8


@pytest.mark.parametrize('rate_v_s', [0.1, 1.0])
def test_a_ramp_beside_noise_is_a_move(rate_v_s: float) -> None:
    """No span is so long that the ramp moves by more than the noise within it."""
    noise_v = 0.12
    ramp = rate_v_s * INTERVAL_S * np.arange(40_000) % 10.0
    span_s = longest_span_s(ramp + noise_v * np.random.default_rng(2).normal(size=ramp.size))
    assert span_s * rate_v_s < noise_v


@pytest.mark.parametrize('place', [2000, 5900, 6100])
def test_a_noisy_voltage_goes_on_alike_where_it_is_restored(place: int) -> None:
    rng = np.random.default_rng(4)
    level = np.repeat([9.0, -4.0, 6.0], [3000, 3000, 2000])
    samples = samples_of(level + 0.05 * rng.normal(size=level.size))
    check_goes_on_alike(samples, place)
