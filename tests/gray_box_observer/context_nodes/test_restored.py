"""A checkpoint goes on as the saved observer would, wherever in a block or a drift it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import RecursiveEstimator, RecursiveSettings
from gray_box_observer.samples import ReplayBuffer, Sample
from gray_box_observer.white_box import MotorWhiteBox

SHORT = RecursiveSettings(replay_capacity=200)
"""A memory that is full soon."""

START = np.array([[1.5, 3.0, 30.0]])

Samples = list[Sample]


def rest(record: Callable[..., Recording], samples_of: Callable[..., Samples]) -> Samples:
    """A motor that has settled before it was first heard, and moves at last."""
    return samples_of(record('C[6]', 16.0, torque_noise_std=1e-4))[600:]


def heat(record: Callable[..., Recording], samples_of: Callable[..., Samples]) -> Samples:
    """A motor whose winding warms, and that changes suddenly later."""
    schedule = ('motor.resistance=1.0..1.4@4..9', 'motor.inductance=0.3@11')
    return samples_of(record('R[5,15]D[0.2,2]', 14.0, torque_noise_std=1e-4, schedule=schedule))


@pytest.mark.slow
@pytest.mark.parametrize('heard', [rest, heat])
def test_whatever_is_restored_goes_on_bit_for_bit(
    heard: Callable[..., Samples], thesis_box: MotorWhiteBox, record: Any, samples_of: Any
) -> None:
    samples = heard(record, samples_of)
    told = []
    saved = {}
    one = RecursiveEstimator(thesis_box, START, rules=SHORT)
    for k, sample in enumerate(samples):
        if k > 150 and k % 97 == 0:
            saved[k] = one.state()
        one.learn(sample)
        told.append(one.theta.tobytes())
    assert len(set(told)) > 4
    for cut, (plain, arrays) in saved.items():
        other = RecursiveEstimator(thesis_box, START, rules=SHORT)
        other.restore(plain, arrays)
        for k in range(cut, len(samples)):
            other.learn(samples[k])
            assert other.theta.tobytes() == told[k], f'saved at {cut}, another at {k}'


@pytest.mark.parametrize('capacity', [60, 200, 800])
def test_a_memory_of_another_size_goes_on_from_what_there_is(
    capacity: int, thesis_box: MotorWhiteBox, record: Any, samples_of: Any
) -> None:
    samples = samples_of(record('R[5,15]D[0.2,2]', 14.0, torque_noise_std=1e-4))
    one = RecursiveEstimator(thesis_box, START, rules=SHORT)
    for sample in samples[:370]:
        one.learn(sample)
    other = RecursiveEstimator(thesis_box, START, rules=RecursiveSettings(replay_capacity=capacity))
    other.restore(*one.state())
    assert len(other.replay) == min(capacity, 200 + 370 % 32)
    np.testing.assert_array_equal(
        other.replay.newest(50, slice(None)), one.replay.newest(50, slice(None))
    )
    for sample in samples[370:]:
        other.learn(sample)
    np.testing.assert_allclose(other.theta, [[0.5, 1.0, 10.0]], rtol=0.01)


def test_a_refilled_buffer_counts_its_streams_on() -> None:
    samples = [Sample.of_one_motor(k, 0.01, float(k), 0.1) for k in range(1, 41)]
    one = ReplayBuffer(1, 16)
    other = ReplayBuffer(1, 16)
    for sample in samples:
        one.append(sample)
    content = one.content(more=4)
    assert content[1, 0].tolist() == list(range(21, 41))
    other.refill(content, dropped_count=20)
    place = np.array([36])
    assert other.received[0] == one.received[0] == 40
    assert other.remembered(until=place)[0] == one.remembered(until=place)[0] == 16
    np.testing.assert_array_equal(other.newest(16, until=place), one.newest(16, until=place))
    for buffer in (one, other):
        buffer.append(Sample.of_one_motor(41, 0.01, 41.0, 0.1))
    np.testing.assert_array_equal(other.content(), one.content())


def test_blocks_of_another_size_go_on_without_the_samples_that_a_smaller_memory_has_no_room_for(
    thesis_box: MotorWhiteBox, record: Any, samples_of: Any
) -> None:
    samples = samples_of(record('R[5,15]D[0.2,2]', 14.0, torque_noise_std=1e-4))
    one = RecursiveEstimator(
        thesis_box, START, rules=RecursiveSettings(block=400, replay_capacity=800)
    )
    for sample in samples[:1000]:
        one.learn(sample)
    plain, arrays = one.state()
    assert plain['new'] == 360
    other = RecursiveEstimator(thesis_box, START, rules=RecursiveSettings(replay_capacity=80))
    other.restore(plain, arrays)
    np.testing.assert_array_equal(other.theta, one.theta)
    for sample in (samples[1000].beginning(), *samples[1001:]):
        other.learn(sample)
    np.testing.assert_allclose(other.theta, [[0.5, 1.0, 10.0]], rtol=0.05)
