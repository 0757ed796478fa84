"""The topics that the observer listens to: what comes on them, and why nothing does."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible, qos_policy_name_from_kind
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.ros import topics
from gray_box_observer.ros.message_types import message_class, missing_field
from gray_box_observer.ros.observer.receive_memory import ReceiveMemory
from gray_box_observer.ros.observer.receive_queue import ReceiveQueue
from gray_box_observer.ros.qos import PREFIX, subscribe
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.signal_sources import Feed

Take = Callable[[str, Any, int, str], None]
"""Takes the signal's name, the message, the stamp in ns of one without header, and the topic."""

Refuse = Callable[[str, Rejection], None]
"""Takes the signal's name of a message that is not read, and why."""

Decode = Callable[[bytes], Any]
"""Makes a message of its bytes."""

VIEWED = frozenset(('position', 'velocity', 'effort'))
"""Fields of a JointState that are read from its bytes: that takes a third of the time of building
the message."""

ANSWER_AGE_S = 0.5
"""How long the graph's answer serves: it is asked anew for each round of diagnostics, not for each
motor, for of a node with thousands of topics an answer takes tens of milliseconds."""

WATCH_PERIOD_S = 0.2
"""Between two looks at what the middleware holds."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why nothing can come on a topic.

    Attributes:
        message: what is wrong and what to do about it.
        is_broken: whether somebody publishes there and will never be heard; else nobody publishes
            at all.
    """

    message: str
    is_broken: bool


