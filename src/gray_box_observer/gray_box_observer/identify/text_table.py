"""Rows of text in aligned columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import zip_longest

GAP = '  '
"""Between two columns."""


def aligned(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Return rows as lines whose columns stand below each other.

    Args:
        rows: of cells; a short row ends early. The last cell of a row widens no column, so that a
            sentence may stand there.
        right: places of the columns that are aligned to the right, as numbers are.
    """
    columns = zip_longest(*(row[:-1] for row in rows), fillvalue='')
    widths = [max(map(len, column)) for column in columns] + [0]
    return [
        GAP.join(
            _cell(text, width, is_right=place in right)
            for place, (text, width) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    ]


def _cell(text: str, width: int, *, is_right: bool) -> str:
    return text.rjust(width) if is_right else text.ljust(width)
