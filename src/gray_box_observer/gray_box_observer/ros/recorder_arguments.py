"""The command line of the ``recorder``; where ``ros2 bag record`` has an option, it has the same name here."""

from __future__ import annotations

import argparse
from typing import Any

from gray_box_observer.bag.mcap_file import COMPRESSIONS
from gray_box_observer.bag.options import PRESETS

_DESCRIPTION = """Record topics to a rosbag2 folder (MCAP). Topics that appear later are recorded from then on.
Without TOPIC: voltage, torque, voltage command, everything that the observer publishes, and /diagnostics.
SIGINT and SIGTERM finish the bag."""
_PARAMETERS = """parameters (--ros-args -p NAME:=VALUE):
  topics               topics to record, as [/a, /b]
  output               folder to make; default rosbag2_<date and time>
  all                  record every topic, except /parameter_events and /rosout
  include_ros_internals  with all: these two as well
  duration_s           end after this time; 0: when interrupted
  compression          of chunks: none, lz4 or zstd; also --compression-format
  storage_preset_profile  none, fastwrite, zstd_fast or zstd_small instead; also --storage-preset-profile
  max_file_bytes       begin a new file when one is this large; 0: never; also --max-bag-size
  max_file_duration_s  begin a new file when one spans this time; 0: never; also --max-bag-duration
  flush_period_s       at most this much, and what waits in queues, is lost if the recorder is killed
  queue_depth          messages that may wait per topic
"""


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog='recorder',
        description=_DESCRIPTION,
        epilog=_PARAMETERS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('topics', nargs='*', metavar='TOPIC', help='topic to record')
    parser.add_argument('-o', '--output', default='', metavar='FOLDER', help='folder to make')
    parser.add_argument('-a', '--all', action='store_true', help='record every topic')
    parser.add_argument(
        *('-b', '--max-bag-size'), type=int, metavar='BYTES', help='begin a new file when one is this large; 0: never'
    )
    parser.add_argument(
        *('-d', '--max-bag-duration'), type=float, metavar='S', help='begin a new file when one spans this; 0: never'
    )
    packing = parser.add_mutually_exclusive_group()
    packing.add_argument(
        '--compression-format', choices=COMPRESSIONS, help='of the chunks inside a file, which stays readable in place'
    )
    packing.add_argument(
        '--storage-preset-profile', choices=list(PRESETS), help="the same by the names of rosbag2's MCAP storage"
    )
    return parser


def given_options(options: argparse.Namespace) -> dict[str, Any]:
    """What the command line says of how to write, by the names of the parameters."""
    given = {
        'max_file_bytes': options.max_bag_size,
        'max_file_duration_s': options.max_bag_duration,
        'compression': options.compression_format,
        'storage_preset_profile': options.storage_preset_profile,
    }
    if options.compression_format is not None or options.storage_preset_profile is not None:
        given['compression'] = given['compression'] or 'none'
        given['storage_preset_profile'] = given['storage_preset_profile'] or 'none'
    return {name: value for name, value in given.items() if value is not None}
