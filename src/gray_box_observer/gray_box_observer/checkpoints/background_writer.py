"""Writes checkpoints in the background: only the newest counts, a slow disk delays nothing."""

from __future__ import annotations

import threading
from pathlib import Path

from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.checkpoints.checkpoint import Snapshot
from gray_box_observer.errors import GrayBoxError


class CheckpointWriter:
    """Writes one snapshot after the other in a thread of its own.

    Encoding, checksum and the disk are the thread's; handing over costs the sample path nothing.
    Where the disk is slower than snapshots come, those in between are left out.

    Attributes:
        written: checkpoints that stand on the disk by now.
        failure: why the newest attempt has failed; None where it has not.
    """

    def __init__(self) -> None:
        self.written_count = 0
        self.failure: str | None = None
        self._next: tuple[Snapshot, Path] | None = None
        self._busy = False
        self._is_closed = False
        self._condition = threading.Condition()
        self._thread: threading.Thread | None = None

    @property
    def thread(self) -> threading.Thread | None:
        """The thread that writes; None before the first snapshot."""
        return self._thread

    def submit(self, snapshot: Snapshot, path: Path) -> None:
        """Hand a snapshot over; returns at once. It takes the place of one that still waits."""
        with self._condition:
            self._next = snapshot, path
            if self._thread is None:
                # a daemon: a disk that hangs must not keep the process from ending
                self._thread = threading.Thread(target=self._run, daemon=True, name='checkpoints')
                self._thread.start()
            self._condition.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until all pending work is written or has failed; tell whether it was in time."""
        with self._condition:
            return self._condition.wait_for(
                lambda: not self._busy and self._next is None, timeout_s
            )

    def close(self, timeout_s: float) -> bool:
        """Write what still waits, then end the thread; tell whether that came to pass in time."""
        is_written = self.flush(timeout_s)
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()
        return is_written

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._next is not None or self._is_closed)
                if self._next is None:
                    return
                (snapshot, path), self._next = self._next, None
                self._busy = True
            try:
                checkpoint.write(snapshot, path)
                failure = None
            except GrayBoxError as error:
                failure = str(error)
            except Exception as error:  # a defect: do not let the others wait for ever
                failure = f'{path}: {error!r}'
            with self._condition:
                self.failure = failure
                self.written_count += failure is None
                self._busy = False
                self._condition.notify_all()