class Inputs:
    """Subscriptions of the topics that the configured signals come from.

    Args:
        node: the node that listens.
        configuration: names topics and types.
        take: gets every message.
        refuse: told of every message whose bytes make no sense, or are too many.
        writers: returns the numbers of the node's own threads, whose memory is not the
            middleware's.

    Raises:
        ConfigurationError: a message type that this environment does not have, or a field that the
            type has not.
    """

    def __init__(
        self,
        node: Node,
        configuration: Configuration,
        take: Take,
        refuse: Refuse,
        writers: Callable[[], Iterable[int]] = tuple,
    ) -> None:
        self._node = node
        self._ingest = take
        self._refuse = refuse
        self._feeds = {feed.group: feed for feed in configuration.feeds}
        self._types = {
            name: _message_type(name, feed.type_name) for name, feed in self._feeds.items()
        }
        for name, feed in self._feeds.items():
            for parameter, path in feed.fields.items():
                complaint = missing_field(self._types[name], FieldPath(path).steps)
                if complaint:  # said now, and not when the first message comes
                    raise ConfigurationError(f'{parameter} {path!r} on {feed.topic}: {complaint}')
        self._max_message_bytes = round(configuration['max_message_mb'] * 1e6)
        self._queues: dict[str, ReceiveQueue] = {}
        self._memory = ReceiveMemory(writers)
        self._watch: Timer | None = None
        self._refusals: dict[str, str] = {}
        self._graph_answers: dict[str, tuple[float, Trouble | None]] = {}

    def open(self) -> None:
        """Begin to listen.

        Raises:
            ConfigurationError: a quality of service that cannot be had.
        """
        for name, feed in self._feeds.items():
            if not self._has_header(name):
                self._node.get_logger().info(
                    f'{self._type_name(name)} has no header: {name} is stamped by '
                    f'{self._clock_in_words}'
                )
            subscribe = partial(self._subscribe, feed)
            self._queues[name] = ReceiveQueue(
                self._node, subscribe, self._max_message_bytes, self._watch_queues
            )
        self._memory.mark()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._watch = self._node.create_timer(WATCH_PERIOD_S, self._watch_queues, clock=steady)

    def close(self) -> None:
        """Stop listening."""
        if self._watch is not None:
            self._node.destroy_timer(self._watch)
            self._watch = None
        for queue in self._queues.values():
            queue.close()
        self._queues.clear()

    def _watch_queues(self) -> None:
        """Have the queues emptied where the middleware has grown by more than they may hold."""
        budget_bytes = max((queue.budget_bytes for queue in self._queues.values()), default=0)
        if self._memory.grown_bytes() > budget_bytes:
            self._memory.mark()
            for queue in self._queues.values():
                queue.empty()

    @property
    def _subscriptions(self) -> dict[str, Subscription]:
        """The present subscription of every topic, by the group of its parameters."""
        return {name: queue.subscription for name, queue in self._queues.items()}

    @property
    def needs_source_time(self) -> bool:
        """Whether a signal's messages lack a header, so that middleware time stamps them."""
        return not all(self._has_header(name) for name in self._feeds)

    @property
    def in_words(self) -> str:
        """Every topic by its full name."""
        return ', '.join(self._node.resolve_topic_name(feed.topic) for feed in self._feeds.values())

    def trouble(self, names: Iterable[str]) -> Trouble | None:
        """Say why nothing comes for these signals, as the ROS graph shows; None: unknown."""
        signals = set(names)
        troubles = [
            trouble
            for feed in self._feeds.values()
            if signals.intersection(feed.signals) and (trouble := self._trouble(feed)) is not None
        ]
        troubles.sort(key=lambda trouble: not trouble.is_broken)
        same = [
            trouble.message
            for trouble in troubles
            if troubles and trouble.is_broken == troubles[0].is_broken
        ]
        return Trouble('; '.join(same), troubles[0].is_broken) if troubles else None

    def _subscribe(self, feed: Feed, qos: QoSProfile | None) -> Subscription:
        """Subscribe with a quality of service; None: the configured one."""
        name = feed.group
        receive = self._receive if self._has_header(name) else self._receive_bare
        callback = partial(receive, feed, self._decoder(feed))
        profile = qos or topics.SIGNAL_QOS
        listen = partial(
            subscribe,
            self._node,
            self._types[name],
            feed.topic,
            callback,
            profile,
            raw=True,
            overridden=qos is None,
        )
        # Not message_lost: with Fast DDS 2.14, taking that event while the next one arrives locks
        # up for good.
        try:
            return listen(
                SubscriptionEventCallbacks(incompatible_qos=partial(self._incompatible, name))
            )
        except UnsupportedEventTypeError:  # not every middleware tells
            return listen()

    def _decoder(self, feed: Feed) -> Decode:
        kind = self._types[feed.group]
        first_fields = {re.split(r'\W', path)[0] for path in feed.fields.values()}
        if kind is JointState and first_fields <= VIEWED:
            return JointStateDecoder()
        return partial(_deserialized, kind)

    def _receive(self, feed: Feed, decode: Decode, data: bytes) -> None:
        message = self._decode(feed, decode, data)
        if message is None:
            return
        for name in feed.signals:
            self._ingest(name, message, 0, feed.topic)

    def _receive_bare(self, feed: Feed, decode: Decode, data: bytes, info: dict[str, Any]) -> None:
        message = self._decode(feed, decode, data)
        if message is None:
            return
        clock = self._node.get_clock()
        # the middleware stamps by the wall clock, which tells nothing of simulated time
        arrival_ns = (
            clock.now().nanoseconds
            if clock.ros_time_is_active  # type: ignore[attr-defined]
            else info['source_timestamp']
        )
        for name in feed.signals:
            self._ingest(name, message, arrival_ns, feed.topic)

    def _decode(self, feed: Feed, decode: Decode, data: bytes) -> Any:
        """Return the message of some bytes; None, reported, if too many or malformed."""
        queue = self._queues.get(feed.group)
        if queue is None:  # it waited while listening ended
            return None
        if len(data) > queue.unchecked_bytes and not queue.admit(len(data)):
            self._refuse_all(feed, Rejection.OVERSIZED)
            return None
        try:
            return decode(data)
        except SampleError:
            self._refuse_all(feed, Rejection.MALFORMED)
            return None

    def _refuse_all(self, feed: Feed, reason: Rejection) -> None:
        for name in feed.signals:
            self._refuse(name, reason)

    @property
    def _clock_in_words(self) -> str:
        return (
            '/clock, when it arrives'
            if self._node.get_clock().ros_time_is_active  # type: ignore[attr-defined]
            else 'the middleware'
        )

    def _has_header(self, name: str) -> bool:
        return 'header' in self._types[name].get_fields_and_field_types()

    def _type_name(self, name: str) -> str:
        kind = self._types[name]
        return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'

    def _incompatible(self, name: str, event: Any) -> None:
        """Hear a publisher by best effort where that is all it offers; else say what keeps it."""
        policy = qos_policy_name_from_kind(event.last_policy_kind).lower()
        if policy == 'reliability' and self._adapts(name):
            return
        self._refusals[name] = policy
        self._node.get_logger().warning(self._refusal(name, self._refusals[name]))

    def _adapts(self, name: str) -> bool:
        """Tell whether a topic is heard by best effort from now on, or is already about to be.

        Who asks for reliability by an override gets nothing less.
        """
        queue = self._queues.get(name)
        topic = self._node.resolve_topic_name(self._feeds[name].topic)
        override = f'{PREFIX}{topic}.subscription.reliability'
        if queue is None or override in getattr(self._node, '_parameter_overrides', {}):
            return False
        if queue.relax():
            self._node.get_logger().info(
                f'a publisher of {topic} offers best effort: heard by best effort from now on'
            )
        return True

    def _refusal(self, name: str, policy: str) -> str:
        topic = self._node.resolve_topic_name(self._feeds[name].topic)
        return (
            f'a publisher of {topic} offers less {policy} than is asked for, so nothing comes '
            'from it: '
            f'change it, or start with qos_overrides.{topic}.subscription.{policy}'
        )

    def _trouble(self, feed: Feed) -> Trouble | None:
        """Say what the graph shows of a topic; every motor of a round gets the same answer."""
        now_s = time.monotonic()
        asked_s, trouble = self._graph_answers.get(feed.group, (-math.inf, None))
        if now_s - asked_s > ANSWER_AGE_S:
            trouble = self._trouble_now(feed)
            self._graph_answers[feed.group] = now_s, trouble
        return trouble

    def _trouble_now(self, feed: Feed) -> Trouble | None:
        name = feed.group
        topic = self._node.resolve_topic_name(feed.topic)
        publishers = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return Trouble(
                f'nobody publishes {topic}: start its driver, or set {name}.topic', is_broken=False
            )
        right = [
            publisher for publisher in publishers if publisher.topic_type == self._type_name(name)
        ]
        if not right:
            return Trouble(
                f'{topic} is published as {publishers[0].topic_type}, but {name}.type is '
                f'{self._type_name(name)}',
                is_broken=True,
            )
        reasons = [self._mismatch(name, publisher) for publisher in right]
        if all(reasons):
            return Trouble(self._refusal(name, str(reasons[0])), is_broken=True)
        return None

    def _mismatch(self, name: str, publisher: TopicEndpointInfo) -> str:
        """Name the policy that keeps a publisher from being heard; empty where it is heard."""
        profile, publisher_profile = self._subscriptions[name].qos_profile, publisher.qos_profile
        if qos_check_compatible(publisher_profile, profile)[0] != QoSCompatibility.ERROR:
            return ''
        policies = [
            p
            for p in ('reliability', 'durability')
            if getattr(profile, p) != getattr(publisher_profile, p)
        ]
        return self._refusals.get(name) or (policies[0] if policies else 'quality of service')


def _deserialized(kind: Any, data: bytes) -> Any:
    """Return the message that some bytes are.

    Raises:
        SampleError: they are no such message.
    """
    try:
        return deserialize_message(data, kind)
    except rclpy_implementation.RMWError as error:
        raise SampleError(f'not a message of this type: {error}') from error


def _message_type(name: str, type_name: str) -> Any:
    kind = message_class(type_name)
    if kind is None:
        raise ConfigurationError(
            f'{name}.type {type_name!r} is not a message this environment knows: source the '
            'workspace that has it'
        )
    return kind
