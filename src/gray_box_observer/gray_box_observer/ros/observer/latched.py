"""Topics that tell a late subscriber the latest value: what is latched has to be true of now.

A publisher that is deactivated still serves late subscribers. So a number that holds no more is not
left standing: its publisher goes, and comes back with the next number.
"""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNode

from gray_box_observer.ros import topics
from gray_box_observer.ros.observer.serialized_publisher import SerializedPublisher


class LatchedTopic:
    """One latched topic of a managed node.

    Args:
        node: who publishes.
        topic: name, type and quality of service.
        names: what stands for the placeholders in the name.
    """

    def __init__(self, node: LifecycleNode, topic: topics.Topic, **names: str) -> None:
        self._node = node
        self._topic = topic
        self._name = topic.name.format(**names)
        self._holds_value = False
        self._publisher: SerializedPublisher | None = self._create()

    @property
    def holds_value(self) -> bool:
        """Whether a late subscriber hears something."""
        return self._holds_value

    def __call__(self, message: bytes) -> None:
        """Publish a serialised message; only while the node is active."""
        publisher = self._publisher
        if publisher is None:
            publisher = self._publisher = self._create()
            publisher.activate()
        self._holds_value = True
        publisher(message)

    def correct(self, message: bytes) -> None:
        """Publish what holds now instead of what is latched, in whatever state the node is."""
        publisher = self._publisher = self._publisher or self._create()
        if publisher.is_active:
            self(message)
            return
        publisher.activate()
        try:
            self(message)
        finally:
            publisher.deactivate()

    def retract(self) -> None:
        """Leave nothing for late subscribers."""
        if self._holds_value:
            self.close()

    def close(self) -> None:
        """Take the topic away for good."""
        if self._publisher is not None:
            self._publisher.destroy()
            self._publisher = None
            self._holds_value = False

    @property
    def is_active(self) -> bool:
        """Whether what is published goes out."""
        return self._publisher is not None and self._publisher.is_active

    def activate(self) -> None:
        """Publish from now on: of a topic that came while the node was active."""
        if self._publisher is not None:
            self._publisher.activate()

    def _create(self) -> SerializedPublisher:
        return SerializedPublisher(self._node, self._topic, self._name)
