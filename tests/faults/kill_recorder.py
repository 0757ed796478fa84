"""Kills the recorder at seeded moments while messages flow, and reads what it leaves.

    python tests/faults/kill_recorder.py [--times 50] [--seed 1] [--rate 1000]

Needs a sourced workspace. Every round records two topics in another way (compression, splitting)
and ends with SIGKILL. The bag then has to be read by this package, by mcap's readers and by rosbags
as it lies there, without a gap, and up to the last second. Prints a line a round and one line of
JSON; ends with 1 if a figure is not reached.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rclpy
from mcap.reader import NonSeekingReader, make_reader
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from tqdm import tqdm

from gray_box_observer.bag.joint_state import decode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError

RECORDER = 'gray_box_observer.ros.bags.recorder_node'
FAST = 'motor/torque'
SLOW = 'motor/voltage'
SLOW_EVERY = 10
PATIENCE_S = 60.0
SHORTEST_S = 0.2
LONGEST_S = 5.0
"""How long a recorder lives after the first message."""
WAYS = (
    (),
    ('--compression-format', 'zstd'),
    ('--compression-format', 'lz4', '--max-bag-duration', '0.5'),
    ('--max-bag-size', '60000'),
    ('--storage-preset-profile', 'zstd_fast', '--max-bag-size', '20000'),
)


@dataclass(frozen=True, slots=True)
class Round:
    """What one kill left.

    Attributes:
        lived_s: from the first message to the kill.
        lost_s: from the last message that can be read, or else from the first, to the kill.
        found: messages of the fast topic that can be read.
        is_whole: whether these are the first ones that were sent, each once and in order.
        readers: who else reads as many messages, by name.
    """

    lived_s: float
    lost_s: float
    found: int
    is_whole: bool
    readers: dict[str, bool]


def main() -> int:
    """Run the rounds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--times', type=int, default=50, help='how often the recorder is killed')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--rate', type=float, default=1000.0, help='messages a second')
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rounds = []
    rclpy.init()
    node = rclpy.create_node('fault_publisher')
    try:
        with tempfile.TemporaryDirectory() as folder:
            for number in tqdm(range(options.times), 'kills', unit='kill', mininterval=1.0):
                draw = random.Random(f'{options.seed}:{number}')
                way = WAYS[number % len(WAYS)]
                rounds.append(_round(node, Path(folder) / str(number), way, draw, options.rate))
                tqdm.write(f'{number:3d} {_line(rounds[-1])}  {" ".join(way)}')
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return _tell(rounds, options)


def _round(
    node: Node, folder: Path, way: tuple[str, ...], draw: random.Random, rate_hz: float
) -> Round:
    life_s = draw.uniform(SHORTEST_S, LONGEST_S)
    qos = QoSProfile(depth=1000)
    # Topics of its own: the dead recorder of the round before seems to listen for seconds yet.
    topics = [f'/round_{folder.name}/{name}' for name in (FAST, SLOW)]
    fast, slow = (node.create_publisher(JointState, topic, qos) for topic in topics)
    command = [sys.executable, '-m', RECORDER, *topics, '-o', str(folder), *way]
    recorder = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        until_s = time.monotonic() + PATIENCE_S
        while not (fast.get_subscription_count() and slow.get_subscription_count()):
            if recorder.poll() is not None or time.monotonic() > until_s:
                raise SystemExit(f'the recorder did not start: {recorder.communicate()[1]}')
            time.sleep(0.02)
        message = JointState(name=['motor'], effort=[0.0])
        for publisher in (fast, slow):  # the other side may be matched later than this one
            publisher.publish(message)
            if not publisher.wait_for_all_acked(Duration(seconds=PATIENCE_S)):
                raise SystemExit('the recorder does not listen')
        begun_s = time.monotonic()
        sent_s = [begun_s]
        while (now_s := time.monotonic()) - begun_s < life_s:
            if now_s - begun_s < len(sent_s) / rate_hz:
                time.sleep(0.0002)
                continue
            message.header.stamp = node.get_clock().now().to_msg()
            message.effort = [float(len(sent_s))]
            if len(sent_s) % SLOW_EVERY == 0:
                slow.publish(message)
            sent_s.append(time.monotonic())
            fast.publish(message)
        killed_s = time.monotonic()
    finally:
        recorder.kill()
        recorder.communicate()
        node.destroy_publisher(fast)
        node.destroy_publisher(slow)
    return _judge(folder, sent_s, killed_s)


