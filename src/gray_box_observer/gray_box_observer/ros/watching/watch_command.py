"""The command ``watch``: live topics, or a bag, which needs no ROS."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from gray_box_observer.errors import ConfigurationError, GrayBoxError
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.plain_number import parse_float, parse_int
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.watching.observer_state import SILENT_S

EXIT_DONE = 0
EXIT_USER_ERROR = 2

MOST_MOTORS = 20

PARAMETER_OPTIONS = ('-p', '--param')
PARAMETER_FILE_OPTIONS = ('--params-file',)

_DESCRIPTION = """Show every motor of every observer in a table: values, deviations, verdicts, fit,
rates, the advice of the moment and the course of the last minutes.
With BAG: what an observer said when it was recorded; of a bag that holds no estimates, what the
observer says of it now."""


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = CommandParser(
        prog='watch',
        description=_DESCRIPTION,
        epilog='In a pipe, plain tables without colours. Ctrl-C ends it.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'bag', nargs='?', type=Path, metavar='BAG', help='rosbag2 folder or .mcap file'
    )
    parser.add_argument(
        '--observer',
        action='append',
        default=[],
        metavar='NAME',
        help='watch only this node, such as /r1/gray_box_observer; may be repeated',
    )
    parser.add_argument(
        '--period',
        type=parse_float,
        default=1.0,
        metavar='S',
        help='of the table (default 1)',
    )
    parser.add_argument(
        '--motors',
        type=parse_int,
        default=MOST_MOTORS,
        metavar='N',
        help=f'show so many of each observer, those with trouble first (default {MOST_MOTORS})',
    )
    parser.add_argument('--once', action='store_true', help='show the first complete table and end')
    parser.add_argument(
        '--timeout',
        type=parse_float,
        default=SILENT_S,
        metavar='S',
        help='with --once, show what was heard after so long at the latest '
        f'(default {SILENT_S:g}); exit code 2 where that is nothing',
    )
    parser.add_argument(
        '-r',
        '--rate',
        type=parse_float,
        metavar='RATE',
        help='of a BAG: recorded seconds per second; 0 (default): as fast as possible',
    )
    parser.add_argument(
        '--params',
        type=Path,
        metavar='FILE.yaml',
        help="of a BAG without estimates: the observer's parameter file",
    )
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the result is the exit code."""
    words = list(sys.argv if args is None else args)
    own_words, of_ros = part_words(words[1:])
    parser = make_parser()
    options = parser.parse_args(own_words)
    _check(parser, options, of_ros)
    observers = ['/' + name.strip('/') for name in options.observer]
    try:
        refuse_parameters(of_ros)
        if options.bag is None:
            from gray_box_observer.ros.watching.watch_node import watch_live

            return watch_live(
                [words[0], *of_ros],
                observers,
                options.period,
                options.motors,
                once=options.once,
                timeout_s=options.timeout,
            )
        _watch_bag(options, tuple(observers))
    except GrayBoxError as error:
        _tell(f'error: {" ".join(str(error).split())}')
        return EXIT_USER_ERROR
    except KeyboardInterrupt:
        pass
    return EXIT_DONE


def part_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Part a command's own words from those of ROS, which go from ``--ros-args`` to ``--``."""
    own: list[str] = []
    of_ros: list[str] = []
    is_of_ros = False
    for word in words:
        is_of_ros = is_of_ros or word == '--ros-args'
        (of_ros if is_of_ros else own).append(word)
        is_of_ros = is_of_ros and word != '--'
    return own, of_ros


def refuse_parameters(of_ros: Sequence[str]) -> None:
    """Refuse parameters among the words of ROS, for nobody would read them.

    ``use_sim_time`` is of every node: a launch file may give it to all.

    Raises:
        ConfigurationError: there is one.
    """
    for option, text in pairwise([*of_ros, '']):
        name = text.partition(':=')[0].rpartition(':')[2]
        if option in PARAMETER_FILE_OPTIONS or (
            option in PARAMETER_OPTIONS and name != 'use_sim_time'
        ):
            words = f'{option} {text}'.strip()
            raise ConfigurationError(
                f'{words}: this node has no parameters; --help lists its options'
            )


def _check(
    parser: argparse.ArgumentParser, options: argparse.Namespace, of_ros: Sequence[str]
) -> None:
    """Refuse what does not go together; exits with code 2."""
    if not 0.05 <= options.period <= 1e6:
        parser.error('--period must be from 0.05 to 1e6 seconds')
    if not 0.1 <= options.timeout <= 1e6:
        parser.error('--timeout must be from 0.1 to 1e6 seconds')
    if not 1 <= options.motors <= 100_000:
        parser.error('--motors must be from 1 to 100000')
    if options.bag is None:
        for name in ('rate', 'params'):
            if getattr(options, name) is not None:
                parser.error(f'--{name} is for a BAG')
        return
    if of_ros:
        parser.error('--ros-args is for live topics, not for a BAG')
    if options.rate is not None and not 0.0 <= options.rate <= 1e9:
        parser.error('--rate must be from 0 to 1e9')


def _watch_bag(options: argparse.Namespace, observers: tuple[str, ...]) -> None:
    """Show a bag."""
    from gray_box_observer.settings.ros_parameter_file import read_parameter_file
    from gray_box_observer.watching.recorded_run import Playback, watch_bag
    from gray_box_observer.watching.table_display import TableDisplay

    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    parameter_values = read_parameter_file(options.params) if options.params else {}
    rate = 0.0 if options.once or options.rate is None else options.rate
    period_s = 0.0 if options.once else options.period
    with TableDisplay(sys.stdout, options.motors, live=not options.once) as display:
        playback = Playback(rate, period_s, observers)
        warnings = watch_bag(options.bag, parameter_values, playback, display)
    for warning in warnings:
        _tell(f'warning: {warning}')


def _tell(text: str) -> None:
    print(printable(f'watch: {text}'), file=sys.stderr, flush=True)


if __name__ == '__main__':
    raise SystemExit(main())
