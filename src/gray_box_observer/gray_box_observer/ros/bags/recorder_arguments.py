"""The command line and the parameters of the ``recorder``, each declared once.

Where ``ros2 bag record`` has an option, it has the same name here.
"""

from __future__ import annotations

import argparse
from typing import Any

from gray_box_observer.bag.mcap.mcap_file import COMPRESSIONS
from gray_box_observer.bag.writing_options import FLUSH_PERIOD_S, PRESETS
from gray_box_observer.ros.bags import foreign_options
from gray_box_observer.ros.listed_parameters import help_text
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.plain_number import parse_float, parse_int
from gray_box_observer.settings.parameters import ParameterSpec

_DESCRIPTION = """Record topics to a rosbag2 folder (MCAP). Topics that appear later are recorded
from then on.
Without TOPIC: voltage, torque, voltage command, everything that the observer publishes, and
/diagnostics.
SIGINT and SIGTERM finish the bag."""

_REFUSED = {
    (
        '--compression-mode',
    ): 'leave it out: --compression-format compresses the chunks inside a file',
    (
        '--compression-queue-size',
        '--compression-threads',
    ): 'leave it out: --compression-format alone serves',
    (
        '-e',
        '--regex',
        '-x',
        '--exclude',
        '--exclude-regex',
        '--exclude-topics',
        '--topic-types',
        '--exclude-topic-types',
        '--ignore-leaf-topics',
    ): 'name what is wanted, or --all',
    ('--services', '--all-services', '--exclude-services'): 'only topics are recorded',
    (
        '--no-discovery',
        '-p',
        '--polling-interval',
    ): 'leave it out: topics that appear later are recorded from then on',
    (
        '--include-hidden-topics',
        '--include-unpublished-topics',
    ): 'name the topics: those are recorded, hidden or not',
    (
        '--qos-profile-overrides-path',
    ): 'topics are recorded with the quality of service that is offered',
    ('--use-sim-time',): 'say --ros-args -p use_sim_time:=true',
    ('--node-name',): 'say --ros-args -r __node:=NAME',
    (
        '--max-cache-size',
        '--snapshot-mode',
        '--start-paused',
    ): 'leave it out: what comes is written within half a second',
    ('--storage-config-file',): '--storage-preset-profile chooses how to write',
    ('-f', '--serialization-format'): 'leave it out: messages are recorded as they come',
    ('--disable-keyboard-controls',): 'leave it out: there are none',
    ('--log-level',): foreign_options.LOG_LEVEL,
    ('--custom-data',): 'leave it out: keep notes in a file beside the bag',
    ('--compression-threads-priority',): 'leave it out: --compression-format alone serves',
}
"""Options of ``ros2 bag record``, and what serves instead."""

RECORDER_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('topics', [''], 'Topics to record, as [/a, /b].'),
    ParameterSpec('output', '', 'Folder to make; empty: rosbag2_ with date and time.'),
    ParameterSpec('all', False, 'Record every topic, except /parameter_events and /rosout.'),
    ParameterSpec('include_ros_internals', False, 'With all: these two as well.'),
    ParameterSpec(
        'duration_s',
        0.0,
        'End after this time by the clock on the wall; 0: when interrupted.',
        0.0,
        1e9,
    ),
    ParameterSpec(
        'compression',
        'none',
        'Of the chunks inside a file, which stays readable in place.',
        choices=COMPRESSIONS,
    ),
    ParameterSpec(
        'storage_preset_profile',
        'none',
        "The same by the names of rosbag2's MCAP storage; fastwrite is as none, for chunks and "
        'checksums stay.',
        choices=tuple(PRESETS),
    ),
    ParameterSpec(
        'max_file_bytes', 0, 'Begin a new file when one is this large; 0: never.', 0, 10**15
    ),
    ParameterSpec(
        'max_file_duration_s', 0.0, 'Begin a new file when one spans this time; 0: never.', 0.0, 1e9
    ),
    ParameterSpec(
        'flush_period_s',
        FLUSH_PERIOD_S,
        'At most this much, and what waits in queues, is lost if the recorder is killed.',
        0.0,
        1e9,
    ),
    ParameterSpec('queue_depth', 5000, 'Messages that may wait per topic.', 1, 1_000_000),
)
"""Parameters of the recorder, all read-only."""


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = CommandParser(
        prog='recorder',
        description=_DESCRIPTION,
        epilog=help_text(RECORDER_PARAMETERS),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('topics', nargs='*', metavar='TOPIC', help='topic to record')
    parser.add_argument('-o', '--output', default='', metavar='FOLDER', help='folder to make')
    parser.add_argument(
        '-a', '--all', '--all-topics', action='store_true', help='record every topic'
    )
    parser.add_argument(
        '--topics',
        dest='more_topics',
        nargs='+',
        default=[],
        metavar='TOPIC',
        help='the same as TOPIC',
    )
    parser.add_argument(
        *('-b', '--max-bag-size'),
        dest='max_file_bytes',
        type=parse_int,
        metavar='BYTES',
        help='begin a new file when one is this large; 0: never',
    )
    parser.add_argument(
        *('-d', '--max-bag-duration'),
        dest='max_file_duration_s',
        type=parse_float,
        metavar='SECONDS',
        help='begin a new file when one spans this time; 0: never',
    )
    packing_options = parser.add_mutually_exclusive_group()
    packing_options.add_argument(
        '--compression-format',
        dest='compression',
        choices=COMPRESSIONS,
        help='compression of the chunks inside a file, which stays readable in place',
    )
    packing_options.add_argument(
        '--storage-preset-profile',
        choices=list(PRESETS),
        help="the same by the names of rosbag2's MCAP storage",
    )
    foreign_options.add_storage(parser)
    foreign_options.refuse(parser, _REFUSED)
    return parser


def by_command_line(options: argparse.Namespace) -> dict[str, Any]:
    """What the command line says of writing, by the names of overridden parameters."""
    names = ('max_file_bytes', 'max_file_duration_s', 'compression', 'storage_preset_profile')
    values = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if values.keys() & {
        'compression',
        'storage_preset_profile',
    }:  # one of them; it replaces both parameters
        values = {'compression': 'none', 'storage_preset_profile': 'none', **values}
    return values
