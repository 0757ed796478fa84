"""Noise of a current beside a filter: that of a reading goes with that of the one before.

Noise that has passed the filter remembers a share of what it was. Of noise that comes behind a
moving average, which is undone, the next value has a share with the opposite sign. What is new at
every sample is white.
A residual, its derivatives and all that it is compared with are taken without what they remember
(generalised least squares; Aitken 1936).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER
from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.settings.sensor_lag import LONGEST_MEMORY
from gray_box_observer.white_box.interface import Array

CHANCE = 3.0
"""Correlation that white noise may have by chance, times the root of the samples."""

SAME_MEMORY = 0.03
"""Difference of two memories of the noise that are the same."""


def without_memory(signal: Array, memory: float, begins: NDArray[np.bool_] | None = None) -> Array:
    """Return what a signal has beyond the memory of the noise, of its shape.

    Args:
        signal: shape (k + 1, ...): readings, or what they are compared with.
        memory: share m of the noise before that a reading has, ``n_k = m n_(k-1) + new_k``; a
            negative one of what was new before, ``n_k = new_k + m new_(k-1)``.
        begins: shape (k + 1,): where a signal history begins; None: at the first sample alone.
    """
    if memory == 0.0:
        return signal
    result: Array = signal.copy()
    places = [0] if begins is None else np.flatnonzero(begins).tolist()
    if memory > 0.0:
        fresh = np.sqrt(1.0 - memory**2)
        result[1:] -= memory * signal[:-1]
        result[places] = fresh * signal[places]
        return result
    count = signal.shape[0]
    rows = np.ascontiguousarray(signal.reshape(count, -1).T)
    rows[:, places] /= np.sqrt(1.0 + memory**2)
    kept_share = np.full(count - 1, -memory)
    kept_share[[place - 1 for place in places if place > 0]] = 0.0
    factors = np.broadcast_to(kept_share, (1, count - 1))
    new = recurrence(factors, rows[:, None, 1:], rows[:, :1])[:, 0]
    return np.asarray(np.ascontiguousarray(new.T).reshape(signal.shape))


def autocovariance(residual_a: Array) -> tuple[float, float]:
    """Return the sums of products one sample apart and of squares, in A^2, outliers clipped.

    Args:
        residual_a: shape (k + 1,): measured less predicted current.
    """
    most_a = OUTLIER * MAD_TO_STD * float(median(np.abs(residual_a)))
    off_a = np.clip(residual_a, -most_a, most_a)
    return float(off_a[1:] @ off_a[:-1]), float(off_a @ off_a)


def memory_of(
    residuals_a: Sequence[Array], longest: float = LONGEST_MEMORY, *, is_undone: bool = False
) -> float:
    """Return the memory of the noise, see :func:`without_memory`; 0 where chance would be enough.

    Args:
        residuals_a: shape (k + 1,) each: measured less predicted current, one a signal history.
        longest: what a filter leaves of a reading after an interval. Noise that passes it remembers
            no more, and what remembers more is no noise.
        is_undone: whether it is a moving average that was undone: noise behind it has a negative
            memory.
    """
    product = 0.0
    power = 0.0
    count = 0
    for residual_a in residuals_a:
        lagged_a2, own_a2 = autocovariance(residual_a)
        product += lagged_a2
        power += own_a2
        count += residual_a.size
    correlation = product / max(power, 1e-300)
    chance = CHANCE / np.sqrt(max(count, 1))
    if is_undone and correlation < -chance:
        size = min(-correlation, 0.5)
        return -min(0.5 * (1.0 - math.sqrt(1.0 - 4.0 * size**2)) / size, longest, LONGEST_MEMORY)
    memory = min(correlation, longest, LONGEST_MEMORY)
    return memory if memory > chance else 0.0
