"""Opens a user's input: regular files of bounded size, nothing that waits or never ends."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from gray_box_observer.errors import InputError

_KINDS = (
    (stat.S_ISDIR, 'a folder'),
    (stat.S_ISFIFO, 'a pipe'),
    (stat.S_ISCHR, 'a device'),
    (stat.S_ISBLK, 'a device'),
    (stat.S_ISSOCK, 'a socket'),
)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading, without waiting for whoever might write to it.

    Raises:
        InputError: There is no such file, it may not be read, or it is a folder, a pipe or a
            device.
    """
    try:
        # A pipe would keep a plain open() waiting for ever.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise InputError(f'{path}: cannot be read: {_reason(error)}') from None
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, 'rb')
    os.close(descriptor)
    kind = next((word for is_kind, word in _KINDS if is_kind(mode)), 'something else')
    raise InputError(f'{path}: cannot be read: it is {kind}, expected a regular file')


def read_text(path: Path, largest_bytes: int) -> str:
    """Return the text of a small UTF-8 file.

    Args:
        path: Of the file.
        largest_bytes: More than this is refused before it is read.

    Raises:
        InputError: The file cannot be read, is larger, or is no UTF-8.
    """
    with open_regular(path) as stream:
        try:
            content = stream.read(largest_bytes + 1)
        except OSError as error:
            raise InputError(f'{path}: cannot be read: {_reason(error)}') from None
    if len(content) > largest_bytes:
        raise InputError(
            f'{path}: cannot be read: it is larger than the {largest_bytes:,} bytes expected at '
            'most'
        )
    try:
        return content.decode('utf-8-sig')
    except UnicodeDecodeError as error:
        raise InputError(f'{path}: cannot be read: byte {error.start} is no UTF-8') from None


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
