"""What the middleware may hold of a topic is bounded in bytes."""

from __future__ import annotations

import mmap
import threading
from types import SimpleNamespace

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy

from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder
from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.ros.observer import receive_queue
from gray_box_observer.ros.observer.receive_memory import ReceiveMemory
from gray_box_observer.ros.observer.receive_queue import BUDGET_MESSAGES, CALM_S, ReceiveQueue

LIMIT = 4_000_000
BUDGET = BUDGET_MESSAGES * LIMIT
DEPTH = 1000


def touched_memory() -> mmap.mmap:
    """Return 80 MB, each page touched; pages that the system makes large would count as few."""
    memory = mmap.mmap(-1, 80_000_000)
    memory.madvise(mmap.MADV_NOHUGEPAGE)
    for offset in range(0, len(memory), mmap.PAGESIZE):
        memory[offset] = 1
    return memory


class Node:
    """Does what it is asked for when :meth:`turn` is called, as an executor does."""

    def __init__(self) -> None:
        self.executor = SimpleNamespace(create_task=lambda task: self.waiting.append(task))
        self.waiting = []
        self.alive = []
        self.said = []
        self.watched = []

    def turn(self) -> None:
        """Serve tasks, and the timers that they begin."""
        while self.waiting:
            self.waiting.pop(0)()

    def subscribe(self, profile: QoSProfile | None) -> SimpleNamespace:
        """Make a subscription."""
        made = SimpleNamespace(
            qos_profile=profile or QoSProfile(depth=DEPTH), topic_name='/motor/voltage'
        )
        self.alive.append(made)
        return made

    def create_timer(self, period_s, callback, clock):
        """Have something done later."""
        self.waiting.append(callback)
        return callback

    def destroy_timer(self, timer) -> None:
        """Have it done no more."""
        self.waiting = [callback for callback in self.waiting if callback != timer]

    def destroy_subscription(self, subscription) -> None:
        """End a subscription."""
        self.alive.remove(subscription)

    def get_logger(self):
        """Keep what is said."""
        return SimpleNamespace(
            warning=lambda text, **_: self.said.append(text), info=self.said.append
        )


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def queue(node) -> ReceiveQueue:
    return ReceiveQueue(node, node.subscribe, LIMIT, lambda: node.watched.append(True))


def test_usual_messages_are_not_looked_at_and_change_nothing(queue, node):
    assert queue.unchecked_bytes == BUDGET // DEPTH
    assert queue.admit(queue.unchecked_bytes)
    node.turn()
    assert not node.watched
    assert [subscription.qos_profile.depth for subscription in node.alive] == [DEPTH]
    assert not node.said


@pytest.mark.parametrize(
    ('size', 'is_read'), [(100_000, True), (LIMIT, True), (LIMIT + 1, False), (BUDGET, False)]
)
def test_a_large_message_now_and_then_costs_no_other(queue, node, size, is_read):
    assert queue.admit(size) == is_read
    node.turn()
    assert [subscription.qos_profile.depth for subscription in node.alive] == [DEPTH]
    assert node.watched, 'but the memory is looked at'


@pytest.mark.parametrize(
    ('size', 'depth'), [(100_000, 16), (LIMIT, 16), (LIMIT + 1, 8), (10 * BUDGET, 1)]
)
def test_where_the_memory_has_grown_the_queue_is_short_and_shorter_for_larger_messages(
    queue, node, size, depth
):
    queue.empty()
    assert len(node.alive) == 1, 'nothing is made anew within the callback'
    node.turn()
    assert [subscription.qos_profile.depth for subscription in node.alive] == [BUDGET_MESSAGES]
    queue.admit(size)
    node.turn()
    assert [subscription.qos_profile.depth for subscription in node.alive] == [depth]
    assert depth * size <= BUDGET or depth == 1
    assert node.alive[0].qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    said = len(node.said)
    queue.admit(size)
    node.turn()
    assert len(node.said) == said, 'the same again changes nothing'


def test_the_full_queue_comes_back_when_it_has_been_calm(queue, node, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(receive_queue.time, 'monotonic', lambda: now_s[0])
    queue.empty()
    node.turn()
    now_s[0] = 0.9 * CALM_S
    assert queue.unchecked_bytes < 0, 'every message is looked at'
    queue.admit(100)
    node.turn()
    assert queue.subscription.qos_profile.depth == 16
    now_s[0] = 1.1 * CALM_S
    queue.admit(100)
    node.turn()
    assert queue.subscription.qos_profile.depth == DEPTH
    assert queue.subscription.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    assert queue.unchecked_bytes == BUDGET // DEPTH


def test_a_queue_can_be_emptied_though_no_message_of_it_was_ever_complete(queue, node):
    before = queue.subscription
    queue.empty()
    node.turn()
    assert before not in node.alive
    assert queue.subscription.qos_profile.depth == BUDGET_MESSAGES


def test_what_is_closed_while_it_is_made_anew_stays_closed(queue, node):
    queue.empty()
    queue.close()
    node.turn()
    assert node.alive == []


def test_what_is_closed_between_two_readers_stays_closed(queue, node):
    queue.empty()
    node.waiting.pop(0)()
    assert node.alive == []
    queue.close()
    assert node.waiting == [], 'no timer is left'


def test_the_next_reader_waits_for_the_end_of_the_last_however_late_that_is(queue, node):
    """While the last one lives, the middleware gives none of its memory back."""
    queue.empty()
    assert [task.__name__ for task in node.waiting] == ['_destroy']
    node.waiting.pop(0)()
    assert [task.__name__ for task in node.waiting] == ['_reopen']


def test_growth_is_told_by_who_has_touched_the_memory():
    memory = ReceiveMemory()
    kept = []
    kept.append(touched_memory())
    assert memory.grown_bytes() < 20e6, 'ours'
    memory.mark()
    other = threading.Thread(target=lambda: kept.append(touched_memory()))
    other.start()
    other.join()
    assert memory.grown_bytes() > 60e6, 'of another thread'


def test_what_the_writer_of_checkpoints_touches_is_no_flood(tmp_path, monkeypatch):
    kept = []
    written = threading.Event()
    go_on = threading.Event()

    def write(*_):
        kept.append(touched_memory())
        written.set()
        assert go_on.wait(20.0)

    monkeypatch.setattr(checkpoint, 'write', write)
    monkeypatch.setattr(checkpoint, 'capture', lambda _: None)
    path = tmp_path / 'c.safetensors'
    keeper = CheckpointKeeper(CheckpointFolder('', str(path), tmp_path), str(path), automatic=True)
    memory = ReceiveMemory(lambda: keeper.thread_numbers)
    counts = SimpleNamespace(used_count=1)
    observer = SimpleNamespace(
        motors=['motor'], counts=lambda _: counts, configuration=SimpleNamespace(motors=['motor'])
    )
    keeper.keep(observer)
    assert written.wait(20.0)
    assert memory.grown_bytes() < 20e6, 'while it writes'
    other = threading.Thread(target=lambda: kept.append(touched_memory()))
    other.start()
    other.join()
    assert memory.grown_bytes() > 60e6, 'a flood meanwhile, with a disk that does not answer'
    go_on.set()
    assert keeper.close(None) is None
