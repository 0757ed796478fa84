"""Floods the observer's topics: what it holds in memory, and how soon it ends on request.

    python tests/faults/flood.py [--seconds 60] [--megabytes 20] [--senders 2]
    [--kinds large nearly names layouts small speed inputs]

Needs a sourced workspace. Every kind of flood meets an observer of its own, sent as fast as the
senders can:

* few large messages;
* messages just below the size that is read, each by its frame, by its names or by its values;
* lists of names that never come twice;
* frames and array lengths that never come twice;
* small garbage;
* speeds on a topic of their own, and inputs of an expression: valid ones, ever later, among which
  every hundredth is just below the size that is read.

At the end of each the observer gets SIGTERM while the flood goes on. Prints a table and one line of
JSON; ends with 1 if a figure is not reached.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from typing import IO, Any

import psutil
import rclpy
from figures import Figure, tell
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from gray_box_observer.bag.joint_state import encode_joint_state

OBSERVER = 'gray_box_observer.ros.observer.observer_node'
TOPICS = ('/motor/voltage', '/motor/torque')
LARGEST_MB = 400.0
LONGEST_END_S = 1.0
PATIENCE_S = 60.0
LOOK_EVERY_S = 0.02
QUEUE = 10
"""Messages that a sender holds for a reader that is slower."""


LIMIT_BYTES = 4_000_000
"""Default of ``max_message_mb``."""

STAMP = struct.Struct('<iI')
"""Seconds and nanoseconds, as a serialised message has them behind its four bytes of encoding."""

STEP_NS = 1_000_000
LARGE_EVERY = 100


def large(size: int) -> Iterator[bytes]:
    """One message of so many bytes, again and again."""
    message = encode_joint_state(0, ['motor'], effort=[1.0] * (size // 8))
    while True:
        yield message


def names(size: int) -> Iterator[bytes]:
    """Messages of 1000 names that nobody has, never the same twice."""
    number = 0
    while True:
        number += 1
        yield encode_joint_state(
            0, [f'name {number} {k}' for k in range(1000)], effort=[1.0] * 1000
        )


def layouts(size: int) -> Iterator[bytes]:
    """Messages whose frame is long and whose arrays are of other lengths every time."""
    number = 0
    while True:
        number += 1
        values = [1.0] * (number % 997)
        yield encode_joint_state(
            number, ['motor'], position=values, effort=[1.0], frame_id=f'{number}' * 10_000
        )


def small(size: int) -> Iterator[bytes]:
    """Bytes that are no message."""
    while True:
        yield b'\x00\x01\x00\x00' + b'\xff' * 60


def nearly(size: int) -> Iterator[bytes]:
    """Valid messages just below the size that is read, each later than the last."""
    share = LIMIT_BYTES - 1000
    contents = [
        _valid(['motor'], frame_id='f' * share),
        _valid(['motor', *(f'{k:011}' for k in range(share // 40 - 1))]),
        encode_joint_state(0, ['motor'], velocity=[1.0], effort=[1.0] * (share // 8)),
    ]
    assert all(0.9 * LIMIT_BYTES < len(data) <= LIMIT_BYTES for data in contents)
    return _ever_later(itertools.cycle(contents))


def valid(size: int) -> Iterator[bytes]:
    """Messages of one motor, each later than the last; some just below the size that is read."""
    small_message = _valid(['motor'])
    large_messages = nearly(size)
    return _ever_later(
        next(large_messages) if number % LARGE_EVERY == 0 else small_message
        for number in itertools.count(1)
    )


def _valid(motors: list[str], **more: str) -> bytes:
    values = [1.0] * len(motors)
    return encode_joint_state(0, motors, position=values, velocity=values, effort=values, **more)


def _ever_later(messages: Iterator[bytes]) -> Iterator[bytes]:
    for number, data in enumerate(messages):
        sec, nanosec = divmod(number * STEP_NS, 10**9)
        yield data[:4] + STAMP.pack(sec, nanosec) + data[4 + STAMP.size :]


@dataclass(frozen=True)
class Flood:
    """What is sent, and where.

    Attributes:
        messages: makes the messages; gets the size of a large one in bytes.
        topics: where they go, one sender after the other.
        parameters: of the observer.
    """

    messages: Callable[[int], Iterator[bytes]]
    topics: tuple[str, ...] = TOPICS
    parameters: tuple[str, ...] = ()


def _input(name: str) -> tuple[str, ...]:
    return (f'{name}.topic:=/{name}', f'{name}.type:=sensor_msgs/msg/JointState',
            f'{name}.field:=effort')  # fmt: skip


FLOODS = {
    'large': Flood(large),
    'nearly': Flood(nearly),
    'names': Flood(names),
    'layouts': Flood(layouts),
    'small': Flood(small),
    'speed': Flood(valid, ('/motor/speed',), ('speed.topic:=/motor/speed',)),
    'inputs': Flood(
        valid,
        ('/duty', '/battery'),
        ('voltage.expression:=duty * battery', *_input('duty'), *_input('battery')),
    ),
}


def main() -> int:
    """Flood one observer after another; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--seconds', type=float, default=60.0, help='length of every flood')
    parser.add_argument('--kinds', nargs='+', choices=list(FLOODS), default=list(FLOODS))
    parser.add_argument('--megabytes', type=float, default=20.0, help='size of a large message')
    parser.add_argument(
        '--senders', type=int, default=2, help='processes that send, in turn to the topics'
    )
    parser.add_argument(
        '--domain', type=int, default=87, help='ROS domain of everything that is started'
    )
    options = parser.parse_args()
    os.environ['ROS_DOMAIN_ID'] = str(options.domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    figures: list[Figure] = []
    counts: dict[str, object] = {}
    with tempfile.TemporaryFile('w+', encoding='utf-8') as log:
        for kind in options.kinds:
            peak_mb, end_s, sent = flood(kind, options, log)
            figures.append(Figure(f'{kind}: memory, most [MB]', peak_mb, LARGEST_MB))
            figures.append(Figure(f'{kind}: end after SIGTERM [s]', end_s, LONGEST_END_S))
            counts[f'{kind}: messages sent'] = sent
        log.seek(0)
        said = log.read()
        figures.append(Figure('tracebacks', said.count('Traceback'), 0))
    return tell('flood', 0, figures, counts)


def flood(kind: str, options: argparse.Namespace, log: IO[str]) -> tuple[float, float, int]:
    """Flood one observer; return its largest memory in MB, time to end, and amount sent."""
    context = multiprocessing.get_context('spawn')
    ready = context.Semaphore(0)
    stop = context.Event()
    sent = context.Value('q', 0)
    size = int(options.megabytes * 1e6)
    topics = FLOODS[kind].topics
    command = [sys.executable, '-m', OBSERVER, '--ros-args', '-p', 'predictor:=false']
    command += itertools.chain.from_iterable(('-p', text) for text in FLOODS[kind].parameters)
    with subprocess.Popen(command, stdout=log, stderr=log, text=True) as process:
        senders = [
            context.Process(
                target=send, args=(kind, size, topics[k % len(topics)], ready, stop, sent)
            )
            for k in range(options.senders)
        ]
        try:
            for sender in senders:
                sender.start()
            for _ in senders:
                assert ready.acquire(timeout=PATIENCE_S), 'nobody listens'
            peak_mb = watched(process, options.seconds)
            since_s = time.monotonic()
            process.terminate()
            process.wait(PATIENCE_S)
            return peak_mb, time.monotonic() - since_s, sent.value
        finally:
            stop.set()
            process.kill()
            for sender in senders:
                sender.join(PATIENCE_S)
                sender.kill()


def watched(process: subprocess.Popen[str], duration_s: float) -> float:
    """Return the largest memory in MB of a process that must not end by itself.

    Raises:
        AssertionError: it has ended.
    """
    observed = psutil.Process(process.pid)
    peak_mb = 0.0
    until_s = time.monotonic() + duration_s
    while time.monotonic() < until_s:
        assert process.poll() is None, f'the observer has ended with {process.returncode}'
        peak_mb = max(peak_mb, observed.memory_info().rss / 1e6)
        time.sleep(LOOK_EVERY_S)
    return peak_mb


def send(kind: str, size: int, topic: str, ready: Any, stop: Any, sent: Synchronized[int]) -> None:
    """Send one kind of message at full speed, from the first reader on until told to stop."""
    rclpy.init()
    node = rclpy.create_node(f'flood_{os.getpid()}')
    publisher = node.create_publisher(JointState, topic, QoSProfile(depth=QUEUE))
    while not publisher.get_subscription_count() and not stop.is_set():
        time.sleep(LOOK_EVERY_S)
    ready.release()
    for message in FLOODS[kind].messages(size):
        if stop.is_set():
            break
        publisher.publish(message)
        with sent.get_lock():
            sent.value += 1
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    raise SystemExit(main())
