"""The latched topics of one motor's parameters, which go and come with the form of its physics."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.lifecycle import LifecycleNode

from gray_box_observer.ros import topics
from gray_box_observer.ros.observer.latched import LatchedTopic


class ParameterTopics:
    """A number and a flag for every parameter of one motor.

    Args:
        node: who publishes.
        motor: its name.
        names: parameters of the form that it is configured with.

    Attributes:
        values: topics of the estimates, by the parameter's name.
        flags: topics that say whether each is identified.
    """

    def __init__(self, node: LifecycleNode, motor: str, names: Iterable[str]) -> None:
        self._node = node
        self._motor = motor
        self.values: dict[str, LatchedTopic] = {}
        self.flags: dict[str, LatchedTopic] = {}
        self._open(names)

    def follow(self, names: tuple[str, ...], *, is_active: bool) -> bool:
        """Have topics of just these parameters; tell whether that has changed anything.

        Args:
            names: parameters of the form in force.
            is_active: whether the node publishes now.
        """
        if tuple(self.values) == names:
            return False
        old_names = [name for name in self.values if name not in names]
        for kind in (self.values, self.flags):
            for name in old_names:
                kind.pop(name).close()
        new = self._open(names)
        if is_active:
            for topic in new:
                topic.activate()
        for kind in (self.values, self.flags):
            topics_in_order = {name: kind[name] for name in names}
            kind.clear()
            kind.update(topics_in_order)
        return True

    def _open(self, names: Iterable[str]) -> list[LatchedTopic]:
        """Make the topics that are not there yet; return them."""
        new = [name for name in names if name not in self.values]
        kinds = ((self.values, topics.PARAMETER), (self.flags, topics.PARAMETER_IDENTIFIED))
        for kind, topic in kinds:
            for name in new:
                kind[name] = LatchedTopic(self._node, topic, motor=self._motor, parameter=name)
        return [kind[name] for kind, _ in kinds for name in new]
