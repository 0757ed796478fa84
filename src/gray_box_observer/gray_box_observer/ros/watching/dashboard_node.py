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
    """Listens, for a page that is served in a thread of its own.

    Args:
        settings: what to show.
        configuration: of the observer, by the same settings.
        source: what the page is told.
        server: of the page, which is served already.
        context: of the participant that is used.
    """

    def __init__(
        self,
        settings: DashboardSettings,
        configuration: Configuration,
        source: PageSource,
        server: PageServer,
        context: Context,
    ) -> None:
        super().__init__(NODE_NAME, context=context, **WITHOUT_SERVICES)
        self._settings = settings
        self._configuration = configuration
        self._source = source
        self._server = server
        self._listener = ObserverListener(self, source.state, settings.observers, time.monotonic)
        self._signals: SignalListener | None = None
        self._poll_count = 0

    def poll(self) -> float:
        """Take what has come; return when to look again.

        Raises:
            ConfigurationError: the page is served no more.
        """
        self._server.check()
        with self._source.lock:
            self._listener.poll()
            if self._signals is not None:
                for observer in self._source.state.observers:
                    self._signals.listen_to(observer)
                self._signals.poll()
        self._poll_count += 1
        if self._signals is None and (self._source.state.observers or self._poll_count > PATIENCE):
            self._signals = self._listen_to_signals()
        return POLL_S

    def _listen_to_signals(self) -> SignalListener:
        """Load what reads signals, once estimates are there: that takes as long as all before."""
        from gray_box_observer.ros.watching.signal_listener import SignalListener

        signals = SignalListener(
            self, self._source.signals, self._configuration, self._settings.topic_names
        )
        for observer in self._settings.observers:
            signals.listen_to(observer)
        return signals

    def close(self) -> None:
        """Stop serving, before the participant is gone."""
        self._server.stop()


def serve(args: Sequence[str], settings: DashboardSettings) -> int:
    """Serve the page until asked to end; the result is the exit code.

    Args:
        args: The whole command line, for what ROS takes of it.
        settings: What to show.
    """
    with ExitStack() as resources:

        def make_node(stop: Stop) -> DashboardNode:
            configuration = Configuration.from_flat(settings.parameters)
            courses = SignalCourses(configuration['jump_back_s'])
            source = PageSource(WatchedState(settings.observers), courses, time.monotonic)
            server = PageServer(source, settings.address, settings.port)
            server.start()  # before the search: who opens the page need not wait for it
            resources.callback(server.stop)
            print(f'dashboard: {printable(server.url)}', flush=True)
            observers = settings.observers
            with answered_participant(args, observers, lambda: stop.is_requested) as context:
                resources.callback(context.try_shutdown)
                return DashboardNode(settings, configuration, source, server, context)

        return run_node(
            make_node,
            args,
            name='dashboard',
            executor_factory=PollingExecutor,
            tells_range=False,
        )
