"""Keeps one checkpoint file: its place, its use at a start, and when it is rewritten."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.checkpoints.background_writer import CheckpointWriter
from gray_box_observer.checkpoints.checkpoint import Resumed
from gray_box_observer.checkpoints.checkpoint_folder import CheckpointFolder
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.incident import Incident
from gray_box_observer.observer.observer import Observer

PATIENCE_S = 2.0
"""How long somebody who asked for a checkpoint is let wait for a disk that does not answer."""

END_PATIENCE_S = 0.5
"""The same for a process that was asked to end: it has a second."""


class CheckpointKeeper:
    """Saves and loads the state of an observer, by itself where asked to.

    Args:
        folder: where files may stand.
        path: the parameter ``checkpoint.path``.
        automatic: whether to continue from the file and to keep it up to date.

    Attributes:
        path: the parameter; may be changed to whatever the folder allows.
        automatic: as above.
    """

    def __init__(self, folder: CheckpointFolder, path: str, *, automatic: bool) -> None:
        self.folder = folder
        self.path = path
        self.automatic = automatic
        self._writer = CheckpointWriter()
        self._reports: list[threading.Thread] = []
        self._astray: str | None = None
        self._saved_sample_count = 0
        self._since_s: float | None = None

    @property
    def file(self) -> Path:
        """Where the checkpoint stands.

        Raises:
            ConfigurationError: the path leads out of the folder, by a link that was put there
                since.
        """
        return self.folder.file(self.path)

    def resume(self, observer: Observer) -> Resumed:
        """Continue where the file stands; one that cannot be used is set aside."""
        self._writer.flush(PATIENCE_S)
        self._saved_sample_count = 0
        try:
            file = self.file
        except GrayBoxError as error:  # a link was put there since the start
            return Resumed(True, f'{error}; it is left as it is')
        return checkpoint.resume(observer, file)

    def keep(self, observer: Observer | None) -> None:
        """Bring the file up to date if needed, without waiting; errors are in :attr:`failure`."""
        if not self.automatic or observer is None or not observer.motors:
            return
        used_count = sum(
            observer.counts(motor).used_count for motor in observer.configuration.motors
        )
        if used_count == self._saved_sample_count and self.failure is None:
            return
        try:
            file = self.file
        except GrayBoxError as error:  # a link was put there since
            self._astray = str(error)
            return
        self._astray = None
        self._writer.submit(checkpoint.capture(observer), file)
        self._saved_sample_count = used_count
        self._since_s = time.monotonic()

    def save(self, observer: Observer) -> str:
        """Write the file now; return where it stands.

        Raises:
            GrayBoxError: nothing was learnt yet, or the file cannot be written.
        """
        path = self.file
        self._astray = None
        self._writer.submit(checkpoint.capture(observer), path)
        if not self._writer.flush(PATIENCE_S):
            raise GrayBoxError(
                f'{path} is still being written after {PATIENCE_S:g} s: does the disk answer?'
            )
        if self._writer.failure is not None:
            raise GrayBoxError(self._writer.failure)
        self._since_s = time.monotonic()
        return str(path)

    def load(self, observer: Observer) -> str:
        """Take back what the file holds; return where it stands.

        Raises:
            GrayBoxError: no such file, or one that cannot be used; the observer is as it was.
        """
        path = self.file
        self._writer.flush(PATIENCE_S)
        checkpoint.load(observer, path)
        return str(path)

    def forget(self) -> str | None:
        """Let the next start begin anew, as the user asked; return where the old file is kept.

        None where there is nothing to keep, or what stands there is no checkpoint in the folder.
        """
        self._saved_sample_count = 0
        if not self.automatic:
            return None
        self._writer.flush(PATIENCE_S)
        try:
            aside = checkpoint.set_aside(self.file, 'reset')
        except GrayBoxError:  # a link was put there since: what it leads to is not ours
            return None
        return None if aside is None else str(aside)

    def report(self, incident: Incident, tell: Callable[[str], object]) -> None:
        """Have an incident written beside the checkpoint, where that has a place.

        A thread writes: a disk that does not answer must not keep the other motors waiting.

        Args:
            incident: what has stopped a motor.
            tell: gets one line, from that thread, that says where it stands or why it does not.
        """
        try:
            file = self.file
        except GrayBoxError:  # the path leads out of the folder by now
            return
        if not self.automatic and not file.parent.is_dir():
            return
        writing = threading.Thread(
            target=_write_report, args=(incident, file, tell), daemon=True, name='incident'
        )
        self._reports = [thread for thread in self._reports if thread.is_alive()]
        self._reports.append(writing)
        writing.start()

    def close(self, observer: Observer | None) -> str | None:
        """Bring the file up to date for the last time; return what went wrong, if anything did."""
        for report in self._reports:
            report.join(END_PATIENCE_S)
        self.keep(observer)
        if not self._writer.close(END_PATIENCE_S):
            return (
                f'the last checkpoint was not written within {END_PATIENCE_S:g} s: does the disk '
                'answer?'
            )
        return self.failure

    @property
    def thread_numbers(self) -> list[int]:
        """Numbers that the system gives the threads which write."""
        threads = (self._writer.thread, *self._reports)
        return [t.native_id for t in threads if t is not None and t.native_id is not None]

    @property
    def failure(self) -> str | None:
        """Why the newest checkpoint could not be written; None where it could."""
        return self._astray or self._writer.failure

    @property
    def age_s(self) -> float | None:
        """Time since a checkpoint was last taken; None where none was."""
        return None if self._since_s is None else time.monotonic() - self._since_s


def _write_report(incident: Incident, file: Path, tell: Callable[[str], object]) -> None:
    try:
        tell(f'what led there is in {incident.write(file)}')
    except Exception as error:  # it comes from a broken observer: anything may be in it
        tell(f'what led there could not be written: {error}')
