"""A test of the fit of one motor whose estimate has gone out: its result counts with the next one.

A test takes as long as several samples at 1 kHz, and predictions would wait for it. So it is done
in pieces behind the samples that come before the next estimate. It reads nothing that may change
meanwhile, and nobody sees its result before. What comes of it is the same whenever it is done. Of a
rotor, and of a speed that is measured, the next estimate may be a thousand samples away: these are
tested at once.
"""

from __future__ import annotations

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.fit_test.fit_result import FitResult

ALONE = 13
"""Samples behind which one piece is done, and two behind each later one. A test that passes has
about 25 pieces. One that names what is left out has 43 to 56, of which 49 are done behind 31
samples: the next estimate waits for the last of the longest."""


class DeferredFitTest:
    """A test that has begun.

    Args:
        work: its pieces, or their result, where it was saved.
    """

    def __init__(self, work: Pieces[FitResult] | FitResult) -> None:
        self._work = work
        self._has_turn = False
        self._turn_count = 0

    def begin_sample(self) -> None:
        """Note that a sample has come, behind which there is time for a piece."""
        self._has_turn = True

    def advance(self) -> None:
        """Do a piece, once a sample; two of a test that takes long."""
        if not self._has_turn or isinstance(self._work, FitResult):
            return
        self._has_turn = False
        self._turn_count += 1
        try:
            next(self._work)
            if self._turn_count > ALONE:
                next(self._work)
        except StopIteration as end:
            self._work = end.value

    def result(self) -> FitResult:
        """Return what has come of it, all pieces done."""
        if not isinstance(self._work, FitResult):
            self._work = completed(self._work)
        return self._work
