from __future__ import annotations

import time

import pytest

from gray_box_observer.ros.chore import Chore


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    return now


def test_what_the_timer_does_in_time_nobody_does_again(clock: list[float]) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    for _ in range(5):
        clock[0] += 1.0
        chore.ring()
        assert not chore.meet(quiet=True)
        clock[0] += 0.4
        assert not chore.meet(quiet=True)
        clock[0] -= 0.4
    assert done == [101.0, 102.0, 103.0, 104.0, 105.0]


def test_where_the_timer_is_late_it_is_done_beside_any_message_and_once(clock: list[float]) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    told = []
    for _ in range(40):
        clock[0] += 0.25
        told.append(chore.meet(quiet=False))
    assert done == [101.75, 103.5, 105.25, 107.0, 108.75]
    assert told.count(True) == len(done)


def test_while_messages_come_it_waits_for_a_quiet_moment(clock: list[float]) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    clock[0] = 100.99
    chore.meet(quiet=True)
    clock[0] = 101.0
    chore.ring()
    clock[0] = 101.01
    assert not chore.meet(quiet=False)
    clock[0] = 101.02
    assert chore.meet(quiet=True)
    assert not chore.meet(quiet=True)
    assert done == [101.02]


def test_what_was_left_to_messages_that_came_no_more_is_done_by_the_next_timer(clock: list[float]) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    clock[0] = 100.95
    chore.meet(quiet=True)
    for clock[0] in (101.0, 102.0, 103.0):
        chore.ring()
    assert done == [102.0, 103.0]
