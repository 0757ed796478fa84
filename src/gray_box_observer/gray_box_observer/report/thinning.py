"""Fewer points for the eye, the same picture.

A screen shows about a thousand columns. A long series is cut into more time buckets than that, and
the lowest and the highest sample of every bucket stay, so no peak disappears however short it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gray_box_observer.report.run.history import FloatArray

DRAWN_WHOLE = 20_000
"""Series up to this length are drawn as they are."""

BUCKETS = 4_000
"""Time buckets of a longer one: several for each column of a screen, so that zooming in shows more.
"""


@dataclass(frozen=True)
class Segment:
    """A stretch of time under one verdict, from `start_s` to `end_s`."""

    start_s: float
    end_s: float
    verdict: str


def thinned(
    time_s: FloatArray, value: FloatArray, drawn_whole: int = DRAWN_WHOLE, buckets: int = BUCKETS
) -> npt.NDArray[np.intp]:
    """Choose the samples to draw.

    Args:
        time_s: stamps. Shape `(sample,)`, non-decreasing.
        value: what is drawn; NaN where there is none. Shape `(sample,)`.
        drawn_whole: the longest series that is left whole.
        buckets: buckets of equal time for a longer one.

    Returns:
        Rising indices: all of a short series; otherwise the first and the last sample, the lowest
        and the highest finite one of every bucket, and one sample of a bucket that holds no finite
        one (the gap in the line stays visible).
    """
    count = len(time_s)
    if count <= drawn_whole:
        return np.arange(count)
    span_s = float(time_s[-1] - time_s[0])
    if span_s > 0.0:
        bucket = np.minimum(
            ((time_s - time_s[0]) * (buckets / span_s)).astype(np.intp), buckets - 1
        )
    else:
        bucket = np.arange(count) * buckets // count
    places = [np.array([0, count - 1])]
    finite = np.flatnonzero(np.isfinite(value))
    if finite.size:
        order = finite[np.lexsort((value[finite], bucket[finite]))]
        edges = np.flatnonzero(np.diff(bucket[order])) + 1
        places.append(order[np.concatenate(([0], edges))])
        places.append(order[np.concatenate((edges - 1, [order.size - 1]))])
    occupied_buckets, first = np.unique(bucket, return_index=True)
    places.append(first[~np.isin(occupied_buckets, bucket[finite])])
    return np.unique(np.concatenate(places))


def segments(time_s: FloatArray, verdict: Sequence[str]) -> list[Segment]:
    """Join equal verdicts that follow one another; each lasts until the next one starts."""
    if not len(time_s):
        return []
    starts = [0, *(k for k in range(1, len(verdict)) if verdict[k] != verdict[k - 1])]
    ends = [*starts[1:], len(verdict) - 1]
    return [
        Segment(float(time_s[start]), float(time_s[end]), verdict[start])
        for start, end in zip(starts, ends, strict=True)
    ]
