"""Every topic of the package: name, type and quality of service, said once.

Nodes create their endpoints from this list, the recorder records by it and the documentation is tested against it.
"""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray

SIGNAL_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Stamped signals: nothing may be lost on the way to a slower reader."""

LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The latest value, also for whoever subscribes late."""

DIAGNOSTICS_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: relative name (``{motor}`` and ``{parameter}`` stand for their names), type and QoS."""

    name: str
    type: type
    qos: QoSProfile


VOLTAGE = Topic('motor/voltage', JointState, SIGNAL_QOS)
TORQUE = Topic('motor/torque', JointState, SIGNAL_QOS)
PARAMETER = Topic('~/{motor}/{parameter}', Float64, LATCHED_QOS)
IDENTIFIED = Topic('~/{motor}/identified', Bool, LATCHED_QOS)
ALARM = Topic('~/{motor}/alarm', Bool, LATCHED_QOS)
COVARIANCE = Topic('~/{motor}/covariance', Float64MultiArray, LATCHED_QOS)
ESTIMATES = Topic('~/estimates', Float64MultiArray, LATCHED_QOS)
PREDICTED_TORQUE = Topic('~/predicted_torque', JointState, SIGNAL_QOS)
FORECAST_TORQUE = Topic('~/forecast_torque', JointState, SIGNAL_QOS)
DIAGNOSTICS = Topic('/diagnostics', DiagnosticArray, DIAGNOSTICS_QOS)
