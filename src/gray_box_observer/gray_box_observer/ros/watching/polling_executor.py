"""Serves a node that reads its topics by itself, every so often, instead of message by message.

Waking for each of some thousand messages a second takes most of a core in Python; taking what has
come every tenth of a second takes a few per cent. Nothing else of the node is served: it has no
services, parameters or timers.
"""

from __future__ import annotations

import time
from typing import Any, Protocol

from rclpy.parameter import Parameter

SLICE_S = 0.02


WITHOUT_SERVICES: dict[str, Any] = {
    'start_parameter_services': False,
    'enable_rosout': False,
    'parameter_overrides': [Parameter('start_type_description_service', value=False)],
}
"""How a node is made that is served so: nobody would answer its services."""


class PollingNode(Protocol):
    """A node that is asked to read what has come."""

    def poll(self) -> float:
        """Read what has come; return in how many seconds to ask again."""


class PollingExecutor:
    """Stands in for an executor of rclpy in :func:`~gray_box_observer.ros.running.run_node`."""

    def __init__(self) -> None:
        self._nodes: list[PollingNode] = []

    def add_node(self, node: Any) -> None:
        """Serve a node from now on."""
        self._nodes.append(node)

    def remove_node(self, node: Any) -> None:
        """Serve it no more."""
        self._nodes.remove(node)

    def shutdown(self) -> None:
        """End; nothing is held."""

    def spin_until_future_complete(self, future: Any, timeout_sec: float) -> None:
        """Ask the nodes to read until the future is done or the time is over."""
        end_s = time.monotonic() + timeout_sec
        due_s = 0.0
        while not future.done() and (now_s := time.monotonic()) < end_s:
            if now_s >= due_s:
                due_s = now_s + min((node.poll() for node in self._nodes), default=SLICE_S)
            time.sleep(min(SLICE_S, max(0.0, due_s - time.monotonic())))
