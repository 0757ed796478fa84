"""Every topic of the package: name, type and quality of service, said once.

Nodes create their endpoints from this list, the recorder records by it and the documentation is
tested against it.
"""

from __future__ import annotations

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray

SIGNAL_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Stamped signals: nothing may be lost on the way to a slower reader."""

LATCHED_QOS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""The latest value, also for whoever subscribes late."""

DIAGNOSTICS_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: relative name with ``{motor}`` and ``{parameter}``, type, QoS and content."""

    name: str
    type: type
    qos: QoSProfile
    description: str = ''


VOLTAGE = Topic(
    'motor/voltage',
    JointState,
    SIGNAL_QOS,
    'Armature voltage in V as `effort`, of the motors in `name`; stamped.',
)
TORQUE = Topic(
    'motor/torque',
    JointState,
    SIGNAL_QOS,
    'Torque in N m as `effort`, measured speed in rad/s as `velocity`; stamped.',
)
PARAMETER = Topic(
    '~/{motor}/{parameter}',
    Float64,
    LATCHED_QOS,
    'Estimate in SI units; one topic for each of the context nodes.',
)
IDENTIFIED = Topic(
    '~/{motor}/identified',
    Bool,
    LATCHED_QOS,
    'True while every verdict is `identified` or `negligible`.',
)
PARAMETER_IDENTIFIED = Topic(
    '~/{motor}/{parameter}/identified',
    Bool,
    LATCHED_QOS,
    'The same of one parameter; published when it changes.',
)
FIT = Topic(
    '~/{motor}/fit',
    Float64,
    LATCHED_QOS,
    'Residual of the free run over the noise floor, once tested and when it changes: about 1 '
    'where the white box '
    'holds; 0 where what was tested is forgotten.',
)
ALARM = Topic(
    '~/{motor}/alarm',
    Bool,
    LATCHED_QOS,
    'True while torque is not what voltage and the identified parameters explain.',
)
COVARIANCE = Topic(
    '~/{motor}/covariance',
    Float64MultiArray,
    LATCHED_QOS,
    'Covariance of the estimates, row by row; both dimensions are labelled with the parameter '
    'names.',
)
ESTIMATES = Topic(
    '~/estimates',
    Float64MultiArray,
    LATCHED_QOS,
    'Value and standard deviation of every parameter of every motor, labelled; every '
    '`estimates_period_s`. A standard '
    'deviation of -1 stands where nothing is known.',
)
PREDICTED_TORQUE = Topic(
    '~/predicted_torque',
    JointState,
    SIGNAL_QOS,
    'Torque in N m as `effort`, predicted before the torque of the same stamp came.',
)
FORECAST_TORQUE = Topic(
    '~/forecast_torque',
    JointState,
    SIGNAL_QOS,
    'With `horizon_s` above 0: torque in N m that long after the newest voltage, if it is held.',
)
SPEED = Topic(
    '~/speed',
    JointState,
    SIGNAL_QOS,
    'Speed in rad/s as `velocity` of a motor with a rotor, which nobody has to measure; with the '
    'stamp of the torque.',
)
SPEED_STD = Topic(
    '~/{motor}/speed_std',
    Float64,
    LATCHED_QOS,
    'Standard deviation of that speed in rad/s; nothing where no speed may be believed.',
)
DIAGNOSTICS = Topic(
    '/diagnostics',
    DiagnosticArray,
    DIAGNOSTICS_QOS,
    'One status for each motor: level, advice, and verdicts, rates, rejects and skill as '
    'key-value pairs; 1 Hz.',
)
