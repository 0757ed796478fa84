"""Tests of the fit are done piece by piece, as the samples come."""

from __future__ import annotations

import pytest

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.observer.fit_test_queue import WORK_A_SECOND, FitTestQueue

SHORT_S = 1.0 / WORK_A_SECOND
"""Interval that allows one piece."""


class Bench:
    """Where tests of three pieces each are done."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.queue = FitTestQueue(self._test)

    def _test(self, motor: int, is_recent: bool) -> Pieces[None]:
        for piece in range(3):
            self.done.append(f'{motor}{"r" if is_recent else ""}.{piece}')
            yield 10
        self.done.append(f'{motor} ends')


@pytest.fixture
def bench() -> Bench:
    """Return one on which two tests are asked for."""
    one = Bench()
    one.queue.ask(1)
    one.queue.ask(2, is_recent=True)
    return one


def test_every_sample_gets_a_test_on_by_a_piece_however_often_that_is_asked_for(
    bench: Bench,
) -> None:
    for count in range(1, 4):
        bench.queue.begin_sample(SHORT_S)
        bench.queue.advance()
        bench.queue.advance()
        assert len(bench.done) == count
    bench.queue.begin_sample(0.0)  # how long it took nobody knows
    bench.queue.advance()
    assert bench.done == ['1.0', '1.1', '1.2', '1 ends', '2r.0']


def test_slow_samples_have_time_for_more(bench: Bench) -> None:
    bench.queue.begin_sample(50 * SHORT_S)
    bench.queue.advance()
    assert bench.done == ['1.0', '1.1', '1.2', '1 ends', '2r.0', '2r.1']
    bench.queue.begin_sample(50 * SHORT_S)
    bench.queue.advance()
    assert bench.queue.is_empty
    assert bench.done[-2:] == ['2r.2', '2 ends']


def test_what_has_begun_or_all_of_it_can_be_completed(bench: Bench) -> None:
    bench.queue.complete_begun()
    assert bench.done == []
    bench.queue.begin_sample(SHORT_S)
    bench.queue.advance()
    bench.queue.complete_begun()
    assert bench.done[-1] == '1 ends'
    assert not bench.queue.is_empty
    bench.queue.complete()
    assert bench.done[-1] == '2 ends'
    assert bench.queue.is_empty


def test_where_samples_have_ceased_all_is_done(bench: Bench) -> None:
    bench.queue.begin_sample(SHORT_S)
    bench.queue.rest()
    assert bench.done == [], 'one has just come'
    bench.queue.rest()
    assert bench.queue.is_empty
    assert bench.done[-1] == '2 ends'


def test_what_is_cleared_is_never_done(bench: Bench) -> None:
    bench.queue.begin_sample(SHORT_S)
    bench.queue.advance()
    bench.queue.clear()
    bench.queue.complete()
    assert bench.queue.is_empty
    assert bench.done == ['1.0']


def test_one_that_fails_is_given_up() -> None:
    def failing(_motor: int, _is_recent: bool) -> Pieces[None]:
        yield 1
        raise ZeroDivisionError

    queue = FitTestQueue(failing)
    queue.ask(0)
    queue.begin_sample(SHORT_S)
    queue.advance()
    queue.begin_sample(SHORT_S)
    with pytest.raises(ZeroDivisionError):
        queue.advance()
