"""The memory that noise of a measured speed gives the residual of a free run.

Every reading pushes two intervals. What is left of a push decays with the winding, and the readings
of the current have noise of their own. So the residual is an autoregression of first order, driven
by a moving average of first order (G. Box, G. Jenkins, "Time Series Analysis", 1976, chapter 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array

OWN_SHARE = 1e-6
"""Share of what drives the residual that is the current's own noise, at least."""

HELD_SHARE = 0.5
"""Share of the usual decay below which brushes hold the current: nothing is remembered there."""


@dataclass(frozen=True, slots=True)
class SpeedMemory:
    """What noise of the speed does to the residual, in usual intervals.

    Attributes:
        decay: share of a deviation that an interval leaves.
        start_a: what one standard deviation at its start adds.
        end_a: what one at its end adds.
    """

    decay: float
    start_a: float
    end_a: float

    def innovation(self, residual_a: Array, decay: Array, is_whole: NDArray[np.bool_]) -> Array:
        """Return what a residual has beyond that memory, shape (k + 1,).

        Args:
            residual_a: shape (k + 1,).
            decay: shape (k,): what every interval leaves of a deviation.
            is_whole: shape (k,): over which intervals the run goes on.
        """
        is_free = is_whole & (decay > HELD_SHARE * self.decay)
        decays = np.where(is_whole, decay, 0.0)
        inputs_a = residual_a[1:] - decays * residual_a[:-1]
        size_a = MAD_TO_STD * float(median(np.abs(inputs_a[is_free]))) if is_free.any() else 0.0
        if not size_a > 0.0:
            return residual_a
        memories = np.where(is_free, self._memory(size_a * size_a), 0.0)
        result = recurrence(memories[None], inputs_a[None, None], residual_a[None, :1])
        return np.asarray(result[0, 0])

    def _memory(self, size_a2: float) -> float:
        """Return what an innovation leaves in the next one.

        Args:
            size_a2: variance of what drives the autoregression.
        """
        pushes_a2 = self.start_a**2 + self.end_a**2
        own_a2 = max(size_a2 - pushes_a2, OWN_SHARE * size_a2) / (1.0 + self.decay**2)
        product = self.start_a * self.end_a - self.decay * own_a2
        share = 2.0 * product / (pushes_a2 + (1.0 + self.decay**2) * own_a2)
        return -share / (1.0 + math.sqrt(max(1.0 - share * share, 0.0)))
