"""Whether samples that did not teach bear out that something was learnt."""

from __future__ import annotations

import numpy as np

from gray_box_observer.white_box.interface import Array

PARTS = 6
"""Parts in time that samples which judge fall into, for what chance could do."""

GAIN = 0.02
"""Least fraction by which the mean absolute error must fall."""

SIGNIFICANT = 2.0
"""Least gain, in its standard errors over the parts."""

SPEAKING = 2.0
"""Fewest parts that must have something to say, counted as many of equal error would say it."""


def is_significant(had: Array, gains: Array, significant: float = SIGNIFICANT) -> bool:
    """Whether parts tell of a gain that is worth it and more than chance.

    The gain is a ratio, all that was gained to all that there was, with the standard error of one
    (Cochran 1977, 2.11): that a motor at rest leaves nothing to gain does not make what is gained
    while it runs a matter of chance.

    Args:
        had: shape (part,): mean absolute errors without the correction.
        gains: shape (part,): by how much less they are with it.
        significant: least gain, in its standard errors.
    """
    total = float(had.sum())
    n = had.size
    if total <= 0.0 or total**2 < SPEAKING * float(np.sum(had**2)):
        return False
    ratio = float(gains.sum()) / total
    error = float(np.sqrt(n / (n - 1.0) * np.sum((gains - ratio * had) ** 2))) / total
    return ratio > max(significant * error, GAIN)
