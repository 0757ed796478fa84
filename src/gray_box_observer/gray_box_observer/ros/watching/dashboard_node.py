"""The node behind the dashboard: hears observers and signals, and serves a page of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rclpy.context import Context
from rclpy.node import Node

from gray_box_observer.ros.running import Stop, run_node
from gray_box_observer.ros.watching.answered_participant import answered_participant
from gray_box_observer.ros.watching.observer_listener import ObserverListener
from gray_box_observer.ros.watching.polling_executor import WITHOUT_SERVICES, PollingExecutor
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.watching.dashboard.page_feed import PageSource
from gray_box_observer.watching.dashboard.page_server import PageServer
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses
from gray_box_observer.watching.observer_state import WatchedState

if TYPE_CHECKING:
    from gray_box_observer.ros.watching.signal_listener import SignalListener

NODE_NAME = 'gray_box_dashboard'
POLL_S = 0.1

PATIENCE = 10
"""Polls after which signals are read though no observer was heard."""


@dataclass(frozen=True)
class DashboardSettings:
    """What the dashboard shows, and where.

    Attributes:
        address, port: to listen on; port 0: one that is free.
        observers: names of the only ones to show; none for all.
        parameters: of the observer, by dotted names: they say how signals are read.
        topic_names: topics from the root on, by the configured names, where an observer says them.
    """

    address: str = '127.0.0.1'
    port: int = 0
    observers: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    topic_names: Mapping[str, str] = field(default_factory=dict)


class DashboardNode(Node):
    """Listens, and serves the page in a thread of its own.

    Args:
        settings: what to show.
        context: of the participant that is used; None: the default one.

    Raises:
        ConfigurationError: a parameter, or the port, cannot be used.
    """

    def __init__(self, settings: DashboardSettings, context: Context | None = None) -> None:
        self._configuration = Configuration.from_flat(settings.parameters)
        self._settings = settings
        super().__init__(NODE_NAME, context=context, **WITHOUT_SERVICES)
        courses = SignalCourses(self._configuration['jump_back_s'])
        self.source = PageSource(WatchedState(settings.observers), courses, time.monotonic)
        self._server = PageServer(self.source, settings.address, settings.port)
        self._listener = ObserverListener(
            self, self.source.state, settings.observers, time.monotonic
        )
        self._signals: SignalListener | None = None
        self._poll_count = 0
        self._server.start()
        self.url = self._server.url
        print(f'dashboard: {printable(self.url)}', flush=True)

    def poll(self) -> float:
        """Take what has come; return when to look again.

        Raises:
            ConfigurationError: the page is served no more.
        """
        self._server.check()
        with self.source.lock:
            self._listener.poll()
            if self._signals is not None:
                for observer in self.source.state.observers:
                    self._signals.listen_to(observer)
                self._signals.poll()
        self._poll_count += 1
        if self._signals is None and (self.source.state.observers or self._poll_count > PATIENCE):
            self._signals = self._listen_to_signals()
        return POLL_S

    def _listen_to_signals(self) -> SignalListener:
        """Load what reads signals, once estimates are there: that takes as long as all before."""
        from gray_box_observer.ros.watching.signal_listener import SignalListener

        signals = SignalListener(
            self, self.source.signals, self._configuration, self._settings.topic_names
        )
        for observer in self._settings.observers:
            signals.listen_to(observer)
        return signals

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()


def serve(args: Sequence[str], settings: DashboardSettings) -> int:
    """Serve the page until asked to end; the result is the exit code.

    Args:
        args: The whole command line, for what ROS takes of it.
        settings: What to show.
    """
    with ExitStack() as contexts:

        def make_node(stop: Stop) -> DashboardNode:
            observers = settings.observers
            with answered_participant(args, observers, lambda: stop.is_requested) as context:
                contexts.callback(context.try_shutdown)
                return DashboardNode(settings, context)

        return run_node(
            make_node,
            args,
            name='dashboard',
            executor_factory=PollingExecutor,
            tells_range=False,
        )
