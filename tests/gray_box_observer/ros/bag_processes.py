"""Known series of messages, bags of them, and processes that are interrupted as by a terminal."""

from __future__ import annotations

import signal
from pathlib import Path

import rclpy
from sensor_msgs.msg import JointState

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter

TIMEOUT_S = 120.0
RECORDER = 'gray_box_observer.ros.bags.recorder_node'
PLAYER = 'gray_box_observer.ros.bags.player_node'


def series(count: int, step_s: float = 0.01) -> list[JointState]:
    """A known series of messages."""
    messages = []
    for index in range(count):
        message = JointState(
            name=['motor', 'zweiter'], effort=[0.1 * index, -index], velocity=[1.0, 2.0]
        )
        message.header.stamp = rclpy.time.Time(
            nanoseconds=10**9 + round(index * step_s * 1e9)
        ).to_msg()
        message.header.frame_id = 'x' * (index % 5)
        messages.append(message)
    return messages


def make_bag(
    folder: Path, times_s: list[float], topic: str = '/motor/torque', log_s: int = 0
) -> Path:
    """A bag whose message k has effort k, logged at the k-th time, `log_s` after its stamp."""
    with BagWriter(folder) as writer:
        writer.add_topic(topic, TYPE_NAME, schema_text(TYPE_NAME, built_in_lookup))
        for index, time_s in enumerate(times_s):
            stamp_ns = 10**9 + round(time_s * 1e9)
            data = encode_joint_state(stamp_ns, ['motor'], effort=[index])
            writer.write(topic, data, stamp_ns + log_s * 10**9, stamp_ns)
    return folder


def interrupted_twice(peer, process) -> tuple[int, str]:
    """Interrupt a process twice at once, as terminal and launch do; return its end."""
    process.send_signal(signal.SIGINT)
    code, _, said = peer.end(process, signal.SIGINT)
    return code, said
