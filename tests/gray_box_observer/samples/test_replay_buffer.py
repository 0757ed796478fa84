from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.samples import ReplayBuffer, Sample
from gray_box_observer.samples.replay_buffer import (
    FEWEST_SIGNALS,
    HELD_VOLTAGE,
    check_signals,
    forget_moves,
    moves_of,
    with_moves,
)


def sample(random: np.random.Generator, motors: int) -> Sample:
    return Sample(0, *(random.normal(size=motors) for _ in range(4)))


def rows(samples: list[Sample]) -> list[np.ndarray]:
    names = ('interval_s', 'voltage_v', 'torque_nm', 'speed_rad_s')
    return [np.array([getattr(s, name) for s in samples]).T for name in names]


def views(buffer: ReplayBuffer, count: int | None = None) -> list[np.ndarray]:
    return [
        f(count)
        for f in (buffer.interval_s, buffer.voltage_v, buffer.torque_nm, buffer.speed_rad_s)
    ]


@pytest.mark.parametrize(('motors', 'capacity'), [(1, 1), (1, 7), (3, 16)])
def test_a_replay_buffer_remembers_what_a_deque_would(motors: int, capacity: int) -> None:
    random = np.random.default_rng(0)
    buffer = ReplayBuffer(motors, capacity)
    reference = deque(maxlen=capacity)
    for step in range(6 * capacity):
        new = sample(random, motors)
        buffer.append(new)
        reference.append(new)
        if step % 5 == 4:
            keep = int(random.integers(0, capacity + 3))
            buffer.forget(keep)
            while len(reference) > keep:
                reference.popleft()
        assert len(buffer) == len(reference)
        if reference:
            for got, expected in zip(views(buffer), rows(list(reference)), strict=True):
                np.testing.assert_array_equal(got, expected)
    assert buffer.total == 6 * capacity


def test_the_newest_few_can_be_asked_for_and_never_more_than_there_are() -> None:
    random = np.random.default_rng(1)
    buffer = ReplayBuffer(2, 10)
    all_samples = [sample(random, 2) for _ in range(8)]
    for one in all_samples:
        buffer.append(one)
    for got, expected in zip(views(buffer, 3), rows(all_samples[-3:]), strict=True):
        np.testing.assert_array_equal(got, expected)
    assert buffer.torque_nm(99).shape == (2, 8)


def test_moves_of_the_voltage_are_remembered_where_that_is_asked_for() -> None:
    told = Sample.of_one_motor(0, 1e-3, 3.0, 0.1, 0.0, held_v=5.0, moment_v=0.25)
    untold = told._replace(held_v=None, moment_v=None)
    buffer = ReplayBuffer(1, 8, with_moves=True)
    for one in (told, untold):
        buffer.append(one)
    content = buffer.content()
    assert [row[0].tolist() for row in moves_of(content)] == [[5.0, 3.0], [0.25, 0.0]]
    check_signals('samples', content)
    other = ReplayBuffer(1, 8, with_moves=True)
    other.refill(content)
    assert np.array_equal(other.content(), content)
    plain = ReplayBuffer(1, 8)
    plain.refill(content)
    assert plain.content().shape[0] == FEWEST_SIGNALS
    other.refill(plain.content())  # of an early release: each interval has one voltage
    assert [row[0].tolist() for row in moves_of(other.content())] == [[3.0, 3.0], [0.0, 0.0]]
    assert np.array_equal(with_moves(plain.content()), other.content())
    forget_moves(content)
    assert np.array_equal(content, other.content())
    content[HELD_VOLTAGE, 0, 0] = np.nan
    with pytest.raises(CheckpointError, match='held_v'):
        check_signals('samples', content)


def test_views_are_not_copies() -> None:
    buffer = ReplayBuffer(1, 4)
    buffer.append(sample(np.random.default_rng(2), 1))
    assert np.shares_memory(buffer.torque_nm(), buffer.torque_nm())


