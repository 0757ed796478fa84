from __future__ import annotations

import time

import pytest

from gray_box_observer.ros.periodic_task import PeriodicTask


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    return now


def test_what_the_timer_does_in_time_nobody_does_again(clock: list[float]) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    for _ in range(5):
        clock[0] += 1.0
        task.on_timer()
        assert not task.on_message(quiet=True)
        clock[0] += 0.4
        assert not task.on_message(quiet=True)
        clock[0] -= 0.4
    assert done == [101.0, 102.0, 103.0, 104.0, 105.0]


def test_where_the_timer_is_late_it_is_done_beside_any_message_and_once(clock: list[float]) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    told = []
    for _ in range(40):
        clock[0] += 0.25
        told.append(task.on_message(quiet=False))
    assert done == [101.75, 103.5, 105.25, 107.0, 108.75]
    assert told.count(True) == len(done)


def test_while_messages_come_it_waits_for_a_quiet_moment(clock: list[float]) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    clock[0] = 100.99
    task.on_message(quiet=True)
    clock[0] = 101.0
    task.on_timer()
    clock[0] = 101.01
    assert not task.on_message(quiet=False)
    clock[0] = 101.02
    assert task.on_message(quiet=True)
    assert not task.on_message(quiet=True)
    assert done == [101.02]


def test_what_was_left_to_messages_that_came_no_more_is_done_by_the_next_timer(
    clock: list[float],
) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    clock[0] = 100.95
    task.on_message(quiet=True)
    for clock[0] in (101.0, 102.0, 103.0):
        task.on_timer()
    assert done == [102.0, 103.0]


def test_where_messages_lead_to_nothing_it_is_done_as_often_as_otherwise(
    clock: list[float],
) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    for tick in range(1, 501):  # a message every 20 ms, the timer right behind some
        clock[0] = 100.0 + 0.02 * tick
        task.on_message(quiet=False)
        if tick % 50 == 0:
            task.on_timer()
    assert done == pytest.approx(
        [101.1, 102.1, 103.1, 104.1, 105.1, 106.1, 107.1, 108.1, 109.1], abs=0.03
    )


def test_a_timer_that_has_fallen_behind_does_not_do_what_messages_have_seen_to(
    clock: list[float],
) -> None:
    done: list[float] = []
    task = PeriodicTask(1.0, lambda: done.append(clock[0]))
    clock[0] = 101.6
    assert task.on_message(quiet=False)
    for clock[0] in (101.61, 101.62):  # of 101.0, which had to queue up behind messages
        task.on_timer()
        assert not task.on_message(quiet=True)
    clock[0] = 103.0
    task.on_timer()
    assert done == [101.6, 103.0]


def test_what_comes_round_faster_than_messages_do_is_not_left_to_them_for_long(
    clock: list[float],
) -> None:
    done: list[float] = []
    task = PeriodicTask(0.02, lambda: done.append(clock[0]))
    for tick in range(1, 101):  # ms; a message every 50
        clock[0] = 100.0 + 0.001 * tick
        if tick % 50 == 8:
            task.on_message(quiet=True)
        if tick % 20 == 0:
            task.on_timer()
    assert done == pytest.approx([100.02, 100.04, 100.08, 100.1])
