"""The command line and the parameters of the ``player``, each declared once.

Where ``ros2 bag play`` has an option, it has the same name here.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from gray_box_observer.bag.limits import DEFAULT_CHUNK_MB
from gray_box_observer.ros.bags import foreign_options
from gray_box_observer.ros.listed_parameters import help_text
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.plain_number import parse_float
from gray_box_observer.settings.parameters import ParameterSpec

_DESCRIPTION = """Replay a bag onto the topics that it was recorded from, with the quality of
service that it was recorded with, once voltage and torque have a reader. What an observer
published is left out.
Services: ~/pause, ~/resume, ~/toggle_paused, ~/play_next (std_srvs/srv/Trigger)."""

_REFUSED = {
    (
        '-d',
        '--delay',
    ): 'it waits for readers: --ros-args -p wait_for_subscribers:=2 waits for two of them',
    ('-m', '--remap'): 'rename topics by --ros-args -r /motor/torque:=/other',
    (
        '-e',
        '--regex',
        '-x',
        '--exclude-regex',
        '--exclude-topics',
    ): 'name what is wanted: --topics /a /b',
    ('--services', '--exclude-services', '--publish-service-requests'): 'only topics are replayed',
    (
        '--qos-profile-overrides-path',
    ): 'topics are replayed with the quality of service that they were recorded with',
    ('--playback-duration', '--playback-until-sec', '--playback-until-nsec'): 'end it by Ctrl-C',
    ('--clock-topics', '--clock-topics-all'): '--clock ticks with every message, and between them',
    ('-i', '--input'): 'name one bag without an option',
    (
        '--read-ahead-queue-size',
        '--storage-config-file',
    ): 'leave it out: chunks are read when they are due',
    ('--wait-for-all-acked',): 'leave it out: it waits for acknowledgements',
    ('--disable-keyboard-controls', '--disable-loan-message'): 'leave it out: there are none',
    ('--log-level',): foreign_options.LOG_LEVEL,
    (
        '--progress-bar',
        '--progress-bar-update-rate',
        '--progress-bar-separation-lines',
    ): 'leave it out: a terminal is told how many messages have gone out',
    ('--message-order',): 'leave it out: messages come in the order in which they were recorded',
    ('--service-requests-source',): 'only topics are replayed',
}
"""Options of ``ros2 bag play``, and what serves instead."""

OWN_WAIT = -1
"""Of ``wait_for_subscribers``: one reader, without which the replay begins all the same."""

PLAYER_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('bag', '', 'Rosbag2 folder or .mcap file, if BAG is not given.'),
    ParameterSpec(
        'rate',
        1.0,
        'Recorded seconds per second; 0 or less: as fast as max_messages_per_s allows.',
        -1e9,
        1e9,
    ),
    ParameterSpec(
        'max_messages_per_s',
        1000.0,
        'With rate 0, of all topics together; 0: no limit. Readers acknowledge what has arrived, '
        'not what they have '
        'worked off: one that cannot follow loses messages once its queue is full (identify never '
        'does). What was '
        'recorded faster comes as fast as it was recorded.',
        0.0,
        1e9,
    ),
    ParameterSpec('loop', False, 'Begin again at the end.'),
    ParameterSpec('start_offset_s', 0.0, 'Leave out the first seconds.', 0.0, 1e9),
    ParameterSpec('paused', False, 'Begin paused.'),
    ParameterSpec(
        'topics', [''], 'Replay only these, as [/a, /b]; empty: all but what an observer published.'
    ),
    ParameterSpec(
        'observer_outputs',
        False,
        'Replay what an observer published too: topics of gray_box_observer, and /diagnostics of '
        'a bag that has such. '
        'A live observer publishes them itself.',
    ),
    ParameterSpec(
        'clock',
        False,
        'Publish /clock with the recorded time; it jumps back when a loop begins again.',
    ),
    ParameterSpec(
        'wait_for_subscribers',
        OWN_WAIT,
        'Begin when voltage and torque (if replayed, else every topic) have so many readers, or '
        'end with an error. '
        '-1: wait for one of them (if neither is replayed, for one of any topic), and begin '
        'without in the end; '
        '0: begin at once.',
        OWN_WAIT,
        1000,
    ),
    ParameterSpec('wait_timeout_s', 10.0, 'Wait for readers no longer than this.', 0.0, 1e9),
    ParameterSpec(
        'max_chunk_mb',
        0,
        f'Read chunks of the bag up to so many MB, unpacked; 0: up to {DEFAULT_CHUNK_MB}. '
        'The memory that a bag may take grows with it, to about four times as much.',
        0,
        1_000_000,
    ),
)
"""Parameters of the player, all read-only. 1000 messages a second is five times one motor at 100
Hz, which an observer can follow."""


class _Parser(CommandParser):
    """Refuses the rate that ``--clock`` of ``ros2 bag`` may have, for BAG may stand there too."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As every parser does; a rate behind ``--clock`` ends the command with one line."""
        words = list(sys.argv[1:] if args is None else args)
        for word, next_word in pairwise([*words, '']):
            if word.startswith('--clock=') or (word == '--clock' and _is_number(next_word)):
                self.error(
                    '--clock has no rate here; leave it out: /clock ticks with every message, '
                    'and between them'
                )
        return super().parse_known_args(words, namespace)


def _is_number(word: str) -> bool:
    try:
        parse_float(word)
    except argparse.ArgumentTypeError:
        return False
    return True


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = _Parser(
        prog='player',
        description=_DESCRIPTION,
        epilog=f'{help_text(PLAYER_PARAMETERS)}\n\n'
        'topics are renamed as everywhere in ROS: --ros-args -r /motor/torque:=/other',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'bag', nargs='?', default='', metavar='BAG', help='rosbag2 folder or .mcap file'
    )
    parser.add_argument(
        '-r', '--rate', type=parse_float, metavar='RATE', help='recorded seconds per second'
    )
    parser.add_argument(
        '-l', '--loop', action='store_const', const=True, help='begin again at the end'
    )
    parser.add_argument(
        *('-p', '--start-paused'),
        dest='paused',
        action='store_const',
        const=True,
        help='begin paused',
    )
    parser.add_argument(
        '--start-offset',
        dest='start_offset_s',
        type=parse_float,
        metavar='SECONDS',
        help='leave out the first seconds',
    )
    parser.add_argument(
        '--clock', action='store_const', const=True, help='publish /clock with the recorded time'
    )
    parser.add_argument('--topics', nargs='+', metavar='TOPIC', help='replay only these')
    foreign_options.add_storage(parser)
    foreign_options.refuse(parser, _REFUSED)
    return parser


def by_command_line(options: argparse.Namespace) -> dict[str, Any]:
    """What the command line says, by the names of the parameters that it precedes."""
    names = ('rate', 'loop', 'paused', 'start_offset_s', 'clock', 'topics')
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}
