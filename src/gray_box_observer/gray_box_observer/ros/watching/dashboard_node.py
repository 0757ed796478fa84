"""The node behind the dashboard: hears observers and signals, and serves a page of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rclpy.node import Node

from gray_box_observer.ros.running import run_node
from gray_box_observer.ros.watching.observer_listener import ObserverListener
from gray_box_observer.ros.watching.polling_executor import PollingExecutor
from gray_box_observer.ros.watching.signal_listener import SignalListener
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.watching.dashboard.page_feed import PageSource
from gray_box_observer.watching.dashboard.page_server import PageServer
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses
from gray_box_observer.watching.observer_state import WatchedState

NODE_NAME = 'gray_box_dashboard'
POLL_S = 0.1


@dataclass(frozen=True)
class DashboardSettings:
    """What the dashboard shows, and where.

    Attributes:
        address, port: to listen on; port 0: one that is free.
        observers: names of the only ones to show; none for all.
        parameters: of the observer, by dotted names: they say how signals are read.
        resolved: topics from the root on, by the configured names, where an observer says them.
    """

    address: str = '127.0.0.1'
    port: int = 0
    observers: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    resolved: Mapping[str, str] = field(default_factory=dict)


class DashboardNode(Node):
    """Listens, and serves the page in a thread of its own.

    Args:
        settings: what to show.

    Raises:
        ConfigurationError: a parameter, or the port, cannot be used.
    """

    def __init__(self, settings: DashboardSettings) -> None:
        configuration = Configuration.from_flat(settings.parameters)
        super().__init__(NODE_NAME, start_parameter_services=False, enable_rosout=False)
        self.source = PageSource(WatchedState(settings.observers), SignalCourses(), time.monotonic)
        self._server = PageServer(self.source, settings.address, settings.port)
        self._listener = ObserverListener(
            self, self.source.state, settings.observers, time.monotonic
        )
        self._signals = SignalListener(self, self.source.signals, configuration, settings.resolved)
        for observer in settings.observers:
            self._signals.listen_to(observer)
        self._server.start()
        self.url = self._server.url
        print(f'dashboard: {printable(self.url)}', flush=True)

    def poll(self) -> float:
        """Take what has come; return when to look again."""
        with self.source.lock:
            self._listener.poll()
            for observer in self.source.state.observers:
                self._signals.listen_to(observer)
            self._signals.poll()
        return POLL_S

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()


def serve(args: Sequence[str], settings: DashboardSettings) -> int:
    """Serve the page until asked to end; the result is the exit code.

    Args:
        args: The whole command line, for what ROS takes of it.
        settings: What to show.
    """
    return run_node(
        lambda _: DashboardNode(settings),
        args,
        name='dashboard',
        executor_factory=PollingExecutor,
        tells_range=False,
    )
