"""Makes the DDS participant of a watcher anew until an observer has answered it.

Fast DDS 2.14 announces a participant before it reads what comes. An answer within that fraction of
a millisecond is lost, and who has answered once announces itself next by its period of 3 s: every
second start of a watcher heard nothing for up to 3 s. Another participant is another chance.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rclpy.node import Node
from rclpy.subscription import Subscription

from gray_box_observer.ros.topics import ESTIMATES
from gray_box_observer.ros.watching.observer_listener import LEAF, observers_of, taken
from gray_box_observer.ros.watching.polling_executor import WITHOUT_SERVICES

ANSWER_S = 0.2
"""Within which the latched estimates come of an observer that has answered."""

MOST_PARTICIPANTS = 6
"""Where no observer has told anything yet, they take 1.2 s."""

LOOK_S = 0.01
_NODE_NAME = 'gray_box_listener'


@contextmanager
def answered_participant(
    observers: Sequence[str], is_end_requested: Callable[[], bool]
) -> Iterator[None]:
    """Hold a participant of the default context, which nodes share that are made meanwhile.

    Args:
        observers: names of those that must have answered; none: any.
        is_end_requested: tells that nobody waits any more.
    """
    node = _listening_node()
    for _ in range(MOST_PARTICIPANTS - 1):
        if _is_answered(node, observers, is_end_requested) or is_end_requested():
            break
        node.destroy_node()
        node = _listening_node()
    try:
        yield
    finally:
        node.destroy_node()


def _listening_node() -> Node:
    return Node(_NODE_NAME, **WITHOUT_SERVICES)


def _is_answered(
    node: Node, observers: Sequence[str], is_end_requested: Callable[[], bool]
) -> bool:
    """Wait for the latched estimates of observers; tell whether they have come."""
    subscriptions: dict[str, Subscription] = {}
    heard: set[str] = set()
    until_s = time.monotonic() + ANSWER_S
    while time.monotonic() < until_s and not is_end_requested():
        for observer in observers_of(node):
            if observer not in subscriptions:
                subscriptions[observer] = node.create_subscription(
                    ESTIMATES.type, observer + LEAF, lambda _: None, ESTIMATES.qos
                )
        heard.update(
            observer
            for observer, subscription in subscriptions.items()
            if any(True for _ in taken(subscription, raw=True))
        )
        if heard and heard.issuperset(observers):
            return True
        time.sleep(LOOK_S)
    return False
