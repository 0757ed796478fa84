"""The faults themselves: the number asked for, every kind, repeatable by seed, counted."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from stream_faults import CORE_WEIGHTS, Delivery, FaultSettings, Kind, StreamFaults, encoded

from gray_box_observer.bag.joint_state import JointStateView, decode_joint_state
from gray_box_observer.errors import SampleError

MESSAGES = 20_000


def message(k: int) -> JointStateView:
    return JointStateView(10**18 + k * 10**7, ('motor',), (), (), (1.0 + k,))


def spoil(faults: StreamFaults, count: int = MESSAGES) -> list[Delivery]:
    arrived: list[Delivery] = []
    for k in range(count):
        arrived += faults.take('torque', message(k))
    return arrived + faults.flush()


def plain(arrived: Iterable[Delivery]) -> list[str]:
    return [repr(delivery) for delivery in arrived]


@pytest.mark.parametrize('share', [0.05, 0.3, 0.8])
def test_the_share_that_was_asked_for_is_touched(share: float) -> None:
    faults = StreamFaults(FaultSettings(share, CORE_WEIGHTS, most_frozen=50), 3)
    spoil(faults)
    assert faults.seen == MESSAGES
    assert faults.touched / MESSAGES == pytest.approx(share, rel=0.15)


def test_every_kind_comes_about() -> None:
    equal = dict.fromkeys((kind for kind in Kind if kind is not Kind.MILLION_ENTRIES), 1.0)
    faults = StreamFaults(FaultSettings(0.3, equal), 1)
    spoil(faults)
    assert set(faults.counts) == set(equal)


def test_the_same_seed_gives_the_same_faults_and_another_gives_others() -> None:
    first, second, third = (
        plain(spoil(StreamFaults(FaultSettings(weights=CORE_WEIGHTS), s), 2000)) for s in (1, 1, 2)
    )
    assert first == second
    assert first != third


def test_without_faults_everything_arrives_as_it_was_sent() -> None:
    assert spoil(StreamFaults(FaultSettings(share=0.0), 1), 500) == [
        Delivery('torque', message(k)) for k in range(500)
    ]


def test_late_and_frozen_messages_arrive_all_of_them_once() -> None:
    kinds = {Kind.DELAYED: 1.0, Kind.REORDERED: 1.0, Kind.FROZEN: 1.0}
    arrived = spoil(StreamFaults(FaultSettings(0.5, kinds), 1), 3000)
    assert [delivery.message for delivery in arrived] != [message(k) for k in range(3000)]
    assert sorted(arrived) == [Delivery('torque', message(k)) for k in range(3000)]


def test_what_is_dropped_and_doubled_is_counted() -> None:
    faults = StreamFaults(FaultSettings(0.3, {Kind.DROPPED: 1.0}), 1)
    assert len(spoil(faults, 1000)) == 1000 - faults.counts[Kind.DROPPED]
    assert faults.delivered == {'torque': 1000 - faults.counts[Kind.DROPPED]}


def test_damaged_bytes_are_no_message_or_one_that_says_less() -> None:
    unreadable = 0
    arrived = spoil(StreamFaults(FaultSettings(1.0, {Kind.DAMAGED_BYTES: 1.0}), 1), 300)
    for _, data in arrived:
        assert isinstance(data, bytes)
        try:
            decode_joint_state(data)
        except SampleError:
            unreadable += 1
    assert unreadable > 250


def test_every_other_fault_can_be_sent_as_a_message() -> None:
    weights = {kind: 1.0 for kind in Kind if kind not in (Kind.DAMAGED_BYTES, Kind.MILLION_ENTRIES)}
    for _, spoilt in spoil(StreamFaults(FaultSettings(1.0, weights), 1), 3000):
        assert isinstance(spoilt, JointStateView)
        assert decode_joint_state(encoded(spoilt)).names == spoilt.names
