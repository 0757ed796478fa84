from __future__ import annotations

import time

import pytest

from gray_box_observer.ros.periodic_task import Chore


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


def test_what_was_left_to_messages_that_came_no_more_is_done_by_the_next_timer(
    clock: list[float],
) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    clock[0] = 100.95
    chore.meet(quiet=True)
    for clock[0] in (101.0, 102.0, 103.0):
        chore.ring()
    assert done == [102.0, 103.0]


def test_where_messages_lead_to_nothing_it_is_done_as_often_as_otherwise(
    clock: list[float],
) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    for tick in range(1, 501):  # a message every 20 ms, the timer right behind some
        clock[0] = 100.0 + 0.02 * tick
        chore.meet(quiet=False)
        if tick % 50 == 0:
            chore.ring()
    assert done == pytest.approx(
        [101.1, 102.1, 103.1, 104.1, 105.1, 106.1, 107.1, 108.1, 109.1], abs=0.03
    )


def test_a_timer_that_has_fallen_behind_does_not_do_what_messages_have_seen_to(
    clock: list[float],
) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    clock[0] = 101.6
    assert chore.meet(quiet=False)
    for clock[0] in (101.61, 101.62):  # of 101.0, which had to queue up behind messages
        chore.ring()
        assert not chore.meet(quiet=True)
    clock[0] = 103.0
    chore.ring()
    assert done == [101.6, 103.0]


def test_what_comes_round_faster_than_messages_do_is_not_left_to_them_for_long(
    clock: list[float],
) -> None:
    done: list[float] = []
    chore = Chore(0.02, lambda: done.append(clock[0]))
    for tick in range(1, 101):  # ms; a message every 50
        clock[0] = 100.0 + 0.001 * tick
        if tick % 50 == 8:
            chore.meet(quiet=True)
        if tick % 20 == 0:
            chore.ring()
    assert done == pytest.approx([100.02, 100.04, 100.08, 100.1])
