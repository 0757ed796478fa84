"""The command ``dashboard``: a page that shows observers while they run."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gray_box_observer.errors import GrayBoxError, InputError
from gray_box_observer.ros.watching.watch_command import (
    EXIT_USER_ERROR,
    part_words,
    refuse_parameters,
)
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.safe_io.plain_number import parse_int
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.settings.ros_parameter_file import read_parameter_file

LOOPBACK = '127.0.0.1'
STDIN = 0
LARGEST_SETTINGS = 16_000_000

_DESCRIPTION = """Show observers in a browser while they run: estimates with bands, voltage, torque
with its prediction and residual, verdicts and advice. The page is read only, and needs no network
but the way to here."""


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = CommandParser(
        prog='dashboard',
        description=_DESCRIPTION,
        epilog='The first line of standard output says where the page is. Ctrl-C ends it.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--port', type=parse_int, default=0, metavar='N', help='0 (default): one that is free'
    )
    parser.add_argument(
        '--address',
        default=LOOPBACK,
        metavar='ADDRESS',
        help=f'to listen on (default {LOOPBACK}, this host only); whoever reaches it may look',
    )
    parser.add_argument(
        '--observer',
        action='append',
        default=[],
        metavar='NAME',
        help='show only this node, such as /r1/gray_box_observer; may be repeated',
    )
    parser.add_argument(
        '--params',
        type=Path,
        metavar='FILE.yaml',
        help="the observer's parameter file: it says how voltage and torque are read",
    )
    parser.add_argument('--of-observer', action='store_true', help=argparse.SUPPRESS)
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; the result is the exit code."""
    words = list(sys.argv if args is None else args)
    own_words, of_ros = part_words(words[1:])
    parser = make_parser()
    options = parser.parse_args(own_words)
    if not 0 <= options.port <= 65_535:
        parser.error('--port must be from 0 to 65535')
    try:
        refuse_parameters(of_ros)
        settings = _settings(options)
    except GrayBoxError as error:
        print(printable(f'dashboard: error: {error}'), file=sys.stderr, flush=True)
        return EXIT_USER_ERROR
    from gray_box_observer.ros.watching.dashboard_node import DashboardSettings, serve

    return serve([words[0], *of_ros], DashboardSettings(**settings))


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """Return what to show, from the command line or from the observer that starts it."""
    parameters = _parameters_of_file(options.params) if options.params else {}
    settings: dict[str, Any] = {
        'address': options.address,
        'port': options.port,
        'observers': tuple('/' + name.strip('/') for name in options.observer),
        'parameters': parameters,
    }
    if options.of_observer:
        settings |= _read_signals(_first_line(STDIN))
        threading.Thread(target=_end_with_observer, daemon=True, name='observer').start()
        _give_way()
    return settings


def _parameters_of_file(path: Path) -> dict[str, Any]:
    """Return what a parameter file of an observer says.

    Raises:
        GrayBoxError: it cannot be read, or misspells a parameter.
    """
    from gray_box_observer.settings.configuration import Configuration

    parameters = read_parameter_file(path)
    Configuration.from_flat(parameters).require_no_slips()
    return parameters


def _read_signals(line: bytes) -> dict[str, Any]:
    """Return parameters and resolved topics from the line that an observer writes.

    Raises:
        InputError: the line is none of an observer, or ended early.
    """
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        data = None
    names = ('parameters', 'topic_names')
    if not isinstance(data, dict) or not all(isinstance(data.get(name), dict) for name in names):
        raise InputError(
            'the observer that started this has not said how it reads its signals: it may have '
            'ended; --of-observer is for observers alone'
        )
    return {name: data[name] for name in names}


def _first_line(descriptor: int) -> bytes:
    """Read up to a line feed, by the system itself: at the end a thread may still be reading."""
    line = bytearray()
    while not line.endswith(b'\n') and len(line) < LARGEST_SETTINGS:
        part = os.read(descriptor, 65_536)
        if not part:
            break
        line += part
    return bytes(line)


def _end_with_observer() -> None:
    """Ask for the end when the observer that has started this has ended, however it did."""
    while os.read(STDIN, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _give_way() -> None:
    """Give sampling precedence: low priority, never the real-time one of the observer."""
    if hasattr(os, 'SCHED_BATCH'):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    os.nice(10)


if __name__ == '__main__':
    raise SystemExit(main())
