"""Every topic of the package: name, type and quality of service, said once."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

SIGNAL_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Stamped signals: nothing may be lost on the way to a slower reader."""

CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Only the latest time counts; reliable, so that readers of either kind match."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: relative name, type and QoS."""

    name: str
    type: type
    qos: QoSProfile


VOLTAGE = Topic('motor/voltage', JointState, SIGNAL_QOS)
TORQUE = Topic('motor/torque', JointState, SIGNAL_QOS)
VOLTAGE_COMMAND = Topic('motor/voltage_command', JointState, SIGNAL_QOS)
CLOCK = Topic('/clock', Clock, CLOCK_QOS)
