"""How regularly samples come by their stamps: usual interval, gaps, and pauses."""

from __future__ import annotations

import math
from typing import Any

LATE = 1.75
"""Intervals beyond this many usual ones have lost something; a jitter of half an interval has not.
"""

STEP = 0.02
"""By which fraction the usual interval follows; up and down alike, so that it ends at the median.
"""

SILENCE = 20.0
"""Intervals longer than this many usual ones are no lost samples any more: the signal was silent.
"""

REGULAR = 1000
"""Intervals without a silence after which the next one is against the habit of the signal."""

LEARNT = 20
"""Intervals before anything is called missing."""

MOSTLY = 0.15
"""Share of late intervals up to which a signal is periodic and has lost samples. Of a signal that
comes when it changes, at random, a third are late."""


class Rhythm:
    """Counts the samples that should have come and did not.

    The usual interval is the median of all, followed by small steps: a minority of odd intervals
    moves it by little.

    Attributes:
        usual_s: the usual interval in s; 0 before the first.
        silence_s: longer than this no signal of this habit waits, in s; endless before the habit is
            known.
        missing_count: samples that never came, by the length of the intervals.
        pauses: how often the signal history began anew, after a gap or a jump of the stamps.
    """

    def __init__(self) -> None:
        self.usual_s = 0.0
        self.silence_s = math.inf
        self.missing_count = 0
        self.pauses = -1  # the first sample begins the first history
        self._sample_count = 0
        self._unbroken = 0
        self._late_share = 0.0

    def silent(self, interval_s: float) -> bool:
        """Tell whether an interval in s is a silence by the signal's own habit."""
        return interval_s > self.silence_s

    @property
    def regular(self) -> bool:
        """Whether the signal has long come without silence, not only when it changes."""
        return self._unbroken >= REGULAR

    def loses(self, interval_s: Any) -> Any:
        """Tell whether a periodic signal has lost samples in an interval in s, short of silence.

        Of an array of intervals the answer is an array, unless none can have.
        """
        if self._late_share >= MOSTLY or math.isinf(self.silence_s):
            return False
        return (interval_s > LATE * self.usual_s) & (interval_s <= self.silence_s)

    def update(self, interval_s: float) -> None:
        """Take one sample's interval since the one before, in s; 0 at the start of a history."""
        if interval_s <= 0.0:
            self.pauses += 1
            return
        self._sample_count += 1
        if self._sample_count <= LEARNT:  # quick at first: the mean
            self.usual_s += (interval_s - self.usual_s) / self._sample_count
            return
        usual_s = self.usual_s
        self._unbroken = 0 if interval_s > SILENCE * usual_s else self._unbroken + 1
        is_late = interval_s > LATE * usual_s
        if is_late:
            self.missing_count += round(interval_s / usual_s) - 1
        self._late_share += STEP * (is_late - self._late_share)
        self.usual_s = usual_s * (1.0 + STEP if interval_s > usual_s else 1.0 - STEP)
        self.silence_s = SILENCE * self.usual_s
