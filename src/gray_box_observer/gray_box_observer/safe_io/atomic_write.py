"""Files written whole or not at all: first beside their place, under an unguessable name.

A reader never sees half a file, a crash leaves the old one. Nothing is ever written through a link
that somebody has laid there: the file that is not whole yet is made exclusively, and a link in the
place of the whole one is replaced.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

PARTIAL = '.partial'
"""What the name of a file ends with that is not whole yet."""

SCRAP_AGE_S = 60.0
"""A partial file that nobody has written to for so long belongs to a process that was killed."""

SECRET_BYTES = 16
"""Random bytes in the name of a file that is not whole yet."""

_EXCLUSIVE = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def atomic_write(path: Path, *, private: bool = False, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a new file that replaces ``path`` at the block's end; on failure the old one stays.

    Args:
        path: where the file shall stand, in a folder that is there.
        private: whether its owner alone may read it; else the umask decides, as for any file.
        durable: whether it shall outlive a power cut from the end of the block on, which takes the
            disk's time.

    Yields:
        The file, to be written to.

    Raises:
        OSError: the file cannot be made, written or put in its place.
    """
    _refuse_special(path)
    _sweep(path)
    partial = path.with_name(f'.{path.name}.{secrets.token_hex(SECRET_BYTES)}{PARTIAL}')
    descriptor = os.open(partial, _EXCLUSIVE, 0o600 if private else 0o666)
    try:
        with os.fdopen(descriptor, 'wb') as file:
            yield file
            file.flush()
            if durable:
                os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        with suppress(OSError):  # on a dead disk there is no help
            partial.unlink(missing_ok=True)
        raise
    if durable:
        _sync_folder(path.parent)


def _refuse_special(path: Path) -> None:
    """Leave pipes, devices and sockets alone: a file in their place would be somebody's surprise.

    Raises:
        OSError: the path is one of them.
    """
    with suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
            raise OSError(errno.EINVAL, 'it is no regular file', str(path))


def _sweep(path: Path) -> None:
    """Remove what killed writers of this file have left; a young one may still be in use."""
    pattern = re.compile(
        rf'\.{re.escape(path.name)}\.[0-9a-f]{{{2 * SECRET_BYTES}}}{re.escape(PARTIAL)}'
    )
    with suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            if pattern.fullmatch(entry.name):
                _remove_if_old(entry)


def _remove_if_old(entry: os.DirEntry[str]) -> None:
    with suppress(OSError):
        status = entry.stat(follow_symlinks=False)
        if stat.S_ISREG(status.st_mode) and time.time() - status.st_mtime > SCRAP_AGE_S:
            Path(entry.path).unlink()


def _sync_folder(folder: Path) -> None:
    """Let the new name outlive a power cut too, where the file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
