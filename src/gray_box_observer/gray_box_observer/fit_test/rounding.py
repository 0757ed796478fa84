"""What the rounding of a current without noise does: its errors last as long as a held voltage.

Noise spreads the readings over the steps of a sensor, and the rounding becomes white noise of
step / sqrt(12). With less noise, a share of ``exp(-2 pi^2 (std / step)^2)`` of the error remains a
function of the current (B. Widrow and I. Kollar, "Quantization Noise", 2008). Where the steps stand
beside the current is unknown. So the errors are worked out for some places of them.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.samples.noise_floor import STEP_TO_STD
from gray_box_observer.white_box.interface import Array

PLACES = 8
"""Places of the steps beside the current."""

NEGLIGIBLE = 0.01
"""Share of the error that is not white, up to which all of it counts as white noise."""


def rounding_errors(run: FreeRun, step_a: float, size_a: float) -> Array:
    """Return errors whose products have the mean of those of the rounding.

    Args:
        run: the free run of one motor.
        step_a: step of the readings in A; 0: there is none.
        size_a: root mean square of the residual in A, with the rounding.

    Returns:
        Shape (place, k + 1), in A; no rows where they are white noise.
    """
    none = np.empty((0, run.current_a.size))
    if not 0.0 < step_a < math.inf or not np.isfinite(run.current_a).all():
        return none
    size = size_a / step_a
    share = math.exp(-2.0 * math.pi * math.pi * max(0.0, size * size - STEP_TO_STD * STEP_TO_STD))
    if not share > NEGLIGIBLE:
        return none
    steps = run.current_a / step_a + (np.arange(PLACES)[:, None] + 0.5) / PLACES
    errors: Array = share * step_a / math.sqrt(PLACES) * (np.round(steps) - steps)
    return errors
