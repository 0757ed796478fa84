"""What the code says of the nodes: each is made once, on no network, and looked at."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import rclpy
from rclpy.node import Node
from rclpy.utilities import try_shutdown

from dc_motor_sim.ros import motor_sim
from gray_box_observer.ros import running
from gray_box_observer.ros.bags import player_node, recorder_node
from gray_box_observer.ros.observer import observer_node

ROOT = Path(__file__).resolve().parent.parent

ARGUMENTS = (
    *(
        '--ros-args',
        '--disable-stdout-logs',
        '--disable-external-lib-logs',
        '--disable-rosout-logs',
    ),
    *('-p', 'gray_box_observer:horizon_s:=0.1'),
    *('-p', 'motor_sim:publish_clock:=true'),
    *('-p', 'bag_player:clock:=true', '-p', 'bag_player:paused:=true'),
)
"""Whatever makes a node open everything that it can open."""


@dataclass
class Seen:
    """What one node has opened and declared.

    Attributes:
        publishes, subscribes: full topic names.
        services: full names and types.
        declared: parameters in the order of their declaration: default and descriptor by name.
    """

    publishes: set[str] = field(default_factory=set)
    subscribes: set[str] = field(default_factory=set)
    services: dict[str, str] = field(default_factory=dict)
    declared: dict[str, tuple[Any, Any]] = field(default_factory=dict)


def look_at_nodes() -> dict[str, Seen]:
    """Make every node once, without a network, and note what it opens; by node name."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'OFF'
    stop = running.Stop()
    with tempfile.TemporaryDirectory() as folder:
        makers: dict[str, Callable[[], Node]] = {
            'motor_sim': motor_sim.MotorSim,
            'gray_box_observer': lambda: observer_node.ObserverNode(stop),
            'bag_recorder': lambda: recorder_node.BagRecorder(stop, output=f'{folder}/bag'),
            'bag_player': lambda: player_node.BagPlayer(stop, str(ROOT / 'bags' / 'moderate')),
        }
        rclpy.init(args=list(ARGUMENTS))
        try:
            return {name: _look(make) for name, make in makers.items()}
        finally:
            try_shutdown()


def _look(make: Callable[[], Node]) -> Seen:
    seen = Seen()
    with _declarations_noted(seen):
        node = make()
    try:
        seen.publishes = {publisher.topic_name for publisher in node.publishers}
        seen.subscribes = {subscription.topic_name for subscription in node.subscriptions}
        seen.services = {
            node.resolve_service_name(service.srv_name): type_name(service.srv_type)
            for service in node.services
        }
    finally:
        closed: Any = node
        if not isinstance(node, motor_sim.MotorSim):  # it would wait for readers
            closed.close()
        node.destroy_node()
    return seen


@contextmanager
def _declarations_noted(seen: Seen) -> Iterator[None]:
    original = Node.declare_parameter

    def declare(
        node: Node, name: str, value: Any = None, descriptor: Any = None, *rest: Any, **named: Any
    ) -> Any:
        seen.declared[name] = value, descriptor
        given = () if descriptor is None else (descriptor,)
        return original(node, name, value, *given, *rest, **named)

    with mock.patch.object(Node, 'declare_parameter', declare):
        yield


def parser_of(module: ModuleType) -> argparse.ArgumentParser:
    """The parser that a module's ``main`` makes."""
    made: list[argparse.ArgumentParser] = []

    def catch(parser: argparse.ArgumentParser, _args: object) -> None:
        made.append(parser)
        raise SystemExit

    with mock.patch.object(module, 'parse_arguments', catch), suppress(SystemExit):
        module.main([])
    return made[0]


def type_name(kind: Any) -> str:
    """The name of a message or service type, as ROS writes it."""
    package, folder, *_ = kind.__module__.split('.')
    return f'{package}/{folder}/{kind.__name__}'
