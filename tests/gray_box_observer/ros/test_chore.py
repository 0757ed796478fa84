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
        chore.do()
        chore.catch_up()
        clock[0] += 0.4
        chore.catch_up()
        clock[0] -= 0.4
    assert done == [101.0, 102.0, 103.0, 104.0, 105.0]


def test_where_the_timer_is_late_it_is_done_by_the_way_and_once(clock: list[float]) -> None:
    done: list[float] = []
    chore = Chore(1.0, lambda: done.append(clock[0]))
    for _ in range(40):
        clock[0] += 0.25
        chore.catch_up()
    assert done == [101.75, 103.5, 105.25, 107.0, 108.75]
