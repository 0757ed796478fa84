"""Reads a log's text: comma, semicolon, tab or blanks; comments behind ``%`` or ``#``.

Every row must have the cells that the first one promises, and a cell that is asked for must be a
number in ASCII digits: a log that could mean something else is refused by line, column and content.
Of a MAT file (`mat_table.py`) the vectors are the columns.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.csv_import.mat_table import is_mat, read_vectors, vector_names
from gray_box_observer.errors import BagError, InputError, brief
from gray_box_observer.safe_io.input_files import open_regular
from gray_box_observer.safe_io.plain_number import parse_float

_COMMENTS = ('%', '#')
_DELIMITERS = (',', ';', '\t')
_LONGEST_LINE = 1 << 20
_COMMA_NUMBER = re.compile(r'[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?')
_DECIMAL_COMMA = re.compile(r'(?<![0-9])[0-9]+,[0-9]+')


@dataclass(frozen=True)
class TableShape:
    """What the head of a log tells.

    Attributes:
        names: The columns' names; empty if the log has none.
        column_count: Cells in the first row.
        delimiter: None for blanks; where it is no comma, numbers may have a decimal comma.
        warnings: What looks odd, each one line.
    """

    names: tuple[str, ...]
    column_count: int
    delimiter: str | None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Columns:
    """Some columns of a log.

    Attributes:
        values: By the columns' numbers.  shape of each: (row,)
        lines: Which line of the file each row is.  shape: (row,)
        warnings: What looks odd, each one line.
    """

    values: dict[int, NDArray[np.float64]]
    lines: NDArray[np.int64]
    warnings: tuple[str, ...] = ()


def look_at(path: Path) -> TableShape:
    """Find out how a log is laid out.

    Raises:
        BagError: The log cannot be read or holds no rows.
    """
    if is_mat(path):
        names = vector_names(path)
        return TableShape(names, len(names), None)
    rows = _rows(path)
    line_number, line = next(rows, (0, ''))
    if not line:
        raise BagError(f'{path} holds no rows')
    next_line = next(rows, (0, ''))[1]
    delimiter = _delimiter(line, next_line)
    cells = _cells(path, line_number, line, delimiter)
    nonempty_cells = [cell for cell in cells if cell.strip()]
    numbers = [cell for cell in nonempty_cells if _is_number(_with_point(cell, delimiter))]
    if nonempty_cells and len(numbers) == len(nonempty_cells):
        return TableShape((), len(cells), delimiter)
    names = tuple(cell.strip().strip('"\'').strip() for cell in cells)
    if not next_line:
        raise BagError(f'{path} holds a header but no rows')
    odd = (
        f'{path}, line {line_number} is taken for the names of the columns, although '
        f'{brief(numbers[:1])[1:-1]} is '
    )
    return TableShape(names, len(names), delimiter, (f'{odd}a number in it',) if numbers else ())


def read_columns(path: Path, shape: TableShape, column_numbers: Collection[int]) -> Columns:
    """Read some columns of a log.

    Args:
        path: The log.
        shape: What `look_at` found.
        column_numbers: 1-based numbers of the columns.

    Raises:
        BagError: A row has other cells than the first, or a wanted cell is no number; says where.
    """
    if is_mat(path):
        vectors = read_vectors(path, shape.names, column_numbers)
        row_count = next(iter(vectors.values())).size
        return Columns(vectors, np.arange(1, row_count + 1))
    rows = _rows(path)
    if shape.names:
        next(rows, None)
    count = shape.column_count
    delimiter = shape.delimiter
    numbers = sorted(column_numbers) or [1]
    columns: dict[int, list[float]] = {number: [] for number in numbers}
    lines: list[int] = []
    ended_lines: list[int] = []
    first_comma: tuple[int, int] | None = None
    for line_number, line in rows:
        cells = (
            line.split(delimiter) if '"' not in line else _cells(path, line_number, line, delimiter)
        )
        if len(cells) != count:
            cells = _fitting(path, shape, line_number, line, cells)
            if len(cells) > count:
                ended_lines.append(line_number)
        parse = float if line.isascii() and '_' not in line else parse_float
        for number, values in columns.items():
            cell = cells[number - 1]
            try:
                values.append(parse(cell))
            except ValueError:
                with_point = _with_point(cell, delimiter)
                if with_point == cell or not _is_number(with_point):
                    raise BagError(
                        _complaint(path, shape, line_number, cells, number, numbers)
                    ) from None
                values.append(parse_float(with_point))
                first_comma = first_comma or (line_number, number)
        lines.append(line_number)
    warnings = shape.warnings
    if first_comma is not None:
        line_number, number = first_comma
        _refuse_points(path, shape, numbers, line_number)
        where = (
            f'{path}, line {line_number}, {_column_words(shape, number)}: a comma within a number '
            'is its decimal comma'
        )
        warnings = (*warnings, where)
    if ended_lines:
        where = (
            f'{path}, line {ended_lines[0]}: a separator behind the last cell is passed over, in '
            f'{len(ended_lines)} rows'
        )
        warnings = (*warnings, where)
    arrays = {number: np.array(column, dtype=np.float64) for number, column in columns.items()}
    return Columns(arrays, np.array(lines, dtype=np.int64), warnings)


def _delimiter(line: str, next_line: str) -> str | None:
    """Return what stands between the cells, None for blanks, as the first two rows tell.

    A comma may be that of a decimal number: another sign goes before it where it divides both rows
    alike.
    """
    for sign in (';', '\t'):
        if ',' in line and sign in line and line.count(sign) == next_line.count(sign):
            return sign
    return next((d for d in _DELIMITERS if d in line), None)


def _with_point(cell: str, delimiter: str | None) -> str:
    """Return a number with a decimal point that has a decimal comma; others as they are."""
    if delimiter != ',' and _COMMA_NUMBER.fullmatch(cell.strip()) is not None:
        return cell.replace(',', '.')
    return cell


def _refuse_points(
    path: Path, shape: TableShape, column_numbers: Collection[int], comma_line: int
) -> None:
    """Refuse a log with decimal commas and decimal points: one of them divides thousands.

    Raises:
        BagError: it has both, in the columns that are read.
    """
    rows = _rows(path)
    if shape.names:
        next(rows, None)
    for line_number, line in rows:
        cells = _cells(path, line_number, line, shape.delimiter)
        for number in column_numbers:
            if number <= len(cells) and '.' in cells[number - 1]:
                raise BagError(
                    f'{path}: numbers with a comma (line {comma_line}) and with a point (line '
                    f'{line_number}): write one of them only'
                )


def _fitting(
    path: Path, shape: TableShape, line_number: int, line: str, cells: list[str]
) -> list[str]:
    """Cells of a row with too many or too few: without a comment, or with an empty end."""
    count = shape.column_count
    for sign in _COMMENTS:
        before = line.partition(sign)[0].rstrip()
        if sign in line and len(before.split(shape.delimiter)) == count:
            return before.split(shape.delimiter)
    if len(cells) == count + 1 and not cells[-1].strip():
        return cells
    if (
        len(cells) == count - 1 and shape.names and not shape.names[-1]
    ):  # the header ends with a separator
        return [*cells, '']
    first = 'header' if shape.names else 'first row'
    hint = ''
    if len(cells) == 1 and (
        other_delimiter := next((d for d in (*_DELIMITERS, ' ') if d in line.strip()), None)
    ):
        hint = (
            f'; {other_delimiter!r} seems to be between them, but {shape.delimiter or " "!r} is in '
            'the '
            f'{first}'
        )
    elif shape.delimiter == ',' and len(cells) > count:
        hint = '; numbers need a decimal point, and no comma within'
    raise BagError(
        f'{path}, line {line_number}: {len(cells)} cells, but the {first} has {count}: '
        f'{brief(line.strip())}{hint}'
    )


def _complaint(
    path: Path,
    shape: TableShape,
    line_number: int,
    cells: list[str],
    number: int,
    column_numbers: Collection[int],
) -> str:
    cell = cells[number - 1].strip()
    if (
        shape.names
        and not any(_is_number(cells[k - 1]) for k in column_numbers)
        and all(cells[k - 1].strip() for k in column_numbers)
    ):
        row = brief([cells[k - 1].strip() for k in column_numbers])
        return f"{path}, line {line_number}: {row} are no numbers; put '#' before a row of units"
    hint = '; write a decimal point' if _DECIMAL_COMMA.search(cell) else ''
    column = _column_words(shape, number)
    return f'{path}, line {line_number}, {column}: {brief(cell)} is no number{hint}'


def _column_words(shape: TableShape, number: int) -> str:
    """Return the number of a column, with its name where it has one."""
    return f'column {number} ({shape.names[number - 1]})' if shape.names else f'column {number}'


def _cells(path: Path, line_number: int, line: str, delimiter: str | None) -> list[str]:
    """The cells of a line, of which some may be quoted."""
    if '"' not in line or delimiter is None:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=True))
    except csv.Error as error:
        raise BagError(
            f'{path}, line {line_number}: a quoted cell that does not end on its line ({error})'
        ) from None


def _is_number(cell: str) -> bool:
    try:
        parse_float(cell)
    except ValueError:
        return False
    return True


def _rows(path: Path) -> Iterator[tuple[int, str]]:
    """The lines that are neither empty nor comments, with their line numbers."""
    try:
        raw = open_regular(path)
    except InputError as error:
        raise BagError(str(error)) from None
    # Comments may be in any encoding; numbers read the same in all of them.
    with io.TextIOWrapper(raw, encoding='utf-8-sig', errors='replace', newline=None) as stream:
        try:
            for number, line in enumerate(
                iter(lambda: stream.readline(_LONGEST_LINE), ''), start=1
            ):
                if len(line) >= _LONGEST_LINE:
                    raise BagError(
                        f'{path}, line {number}: longer than {_LONGEST_LINE:,} characters; is it '
                        'a log?'
                    )
                content = line.strip()
                if number == 1 and '\x00' in line:
                    raise BagError(f'{path} is no text in UTF-8 or ASCII; save it as that')
                if content and not content.startswith(_COMMENTS):
                    yield number, line.strip('\r\n ')
        except OSError as error:
            raise BagError(f'{path}: cannot be read: {error.strerror or error}') from None
