"""How much readings vary, where they do."""

from __future__ import annotations

import numpy as np

from gray_box_observer.white_box.interface import Array

ROUNDING = 1e-12
"""Standard deviation, relative to the largest reading, up to which it is that of rounded sums."""


def spread(readings: Array) -> float | None:
    """Return the standard deviation of readings, shape (n,); None where they are all the same.

    That of equal readings is seldom 0: their mean is rounded. What is divided by it is no figure.
    """
    std = float(np.std(readings))
    return std if std > ROUNDING * float(np.max(np.abs(readings))) else None
