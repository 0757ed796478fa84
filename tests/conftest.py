"""Tests of real nodes share this: a domain and node of their own, and started processes."""

from __future__ import annotations

import gc
import itertools
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from tests.ended_starts import EndHere, caller

TIMEOUT_S = 120.0
WAITED_IN_VAIN = r'waited [0-9.]+ s for '
CRASHES = (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS, -signal.SIGILL, -signal.SIGFPE)
"""Exit codes of processes that died of a defect."""
ASK_AGAIN_S = 15.0


def _own_domains() -> list[int]:
    """Return the domains of this test process, which no other of the same run has.

    In random order, so that two runs side by side rarely meet; above 101 the ports of DDS meet
    ephemeral ones.
    """
    number = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0').removeprefix('gw'))
    count = max(1, int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1')))
    domains = list(range(1 + number % count, 102, count))
    return random.sample(domains, len(domains))


DOMAINS = _own_domains()
os.environ['ROS_DOMAIN_ID'] = str(DOMAINS.pop())
"""Of processes that are started without one. In that of other test processes some would end while
others begin, and then Fast DDS may wait for ever (eProsima/Fast-DDS issue 6513)."""

_NEXT_DOMAINS = itertools.cycle(DOMAINS)

MOST_PARTICIPANTS = 40
"""Of one domain that are looked for."""


def free_domain() -> int:
    """Find a domain that nobody is in: every participant owns known UDP ports (RTPS 9.6.2.3).

    Not only the first one is looked for: a node of this process that waits for the collector of
    garbage is still in its domain when others have gone.
    """
    for domain in itertools.islice(_NEXT_DOMAINS, len(DOMAINS)):
        first_port = 7410 + 250 * domain
        if all(_is_free(first_port + 2 * k) for k in range(MOST_PARTICIPANTS)):
            return domain
    raise AssertionError('every domain is taken')


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return False
        return True


LIVE_MODULES = ('rclpy', 'subprocess', 'multiprocessing')
"""A test module that imports one of these as a whole starts nodes or processes."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what starts nodes or processes, and repeat what the machine may have spoilt.

    A test on real DDS runs once more where the process of the test itself died in the middleware
    (Fast DDS has died of a segmentation fault while a participant was being deleted), and where it
    waited in vain: a machine that stands still for longer than a queue lasts loses messages. The
    run tells of both (``rerun``). What is found wrong, or a node that crashed, fails at once, and
    what fails twice fails.
    """
    repeats = config.pluginmanager.hasplugin('rerunfailures')
    for item in items:
        on_dds = item.get_closest_marker('system') or 'peer' in getattr(item, 'fixturenames', ())
        if on_dds or any(name in vars(item.module) for name in LIVE_MODULES):
            item.add_marker(pytest.mark.live)
        if repeats and on_dds:
            item.add_marker(pytest.mark.flaky(reruns=1, only_rerun=[WAITED_IN_VAIN]))
    places = _module_places(items)
    items.sort(key=lambda item: places[item.module])


LIVE_SHARE = 0.85
"""Share of a run within which modules that start nodes or processes have had their turn."""


def _module_places(items: Sequence[pytest.Item]) -> dict[ModuleType, float]:
    """Return every test module's place in a run, from 0 to 1.

    Tests that start nodes or processes mostly wait, and others compute: they are spread over the
    run, so that some always do both. At its end are none that take long, for which it would wait.
    """
    totals = Counter(_is_live(item) for item in items)
    counts: Counter[bool] = Counter()
    places: dict[ModuleType, float] = {}
    for item in items:
        is_live = _is_live(item)
        share = LIVE_SHARE if is_live else 1.0
        places.setdefault(item.module, share * counts[is_live] / totals[is_live])
        counts[is_live] += 1
    return places


def _is_live(item: pytest.Item) -> bool:
    return item.get_closest_marker('live') is not None


def pytest_collection_finish() -> None:
    """Let the collector of garbage pass over what was loaded for all tests.

    Else it goes through torch and five thousand tests time and again: a tenth of the time.
    """
    gc.collect()
    gc.freeze()


class Peer:
    """The test's own node and the processes it starts, all in one domain."""

    def __init__(self) -> None:
        self.domain = free_domain()
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=self.domain)
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._running: list[subprocess.Popen[str]] = []

    def start(self, module: str, *arguments: str, **parameters: object) -> subprocess.Popen[str]:
        """Start a module or script; ``motor__resistance=2.0`` sets ``motor.resistance``."""
        program = [module] if module.endswith('.py') else ['-m', module]
        command = [sys.executable, *program, *arguments]
        if parameters and '--ros-args' not in arguments:
            command += ['--ros-args']
        for name, value in parameters.items():
            command += ['-p', f'{name.replace("__", ".")}:={value}']
        environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(self.domain),
            'PYTHONFAULTHANDLER': '1',
        }
        process = subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._running.append(process)
        return process

    def wait(
        self, condition: Callable[[], object], what: str, timeout_s: float = TIMEOUT_S
    ) -> None:
        """Spin until the condition holds; fail after a time-out, or when a process has crashed."""
        until_s = time.monotonic() + timeout_s
        while not condition():
            self._require_living(what)
            assert time.monotonic() < until_s, f'waited {timeout_s} s for {what}'
            self.executor.spin_once(timeout_sec=0.02)

    def _require_living(self, what: str) -> None:
        """Fail where a process has died of a signal that nobody here has sent."""
        for process in self._running:
            if process.poll() in CRASHES:
                code = process.returncode
                said = process.communicate(timeout=TIMEOUT_S)[1]
                raise AssertionError(f'waiting for {what}: {process.args} ended by {code}: {said}')

    def listen(self, kind: type, topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Subscribe; the list fills while the peer spins."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def publisher(self, kind: type, topic: str, qos: QoSProfile, readers: int = 0) -> Publisher:
        """Make a publisher and wait until it has its readers."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.wait(lambda: publisher.get_subscription_count() >= readers, f'readers of {topic}')
        return publisher

    def call(self, kind: type, service: str, request: Any = None) -> Any:
        """Call a service, once it is there, and return its answer.

        A server that has not yet discovered the client's reader of answers loses its answer
        (rmw_fastrtps issue 842). The request is sent again where no answer comes.
        """
        client = self.node.create_client(kind, service)
        self.wait(client.service_is_ready, f'the service {service}')
        futures: list[Any] = []
        ask_again_s = 0.0

        def answered() -> bool:
            nonlocal ask_again_s
            if time.monotonic() >= ask_again_s:
                futures.append(client.call_async(kind.Request() if request is None else request))
                ask_again_s = time.monotonic() + ASK_AGAIN_S
            return any(future.done() for future in futures)

        self.wait(answered, f'the answer of {service}')
        self.node.destroy_client(client)
        return next(future for future in futures if future.done()).result()

    def end(
        self, process: subprocess.Popen[str], number: int | None = signal.SIGINT
    ) -> tuple[int, str, str]:
        """Signal a process if asked to and wait for its end while spinning.

        Returns:
            Its exit code, and what it wrote to standard output and to standard error.
        """
        if number is not None:
            process.send_signal(number)
        self.wait(lambda: process.poll() is not None, 'the end of a process')
        self._running.remove(process)
        out, err = process.communicate(timeout=TIMEOUT_S)
        assert 'Traceback' not in err, err
        return process.returncode, out, err

    def close(self) -> None:
        """End everything; no process may have had a defect on the way."""
        said = []
        for process in self._running:
            process.kill()
            said.append(process.communicate(timeout=TIMEOUT_S)[1])
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        assert 'Traceback' not in ''.join(said), said


@pytest.fixture
def peer(monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    """A node of the test's own in a domain that nobody else is in."""
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    made = Peer()
    yield made
    made.close()


@pytest.fixture
def end_here(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> EndHere:
    """Call a command that must end at its start, in the process of the test."""
    return caller(monkeypatch, capfd, free_domain())