def _judge(folder: Path, sent_s: list[float], killed_s: float) -> Round:
    numbers, count = _ours(folder)
    reached_s = sent_s[len(numbers) - 1] if numbers else sent_s[0]
    readers = {
        'mcap, seeking': _by_mcap(make_reader),
        'mcap, streaming': _by_mcap(NonSeekingReader),
        'rosbags': _rosbags,
    }
    return Round(
        lived_s=killed_s - sent_s[0],
        lost_s=killed_s - reached_s,
        found=len(numbers),
        is_whole=numbers == list(range(len(numbers))),
        readers={name: _reads(read, folder, count) for name, read in readers.items()},
    )


def _ours(folder: Path) -> tuple[list[int], int]:
    """Message numbers of the fast topic in the bag, and message counts of both topics."""
    try:
        with BagReader(folder) as bag:
            messages = list(bag.messages())
    except BagError as error:
        if 'no message in this bag' not in str(error):
            raise
        return [], 0
    return [
        int(decode_joint_state(m.data).effort[0]) for m in messages if m.topic.endswith(FAST)
    ], len(messages)


def _reads(read: Callable[[Path], int], folder: Path, count: int) -> bool:
    try:
        return read(folder) == count
    except Exception as error:  # whatever a foreign reader makes of it
        tqdm.write(f'    {type(error).__name__}: {error}')
        return False


def _by_mcap(make: Callable[..., object]) -> Callable[[Path], int]:
    def read(folder: Path) -> int:
        count = 0
        for path in sorted(folder.glob('*.mcap')):
            with path.open('rb') as stream:
                count += sum(1 for _ in make(stream).iter_messages())
        return count

    return read


def _rosbags(folder: Path) -> int:
    with AnyReader([folder]) as reader:
        return sum(1 for _ in reader.messages())


def _line(r: Round) -> str:
    others = ', '.join(name for name, reads in r.readers.items() if reads) or 'nobody else'
    gaps = '' if r.is_whole else ' WITH GAPS'
    return (
        f'lived {r.lived_s:.2f} s, lost {r.lost_s:.3f} s, {r.found} messages{gaps}; read by us, '
        f'{others}'
    )


def _tell(rounds: list[Round], options: argparse.Namespace) -> int:
    losses_s = [r.lost_s for r in rounds]
    count = len(rounds)
    figures: list[tuple[str, float, float | None]] = [
        ('bags with a gap', sum(not r.is_whole for r in rounds), 0.0),
        *(
            (
                f'bags that {name} does not read as they lie there',
                count - sum(r.readers[name] for r in rounds),
                0.0,
            )
            for name in rounds[0].readers
        ),
        ('lost in s, worst', max(losses_s), 1.0),
        ('lost in s, median', statistics.median(losses_s), None),
    ]
    told = [
        {
            'name': name,
            'value': round(value, 4),
            'goal': goal,
            'met': None if goal is None else value <= goal,
        }
        for name, value, goal in figures
    ]
    for figure in told:
        print(f'{figure["value"]:10g}  {figure["name"]}')
    print(
        json.dumps(
            {'benchmark': 'kill_recorder', 'seed': options.seed, 'times': count, 'figures': told}
        )
    )
    return 1 if any(figure['met'] is False for figure in told) else 0


if __name__ == '__main__':
    raise SystemExit(main())
