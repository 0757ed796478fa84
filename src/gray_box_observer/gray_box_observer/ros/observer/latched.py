"""Topics that tell a late subscriber the latest value: what is latched has to be true of now.

A publisher that is deactivated still serves late subscribers. So a number that holds no more is not
left standing: its publisher goes, and comes back with the next number.
"""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode

from gray_box_observer.ros import topics
from gray_box_observer.ros.qos import advertise


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
        self._publisher: Any = self._create()

    @property
    def holds_value(self) -> bool:
        """Whether a late subscriber hears something."""
        return self._holds_value

    def __call__(self, message: Any) -> None:
        """Publish a message, or its bytes; only while the node is active."""
        if self._publisher is None:
            self._publisher = self._create()
            self._publisher.on_activate(None)
        self._holds_value = True
        self._publisher.publish(message)

    def correct(self, message: Any) -> None:
        """Publish what holds now instead of what is latched, in whatever state the node is."""
        if self._publisher.is_activated:
            self(message)
            return
        self._publisher.on_activate(None)
        try:
            self(message)
        finally:
            self._publisher.on_deactivate(None)

    def retract(self) -> None:
        """Leave nothing for late subscribers."""
        if self._holds_value:
            self._node.destroy_lifecycle_publisher(self._publisher)
            self._publisher = None
            self._holds_value = False

    def close(self) -> None:
        """Take the topic away for good."""
        if self._publisher is not None:
            self._node.destroy_lifecycle_publisher(self._publisher)
            self._publisher = None
            self._holds_value = False

    @property
    def is_active(self) -> bool:
        """Whether what is published goes out."""
        return self._publisher is not None and bool(self._publisher.is_activated)

    def activate(self) -> None:
        """Publish from now on: of a topic that came while the node was active."""
        self._publisher.on_activate(None)

    def _create(self) -> Any:
        topic = self._topic
        return advertise(self._node.create_lifecycle_publisher, topic.type, self._name, topic.qos)
