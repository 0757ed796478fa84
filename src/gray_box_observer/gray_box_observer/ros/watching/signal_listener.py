"""Reads measured and predicted signals for a page that draws them, and as few as it can draw.

Readers are of best effort: nobody waits for a page. Messages are read as an observer of the same
parameters reads them; of many a second those are left out that a page could not tell apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from gray_box_observer.bag.joint_state import JointStateDecoder
from gray_box_observer.errors import GrayBoxError, SampleError
from gray_box_observer.observer.combined_signal import CombinedSignal
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.signal_reading import Signal, names_of, stamp_of
from gray_box_observer.ros.message_types import message_class
from gray_box_observer.ros.topics import PREDICTED_TORQUE, SPEED
from gray_box_observer.ros.watching.observer_listener import taken
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses, Thinning

PAGE_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
MOST_OBSERVERS = 20
"""Observers of which the predictions are read."""

_UNREADABLE = (GrayBoxError, TypeError, ValueError, ArithmeticError, LookupError, AttributeError)
_JOINT_STATE = 'sensor_msgs/msg/JointState'
_DRAWN = ('voltage', 'torque')
_OF_OBSERVER = {'predicted': (PREDICTED_TORQUE, 'effort'), 'speed': (SPEED, 'velocity')}

Reader = Callable[[bytes], None]


class SignalListener:
    """Reads the signals of the configured motors, and what observers predict of them.

    Args:
        node: who listens.
        courses: where they go.
        configuration: of the observer: topics, fields, scales.
        topic_names: names of topics from the root on, by the configured ones, where they are others
            than the node's namespace makes of them.
    """

    def __init__(
        self,
        node: Node,
        courses: SignalCourses,
        configuration: Configuration,
        topic_names: Mapping[str, str],
    ) -> None:
        self._node = node
        self._courses = courses
        self._readers: list[tuple[Subscription, Reader]] = []
        self._observers: set[str] = set()
        self._most_bytes = round(configuration['max_message_mb'] * 1e6)
        signals = MessageInput(Observer(configuration, None), configuration).signals
        for feed in configuration.feeds:
            kind = message_class(feed.type_name)
            names = [name for name in feed.signals if name in _DRAWN]
            if kind is None or not names:
                continue
            decode = _decoder(kind, feed.type_name)
            topic = topic_names.get(feed.topic, feed.topic)
            for name in names:
                reader = self._reader(signals[name], feed.topic, decode, name)
                self._subscribe(kind, topic, reader)

    def listen_to(self, observer: str) -> None:
        """Read what an observer predicts, from now on."""
        if observer in self._observers or len(self._observers) >= MOST_OBSERVERS:
            return
        self._observers.add(observer)
        decode = JointStateDecoder()
        for kind, (topic, field) in _OF_OBSERVER.items():
            rate_limit = Thinning()

            def read(
                data: bytes, kind: str = kind, field: str = field, rate_limit: Thinning = rate_limit
            ) -> None:
                view = decode(data)
                if rate_limit.is_kept(view.stamp_ns):
                    names = names_of(view) or ()
                    values = getattr(view, field)
                    if len(names) == len(values):
                        self._courses.add(observer, kind, names, values, view.stamp_ns)

            self._subscribe(topic.type, observer + topic.name.removeprefix('~'), read)

    def poll(self) -> None:
        """Take what has come."""
        for subscription, reader in self._readers:
            for data in taken(subscription, raw=True):
                if len(data) > self._most_bytes:
                    continue
                try:
                    reader(data)
                except _UNREADABLE:  # the observer counts and tells it
                    continue

    def _subscribe(self, kind: Any, topic: str, reader: Reader) -> None:
        subscription = self._node.create_subscription(
            kind, topic, lambda _: None, PAGE_QOS, raw=True
        )
        self._readers.append((subscription, reader))

    def _reader(
        self,
        signal: Signal | CombinedSignal,
        topic: str,
        decode: Callable[[bytes], Any],
        kind: str,
    ) -> Reader:
        """Return what reads the messages of one topic into the courses of one signal."""
        rate_limit = Thinning()

        def read(data: bytes) -> None:
            message = decode(data)
            stamp_ns = stamp_of(message, self._node.get_clock().now().nanoseconds)
            if isinstance(signal, CombinedSignal):  # it needs every message
                for value_ns, reading, _, _ in signal.ingest(topic, message, stamp_ns):
                    if reading is not None and rate_limit.is_kept(value_ns):
                        self._courses.add('', kind, reading.names, reading.values, value_ns)
            elif rate_limit.is_kept(stamp_ns):
                names, values, _ = signal.read(message)
                self._courses.add('', kind, names, values, stamp_ns)

        return read


def _decoder(kind: Any, type_name: str) -> Callable[[bytes], Any]:
    """Return what reads bytes of a type: ours where it is quicker."""
    if type_name.replace('/msg/', '/') == _JOINT_STATE.replace('/msg/', '/'):
        return JointStateDecoder()

    def decode(data: bytes) -> Any:
        try:
            return deserialize_message(data, kind)
        except Exception as error:  # whatever the middleware makes of foreign bytes
            raise SampleError(str(error)) from error

    return decode
