"""Finds a DDS participant for a watcher that an observer has answered.

Fast DDS 2.14 announces a participant before it reads what comes. An answer within that fraction of
a millisecond is lost, and who has answered once announces itself next by its period of 3 s. Beside
ten motors at 1 kHz, three of ten participants are answered in time; each takes some 5 ms to make.
So a watcher makes one after another, without waiting for the one before, and keeps the first that
has heard.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

from gray_box_observer.ros.topics import ESTIMATES
from gray_box_observer.ros.watching.observer_listener import LEAF, observers_of, taken
from gray_box_observer.ros.watching.polling_executor import WITHOUT_SERVICES
from gray_box_observer.watching.observer_state import MOST_OBSERVERS

ANSWER_S = 0.3
"""Within which the latched estimates come of an observer that has answered: 0.15 s mostly."""

PAUSE_S = 0.1
"""Between two participants: each costs the observer some milliseconds."""

MOST_PARTICIPANTS = 12
"""Where no observer runs, they take 1.4 s."""

LONGEST_S = 3.0
"""Of a search: what was not answered by then hears of the observer by its own period."""

MOST_SILENT = 2
"""Participants after which an observer that is known need not have told anything: it may have
nothing to tell yet. Of a few, what is latched comes 3 s later than what they are called."""

LOOK_S = 0.01

_NODE_NAME = 'gray_box_listener'


@contextmanager
def answered_participant(
    args: Sequence[str] | None, observers: Sequence[str], is_end_requested: Callable[[], bool]
) -> Iterator[Context]:
    """Yield the context of a participant, for nodes to be made in meanwhile.

    Whoever takes it shuts it down, after these nodes.

    Args:
        args: the whole command line, for what ROS takes of it; None: that of the process.
        observers: names of those that must have answered, all of them; none: all that any
            participant knows.
        is_end_requested: tells that nobody waits any more.
    """
    searches: list[_Search] = []
    try:
        best = _answered_search(args, observers, is_end_requested, searches)
        searches.remove(best)
        for search in searches:
            search.close()
        searches.clear()
        try:
            yield best.node.context
        finally:
            best.node.destroy_node()
    finally:
        for search in searches:
            search.close()


def _answered_search(
    args: Sequence[str] | None,
    observers: Sequence[str],
    is_end_requested: Callable[[], bool],
    searches: list[_Search],
) -> _Search:
    """Add searches to a list until one has heard, or there is no use; return the best of them.

    One whose time is over is given back, unless it is the best: in the range of this host the
    middleware announces itself to 32 participants only.
    """
    begin_s = due_s = time.monotonic()
    made_count = silent_count = 0
    most_count = MOST_PARTICIPANTS
    known_observers = set(observers)
    while True:
        now_s = time.monotonic()
        if due_s <= now_s < begin_s + LONGEST_S and made_count < most_count:
            try:
                node = _listening_node(args)  # which takes long on a busy machine
            except rclpy_implementation.RCLError:
                if not searches:
                    raise
                most_count = made_count  # there is room for no more
            else:
                now_s = time.monotonic()
                searches.append(_Search(node, observers, now_s + ANSWER_S))
                made_count += 1
            due_s = now_s + PAUSE_S
        for search in searches:
            search.poll()
        known_observers.update(*(search.subscriptions for search in searches))
        best = max(searches, key=lambda search: (len(search.heard), len(search.subscriptions)))
        for search in [one for one in searches if now_s >= one.end_s]:
            has_found = not search.is_over and known_observers <= search.subscriptions.keys()
            silent_count += bool(known_observers) and has_found
            search.is_over = True
            if search is not best:
                searches.remove(search)
                search.close()
        is_idle = all(search.is_over for search in searches)
        has_heard = bool(known_observers) and known_observers <= best.heard
        if has_heard or silent_count >= MOST_SILENT or is_idle or is_end_requested():
            return best
        time.sleep(LOOK_S)


def _listening_node(args: Sequence[str] | None) -> Node:
    """Make a node with a participant of its own."""
    context = Context()
    rclpy.init(args=None if args is None else list(args), context=context)
    try:
        return Node(_NODE_NAME, context=context, **WITHOUT_SERVICES)
    except BaseException:
        context.try_shutdown()
        raise


class _Search:
    """Listens for the latched estimates of observers, with one participant.

    Args:
        node: of the participant, and of no other.
        observers: names of those that are meant; none: any.
        end_s: monotonic time until which it listens.

    Attributes:
        node, end_s: as above.
        is_over: whether that time is over.
        subscriptions: by the names of the observers whose topics are known.
        heard: names of those that have told something.
    """

    def __init__(self, node: Node, observers: Sequence[str], end_s: float) -> None:
        self.node = node
        self.end_s = end_s
        self.is_over = False
        self._observers = frozenset(observers)
        self.subscriptions: dict[str, Subscription] = {}
        self.heard: set[str] = set()

    def poll(self) -> None:
        """Take what has come."""
        for observer in observers_of(self.node):
            is_meant = not self._observers or observer in self._observers
            is_new = observer not in self.subscriptions
            if is_meant and is_new and len(self.subscriptions) < MOST_OBSERVERS:
                self.subscriptions[observer] = self.node.create_subscription(
                    ESTIMATES.type, observer + LEAF, lambda _: None, ESTIMATES.qos
                )
        for observer, subscription in self.subscriptions.items():
            if any(True for _ in taken(subscription, raw=True)):
                self.heard.add(observer)

    def close(self) -> None:
        """Give the participant back."""
        self.node.destroy_node()
        self.node.context.try_shutdown()
