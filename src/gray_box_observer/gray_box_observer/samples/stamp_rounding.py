"""Finds stamps of even samples that are rounded to coarse steps: whole ms of a loop at 300 Hz."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.white_box.interface import Array

FEWEST = 50
"""Stamps that are judged."""

COARSE = 0.02
"""Step, as a share of the interval, from which it matters."""

FINE = 1.5
"""Steps that the shortest interval has at least: one of a single step may be a lost sample's."""

RAREST, RAREST_SHARE = 10, 0.01
"""How often both lengths of the intervals come, at least: a single other one is a pause."""

EQUAL = 0.01
"""Share of a step up to which intervals are the same."""

LARGEST_SPREAD = 1.2
"""Steps between the earliest and the latest stamp, each against its even place: rounding alone
brings 1."""


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

    Of a period that is less than one and a half steps nothing can be told: lost samples look alike.

    Args:
        interval_s: shape (k,): from stamp to stamp.
    """
    if interval_s.size < FEWEST - 1 or not np.isfinite(interval_s).all():
        return None
    shortest = float(interval_s.min())
    longest = float(interval_s.max())
    step = longest - shortest
    if not (step >= COARSE * shortest and shortest >= FINE * step):
        return None
    is_long = interval_s > shortest + 0.5 * step
    off_length = np.abs(interval_s - np.where(is_long, longest, shortest))
    long_count = int(np.count_nonzero(is_long))
    rarest_count = min(long_count, interval_s.size - long_count)
    steps = shortest / step
    if (
        off_length.max() > EQUAL * step
        or abs(steps - round(steps)) > EQUAL * steps
        or rarest_count < max(RAREST, RAREST_SHARE * interval_s.size)
    ):
        return None
    stamp = np.concatenate([[0.0], np.cumsum(interval_s)])
    place = np.arange(stamp.size, dtype=float)
    slope, level = np.polyfit(place, stamp, 1)
    if np.ptp(stamp - level - slope * place) > LARGEST_SPREAD * step:
        return None
    return StampRounding(step, float(slope))
