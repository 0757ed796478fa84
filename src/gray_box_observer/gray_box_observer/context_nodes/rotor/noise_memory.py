"""Noise of a current that has passed a filter: every reading remembers that of the one before.

What is new at every sample is white. A residual, its derivatives and all that it is compared with
are taken without what they remember (generalised least squares; Aitken 1936).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array

CHANCE = 3.0
"""Correlation that white noise may have by chance, times the root of the samples."""

LONGEST_MEMORY = 0.95
"""Longest memory that is believed to be that of noise."""

SAME_MEMORY = 0.03
"""Difference of two memories of the noise that are the same."""


def without_memory(signal: Array, memory: float, begins: NDArray[np.bool_] | None = None) -> Array:
    """Return what a signal has beyond the memory of the noise, of its shape.

    Args:
        signal: shape (k + 1, ...): readings, or what they are compared with.
        memory: correlation of the noise at two samples in a row.
        begins: shape (k + 1,): where a signal history begins; None: at the first sample alone.
    """
    if memory == 0.0:
        return signal
    result: Array = signal.copy()
    result[1:] -= memory * signal[:-1]
    fresh = np.sqrt(1.0 - memory**2)
    result[0] = fresh * signal[0]
    if begins is not None:
        result[begins] = fresh * signal[begins]
    return result


def memory_of(residuals_a: Sequence[Array], longest: float = LONGEST_MEMORY) -> float:
    """Return the correlation of the noise at two samples in a row; 0 where chance would be enough.

    Args:
        residuals_a: shape (k + 1,) each: measured less predicted current, one a signal history.
        longest: what a filter leaves of a reading after an interval. Noise that passes it remembers
            no more, and what remembers more is no noise.
    """
    product = power = 0.0
    count = 0
    for residual_a in residuals_a:
        most_a = OUTLIER * MAD_TO_STD * float(median(np.abs(residual_a)))
        off_a = np.clip(residual_a, -most_a, most_a)
        product += float(off_a[1:] @ off_a[:-1])
        power += float(off_a @ off_a)
        count += residual_a.size
    memory = min(product / max(power, 1e-300), longest, LONGEST_MEMORY)
    return memory if memory > CHANCE / np.sqrt(max(count, 1)) else 0.0
