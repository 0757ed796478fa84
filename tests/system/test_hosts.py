"""Simulator, observer and recorder on three hosts: what a network may do to samples."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from network import Network, NetworkUnavailableError

from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]

LONG = bool(os.environ.get('GRAY_BOX_LONG'))
"""Minutes instead of seconds: ``GRAY_BOX_LONG=1 make test ARGS='-k hosts'``."""

RATE_HZ = 1000.0
DURATION_S = 120.0 if LONG else 5.0
OUTAGE_S = 10.0 if LONG else 1.5
BEFORE_S = 3.0 if LONG else 1.5
COUNT = round(DURATION_S * RATE_HZ)
DEPTH = 2 * COUNT
"""More than the whole run: whatever the network and the load of the machine do, no history is ever
overwritten."""

PATIENCE_S = 180.0 + 2.0 * DURATION_S
DOMAIN = '1'
"""Any will do: the network is the test's own."""

_FILE = Path(__file__).parents[2] / 'src/gray_box_observer/config/several_hosts.fastdds.xml'
PROFILE = (
    {} if os.environ.get('GRAY_BOX_NO_PROFILE') else {'FASTRTPS_DEFAULT_PROFILES_FILE': str(_FILE)}
)
"""What docs/HOSTS.md recommends; without it one host that is gone holds up the others,
``GRAY_BOX_NO_PROFILE=1``."""

TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
SIGNALS = ('/motor/voltage', '/motor/torque')


