"""Known series of messages, bags of them, and processes that are interrupted as by a terminal."""

from __future__ import annotations

import signal
from collections.abc import Iterable, Sequence
from pathlib import Path

import rclpy
from sensor_msgs.msg import JointState
from tests.ended_starts import EndHere

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.settings.parameter_spec import ParameterSpec

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


def check_refusal(peer, folder: Path, module: str, arguments: Sequence[str], message: str) -> None:
    """Check that a process beside bags of all kinds ends with code 2 and one line that says why."""
    process = peer.start(module, *_beside_bags(folder, arguments))
    code, _, said = peer.end(process, None)
    _check_refused(code, said, message)


def check_refusal_here(
    start: EndHere, folder: Path, module: str, arguments: Sequence[str], message: str
) -> None:
    """Check the same of the command of a module, called in the process of the test."""
    code, _, said = start(module, *_beside_bags(folder, arguments))
    _check_refused(code, said, message)


def _check_refused(code: int, said: str, message: str) -> None:
    assert code == 2
    lines = [line for line in said.splitlines() if 'error:' in line]
    assert len(lines) == 1 and message in lines[0]


def _beside_bags(folder: Path, arguments: Sequence[str]) -> list[str]:
    """Make bags of all kinds and return the arguments with the name of their folder."""
    make_bag(folder / 'bag', [0.0, 1.0])
    make_bag(folder / 'late', [0.0], log_s=2**32)
    make_bag(folder / 'own', [0.0], topic='/gray_box_observer/predicted_torque')
    (folder / 'text.mcap').write_text('no bag')
    spoilt = make_bag(folder / 'damaged', [0.0, 1.0]) / 'damaged_0.mcap'
    spoilt.write_bytes(spoilt.read_bytes()[:400] + bytes(2000))
    return [argument.format(tmp=folder) for argument in arguments]


def check_help(start: EndHere, module: str, specs: Iterable[ParameterSpec]) -> None:
    """Check that the help of a command names every parameter."""
    code, out, _ = start(module, '--help')
    assert code == 0
    assert all(f'\n  {spec.name} ' in out for spec in specs)


def check_defaults(specs: Iterable[ParameterSpec]) -> None:
    """Check that defaults are accepted, and that descriptions are sentences."""
    for spec in specs:
        assert spec.check(spec.default) == spec.default
        assert spec.description.endswith('.')