@pytest.mark.parametrize('capacity', [3, 10, 40])
def test_content_refills_another_buffer_as_far_as_it_has_room(capacity: int) -> None:
    random = np.random.default_rng(4)
    source = ReplayBuffer(2, 10)
    target = ReplayBuffer(2, capacity)
    for _ in range(27):
        source.append(sample(random, 2))
    target.refill(source.content())
    keep = min(10, capacity)
    assert len(target) == keep
    for got, expected in zip(views(target), views(source, keep), strict=True):
        np.testing.assert_array_equal(got, expected)
    new = sample(random, 2)
    target.append(new)
    np.testing.assert_array_equal(target.voltage_v()[:, -1], new.voltage_v)


def test_content_is_a_copy() -> None:
    buffer = ReplayBuffer(1, 4)
    buffer.append(sample(np.random.default_rng(2), 1))
    kept = buffer.content()
    kept[:] = 7.0
    assert buffer.torque_nm()[0, 0] != 7.0


@pytest.mark.parametrize(('motors', 'capacity'), [(0, 5), (1, 0)])
def test_a_buffer_of_nothing_is_refused(motors: int, capacity: int) -> None:
    with pytest.raises(ConfigurationError, match='capacity'):
        ReplayBuffer(motors, capacity)


@pytest.mark.parametrize('capacity', [5, 40])
def test_every_motor_has_a_stream_of_its_own(capacity: int) -> None:
    random = np.random.default_rng(5)
    motors = 3
    buffer = ReplayBuffer(motors, capacity)
    streams: list[list[float]] = [[] for _ in range(motors)]
    for step in range(7 * capacity):
        new = sample(random, motors)
        present = random.uniform(size=motors) < [1.0, 0.9, 0.3]
        buffer.append(
            Sample(0, new.interval_s, new.voltage_v, new.torque_nm, new.speed_rad_s, present)
        )
        for motor in np.flatnonzero(present):
            streams[motor].append(new.torque_nm[motor])
        if step == 3 * capacity:
            buffer.forget(2, [1])
            streams[1] = [0.0] * (len(streams[1]) - 2) + streams[1][-2:]
    np.testing.assert_array_equal(buffer.received, [len(stream) for stream in streams])
    for motor, stream in enumerate(streams):
        one = slice(motor, motor + 1)
        kept = int(buffer.remembered(one)[0])
        assert kept == min(capacity, len(stream) - stream.count(0.0))
        np.testing.assert_array_equal(buffer.newest(kept, one)[2, 0], stream[-kept:])
    place = buffer.received - [3, 1, 2]  # some have not come to the newest yet
    ends = [stream[: int(end)][-2:] for stream, end in zip(streams, place, strict=True)]
    np.testing.assert_array_equal(buffer.newest(2, np.arange(motors), place)[2], ends)


def test_where_speed_is_not_measured_it_reads_zero_whatever_came() -> None:
    random = np.random.default_rng(8)
    buffer, reference = (ReplayBuffer(3, 8, speed_measured=measured) for measured in (False, True))
    buffer.refill(random.normal(size=(4, 3, 8)))
    for k in range(100):
        present = random.random(3) < 0.8 if k % 3 else None
        new = sample(random, 3)._replace(speed_rad_s=np.full(3, np.nan), present=present)
        for one in (buffer, reference):
            one.append(new)
        assert not buffer.speed_rad_s().any()
    for got, expected in zip(views(buffer)[:3], views(reference)[:3], strict=True):
        np.testing.assert_array_equal(got, expected)


def test_what_was_told_to_be_forgotten_goes_on_where_a_checkpoint_holds_it() -> None:
    buffer = ReplayBuffer(1, 64)
    for k in range(50):
        buffer.append(Sample.of_one_motor(10_000_000 * (k + 1), 0.01, float(k), 0.1))
    buffer.forget(20)
    content = buffer.content(with_forgotten=True)
    assert (buffer.content().shape[2], content.shape[2]) == (20, 50)
    other = ReplayBuffer(1, 64)
    other.refill(content, begin=int(buffer.begin()[0]))
    assert other.remembered().tolist() == buffer.remembered().tolist() == [20]
    assert other.stored(0) == buffer.stored(0) == 50
