"""When messages are due."""

from __future__ import annotations

import threading
import time

import pytest

from gray_box_observer.bag.pacer import BURST, Pacer

WAIT_S = 20.0


class Replay:
    """A thread that waits for recorded times in turn, and keeps when each was let through."""

    def __init__(self, pacer: Pacer, times_ns: list[int]) -> None:
        self.passed: list[tuple[int, float]] = []
        self.ticks: list[int] = []
        self._changed = threading.Condition()
        self._pacer = pacer
        self._times_ns = times_ns
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        self._pacer.restart(0)
        for time_ns in self._times_ns:
            if not self._pacer.wait(time_ns, self.ticks.append, 0.005):
                return
            with self._changed:
                self.passed.append((time_ns, time.monotonic()))
                self._changed.notify_all()

    def wait_for(self, count: int) -> None:
        """Block until so many have passed."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.passed) >= count, WAIT_S)


@pytest.mark.parametrize('rate', [1.0, 1000.0])
def test_messages_pass_at_their_recorded_distance_over_the_rate(rate):
    started_s = time.monotonic()
    replay = Replay(Pacer(rate), [0, int(100_000_000 * rate), int(200_000_000 * rate)])
    replay.wait_for(3)
    for time_ns, passed_s in replay.passed:
        assert (passed_s - started_s) - time_ns * 1e-9 / rate >= -1e-3


def test_without_a_rate_nothing_waits():
    Replay(Pacer(0.0), [0, 10**15]).wait_for(2)


def test_without_a_rate_no_more_than_the_limit_passes_however_long_it_stood_still():
    now_s = [0.0]
    pacer = Pacer(0.0, max_messages_per_s=100.0, clock=lambda: now_s[0])

    def passing() -> int:
        """How many pass without waiting."""
        count = 0
        while pacer._left_s(10**15) <= 0:
            assert pacer.wait(10**15)
            count += 1
        return count

    assert passing() == BURST
    now_s[0] = 0.25
    assert passing() == 25
    assert pacer._left_s(0) == pytest.approx(0.01)
    now_s[0] = 1000.0
    assert passing() == BURST


def test_a_limit_delays_and_loses_nothing_and_tells_no_time_meanwhile():
    replay = Replay(Pacer(0.0, max_messages_per_s=500.0), list(range(2 * BURST)))
    replay.thread.join(WAIT_S)
    assert [time_ns for time_ns, _ in replay.passed] == list(range(2 * BURST))
    assert replay.passed[-1][1] - replay.passed[0][1] > 0.9 * BURST / 500.0
    assert replay.ticks == []


def test_a_paused_replay_lets_single_steps_through_and_goes_on_from_there():
    pacer = Pacer(1.0, is_paused=True)
    hour_ns = 3600 * 10**9
    replay = Replay(pacer, [0, hour_ns, hour_ns + 50_000_000])
    assert pacer.step()
    replay.wait_for(1)
    assert pacer.step()
    replay.wait_for(2)
    assert len(replay.passed) == 2
    resumed_s = time.monotonic()
    pacer.resume()
    replay.wait_for(3)
    assert replay.passed[2][1] - resumed_s >= 0.049


def test_a_pause_does_not_count_as_replayed_time():
    now_s = [0.0]
    pacer = Pacer(2.0, clock=lambda: now_s[0])
    pacer.restart(0)
    now_s[0] = 1.0
    pacer.pause()
    now_s[0] = 100.0
    pacer.resume()
    assert pacer._position_ns() == 2_000_000_000
    now_s[0] = 100.5
    assert pacer._position_ns() == 3_000_000_000


def test_stepping_without_a_pause_is_refused():
    assert not Pacer(1.0).step()


def test_stopping_ends_every_wait():
    pacer = Pacer(1.0)
    replay = Replay(pacer, [10**18])
    pacer.stop()
    replay.thread.join(WAIT_S)
    assert not replay.thread.is_alive() and not replay.passed


def test_ticks_tell_the_recorded_time_while_waiting():
    replay = Replay(Pacer(1.0), [0, 100_000_000])
    replay.thread.join(WAIT_S)
    assert len(replay.ticks) >= 5
    assert (
        replay.ticks == sorted(replay.ticks)
        and replay.ticks[0] >= 0
        and replay.ticks[-1] <= 100_000_000
    )
