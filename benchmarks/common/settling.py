"""When an error has come down to stay."""

from __future__ import annotations

import numpy as np

from common.motion import FloatArray


def settled_s(deviation: FloatArray, time_s: FloatArray, tolerance: float) -> float:
    """First instant from which the deviation stays within the tolerance; inf if there is none.

    Args:
        deviation: shape (mark,), not negative; NaN counts as outside.
        time_s: shape (mark,).
        tolerance: largest deviation that counts as settled.
    """
    outside = np.flatnonzero(~(deviation <= tolerance))
    if outside.size == 0:
        return float(time_s[0])
    return float(time_s[outside[-1] + 1]) if outside[-1] + 1 < len(time_s) else float('inf')
