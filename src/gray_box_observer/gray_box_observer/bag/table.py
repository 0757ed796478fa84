"""Reading a log's text: comma, semicolon, tab or blanks between the cells, comments behind ``%`` or ``#``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import BagError

_COMMENTS = ('%', '#')
_DELIMITERS = (',', ';', '\t')


@dataclass(frozen=True, slots=True)
class TableShape:
    """What the head of a log tells.

    Attributes:
        names: The columns' names; empty if the log has none.
        column_count: Cells in the first row of numbers.
        delimiter: None for blanks.
    """

    names: tuple[str, ...]
    column_count: int
    delimiter: str | None


def look_at(path: Path) -> TableShape:
    """Find out how a log is laid out.

    Raises:
        BagError: The log cannot be read or holds no rows.
    """
    rows = _rows(path)
    first = next(rows, None)
    if first is None:
        raise BagError(f'{path} holds no rows')
    delimiter = next((d for d in _DELIMITERS if d in first[1]), None)
    cells = _cells(first[1], delimiter)
    if all(_is_number(cell) for cell in cells if cell) and any(cells):
        return TableShape((), len(cells), delimiter)
    names = tuple(cell.strip().strip('"\'').strip() for cell in cells)
    if next(rows, None) is None:
        raise BagError(f'{path} holds a header but no rows')
    return TableShape(names, len(names), delimiter)


def read_columns(path: Path, shape: TableShape, wanted: Collection[int]) -> dict[int, NDArray[np.float64]]:
    """Read some columns of a log.

    Args:
        path: The log.
        shape: What `look_at` found.
        wanted: 1-based numbers of the columns.

    Returns:
        The columns by number.  shape of each: (row,)

    Raises:
        BagError: A wanted cell is missing or no number; says which.
    """
    rows = _rows(path)
    if shape.names:
        next(rows, None)
    numbers = sorted(wanted) or [1]
    columns: dict[int, list[float]] = {number: [] for number in numbers}
    for line_number, line in rows:
        cells = _cells(line, shape.delimiter)
        for number in numbers:
            try:
                columns[number].append(float(cells[number - 1]))
            except (IndexError, ValueError):
                raise BagError(_complaint(path, shape, line_number, cells, number)) from None
    return {number: np.array(values, dtype=np.float64) for number, values in columns.items()}


def _complaint(path: Path, shape: TableShape, line_number: int, cells: list[str], number: int) -> str:
    name = f' ({shape.names[number - 1]})' if shape.names else ''
    if number > len(cells):
        return f'{path}, line {line_number}: {len(cells)} columns, but column {number}{name} is needed'
    return f'{path}, line {line_number}, column {number}{name}: {cells[number - 1][:40]!r} is no number'


def _cells(line: str, delimiter: str | None) -> list[str]:
    return line.split(delimiter)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _rows(path: Path) -> Iterator[tuple[int, str]]:
    """The lines that are neither empty nor comments, with their line numbers."""
    try:
        # Comments may be in any encoding; numbers read the same in all of them.
        with path.open(encoding='utf-8-sig', errors='replace', newline=None) as stream:
            for number, line in enumerate(stream, start=1):
                stripped = line.strip()
                if stripped and not stripped.startswith(_COMMENTS):
                    yield number, line.strip('\r\n ')
    except OSError as error:
        raise BagError(f'{path}: cannot be read: {error.strerror or error}') from None
