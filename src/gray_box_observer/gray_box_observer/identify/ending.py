"""How a command ends that is told to: by an exception, so that what it began is removed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
"""What tells a process to end; SIGINT is an exception already."""

UNTOUCHED = (signal.SIG_IGN, None)
"""Ignored, or handled by something other than Python."""


@contextmanager
def ended_by_exception() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise SystemExit while this lasts; nothing in another thread.

    One that is ignored stays so: nohup asked for it.

    Raises:
        SystemExit: the process was told to end; its code is that of the signal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: object) -> None:
        raise SystemExit(128 + number)

    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    signal_numbers = [number for number in SIGNALS if handlers[number] not in UNTOUCHED]
    for number in signal_numbers:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in signal_numbers:
            signal.signal(number, handlers[number])
