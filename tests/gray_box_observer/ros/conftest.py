"""What tests of the observer's node share: a rig that starts it, feeds it and hears it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.duration import Duration
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS
from gray_box_observer.settings.configuration import Configuration

MODULE = 'gray_box_observer.ros.observer.observer_node'
NODE = '/gray_box_observer'
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
START_NS = 1_000_000_000
CHUNK = 20
"""Messages that are sent before their arrival is acknowledged; also the publishers' depth: with a
full history DDS asks its readers at once, else every three seconds."""
SENDER_QOS = QoSProfile(depth=CHUNK, reliability=ReliabilityPolicy.RELIABLE)
ACKNOWLEDGE_TIMEOUT_S = 60.0
ORPHAN_END_S = 120.0
"""What an observer had started has ended so long after it."""


class Rig:
    """An observer that runs, what it is sent and what it says.

    Attributes:
        start_ns: stamp of the first sample of a recording that is sent.
    """

    start_ns = START_NS

    def __init__(self, peer, namespace: str = '') -> None:
        self.peer = peer
        self.namespace = namespace
        self.diagnostics = peer.listen(DiagnosticArray, '/diagnostics')
        self.predicted = peer.listen(JointState, f'{namespace}{NODE}/predicted_torque', SIGNAL_QOS)
        self._senders: dict[str, Any] = {}
        self.process: subprocess.Popen | None = None

    @staticmethod
    def state(
        name: str, stamp_ns: int, *efforts: float, speeds: Sequence[float] = ()
    ) -> JointState:
        """One message about one motor, or about several whose names are joined by spaces."""
        message = JointState(name=name.split(), effort=list(efforts), velocity=list(speeds))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        return message

    def start(self, *arguments: str, **parameters: object) -> None:
        """Start the observer, without predictor unless asked for."""
        self.process = self.peer.start(MODULE, *arguments, **{'predictor': 'false', **parameters})

    def signals(self) -> tuple[Any, Any]:
        """The publishers of voltage and torque, once the observer listens."""
        listens = bool(self._senders)
        for name in ('voltage', 'torque'):
            topic = f'{self.namespace}/motor/{name}'
            if name not in self._senders:
                self._senders[name] = self.peer.publisher(JointState, topic, SENDER_QOS)
            listens &= self._senders[name].get_subscription_count() > 0
            self.peer.wait(
                self._senders[name].get_subscription_count, f'the observer to listen to {topic}'
            )
        if not listens:
            self.settle()
        return self._senders['voltage'], self._senders['torque']

    def settle(self) -> None:
        """Wait until the observer's executor knows of every subscription.

        What comes before is served topic by topic, not as it came. The executor hears of a
        subscription right after the call in which it was made: behind the first answer from then
        on.
        """
        for _ in range(2):
            self.lifecycle_state()

    def send(self, recording, indices: Sequence[int]) -> None:
        """Send samples of a recording: a chunk of voltages, then the torques of the same stamps."""
        motors = ' '.join(recording.motors)
        for first in range(0, len(indices), CHUNK):
            chunk = indices[first : first + CHUNK]
            for publisher, values in zip(
                self.signals(), (recording.voltage_v, recording.torque_nm), strict=True
            ):
                for k in chunk:
                    publisher.publish(
                        self.state(
                            motors, START_NS + int(recording.stamp_ns[k]), *values[:, k].tolist()
                        )
                    )
                if len(chunk) == CHUNK:
                    assert publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))

    def status(self, motor: str = 'motor') -> Any:
        """The newest diagnostic status of a motor; None before the first."""
        hardware = f'{self.namespace}/{motor}'.lstrip('/')
        found = [
            s for array in self.diagnostics[-1:] for s in array.status if s.hardware_id == hardware
        ]
        return found[0] if found else None

    def values(self, motor: str = 'motor') -> dict[str, str]:
        """The newest key-value pairs of a motor's diagnostics."""
        status = self.status(motor)
        return {} if status is None else {pair.key: pair.value for pair in status.values}

    def wait_for(self, motor: str = 'motor', **expected: object) -> None:
        """Wait for diagnostics with these counts, such as ``samples_used=100``."""
        wanted = {key.replace('_', ' '): str(value) for key, value in expected.items()}
        try:
            self.peer.wait(
                lambda: wanted.items() <= self.values(motor).items(), f'diagnostics with {wanted}'
            )
        except AssertionError as error:
            raise AssertionError(f'{error}; the last ones were {self.values(motor)}') from error

    def wait_for_level(self, level: bytes, words: str) -> None:
        """Wait for diagnostics of a level that say something."""
        self.diagnostics.clear()

        def said() -> bool:
            return any(
                s.level == level and words in s.message
                for array in self.diagnostics
                for s in array.status
            )

        try:
            self.peer.wait(said, f'diagnostics that say {words!r}')
        except AssertionError as error:
            heard = {(s.level, s.message) for array in self.diagnostics for s in array.status}
            raise AssertionError(f'{error}; they said {heard}') from error

    def latched(self, kind: type, topic: str) -> Any:
        """What a subscriber hears that comes late."""
        heard = self.peer.listen(kind, f'{self.namespace}{NODE}/{topic}', LATCHED_QOS)
        self.peer.wait(lambda: heard, f'what {topic} has latched')
        return heard[-1]

    def estimates(self, motor: str = 'motor') -> dict[str, float]:
        """The latched estimates."""
        return {name: self.latched(Float64, f'{motor}/{name}').data for name in TRUTH}

    def call(self, kind: type, service: str, **fields: Any) -> Any:
        """Call a service of the observer."""
        return self.peer.call(kind, f'{self.namespace}{NODE}/{service}', kind.Request(**fields))

    def change(self, transition: int) -> bool:
        """Ask for a transition of the life cycle."""
        return self.call(ChangeState, 'change_state', transition=Transition(id=transition)).success

    def wait_until_deaf(self) -> None:
        """Wait until the observer listens no more."""
        senders = self._senders.values()
        self.peer.wait(
            lambda: not any(s.get_subscription_count() for s in senders),
            'the observer to stop listening',
        )

    def lifecycle_state(self) -> int:
        """The state of the life cycle."""
        return self.call(GetState, 'get_state').current_state.id

    def wait_until_gone(self, child: psutil.Process) -> None:
        """Wait until a process that the observer had started ends; it ends at low priority."""

        def gone() -> bool:
            try:
                return bool(
                    child.status() == psutil.STATUS_ZOMBIE
                )  # nobody may be there to fetch its exit code
            except psutil.NoSuchProcess:
                return True

        self.peer.wait(gone, 'the end of the training process', timeout_s=ORPHAN_END_S)

    def children(self) -> list[psutil.Process]:
        """The processes that the observer has started."""
        return psutil.Process(self.process.pid).children(recursive=True)


@pytest.fixture
def rig(peer) -> Rig:
    return Rig(peer)


@pytest.fixture
def make_rig(peer) -> Callable[..., Rig]:
    """Make a rig, in a namespace if one is given."""
    return lambda namespace='': Rig(peer, namespace)


@pytest.fixture
def learnt_offline() -> Callable[..., dict[str, float]]:
    """What the core learns of the same samples, fed without ROS."""

    def learn(recording, indices: Iterable[int]) -> dict[str, float]:
        core = Observer(Configuration.from_flat({'predictor': False}))
        for k in indices:
            stamp_ns = START_NS + int(recording.stamp_ns[k])
            core.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
            core.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))
        return dict(zip(TRUTH, core.estimates()['motor'].value[0].tolist(), strict=True))

    return learn
