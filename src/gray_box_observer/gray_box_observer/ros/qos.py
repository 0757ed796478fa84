"""Endpoints whose quality of service users may override, named as rclcpp and rclpy do.

``qos_overrides./motor/voltage.subscription.reliability: best_effort`` and the like; see
:data:`POLICIES`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import InvalidQoSProfileException, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions
from rclpy.subscription import Subscription

from gray_box_observer.errors import ConfigurationError

POLICIES = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)
"""What may be overridden of every topic."""

PREFIX = 'qos_overrides.'
"""What the parameters begin with that override it."""

_REFUSALS = (
    InvalidQoSProfileException,
    InvalidQosOverridesError,
    ParameterException,
    rclpy_implementation.RCLError,
    RuntimeError,  # rclpy's word for a policy that does not exist
    ValueError,
)


def subscribe(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[..., None],
    qos: QoSProfile,
    events: SubscriptionEventCallbacks | None = None,
    *,
    raw: bool = False,
    overridden: bool = True,
) -> Subscription:
    """Create a subscription.

    Args:
        node: who listens.
        kind: message type.
        topic: its name.
        callback: gets every message.
        qos: unless overridden.
        events: what else is told of.
        raw: give the callback serialised messages.
        overridden: whether parameters may override the quality of service; False: it is had as it
            is.

    Raises:
        ConfigurationError: an override that cannot be used.
    """
    return _with_overrides(
        lambda own: node.create_subscription(
            kind,
            topic,
            callback,
            own,
            event_callbacks=events,
            qos_overriding_options=QoSOverridingOptions(POLICIES) if overridden else None,
            raw=raw,
        ),
        topic,
        qos,
    )


def advertise(
    create: Callable[..., Publisher], kind: Any, topic: str, qos: QoSProfile
) -> Publisher:
    """Create a publisher.

    Args:
        create: the node's method for it, of plain or of lifecycle publishers.
        kind: message type.
        topic: its name.
        qos: unless overridden.

    Raises:
        ConfigurationError: an override that cannot be used.
    """
    return _with_overrides(
        lambda own: create(kind, topic, own, qos_overriding_options=QoSOverridingOptions(POLICIES)),
        topic,
        qos,
    )


def _with_overrides(create: Callable[[QoSProfile], Any], topic: str, qos: QoSProfile) -> Any:
    try:
        return create(copy.copy(qos))  # rclpy writes the overrides into the profile
    except _REFUSALS as error:
        raise ConfigurationError(
            f'quality of service of {topic}: {error}; see the parameters {PREFIX}...'
        ) from error


def unused_overrides(node: Node) -> list[str]:
    """Name the overrides that were given for topics that the node does not have."""
    overrides = getattr(node, '_parameter_overrides', {})
    return sorted(
        name for name in overrides if name.startswith(PREFIX) and not node.has_parameter(name)
    )
