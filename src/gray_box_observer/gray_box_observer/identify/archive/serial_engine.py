"""One bag after another, in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from gray_box_observer.identify.archive.bag_work import BagResult

Work = Callable[[Path], BagResult]


class SerialEngine:
    """Reads bags one after another, in this process."""

    name = 'serial'

    def run(self, work: Work, bags: Sequence[Path]) -> Iterator[tuple[int, BagResult]]:
        """Yield the place of every bag in ``bags`` and what it has given, as they come."""
        for index, bag in enumerate(bags):
            yield index, work(bag)
