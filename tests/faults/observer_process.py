"""The observer as a process under test: started, heard, counted, killed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from node_balance import received
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState
from stream_faults import encoded

from gray_box_observer.bag.joint_state import JointStateView

OBSERVER = 'gray_box_observer.ros.observer.observer_node'
SIMULATOR = 'dc_motor_sim.ros.motor_sim'
TOPICS = {'voltage': '/motor/voltage', 'torque': '/motor/torque'}
TRUTH = {'inductance [H]': 0.5, 'resistance [ohm]': 1.0, 'hysteresis [V s/(rad A)]': 10.0}
"""The motor of the thesis, as diagnostics name its parameters."""
QUEUE = 20_000
"""Messages on the way between us and the observer; its own queue of 1000 would drop a burst, and
say so."""
PATIENCE_S = 120.0
HOLD_S = 60.0
"""Stamps run many times faster than the clock here, and so does what one topic is ahead of the
other: on a busy machine by all that is on the way, :data:`QUEUE` messages at most."""
PROBE = JointStateView(0, ('probe',), (), (), (0.0,))


class Bench:
    """A node of ours that feeds an observer and hears its diagnostics.

    Args:
        domain: ROS domain of everything that is started.
        log: where the processes write to.

    Attributes:
        facts: newest diagnostics of the motor, by key; empty before the first of each observer.
        sent: messages sent to the present observer.
        observer: its process.
    """

    def __init__(self, domain: int, log: IO[str]) -> None:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        rclpy.init()
        self.node: Node = rclpy.create_node('fault_proxy')
        self.facts: dict[str, str] = {}
        self.sent = 0
        self.observer: subprocess.Popen[str] | None = None
        self._log = log
        self._running: list[subprocess.Popen[str]] = []
        self._executor = EventsExecutor()
        self._executor.add_node(self.node)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, 10)
        self._senders = {
            name: self.node.create_publisher(JointState, topic, QoSProfile(depth=QUEUE))
            for name, topic in TOPICS.items()
        }

    def start(
        self, module: str, parameters: Mapping[str, object], *remaps: str
    ) -> subprocess.Popen[str]:
        """Start one of our executables."""
        command = [sys.executable, '-m', module, '--ros-args']
        for name, value in parameters.items():
            command += ['-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}']
        for remap in remaps:
            command += ['-r', remap]
        process = subprocess.Popen(
            command, stdout=self._log, stderr=self._log, text=True, start_new_session=True
        )
        self._running.append(process)
        return process

    def start_observer(self, checkpoint: Path, **parameters: object) -> None:
        """Start an observer that continues from its checkpoint; wait until it listens."""
        depth = {f'qos_overrides.{topic}.subscription.depth': QUEUE for topic in TOPICS.values()}
        own = {
            'checkpoint.path': checkpoint,
            'checkpoint.resume': True,
            'hold_s': HOLD_S,
            **depth,
            **parameters,
        }
        self.facts = {}
        self.observer = self.start(OBSERVER, own)
        self.wait(lambda: self.facts, 'the first diagnostics')
        probes = 0
        while not all(
            int(self.facts.get(f'{signal} topic: of no motor here', 0)) for signal in TOPICS
        ):
            assert probes < PATIENCE_S, f'nothing reaches the observer: {self.facts}'
            for signal in (
                TOPICS
            ):  # one that was killed counts as a subscriber for long: only what arrives tells
                self.send(signal, PROBE)
            probes += 1
            self.spin(1.0)
        self.rest()
        self.sent = received(self.facts)

    def settle(self) -> None:
        """Wait until the observer has told of all it was sent."""
        self.wait(lambda: received(self.facts) >= self.sent, 'the observer to catch up')
        self.rest()

    def rest(self) -> None:
        """Wait until nothing new arrives from one diagnostics to the next."""
        before = -1
        while before != received(self.facts):
            before = received(self.facts)
            self.facts = {}
            self.wait(lambda: self.facts, 'diagnostics')

    def send(self, signal: str, message: JointStateView | bytes) -> None:
        """Send one message to the observer, or what is left of one."""
        self._senders[signal].publish(message if isinstance(message, bytes) else encoded(message))
        self.sent += 1

    def spin(self, duration_s: float) -> None:
        """Serve callbacks for a while."""
        self._executor.spin_until_future_complete(Future(), duration_s)

    def wait(self, condition: Callable[[], Any], what: str) -> None:
        """Serve callbacks until a condition holds.

        Raises:
            AssertionError: it does not come to hold, or the observer has died.
        """
        until_s = time.monotonic() + PATIENCE_S
        while not condition():
            self.check_alive()
            assert time.monotonic() < until_s, (
                f'waited {PATIENCE_S:g} s for {what}; diagnostics: {self.facts}'
            )
            self.spin(0.05)

    def check_alive(self) -> None:
        """Raise AssertionError if the observer has died by itself."""
        if self.observer is not None:
            code = self.observer.poll()
            assert code is None, f'the observer has died with {code}; see the log'

    def kill_observer(self) -> None:
        """Give it no time for anything."""
        assert self.observer is not None
        gone, self.observer = self.observer, None
        self.kill(gone)

    def kill(self, process: subprocess.Popen[str]) -> None:
        """Kill a process of ours, with the training process that it may have."""
        children = (
            psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        )
        process.kill()
        process.wait(PATIENCE_S)
        _, left = psutil.wait_procs(children, PATIENCE_S)
        assert not left, f'{left} has outlived the process that started it'
        self._running.remove(process)

    def memory_mb(self) -> float:
        """Resident memory of the observer, without its training process."""
        assert self.observer is not None
        return float(psutil.Process(self.observer.pid).memory_info().rss / 1e6)

    def deviations(self) -> dict[str, float]:
        """How far the estimates are from the truth, in their own standard deviations."""
        found = {}
        for key, truth in TRUTH.items():
            value, std = self.facts[key].split(' +- ')
            found[key.split()[0]] = (float(value) - truth) / float(std)
        return found

    def close(self) -> None:
        """End everything that was started."""
        self.observer = None
        for process in list(self._running):
            self.kill(process)
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.hardware_id == 'motor' and self.observer is not None:
                self.facts = {pair.key: pair.value for pair in status.values}
