"""``watch`` on live topics: hears observers, and shows them while they run."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack

from rclpy.context import Context
from rclpy.node import Node

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.ros.running import Stop, run_node
from gray_box_observer.ros.watching.answered_participant import answered_participant
from gray_box_observer.ros.watching.observer_listener import (
    LOOK_ROUND_LATER_S,
    LOOK_ROUND_S,
    ObserverListener,
)
from gray_box_observer.ros.watching.polling_executor import WITHOUT_SERVICES, PollingExecutor
from gray_box_observer.watching.motor_table import is_complete
from gray_box_observer.watching.observer_state import SILENT_S, WatchedState
from gray_box_observer.watching.table_display import TableDisplay

NODE_NAME = 'gray_box_watch'
POLL_S = 0.1

SETTLE_S = 1.5
"""With ``--once``: another observer may be found so long after the last one."""


class WatchNode(Node):
    """Listens and shows.

    Args:
        stop: ends the process.
        display: where the table goes.
        observers: names of the only ones to watch; none for all.
        period_s: between two tables.
        once: end with the first table that is complete.
        timeout_s: with `once`, show what was heard after so long at the latest.
        started_s: monotonic time from which that counts; None: now.
        context: of the participant that is used; None: the default one.
    """

    def __init__(
        self,
        stop: Stop,
        display: TableDisplay,
        observers: Sequence[str] = (),
        period_s: float = 1.0,
        *,
        once: bool = False,
        timeout_s: float = SILENT_S,
        started_s: float | None = None,
        context: Context | None = None,
    ) -> None:
        super().__init__(NODE_NAME, context=context, **WITHOUT_SERVICES)
        self._stop = stop
        self._display = display
        self._period_s = period_s
        self._is_once = once
        self._timeout_s = timeout_s if once else SILENT_S
        self._observers = observers
        self.state = WatchedState(observers)
        look_round_s = LOOK_ROUND_S if once else LOOK_ROUND_LATER_S
        self._listener = ObserverListener(self, self.state, observers, time.monotonic, look_round_s)
        self._started_s = time.monotonic() if started_s is None else started_s
        self._shown_s = -period_s
        self._shown_count = 0
        self._has_complained = False
        self._known_count = 0
        self._settled_s = 0.0

    def poll(self) -> float:
        """Take what has come and show it when it is time; return when to look again."""
        self._listener.poll()
        now_s = time.monotonic()
        if self._is_once:
            self._show_once(now_s)
        elif self.state.observers:
            is_first = not self._shown_count
            if is_first or now_s - self._shown_s >= self._period_s - POLL_S / 2:
                self._show(now_s)
        elif now_s - self._started_s > self._timeout_s and not self._has_complained:
            self._has_complained = True
            self._complain()
        return POLL_S

    def close(self) -> None:
        """Leave the last table where it is refreshed in place."""
        if self._display.is_terminal and self.state.observers and not self._is_once:
            self._show(time.monotonic())

    def silence(self) -> str:
        """Say that nothing was heard, and what may be the reason."""
        where = ', '.join(self._observers) or '/*/estimates or /diagnostics'
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        reach = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
        return (
            f'no observer heard on {where} for {self._timeout_s:g} s: is it running, active, and '
            f'with ROS_DOMAIN_ID={domain} like this (discovery range {reach})? make demo has a '
            'domain of its own, and says which'
        )

    def _show(self, now_s: float) -> None:
        heading = time.strftime('%H:%M:%S')
        self._shown_s = now_s
        self._shown_count += 1
        self._display.show(self.state, now_s, heading)

    def _show_once(self, now_s: float) -> None:
        """Show the first complete table, or what there is when waiting has been long enough."""
        observers = self.state.observers.values()
        count = len(observers) + sum(len(observer.motors) for observer in observers)
        if count != self._known_count:
            self._known_count = count
            self._settled_s = now_s + SETTLE_S
        is_late = now_s - self._started_s > self._timeout_s
        is_all = self._listener.has_heard_all() and is_complete(self.state)
        is_settled = is_all and now_s > self._settled_s
        if not is_settled and not is_late:
            return
        if self.state.observers:
            self._show(now_s)
            self._stop()
        else:
            self._stop(GrayBoxError(self.silence()))

    def _complain(self) -> None:
        if self._display.is_terminal:
            self._display.say(self.silence())
        else:
            print(f'watch: {self.silence()}', file=sys.stderr, flush=True)


def watch_live(
    args: Sequence[str],
    observers: Sequence[str],
    period_s: float,
    most: int,
    *,
    once: bool,
    timeout_s: float = SILENT_S,
) -> int:
    """Watch live topics until asked to end; the result is the exit code.

    Args:
        args: The whole command line, for what ROS takes of it.
        observers: Names of the only ones to watch.
        period_s: Between two tables.
        most: Motors of each observer that are shown.
        once: End with the first complete table.
        timeout_s: With `once`, wait so long at most for a complete one.
    """
    with ExitStack() as contexts, TableDisplay(sys.stdout, most, live=not once) as display:

        def make_node(stop: Stop) -> WatchNode:
            started_s = time.monotonic()

            def is_over() -> bool:
                return stop.is_requested or (once and time.monotonic() - started_s > timeout_s)

            with answered_participant(args, observers, is_over) as context:
                contexts.callback(context.try_shutdown)
                return WatchNode(
                    stop,
                    display,
                    observers,
                    period_s,
                    once=once,
                    timeout_s=timeout_s,
                    started_s=started_s,
                    context=context,
                )

        return run_node(
            make_node,
            args,
            name='watch',
            executor_factory=PollingExecutor,
            tells_range=False,
        )
