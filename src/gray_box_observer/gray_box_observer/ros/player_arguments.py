"""The command line and the parameters of the ``player``, each declared once."""

from __future__ import annotations

import argparse

from gray_box_observer.bag.limits import DEFAULT_CHUNK_MB
from gray_box_observer.parameters import ParameterSpec
from gray_box_observer.ros.listed_parameters import help_text

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
    ParameterSpec(
        'max_chunk_mb',
        0,
        f'Read chunks of the bag up to so many MB, unpacked; 0: up to {DEFAULT_CHUNK_MB}. '
        'The memory that a bag may take grows with it, to about four times as much.',
        0,
        1_000_000,
    ),
)
"""Parameters of the player, all read-only. 1000 messages a second is five times one motor at 100 Hz, which an observer
can follow."""


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog='player',
        description=_DESCRIPTION,
        epilog=f'{help_text(PLAYER_PARAMETERS)}\n\n'
        'topics are renamed as everywhere in ROS: --ros-args -r /motor/torque:=/other',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', nargs='?', default='', metavar='BAG', help='rosbag2 folder or .mcap file')
    return parser