class Robot:
    """The three programs on their hosts, and the bag that the recorder writes."""

    def __init__(self, folder: Path) -> None:
        self.bag = folder / 'bag'
        self._logs = folder
        self.network = Network(['simulator', 'observer', 'recorder'])
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, host: str, module: str, *arguments: str, **parameters: object) -> None:
        """Start a program on its host; ``motor__resistance=2.0`` sets ``motor.resistance``."""
        command = [sys.executable, '-m', module, *arguments, '--ros-args']
        for name, value in parameters.items():
            command += ['-p', f'{name.replace("__", ".")}:={value}']
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': DOMAIN,
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
            **PROFILE,
        }
        with (self._logs / f'{host}.log').open('wb') as log:
            self._running[host] = subprocess.Popen(
                self.network.on(host, command),
                env=environment,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def listen(self, depth: int, **parameters: object) -> None:
        """Start observer and recorder, and wait until the one hears the other."""
        self.start(
            'recorder',
            'gray_box_observer.ros.bags.recorder_node',
            '-o',
            str(self.bag),
            queue_depth=max(depth, 5000),
        )
        self.start(
            'observer',
            'gray_box_observer.ros.observer.observer_node',
            **overrides('subscription', depth),
            **parameters,
        )
        self.wait(lambda: self.diagnostics(), 'the observer to be recorded')

    def simulate(self, rate_hz: float, duration_s: float, depth: int) -> None:
        """Let the motor run once both others listen; 0 s: until the end."""
        self.start(
            'simulator', 'dc_motor_sim.ros.motor_sim', sample_rate_hz=rate_hz,
            duration_s=duration_s,
            wait_for_subscribers=2, excitation='R[1,5]D[0.05,0.5]', torque_noise_relative=0.01,
            **overrides('publisher', depth),
        )  # fmt: skip

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Wait until a condition holds; nothing that was started may end badly meanwhile."""
        until_s = time.monotonic() + PATIENCE_S
        while not condition():
            for host, process in self._running.items():
                assert not process.poll(), f'{host} ended with {process.poll()}: {self._said(host)}'
            assert time.monotonic() < until_s, (
                f'waited {PATIENCE_S} s for {what}; the observer says {self.diagnostics()}'
            )
            time.sleep(0.4)

    def recorded(self) -> int:
        """Torques in the bag so far."""
        try:
            with BagReader(self.bag) as bag:
                return sum(1 for _ in bag.messages([SIGNALS[1]]))
        except BagError:  # not begun yet
            return 0

    def stamps_ns(self, topic: str) -> np.ndarray:
        """Stamps of the messages of a topic in the bag, which may still be written."""
        return np.array(
            [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in self._messages(topic)],
            dtype=int,
        )

    def diagnostics(self) -> dict[str, str]:
        """The newest diagnostics in the bag; empty before the first."""
        found = self._messages('/diagnostics')
        return {entry.key: entry.value for entry in found[-1].status[0].values} if found else {}

    def gaps(self) -> int:
        """Samples missing and pauses that the observer has counted."""
        facts = self.diagnostics()
        return int(facts.get('samples missing', 0)) + int(facts.get('pauses', 0))

    def estimates(self) -> dict[str, float]:
        """The newest estimate in the bag."""
        return {name: self._messages(f'/gray_box_observer/motor/{name}')[-1].data for name in TRUTH}

    def end(self) -> None:
        """Ask everything to end, the recorder last; every program must do so well."""
        for host in ('simulator', 'observer', 'recorder'):
            process = self._running.pop(host)
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30.0) == 0, self._said(host)
            assert 'Traceback' not in self._said(host), self._said(host)

    def close(self) -> None:
        """Leave nothing behind."""
        for process in self._running.values():
            process.kill()
            process.wait()
        self.network.close()

    def _messages(self, topic: str) -> list[Any]:
        try:
            with BagReader(self.bag) as bag:
                return [message for _, message in bag.decoded_messages([topic])]
        except BagError:  # not begun yet
            return []

    def _said(self, host: str) -> str:
        return (self._logs / f'{host}.log').read_text()


def overrides(end: str, depth: int) -> dict[str, int]:
    """Parameters that give both signals a deeper history."""
    return {f'qos_overrides./{name[1:]}.{end}.depth': depth for name in SIGNALS}


def cut_off(robot: Robot, after: int, outage_s: float, at_most: int = sys.maxsize) -> None:
    """Cut the observer off once so many samples are in the bag, for a time or until the last one.

    The time is that of stamps, none of which is ahead of the wall clock: the bag may lag behind.
    """
    robot.wait(lambda: robot.recorded() >= after, 'samples to flow')
    robot.network.pull_plug('observer')
    before = robot.network.bytes_to('observer')
    until_ns = time.time_ns() + round(outage_s * 1e9)
    robot.wait(
        lambda: robot.recorded() >= at_most or robot.stamps_ns(SIGNALS[1])[-1] >= until_ns,
        'the outage to last',
    )
    assert robot.network.bytes_to('observer') == before
    robot.network.plug_in_again('observer')


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    """Three hosts, where this machine lets the test make them."""
    try:
        made = Robot(tmp_path)
    except NetworkUnavailableError as reason:
        pytest.skip(f'no network of namespaces here: {reason}')
    yield made
    made.close()


def test_with_deep_histories_nothing_is_lost_on_three_hosts_even_where_a_link_goes_down(robot):
    # After an outage a topic is delivered at a time, on a busy machine slowly; torque that comes
    # first waits for its voltage that long.
    robot.listen(DEPTH, hold_s=PATIENCE_S)
    robot.simulate(RATE_HZ, DURATION_S, DEPTH)
    cut_off(robot, round(BEFORE_S * RATE_HZ), OUTAGE_S, COUNT)
    robot.wait(lambda: robot.recorded() >= COUNT, 'the simulation to end')
    robot.wait(
        lambda: robot.diagnostics().get('samples used') == str(COUNT),
        'the observer to have used every sample',
    )
    facts = robot.diagnostics()
    robot.end()
    grid = np.full(COUNT - 1, round(1e9 / RATE_HZ))
    for topic in SIGNALS:
        assert np.array_equal(np.diff(robot.stamps_ns(topic)), grid), topic
    predicted = robot.stamps_ns('/gray_box_observer/predicted_torque')
    assert len(predicted) == len(set(predicted.tolist())), 'a stamp was predicted twice'
    assert set(predicted.tolist()) <= set(robot.stamps_ns('/motor/torque').tolist())
    assert facts['rejected'] == 'none' and facts['samples missing'] == '0'
    for name, value in robot.estimates().items():
        assert value == pytest.approx(TRUTH[name], rel=0.02), name


def test_an_outage_longer_than_the_histories_is_a_gap_that_is_counted_and_everything_goes_on(robot):
    rate_hz = 200.0
    depth = 100  # half a second
    robot.listen(depth)
    robot.simulate(rate_hz, 0.0, depth)
    robot.wait(lambda: robot.recorded() >= 200, 'samples to flow')
    gaps_before = robot.gaps()
    cut_off(robot, 200, 1.5)
    robot.wait(lambda: robot.gaps() > gaps_before, 'the gap to be counted')
    before = int(robot.diagnostics()['samples used'])
    robot.wait(
        lambda: int(robot.diagnostics()['samples used']) > before + 2 * depth,
        'the observer to go on',
    )
    facts = robot.diagnostics()
    robot.end()
    assert int(facts['samples used']) < len(robot.stamps_ns(SIGNALS[1]))
    assert int(facts['samples missing']) + int(facts['pauses']) > 0
    predicted = robot.stamps_ns('/gray_box_observer/predicted_torque')
    assert len(predicted) == len(set(predicted.tolist())), 'a stamp was predicted twice'
