"""Publishing of messages that are serialised already, while their node is active.

For every message ``Publisher.publish`` asks what it was given, and holds on to its handle so that
no other thread destroys it. What is serialised needs no question, and the observer publishes and
destroys in one thread. So bytes go to the handle at once, in half the time.
"""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode

from gray_box_observer.ros import topics
from gray_box_observer.ros.qos import advertise


class SerializedPublisher:
    """Publishes serialised messages on one topic of a managed node.

    Args:
        node: who publishes.
        topic: name, type and quality of service.
        name: of the topic, where its own holds a placeholder.

    Raises:
        ConfigurationError: an override of the quality of service that cannot be used.
    """

    def __init__(self, node: LifecycleNode, topic: topics.Topic, name: str = '') -> None:
        self._node = node
        self._publisher: Any = advertise(
            node.create_lifecycle_publisher, topic.type, name or topic.name, topic.qos
        )
        self._publish = self._publisher.handle.publish_raw

    def __call__(self, message: bytes) -> None:
        """Publish a message; only while the node is active."""
        if self._publisher.is_activated:
            self._publish(message)

    @property
    def is_active(self) -> bool:
        """Whether what is published goes out."""
        return bool(self._publisher.is_activated)

    def activate(self) -> None:
        """Publish from now on, whatever state the node is in."""
        self._publisher.on_activate(None)

    def deactivate(self) -> None:
        """Publish nothing until the node is activated again."""
        self._publisher.on_deactivate(None)

    def destroy(self) -> None:
        """Take the topic away, and what it has latched; this publishes no more."""
        self.deactivate()
        self._node.destroy_lifecycle_publisher(self._publisher)
