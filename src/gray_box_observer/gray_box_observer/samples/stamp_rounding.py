"""Finds stamps of even samples that are rounded to coarse steps: whole ms of a loop at 300 Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.white_box.interface import Array

FEWEST = 50
"""Stamps that are judged."""

COARSE = 0.02
"""Step, as a share of the interval, from which it matters."""

EQUAL = 0.01
"""Share of a step up to which intervals are the same."""

LARGEST_SPREAD = 1.2
"""Steps between the earliest and the latest stamp, each against its even place: rounding alone
brings 1, a lost sample a whole interval."""


@dataclass(frozen=True, slots=True)
class StampRounding:
    """How stamps seem to have been rounded.

    Attributes:
        step_s: to multiples of what.
        period_s: in which the samples come.
    """

    step_s: float
    period_s: float


def stamp_rounding(interval_s: Array) -> StampRounding | None:
    """Find coarse steps of evenly taken samples; None where there are none, or none can be told.

    Args:
        interval_s: shape (k,): from stamp to stamp, all above 0.
    """
    if interval_s.size < FEWEST - 1:
        return None
    shortest, longest = float(interval_s.min()), float(interval_s.max())
    step = longest - shortest
    period = float(interval_s.mean())
    if not step >= COARSE * period:
        return None
    from_shortest, steps = (interval_s - shortest) / step, shortest / step
    is_between = (from_shortest > EQUAL) & (from_shortest < 1.0 - EQUAL)
    if is_between.any() or abs(steps - round(steps)) > EQUAL * max(steps, 1.0):
        return None
    stamp = np.concatenate([[0.0], np.cumsum(interval_s)])
    place = np.arange(stamp.size, dtype=float)
    slope, level = np.polyfit(place, stamp, 1)
    if np.ptp(stamp - level - slope * place) > LARGEST_SPREAD * step:
        return None
    return StampRounding(step, float(slope))
