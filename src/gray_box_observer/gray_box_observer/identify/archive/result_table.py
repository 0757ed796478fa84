"""The results of an archive as one Parquet table: one row a bag, motor and parameter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify.archive.bag_work import BagResult
from gray_box_observer.safe_io.atomic_write import atomic_write

COLUMNS = {
    'bag': 'string',
    'motor': 'string',
    'parameter': 'string',
    'start': 'timestamp',
    'duration_s': 'double',
    'samples': 'int64',
    'value': 'double',
    'std': 'double',
    'unit': 'string',
    'verdict': 'string',
    'alarms': 'int64',
    'warnings': 'string',
    'digest': 'string',
    'error': 'string',
}
"""Name and type of every column; docs/ARCHIVES.md says what they mean."""


def require_pyarrow() -> None:
    """Say before a run that its table could not be written; loads nothing.

    Raises:
        GrayBoxError: pyarrow is not installed.
    """
    if find_spec('pyarrow') is None:
        raise GrayBoxError(
            '--table needs pyarrow, which is not installed: pip install pyarrow, or leave out '
            '--table'
        )


def rows(results: Iterable[BagResult]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table; a failed bag has one row without motor and parameter."""
    for result in results:
        common = dict.fromkeys(COLUMNS) | {
            'bag': result.bag,
            'warnings': '; '.join(result.warnings) or None,
            'digest': result.digest,
            'error': result.error,
        }
        if not result.motors:
            yield common
        for name, motor in result.motors.items():
            alarms = motor['alarms']
            of_motor = common | {
                'motor': name,
                'start': result.start_ns[name],
                'duration_s': motor['duration_s'],
                'samples': motor['samples'],
                'alarms': None if alarms is None else alarms['raised'],
            }
            for parameter, figures in motor['parameters'].items():
                yield of_motor | {'parameter': parameter, **figures}


def write_table(results: Iterable[BagResult], path: Path) -> None:
    """Write the table as a whole or not at all.

    Args:
        results: of the bags, in the order of the table.
        path: a ``.parquet`` file; missing folders are made, an older table is replaced.

    Raises:
        GrayBoxError: pyarrow is not installed, or the file cannot be written.
    """
    require_pyarrow()
    import pyarrow
    from pyarrow import parquet

    types = {'string': pyarrow.string(), 'int64': pyarrow.int64(), 'double': pyarrow.float64()}
    types['timestamp'] = pyarrow.timestamp('ns', tz='UTC')
    schema = pyarrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
    table = pyarrow.Table.from_pylist(list(rows(results)), schema=schema)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            parquet.write_table(table, file)
    except OSError as error:
        raise GrayBoxError(f'cannot write the table {path}: {error.strerror or error}') from error
