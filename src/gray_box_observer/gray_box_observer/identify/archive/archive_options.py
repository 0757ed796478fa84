"""What ``identify`` may be asked of archives; loads nothing of what then does the work."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.safe_io.plain_number import parse_int

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130
DEFAULT_RETRIES = 2
MOST_WORKERS = 1024
MOST_RETRIES = 1000


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of reading every bag by itself."""
    group = parser.add_argument_group(
        'archives', 'every bag by itself instead of all as one recording'
    )
    group.add_argument(
        '--each',
        action='store_true',
        help='identify every BAG by itself; BAG may be a folder of bags, at any depth',
    )
    group.add_argument(
        '--table',
        type=Path,
        metavar='FILE.parquet',
        help='--each, and one row a bag, motor and parameter there',
    )
    group.add_argument(
        '--engine',
        choices=('serial', 'processes', 'dask'),
        help='--each, one bag after another (default), over processes of this machine, or over the '
        'Dask cluster of '
        '--scheduler; dask without --scheduler means processes',
    )
    group.add_argument(
        '--workers',
        type=between(1, MOST_WORKERS),
        metavar='N',
        help='worker processes of this machine; a core each by default',
    )
    group.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='a Dask cluster that is there, such as tcp://host:8786: whoever may connect to it may '
        'run code in it',
    )
    group.add_argument(
        '--retries',
        type=between(0, MOST_RETRIES),
        metavar='N',
        help=f'how often a bag is taken up again after its worker died (default {DEFAULT_RETRIES})',
    )


def is_asked(options: argparse.Namespace) -> bool:
    """Whether the options ask for every bag by itself.

    Raises:
        GrayBoxError: an option has no meaning without another one.
    """
    if options.scheduler is not None and options.engine != 'dask':
        raise GrayBoxError('--scheduler needs --engine dask')
    for name, value in (('--workers', options.workers), ('--retries', options.retries)):
        if value is not None and options.engine not in ('processes', 'dask'):
            raise GrayBoxError(f'{name} needs --engine processes')
        if value is not None and options.scheduler is not None:
            raise GrayBoxError(
                f'{name} is for processes of this machine; {options.scheduler} has its own'
            )
    return bool(options.each or options.table is not None or options.engine is not None)


def between(lowest: int, highest: int) -> Callable[[str], int]:
    """Make what reads a whole number of the command line, within these bounds."""

    def number(text: str) -> int:
        value = parse_int(text)
        if not lowest <= value <= highest:
            raise argparse.ArgumentTypeError(f'must be from {lowest} to {highest}, got {value}')
        return value

    return number
