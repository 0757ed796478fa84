"""Topics are a contract: names, types and QoS of the design."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState

from dc_motor_sim.ros import topics


def test_the_signals_are_reliable_stamped_joint_states_that_keep_the_last_thousand():
    names = {t.name for t in (topics.VOLTAGE, topics.TORQUE, topics.VOLTAGE_COMMAND)}
    assert names == {'motor/voltage', 'motor/torque', 'motor/voltage_command'}
    for topic in (topics.VOLTAGE, topics.TORQUE, topics.VOLTAGE_COMMAND):
        assert topic.type is JointState
        assert topic.qos.reliability == ReliabilityPolicy.RELIABLE
        assert topic.qos.history == HistoryPolicy.KEEP_LAST
        assert topic.qos.durability == DurabilityPolicy.VOLATILE
        assert topic.qos.depth == 1000
