"""What ``identify`` may be asked of archives; loads nothing of what then does the work."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from gray_box_observer.errors import GrayBoxError

EXIT_SOME_FAILED = 3
EXIT_INTERRUPTED = 130
DEFAULT_RETRIES = 2


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options of reading every bag by itself."""
    group = parser.add_argument_group('archives', 'every bag by itself instead of all as one recording')
    group.add_argument(
        '--each', action='store_true', help='identify every BAG by itself; BAG may be a folder of bags, at any depth'
    )
    group.add_argument(
        '--table', type=Path, metavar='FILE.parquet', help='--each, and one row a bag, motor and parameter there'
    )
    group.add_argument(
        '--engine',
        choices=('serial', 'dask'),
        help='--each, one bag after another (default) or spread by dask.distributed',
    )
    group.add_argument(
        '--workers', type=_at_least(1), metavar='N', help='worker processes of dask; a core each by default'
    )
    group.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='an existing Dask cluster, such as tcp://host:8786; else one is started here',
    )
    group.add_argument(
        '--retries',
        type=_at_least(0),
        metavar='N',
        help=f'how often a bag is taken up again after its worker died (default {DEFAULT_RETRIES})',
    )


def is_asked(options: argparse.Namespace) -> bool:
    """Whether the options ask for every bag by itself.

    Raises:
        GrayBoxError: an option has no meaning without another one.
    """
    needs = (('--workers', options.workers), ('--scheduler', options.scheduler), ('--retries', options.retries))
    for name, value in needs:
        if value is not None and options.engine != 'dask':
            raise GrayBoxError(f'{name} needs --engine dask')
        if value is not None and options.scheduler is not None and name != '--scheduler':
            raise GrayBoxError(f'{name} is for a cluster started here; the one at {options.scheduler} has its own')
    return bool(options.each or options.table is not None or options.engine is not None)


def _at_least(lowest: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        value = int(text)
        if value < lowest:
            raise argparse.ArgumentTypeError(f'must be at least {lowest}, got {value}')
        return value

    return number
