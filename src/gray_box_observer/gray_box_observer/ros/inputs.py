"""The topics that the observer listens to: what comes on them, and why nothing does."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible, qos_policy_name_from_kind
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState

from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.configuration import Configuration
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.parameters import SIGNALS
from gray_box_observer.ros import topics
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.ros.qos import subscribe

Take = Callable[[str, Any, int], None]
"""Takes the signal's name, the message, and the stamp in ns of one without header."""

VIEWED = ('position', 'velocity', 'effort')
"""Fields of a JointState that are read from its bytes: that takes a third of the time of building the message."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why nothing can come on a topic.

    Attributes:
        message: what is wrong and what to do about it.
        broken: whether somebody publishes there and will never be heard; else nobody publishes at all.
    """

    message: str
    broken: bool


class Inputs:
    """Subscriptions of the configured signals.

    Args:
        node: the node that listens.
        configuration: names topics and types.
        take: gets every message.
        refuse: told the signal's name of every message whose bytes make no sense.

    Raises:
        ConfigurationError: a message type that this environment does not have.
    """

    def __init__(self, node: Node, configuration: Configuration, take: Take, refuse: Callable[[str], None]) -> None:
        self._node = node
        self._take = take
        self._refuse = refuse
        self._topics = {name: configuration[f'{name}.topic'] for name in SIGNALS if configuration[f'{name}.topic']}
        self._types = {name: _message_type(name, configuration[f'{name}.type']) for name in SIGNALS}
        self._fields = {name: re.split(r'\W', configuration[f'{name}.field'])[0] for name in SIGNALS}
        self._subscriptions: dict[str, Subscription] = {}
        self._refused: dict[str, str] = {}

    def open(self) -> None:
        """Begin to listen.

        Raises:
            ConfigurationError: a quality of service that cannot be had.
        """
        for name, topic in self._topics.items():
            if not self._has_header(name):
                self._node.get_logger().info(
                    f'{self._type_name(name)} has no header: {name} is stamped by {self._clock_in_words}'
                )
            self._subscriptions[name] = self._subscribe(name, topic)

    def close(self) -> None:
        """Stop listening."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    @property
    def needs_source_time(self) -> bool:
        """Whether a signal's messages have no header, so that the middleware's source time has to stamp them."""
        return not all(self._has_header(name) for name in self._topics)

    @property
    def in_words(self) -> str:
        """Every topic by its full name."""
        return ', '.join(self._node.resolve_topic_name(topic) for topic in self._topics.values())

    def trouble(self, names: Iterable[str]) -> Trouble | None:
        """Say why nothing comes for these signals, as far as the graph of nodes and topics tells; None: no idea."""
        found = [trouble for name in names if (trouble := self._trouble(name)) is not None]
        found.sort(key=lambda trouble: not trouble.broken)
        same = [trouble.message for trouble in found if found and trouble.broken == found[0].broken]
        return Trouble('; '.join(same), found[0].broken) if found else None

    def _subscribe(self, name: str, topic: str) -> Subscription:
        callback: Callable[..., None]
        raw = self._types[name] is JointState and self._fields[name] in VIEWED
        if raw:
            callback = partial(self._take_bytes, name, JointStateDecoder())
        else:
            callback = partial(self._take_stamped if self._has_header(name) else self._take_bare, name)
        listen = partial(subscribe, self._node, self._types[name], topic, callback, topics.SIGNAL_QOS, raw=raw)
        # Not message_lost: with Fast DDS 2.14, taking that event while the next one arrives locks up for good.
        try:
            return listen(SubscriptionEventCallbacks(incompatible_qos=partial(self._incompatible, name)))
        except UnsupportedEventTypeError:  # not every middleware tells
            return listen()

    def _take_bytes(self, name: str, decode: JointStateDecoder, data: bytes) -> None:
        try:
            message = decode(data)
        except SampleError:
            self._refuse(name)
            return
        self._take(name, message, 0)

    def _take_stamped(self, name: str, message: Any) -> None:
        self._take(name, message, 0)

    def _take_bare(self, name: str, message: Any, info: dict[str, Any]) -> None:
        clock = self._node.get_clock()
        # the middleware stamps by the wall clock, which tells nothing of simulated time
        self._take(name, message, clock.now().nanoseconds if clock.ros_time_is_active else info['source_timestamp'])

    @property
    def _clock_in_words(self) -> str:
        return '/clock, when it arrives' if self._node.get_clock().ros_time_is_active else 'the middleware'

    def _has_header(self, name: str) -> bool:
        return 'header' in self._types[name].get_fields_and_field_types()

    def _type_name(self, name: str) -> str:
        kind = self._types[name]
        return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'

    def _incompatible(self, name: str, event: Any) -> None:
        self._refused[name] = qos_policy_name_from_kind(event.last_policy_kind).lower()
        self._node.get_logger().warning(self._refusal(name, self._refused[name]))

    def _refusal(self, name: str, policy: str) -> str:
        topic = self._node.resolve_topic_name(self._topics[name])
        return (
            f'a publisher of {topic} offers less {policy} than is asked for, so nothing comes from it: '
            f'change it, or start with qos_overrides.{topic}.subscription.{policy}'
        )

    def _trouble(self, name: str) -> Trouble | None:
        topic = self._node.resolve_topic_name(self._topics[name])
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return Trouble(f'nobody publishes {topic}: start its driver, or set {name}.topic', broken=False)
        right = [publisher for publisher in publishers if publisher.topic_type == self._type_name(name)]
        if not right:
            return Trouble(
                f'{topic} is published as {publishers[0].topic_type}, but {name}.type is {self._type_name(name)}',
                broken=True,
            )
        reasons = [self._mismatch(name, publisher) for publisher in right]
        if all(reasons):
            return Trouble(self._refusal(name, str(reasons[0])), broken=True)
        return None

    def _mismatch(self, name: str, publisher: TopicEndpointInfo) -> str:
        """Name the policy that keeps a publisher from being heard; empty where it is heard."""
        asked, offered = self._subscriptions[name].qos_profile, publisher.qos_profile
        if qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR:
            return ''
        differing = [p for p in ('reliability', 'durability') if getattr(asked, p) != getattr(offered, p)]
        return self._refused.get(name) or (differing[0] if differing else 'quality of service')


def _message_type(name: str, type_name: str) -> Any:
    found = message_class(type_name)
    if found is None:
        raise ConfigurationError(
            f'{name}.type {type_name!r} is not a message this environment knows: source the workspace that has it'
        )
    return found
