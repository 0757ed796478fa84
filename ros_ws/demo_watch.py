"""What the demo sees of the observer: its topics, read as any controller would read them."""

from __future__ import annotations

import math
from contextlib import suppress
from functools import partial
from types import TracebackType

import rclpy
from demo_account import TorqueAccount
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64, Float64MultiArray

from gray_box_observer.ros.topics import DIAGNOSTICS, LATCHED_QOS
from gray_box_observer.white_box import TERMS

OBSERVER = 'gray_box_observer'
_READS_PER_UPDATE = 64


class Watch:
    """Follows the estimates of a running observer, whatever its motors and parameters are called.

    The topics keep their latest value only, so that reading them a few times a second misses
    nothing that counts.

    Attributes:
        estimates: Latest value in SI units by motor and parameter.
        stds: Latest standard deviation by motor and parameter.
        diagnostics: Latest key-value pairs of the observer's statuses, by status name.
        diagnostics_count: How many diagnostic messages of the observer have arrived.
    """

    def __init__(self) -> None:
        self.estimates: dict[str, dict[str, float]] = {}
        self.stds: dict[str, dict[str, float]] = {}
        self.diagnostics: dict[str, dict[str, str]] = {}
        self.diagnostics_count = 0
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node('gray_box_demo', context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._subscribed: set[str] = set()
        self._node.create_subscription(
            DiagnosticArray, DIAGNOSTICS.name, self._on_diagnostics, DIAGNOSTICS.qos
        )

    def __enter__(self) -> Watch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        with suppress(Exception):
            rclpy.shutdown(context=self._context)

    def update(self, wait_s: float) -> None:
        """Read what has arrived, waiting at most ``wait_s`` seconds for the first message."""
        self._subscribe_to_new_topics()
        self._executor.spin_once(timeout_sec=wait_s)
        for _ in range(_READS_PER_UPDATE):
            self._executor.spin_once(timeout_sec=0.0)

    def account(self) -> TorqueAccount | None:
        """Where the observer says that its torque samples went; None at first."""
        return TorqueAccount.of_diagnostics(self.diagnostics.values())

    def _subscribe_to_new_topics(self) -> None:
        for topic, types in self._node.get_topic_names_and_types():
            parts = topic.split('/')
            if topic in self._subscribed or len(parts) != 4 or parts[1] != OBSERVER:
                continue
            motor, leaf = parts[2:]
            if leaf == 'covariance' and 'std_msgs/msg/Float64MultiArray' in types:
                callback = partial(self._on_covariance, motor)
                self._node.create_subscription(Float64MultiArray, topic, callback, LATCHED_QOS)
            elif leaf in TERMS and 'std_msgs/msg/Float64' in types:
                self._node.create_subscription(
                    Float64, topic, partial(self._on_value, motor, leaf), LATCHED_QOS
                )
            self._subscribed.add(topic)

    def _on_value(self, motor: str, parameter: str, message: Float64) -> None:
        self.estimates.setdefault(motor, {})[parameter] = message.data

    def _on_covariance(self, motor: str, message: Float64MultiArray) -> None:
        names = [name.strip() for name in message.layout.dim[0].label.split(',')]
        if len(message.data) != len(names) ** 2:
            return
        variances = message.data[:: len(names) + 1]
        self.stds[motor] = {
            name: math.sqrt(v) if v >= 0 else math.nan
            for name, v in zip(names, variances, strict=True)
        }
        estimates = self.estimates.get(motor, {})  # parameters go where a rotor is found
        self.estimates[motor] = {name: v for name, v in estimates.items() if name in names}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        ours = [status for status in message.status if OBSERVER in status.name]
        for status in ours:
            self.diagnostics[status.name] = {pair.key: pair.value for pair in status.values}
        self.diagnostics_count += bool(ours)
