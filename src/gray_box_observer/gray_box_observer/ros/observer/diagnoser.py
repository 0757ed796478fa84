"""Tells operators once a second how every motor is, whatever state the node is in."""

from __future__ import annotations

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from gray_box_observer.checkpoints.checkpoint_manager import CheckpointKeeper
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros import topics
from gray_box_observer.ros.namesake import has_namesake
from gray_box_observer.ros.observer.diagnostics import NAMESAKE, Situation, idle_status, status_of
from gray_box_observer.ros.observer.topic_inputs import Inputs
from gray_box_observer.ros.observer.traffic import Traffic, TrafficMeter
from gray_box_observer.ros.qos import advertise
from gray_box_observer.safe_io.printable import printable

AT_ONCE = 100
"""Motors, at least, that one message tells of."""

ROUNDS = 4
"""Messages that tell of all motors, however many; a viewer takes what it has not heard of for 5 s
for stale."""


class Diagnoser:
    """Publishes diagnostics.

    Args:
        node: whose they are.
        motors: names of the configured motors.
        inputs, meter, keeper: of the node.
    """

    def __init__(
        self,
        node: Node,
        motors: list[str],
        inputs: Inputs,
        meter: TrafficMeter,
        keeper: CheckpointKeeper,
    ) -> None:
        self._node = node
        self._motors = motors
        self._inputs = inputs
        self._meter = meter
        self._keeper = keeper
        self._has_warned_of_strangers = False
        self._has_warned_of_namesake = False
        self._turn = 0
        topic = topics.DIAGNOSTICS
        self._publisher = advertise(node.create_publisher, topic.type, topic.name, topic.qos)

    def publish(
        self, state: str, observer: Observer | None, message_input: MessageInput | None
    ) -> Traffic | None:
        """Publish one round; return what has come since the last one, where the node is configured.

        Args:
            state: of the node's life cycle.
            observer: of the node; None where it is not configured.
            message_input: likewise.
        """
        array = DiagnosticArray()
        traffic = None
        clock = self._node.get_clock()
        now = clock.now()
        array.header.stamp = now.to_msg()
        name = self._node.get_fully_qualified_name()
        namesake = self._warned_of_namesake(name)
        if observer is None or message_input is None:
            array.status = [idle_status(motor, name, state, {}) for motor in self._next()]
        else:
            self._warn_of_strangers(observer, message_input)
            traffic = self._meter.read(observer, message_input)
            situation = Situation(
                name,
                state,
                observer,
                message_input,
                self._inputs,
                self._meter,
                traffic,
                self._keeper.failure,
                self._keeper.age_s,
                now.nanoseconds,
                is_simulated=clock.ros_time_is_active,  # type: ignore[attr-defined]
                has_namesake=namesake,
            )
            array.status = [_contained_status(motor, situation) for motor in self._next()]
        self._publisher.publish(array)
        return traffic

    def _next(self) -> list[str]:
        """Motors that are told of in this round: all of few, in turn those of many."""
        share = max(AT_ONCE, -(-len(self._motors) // ROUNDS))
        first, self._turn = (
            self._turn,
            (self._turn + share if self._turn + share < len(self._motors) else 0),
        )
        return self._motors[first : first + share]

    def _warned_of_namesake(self, name: str) -> bool:
        """Whether another node has our name, said once while it lasts; nobody can part them."""
        namesake = has_namesake(self._node)
        if namesake and not self._has_warned_of_namesake:
            self._node.get_logger().warning(NAMESAKE.format(name))
        self._has_warned_of_namesake = namesake
        return namesake

    def _warn_of_strangers(self, observer: Observer, message_input: MessageInput) -> None:
        """Warn once where messages name other motors while a configured one is never named."""
        for name in ('voltage', 'torque'):
            strangers = sorted(message_input.signals[name].unknown_names)
            silent = [
                motor
                for motor in self._motors
                if not getattr(observer.counts(motor), f'received_{name}')
            ]
            if strangers and silent and not self._has_warned_of_strangers:
                self._has_warned_of_strangers = True
                self._node.get_logger().warning(
                    f'{message_input.signals[name].topic} speaks of '
                    f'{printable(", ".join(strangers[:5]))} and not of '
                    f'{", ".join(silent)}: give the parameter motors the names in the messages, '
                    'or each motor its joint'
                )


def _contained_status(motor: str, situation: Situation) -> DiagnosticStatus:
    """Describe one motor; one that cannot be described has stopped, and is described as that."""
    observer = situation.observer
    status = observer.contain(observer.group_of(motor), partial(status_of, motor, situation))
    return status_of(motor, situation) if status is None else status
