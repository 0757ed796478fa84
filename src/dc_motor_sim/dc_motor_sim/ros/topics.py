"""Every topic of the package: name, type and quality of service, said once."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

SIGNAL_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Stamped signals: nothing may be lost on the way to a slower reader."""

CLOCK_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
"""Reliable, so that readers of either kind match; of one message alone, none that the transport
drops is sent again."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: relative name, type, QoS, and what it tells."""

    name: str
    type: type
    qos: QoSProfile
    description: str = ''


VOLTAGE = Topic(
    'motor/voltage',
    JointState,
    SIGNAL_QOS,
    'Armature voltage in V as `effort`; it holds until the next.',
)
TORQUE = Topic(
    'motor/torque',
    JointState,
    SIGNAL_QOS,
    'Torque in N m as `effort`; speed in rad/s as `velocity` with `speed_measured` or in rotor '
    'mode.',
)
VOLTAGE_COMMAND = Topic(
    'motor/voltage_command',
    JointState,
    SIGNAL_QOS,
    'Voltage in V as `effort`, with `excitation` set to `external`.',
)
CLOCK = Topic('/clock', Clock, CLOCK_QOS, 'Simulated time, with `publish_clock`.')
