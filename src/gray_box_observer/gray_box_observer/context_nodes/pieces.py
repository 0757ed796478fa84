"""Work in pieces: what a fit costs is spread over the samples that follow, by their number.

A piece says how much work it was, in units of about a third of a microsecond; 0 where its work is
counted with another one. A :class:`WorkBudget` grants every sample its share, never by a clock, so
that every door leads to the same results at the same sample.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import MOST, whole
from gray_box_observer.white_box.interface import Array

Result = TypeVar('Result')

Pieces = Generator[int, None, Result]
"""A piece of work at each ``next``, which gives its size; the result at the end."""

SHARE = 160
"""Work that every sample grants, at least."""

SHARE_A_SECOND, LARGEST_SHARE = 160_000, 1600
"""Work that a sample grants for the time since the one before, and at one sample at most: slow
samples have more time, and their runs take more steps."""

SAVED = 262144
"""Work that samples at which nothing was to be done have saved up, at most."""

MOST_PIECES = 100_000
"""Of a saved piece of work, so that no file can make its restoration endless."""

FINISHED = 16 * SAVED
"""Work that is done of a trial, or of fits, at the end of a recording: about a second's."""

AT_ONCE = 4096
"""Work at one sample, at most, beside what the last piece takes beyond it."""

WORK_S = 0.33e-6
"""Time that a unit of work takes, in s, as a share of the time is reckoned by it."""

MOST_SAVED = 4 * AT_ONCE
"""Work that motors which are computed together save up, at most, where a sample grants less."""


def completed(pieces: Pieces[Result]) -> Result:
    """Do all of the work at once and return its result."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            result: Result = end.value
            return result


def without_warnings(work: Pieces[Result]) -> Pieces[Result]:
    """Go on with some work whose numbers may be absurd: numpy warns of nothing while it does it."""
    while True:
        with np.errstate(all='ignore'):
            try:
                size = next(work)
            except StopIteration as end:
                result: Result = end.value
                return result
        yield size


def bounded(work: Pieces[Result], most: int) -> Pieces[Result | None]:
    """Go on with some work until it has taken so much in all; its result, None where it took more.

    Args:
        work: what is to be done.
        most: work that it may take.
    """
    spent_work = 0
    while spent_work <= most:
        try:
            size = next(work)
        except StopIteration as end:
            result: Result = end.value
            return result
        spent_work += size
        yield size
    return None


def completed_within(work: Pieces[Result], most: int) -> Result | None:
    """Do some work at once; return its result, None where it would take more than so much."""
    return completed(bounded(work, most))


def granted_share(interval_s: float) -> int:
    """Return the work that a sample grants, by the time in s since the one before."""
    return int(min(max(SHARE_A_SECOND * interval_s, SHARE), LARGEST_SHARE))


def granted_shares(interval_s: Array) -> NDArray[np.int64]:
    """Return the same of many motors, shape (motor,)."""
    shares = np.clip(SHARE_A_SECOND * interval_s, SHARE, LARGEST_SHARE)
    return shares.astype(np.int64)


class SharedBudget:
    """Work that motors which are computed together may take in turn, a share of the time.

    Args:
        share: of a core.

    Attributes:
        share: as given.
        credit: work that is granted and not done; negative where more was done at once.
    """

    def __init__(self, share: float) -> None:
        self.share = share
        self.credit = 0.0

    def grant(self, interval_s: float) -> None:
        """Take note of a sample, so long after the one before by their stamps; 0: not known."""
        work = self.share * interval_s / WORK_S if interval_s > 0.0 else SHARE
        self.credit = min(self.credit + work, max(work, MOST_SAVED))


class WorkBudget:
    """How much work may be done, by the number of samples that have come.

    Attributes:
        credit: work that is granted and not done; negative where a piece was larger.
        pieces: of the work under way, done so far.
    """

    def __init__(self) -> None:
        self.credit = SAVED
        self.pieces = 0

    def grant(self, interval_s: float, samples: int = 1) -> None:
        """Take note of samples, so long after the one before by their stamps; 0: not known."""
        self.credit = min(self.credit + granted_share(interval_s) * samples, SAVED)

    def advance(self, work: Pieces[Result]) -> tuple[bool, Result | None]:
        """Do as many pieces of some work as one sample may; tell whether it has ended, and how."""
        spent_work = 0
        while self.credit > 0 and spent_work < AT_ONCE:
            try:
                size = next(work)
            except StopIteration as end:
                self.pieces = 0
                return True, end.value
            self.pieces += 1
            self.credit -= size
            spent_work += size
        return False, None

    def repeat(self, work: Pieces[Result], pieces: int) -> None:
        """Do the pieces again that had been done of some work before it was saved.

        Raises:
            CheckpointError: the work has not as many, or cannot be done.
        """
        try:
            for _ in range(pieces):
                next(work)
        except StopIteration:
            raise CheckpointError(f'the work under way has not {pieces} pieces') from None
        except (ArithmeticError, LookupError, ValueError):
            raise CheckpointError('the work under way cannot be done again') from None
        self.pieces = pieces

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> WorkBudget:
        """Take back the ``credit`` of a saved state; full where releases before knew none.

        Raises:
            CheckpointError: it is none that there could have been.
        """
        budget = cls()
        if 'credit' in plain:
            budget.credit = whole(plain, 'credit', -MOST, SAVED)
        return budget
