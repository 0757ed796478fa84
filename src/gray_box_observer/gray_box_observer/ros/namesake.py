"""Tells whether another node has the name of ours."""

from __future__ import annotations

from rclpy.node import Node

EVERY_NODE_PUBLISHES = '/parameter_events'


def has_namesake(node: Node) -> bool:
    """Whether another node that lives has our name.

    The list of nodes may keep one that has ended (ros2 issue 514): its last message may be read
    after its participant is gone. Its publishers go with the participant, so they decide.
    """
    own_name = (node.get_name(), node.get_namespace())
    if node.get_node_names_and_namespaces().count(own_name) < 2:
        return False  # by far the most, and cheap to ask
    publishers = node.get_publishers_info_by_topic(EVERY_NODE_PUBLISHES)
    return [(p.node_name, p.node_namespace) for p in publishers].count(own_name) > 1
