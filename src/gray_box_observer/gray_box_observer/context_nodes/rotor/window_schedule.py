"""When a window of samples is fitted, where it begins, and how many samples it has.

The first fit comes as soon as there are a few samples, the next ones with half as many more each.
From a full window on, one window follows another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

FIRST_FIT = 128
"""Samples of the first fit; the next ones come with half as many more each, first a quarter. Every
window has as many: of 33 samples one in seven seems to have 1.3 times its noise."""

FEW = 512
"""Samples up to which a fit costs so little that it comes more often."""

STILL = 32
"""Samples after which a voltage that was held is looked at again."""

WINDOW = 2048
"""Samples of a full window."""

AGAIN = 1024
"""Samples between two fits at most, of a motor that is explained."""

NEWS = 32
"""Samples since the last fit, at least, that are worth another one at the end of a recording."""

LONGEST_WAIT = 4096
"""The same at last, of a motor that nothing fits."""


@dataclass(slots=True)
class WindowSchedule:
    """Places of samples, which are counted from the first one.

    Attributes:
        place: of the newest sample.
        mark: before the first sample of the window.
        due: of the sample with which the next fit is due.
        begun_at: of the newest sample of the newest fit.
        wait: samples until the next fit where nothing fits.
    """

    place: int = 0
    mark: int = 0
    due: int = FIRST_FIT
    begun_at: int = 0
    wait: int = AGAIN

    @property
    def has_news(self) -> bool:
        """Whether enough samples have come since the last fit for another one at the end."""
        return self.place - self.begun_at >= NEWS and self.place - self.mark >= FIRST_FIT

    def next_window(
        self, remembered_count: int, *, is_settled: bool, most: int = WINDOW
    ) -> tuple[int, int]:
        """Return the place of the newest sample of the window that is fitted next, and its samples.

        Args:
            remembered_count: samples that there are.
            is_settled: whether the motor is explained.
            most: samples of the window, at most.

        Where a motor is not explained, and more samples than a window's have come, it is the newest
        ones that tell. So it is where far more have come, while others had their turn.
        """
        place = self.place
        mark = max(self.mark, place - remembered_count)
        if place - mark > WINDOW + AGAIN:
            mark = place - WINDOW
        if is_settled:
            place = min(place, mark + WINDOW)
        return place, min(place - mark, most)

    def skip(self, place: int, *, is_settled: bool) -> None:
        """Leave out samples of a voltage that was held."""
        self.mark = place - 1 if is_settled else max(self.mark, place - FIRST_FIT)
        self.due = place + STILL

    def plan(self, place: int, count: int, *, is_settled: bool) -> None:
        """Settle when the next fit is due: with half as many more, later where nothing fits."""
        in_vain = not is_settled and count >= AGAIN
        self.wait = min(2 * self.wait, LONGEST_WAIT) if in_vain else AGAIN
        more = min(count // (4 if count < FEW else 2), AGAIN)
        if count < WINDOW:
            more = min(more, WINDOW - count)
        self.due = place + (self.wait if in_vain else more)
        self._go_on(place)

    def postpone(self) -> None:
        """Put the fit that is due off until half as many more samples have come."""
        count = self.place - self.mark
        self.due = self.place + min(max(count // 2, FIRST_FIT), AGAIN)
        self._go_on(self.place)

    def _go_on(self, place: int) -> None:
        """Go on with newer samples where a full window has told nothing."""
        if place - self.mark >= WINDOW:
            self.mark = place - WINDOW // 2

    def state(self) -> dict[str, int]:
        """Return what a checkpoint holds of it, as seen from the newest sample."""
        return {
            'mark': self.mark - self.place,
            'due': self.due - self.place,
            'begun': self.begun_at - self.place,
            'wait': self.wait,
        }

    @classmethod
    def restored(cls, plain: Mapping[str, int], place: int) -> WindowSchedule:
        """Take back what :meth:`state` gave, with the place of the newest sample."""
        mark = max(place + plain['mark'], 0)
        begun_at = place + plain.get('begun', 0)
        return cls(place, mark, place + plain['due'], begun_at, plain['wait'])
