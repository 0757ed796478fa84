"""What the middleware's threads have made the process grow by."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

try:
    import resource
except ImportError:  # another system: nobody tells
    resource = None  # type: ignore[assignment]

STATM = Path('/proc/self/statm')

TASKS = Path('/proc/self/task')
"""Of every thread, by its number, what the system counts of it."""

MINOR_FAULTS = 7
"""Place of the pages that a thread has touched first, in its ``stat`` behind the name; see proc(5).
"""


class ReceiveMemory:
    """Tells growth that the middleware has caused from growth that this thread has.

    Whoever first touches a page of memory takes a fault. This thread learns, some write files; the
    others receive. The share of their faults is their share of what the process has grown by.

    Args:
        writers: returns the numbers of threads that are not the middleware's either, as they are
            now.
    """

    def __init__(self, writers: Callable[[], Iterable[int]] = tuple) -> None:
        self._writers = writers
        self._page_counts: dict[int, int] = {}
        self.mark()

    def mark(self) -> None:
        """Count from here on."""
        self._resident_bytes = _resident_bytes()
        self._own_faults, self._all_faults = self._faults()

    def grown_bytes(self) -> int:
        """Return what other threads have made the process grow by; 0 where that cannot be told."""
        growth = _resident_bytes() - self._resident_bytes
        own, total = self._faults()
        faults = total - self._all_faults
        if growth < 0:
            self.mark()
        if growth <= 0 or faults <= 0:
            return 0
        return round(growth * max(0.0, 1.0 - (own - self._own_faults) / faults))

    def _faults(self) -> tuple[int, int]:
        """Return the pages first touched by this thread and the writers, and by all threads."""
        # one that has ended keeps what it had when it was last seen
        self._page_counts.update(
            {
                thread: count
                for thread in self._writers()
                if (count := _faults_of(thread)) is not None
            }
        )
        own, total = _faults()
        return own + sum(self._page_counts.values()), total


def give_memory_back() -> None:
    """Let the C library return what was freed, where it can."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def _resident_bytes() -> int:
    """Return how much memory the process holds; 0 where nobody tells."""
    try:
        return int(STATM.read_bytes().split()[1]) * os.sysconf('SC_PAGE_SIZE')
    except (OSError, IndexError, ValueError):
        return 0


def _faults() -> tuple[int, int]:
    """Return how many pages this thread, and all together, have touched first."""
    if resource is None or not hasattr(resource, 'RUSAGE_THREAD'):
        return 0, 0
    own = resource.getrusage(resource.RUSAGE_THREAD)
    total = resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_minflt, total.ru_minflt


def _faults_of(thread: int) -> int | None:
    """Return how many pages a thread has touched first; None where nobody tells."""
    try:
        return int(
            (TASKS / str(thread) / 'stat').read_bytes().rpartition(b')')[2].split()[MINOR_FAULTS]
        )
    except (OSError, IndexError, ValueError):
        return None
