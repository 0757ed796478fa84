"""What the middleware's threads have made the process grow by."""

from __future__ import annotations

import ctypes
import os
from contextlib import suppress
from pathlib import Path

try:
    import resource
except ImportError:  # another system: nobody tells
    resource = None  # type: ignore[assignment]

STATM = Path('/proc/self/statm')


class ReceiveMemory:
    """Tells growth that the middleware has caused from growth that this thread has.

    Whoever first touches a page of memory takes a fault. This thread learns; the others receive. The share of their
    faults is their share of what the process has grown by.
    """

    def __init__(self) -> None:
        self.mark()

    def mark(self) -> None:
        """Count from here on."""
        self._resident_bytes = _resident_bytes()
        self._own_faults, self._all_faults = _faults()

    def grown_bytes(self) -> int:
        """Return what other threads have made the process grow by; 0 where that cannot be told."""
        growth = _resident_bytes() - self._resident_bytes
        own, total = _faults()
        faults = total - self._all_faults
        if growth < 0:
            self.mark()
        if growth <= 0 or faults <= 0:
            return 0
        return round(growth * (1.0 - (own - self._own_faults) / faults))


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
    own, total = resource.getrusage(resource.RUSAGE_THREAD), resource.getrusage(resource.RUSAGE_SELF)
    return own.ru_minflt, total.ru_minflt
