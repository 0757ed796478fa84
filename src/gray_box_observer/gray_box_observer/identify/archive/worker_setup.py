"""What every worker process of `ProcessEngine` is started with, and does first."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

ENVIRONMENT = {'MALLOC_TRIM_THRESHOLD_': str(1 << 28), 'MALLOC_ARENA_MAX': '1'}
"""What a bag has freed is kept for the next; else it would be given back and fetched again all the
time."""


@contextmanager
def starting() -> Iterator[None]:
    """Give processes started in this block `ENVIRONMENT`, and make them ignore Ctrl-C."""
    resource_tracker.ensure_running()  # it would unblock the signal when it starts
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


def set_up() -> None:
    """Leave Ctrl-C to the command, which ends the workers, and end with it, however it ends.

    The garbage collector leaves alone what is loaded by now, which stays as long as the process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name='end with parent', daemon=True).start()
    gc.collect()
    gc.freeze()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
