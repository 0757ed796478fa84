"""A course of numbers as a line of small blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

BLOCKS = '▁▂▃▄▅▆▇█'
PLAIN = '_.-=+*#@'
"""Where the terminal writes ASCII only; low to high as well."""

LEAST_SPAN = 0.02
"""Of the mean: what moves less is drawn as a level line, for it is known as well as is asked."""


def sparkline(values: Sequence[float], width: int, blocks: str = BLOCKS) -> str:
    """Return the course of values in at most ``width`` characters, the newest on the right.

    Args:
        values: oldest first; those that are not finite leave a blank.
        width: characters; more values are averaged to so many.
        blocks: characters from low to high.
    """
    columns = _averaged(values, width)
    finite = [value for value in columns if math.isfinite(value)]
    if not finite:
        return ' ' * len(columns)
    low, high = min(finite), max(finite)
    middle = 0.5 * (low + high)
    span = max(high - low, LEAST_SPAN * abs(middle))
    if span == 0.0:
        low = low - 0.5
        span = 1.0
    elif span > high - low:  # its middle is that of a block, so that it stays within one
        low = middle - span * (len(blocks) // 2 + 0.5) / len(blocks)
    top = len(blocks) - 1
    return ''.join(
        blocks[min(top, int((value - low) / span * len(blocks)))] if math.isfinite(value) else ' '
        for value in columns
    )


def _averaged(values: Sequence[float], width: int) -> list[float]:
    """Average values to at most ``width`` of them."""
    count = len(values)
    if count <= width:
        return list(values)
    edges = [round(k * count / width) for k in range(width + 1)]
    averages = []
    for first, last in pairwise(edges):
        finite = [value for value in values[first:last] if math.isfinite(value)]
        averages.append(sum(finite) / len(finite) if finite else math.nan)
    return averages
