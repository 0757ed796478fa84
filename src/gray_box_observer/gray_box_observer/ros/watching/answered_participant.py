"""Makes the DDS participant of a watcher anew until an observer has answered it.

Fast DDS 2.14 announces a participant before it reads what comes. An answer within that fraction of
a millisecond is lost, and who has answered once announces itself next by its period of 3 s: every
second start of a watcher heard nothing for up to 3 s. Another participant is another chance.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import contextmanager

from rclpy.node import Node
from rclpy.subscription import Subscription

from gray_box_observer.ros.topics import ESTIMATES
from gray_box_observer.ros.watching.observer_listener import LEAF, observers_of, taken
from gray_box_observer.ros.watching.polling_executor import WITHOUT_SERVICES
from gray_box_observer.watching.observer_state import MOST_OBSERVERS

ANSWER_S = 0.2
"""Within which the latched estimates come of an observer that has answered."""

MOST_PARTICIPANTS = 6
"""Where no observer runs, they take 1 s."""

MOST_SILENT = 2
"""Participants after which an observer that is known need not have told anything: it may have
nothing to tell yet. Of a few, what is latched comes 3 s later than what they are called."""

LOOK_S = 0.01

_NODE_NAME = 'gray_box_listener'


@contextmanager
def answered_participant(
    observers: Sequence[str], is_end_requested: Callable[[], bool]
) -> Iterator[None]:
    """Hold a participant of the default context, which nodes share that are made meanwhile.

    Args:
        observers: names of those that must have answered, all of them; none: any.
        is_end_requested: tells that nobody waits any more.
    """
    node = _listening_node()
    try:
        for count in range(1, MOST_PARTICIPANTS):
            search = _Search(node, observers)
            search.wait(is_end_requested)
            if search.has_heard or is_end_requested():
                break
            if search.has_found and count >= MOST_SILENT:
                break
            node.destroy_node()
            node = _listening_node()
        yield
    finally:
        node.destroy_node()


def _listening_node() -> Node:
    return Node(_NODE_NAME, **WITHOUT_SERVICES)


class _Search:
    """Listens for the latched estimates of observers, with one participant.

    Args:
        node: of the participant.
        observers: names of those that are meant; none: any.
    """

    def __init__(self, node: Node, observers: Sequence[str]) -> None:
        self._node = node
        self._observers = frozenset(observers)
        self._subscriptions: dict[str, Subscription] = {}
        self._heard: set[str] = set()

    def wait(self, is_end_requested: Callable[[], bool]) -> None:
        """Listen until all have told something, the end is requested, or ANSWER_S are over."""
        until_s = time.monotonic() + ANSWER_S
        while time.monotonic() < until_s and not (self.has_heard or is_end_requested()):
            self._look()
            time.sleep(LOOK_S)

    @property
    def has_found(self) -> bool:
        """Whether the topics of all are known."""
        return self._includes(self._subscriptions.keys())

    @property
    def has_heard(self) -> bool:
        """Whether all have told something."""
        return self._includes(self._heard)

    def _includes(self, names: Set[str]) -> bool:
        return bool(names) and self._observers <= names

    def _look(self) -> None:
        for observer in observers_of(self._node):
            is_meant = not self._observers or observer in self._observers
            is_new = observer not in self._subscriptions
            if is_meant and is_new and len(self._subscriptions) < MOST_OBSERVERS:
                self._subscriptions[observer] = self._node.create_subscription(
                    ESTIMATES.type, observer + LEAF, lambda _: None, ESTIMATES.qos
                )
        for observer, subscription in self._subscriptions.items():
            if any(True for _ in taken(subscription, raw=True)):
                self._heard.add(observer)
