"""Finds observers by their topics, and reads what they publish of every motor once a second.

``~/estimates`` and ``/diagnostics`` tell all there is: two readers, however many the motors, cost
an observer next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Float64MultiArray

from gray_box_observer.ros.topics import DIAGNOSTICS, ESTIMATES
from gray_box_observer.settings.ros_parameter_file import NODE_NAME
from gray_box_observer.watching.observer_state import MOST_OBSERVERS, WatchedState

LOOK_ROUND_S = 0.25
"""Between two looks at the graph while no observer was heard."""

LOOK_ROUND_LATER_S = 2.0
"""Between two looks afterwards."""

MOST_TAKEN = 2000
"""Messages of one reader in one poll: a sender that never pauses must not keep it from its end."""

LEAF = ESTIMATES.name.removeprefix('~')
_TYPE = 'std_msgs/msg/Float64MultiArray'
_OWN_FACT = 'samples used'
"""Stands in the diagnostics of an observer, whatever its node is called."""


class ObserverListener:
    """Reads estimates and diagnostics of every observer into a state.

    Args:
        node: who listens.
        state: where it goes.
        observers: names of the only ones to listen to; none for all.
        clock: seconds, as the state counts them.
        look_round_s: between two looks at the graph, once an observer was heard.
    """

    def __init__(
        self,
        node: Node,
        state: WatchedState,
        observers: Sequence[str],
        clock: Callable[[], float],
        look_round_s: float = LOOK_ROUND_LATER_S,
    ) -> None:
        self._node = node
        self._state = state
        self._clock = clock
        self._look_round_s = look_round_s
        self._observer_names = frozenset(observers)
        self._estimates: dict[str, Subscription] = {}
        self._diagnostics = node.create_subscription(
            DIAGNOSTICS.type, DIAGNOSTICS.name, _unused, DIAGNOSTICS.qos
        )
        self._next_look_s = 0.0
        for observer in observers:
            self._listen_to(observer)

    def poll(self) -> None:
        """Take what has come, and look for observers that were not there before."""
        now_s = self._clock()
        if now_s >= self._next_look_s:
            self._discover()
            pause_s = self._look_round_s if self._state.observers else LOOK_ROUND_S
            self._next_look_s = now_s + pause_s
        for observer, subscription in self._estimates.items():
            for message in taken(subscription):
                labels = [dimension.label for dimension in message.layout.dim]
                self._state.add_estimates(observer, labels, message.data, now_s)
        for message in taken(self._diagnostics):
            self._add_diagnostics(message, now_s)

    def has_heard_all(self) -> bool:
        """Whether every observer was heard that was asked for, or of which the graph tells."""
        heard = self._state.observers.keys()
        return bool(heard) and heard >= self._estimates.keys()

    def _discover(self) -> None:
        if self._observer_names:
            return
        for observer in observers_of(self._node):
            self._listen_to(observer)

    def _listen_to(self, observer: str) -> None:
        if observer not in self._estimates and len(self._estimates) < MOST_OBSERVERS:
            self._estimates[observer] = self._node.create_subscription(
                Float64MultiArray, observer + LEAF, _unused, ESTIMATES.qos
            )

    def _add_diagnostics(self, message: DiagnosticArray, now_s: float) -> None:
        for status in message.status:
            name, colon, motor = status.name.partition(': ')
            observer = '/' + name.lstrip('/')
            facts = {pair.key: pair.value for pair in status.values}
            if colon and self._is_observer(observer, facts) and _is_name_of_node(observer):
                level = int.from_bytes(status.level, 'little')
                self._state.add_status(observer, motor, level, status.message, facts, now_s)

    def _is_observer(self, name: str, facts: dict[str, str]) -> bool:
        """Whether a status is of an observer; others stand on the same topic."""
        return (
            _OWN_FACT in facts
            or name in self._state.observers
            or name.rpartition('/')[2] == NODE_NAME
        )


def _is_name_of_node(name: str) -> bool:
    """Tell whether topics can stand below a name: anybody may write to diagnostics."""
    try:
        return bool(validate_full_topic_name(name))
    except InvalidTopicNameException:
        return False


def observers_of(node: Node) -> Iterator[str]:
    """Yield the names of the observers whose estimates a node knows of."""
    for topic, types in node.get_topic_names_and_types():
        observer = topic.removesuffix(LEAF)
        if observer != topic and observer and _TYPE in types:
            yield observer


def taken(subscription: Subscription, *, raw: bool = False) -> Iterator[Any]:
    """Yield the messages that wait in a reader, MOST_TAKEN at most.

    Args:
        subscription: the reader.
        raw: whether as bytes.
    """
    for _ in range(MOST_TAKEN):
        with subscription.handle:
            entry = subscription.handle.take_message(subscription.msg_type, raw)
        if entry is None:
            return
        yield entry[0]


def _unused(_message: Any) -> None:
    """Stand in for a callback: messages are taken, not called back with."""
