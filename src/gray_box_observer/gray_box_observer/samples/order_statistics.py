"""Medians, quantiles and distinct values of signals, to the bit as numpy gives them.

numpy's own import its masked arrays when they are first called. That takes longer than a fit.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array

MAD_TO_STD = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""

Number = TypeVar('Number', bound=np.generic)


def quantile(values: Array, share: float) -> Array:
    """Return what a share of some values stays below, between the two values next to it.

    Source: Hyndman and Fan (1996), definition 7.

    Args:
        values: shape (..., n), n at least 1.
        share: 0 ... 1.

    Returns:
        Shape (...); NaN where one of the values is.
    """
    last = values.shape[-1] - 1
    lower = int(share * last)
    upper = min(lower + 1, last)
    weight = share * last - lower
    in_order = np.partition(values, (lower, upper, last), axis=-1)
    below = in_order[..., lower]
    above = in_order[..., upper]
    between: Array = (
        below + (above - below) * weight
        if weight < 0.5
        else above - (above - below) * (1.0 - weight)
    )
    return np.where(np.isnan(in_order[..., last]), np.nan, between)


def median(values: Array) -> Array:
    """Return the median of some values, shape (..., n).

    Returns:
        Shape (...); NaN where one of the values is, or where there are none.
    """
    count = values.shape[-1]
    if count == 0:
        return np.full(values.shape[:-1], np.nan)
    lower, upper = (count - 1) // 2, count // 2
    in_order = np.partition(values, (lower, upper, count - 1), axis=-1)
    middle = in_order[..., lower]
    if upper > lower:
        middle = 0.5 * (middle + in_order[..., upper])
    return np.where(np.isnan(in_order[..., -1]), np.nan, middle)


def usual_interval(interval_s: Array) -> float:
    """Return the median sample interval within signal histories, in s; endless without any.

    Args:
        interval_s: any shape; 0 where a history begins.
    """
    within_s = interval_s[interval_s > 0.0]
    return float(median(within_s)) if within_s.size else math.inf


def distinct(values: NDArray[Number]) -> NDArray[Number]:
    """Return every value of some once, in ascending order.

    Args:
        values: shape (n,), no NaN among them.

    Returns:
        Shape (k,), k at most n.
    """
    in_order = np.sort(values)
    is_first = np.ones(in_order.size, dtype=bool)
    np.not_equal(in_order[1:], in_order[:-1], out=is_first[1:])
    return in_order[is_first]
