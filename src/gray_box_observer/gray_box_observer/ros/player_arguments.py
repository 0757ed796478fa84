"""The command line and the parameters of the ``player``, each declared once."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from rclpy.node import Node

from gray_box_observer.parameters import ParameterSpec
from gray_box_observer.ros.parameters import describe

_DESCRIPTION = """Replay a bag onto the topics that it was recorded from, with the quality of service that it
was recorded with. Services: ~/pause, ~/resume, ~/toggle_paused, ~/play_next (std_srvs/srv/Trigger)."""

PLAYER_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('bag', '', 'Rosbag2 folder or .mcap file, if BAG is not given.'),
    ParameterSpec(
        'rate', 1.0, 'Recorded seconds per second; 0 or less: as fast as max_messages_per_s allows.', -1e9, 1e9
    ),
    ParameterSpec(
        'max_messages_per_s',
        1000.0,
        'With rate 0, of all topics together; 0: no limit. Readers acknowledge what has arrived, not what they have '
        'worked off: one that cannot follow loses messages once its queue is full (identify never does). What was '
        'recorded faster comes as fast as it was recorded.',
        0.0,
        1e9,
    ),
    ParameterSpec('loop', False, 'Begin again at the end.'),
    ParameterSpec('start_offset_s', 0.0, 'Leave out the first seconds.', 0.0, 1e9),
    ParameterSpec('paused', False, 'Begin paused.'),
    ParameterSpec('topics', [''], 'Replay only these, as [/a, /b]; empty: all.'),
    ParameterSpec('clock', False, 'Publish /clock with the recorded time; it jumps back when a loop begins again.'),
    ParameterSpec(
        'wait_for_subscribers',
        0,
        'Begin when voltage and torque (if replayed, else every topic) have so many readers.',
        0,
        1000,
    ),
    ParameterSpec('wait_timeout_s', 10.0, 'Give up waiting for readers after this time.', 0.0, 1e9),
)
"""Parameters of the player, all read-only. 1000 messages a second is five times one motor at 100 Hz, which an observer
can follow."""


def declare(node: Node) -> dict[str, Any]:
    """Declare every parameter and return the values by name.

    Raises:
        ConfigurationError: a value of the wrong type or out of its range.
    """
    given = {name: parameter.value for name, parameter in getattr(node, '_parameter_overrides', {}).items()}
    values = {spec.name: spec.check(given.get(spec.name, spec.default)) for spec in PLAYER_PARAMETERS}
    for spec in PLAYER_PARAMETERS:  # rclpy refuses 1 for 1.0, so what was checked is declared
        node.declare_parameter(spec.name, values[spec.name], describe(spec), ignore_override=True)
    return values


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog='player',
        description=_DESCRIPTION,
        epilog=f'parameters (--ros-args -p NAME:=VALUE):\n{_parameters_text()}\n\n'
        'topics are renamed as everywhere in ROS: --ros-args -r /motor/torque:=/other',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', nargs='?', default='', metavar='BAG', help='rosbag2 folder or .mcap file')
    return parser


def _parameters_text() -> str:
    width = max(len(spec.name) for spec in PLAYER_PARAMETERS) + 4
    lines = [
        textwrap.fill(
            spec.description, 110, initial_indent=f'  {spec.name}'.ljust(width), subsequent_indent=' ' * width
        )
        for spec in PLAYER_PARAMETERS
    ]
    return '\n'.join(lines)
