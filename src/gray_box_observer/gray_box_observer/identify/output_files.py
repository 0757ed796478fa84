"""Where the offline command writes: refused before the work rather than after it."""

from __future__ import annotations

import errno
import json
import os
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.safe_io.finite import plain
from gray_box_observer.safe_io.standard_streams import readers_may_leave


def refuse_unwritable(target: Path, *, makes_folders: bool) -> None:
    """Say before the work, not after it, that a result could not be written.

    Raises:
        GrayBoxError: The file, or the folder it would be made in, takes nothing.
    """
    try:
        if target.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if target.is_file():
            target.open('ab').close()
        elif not target.exists():  # what is there and no file, such as a pipe, is left alone
            folder = target.parent
            while makes_folders and not folder.exists():
                folder = folder.parent
            with tempfile.TemporaryFile(dir=folder):
                pass
    except OSError as error:
        raise GrayBoxError(f'cannot write {target}: {error.strerror}') from error


def write_json(result: dict[str, Any], target: str) -> None:
    """Write a result as JSON, to a file or standard output (``-``); not finite is ``null``.

    Raises:
        GrayBoxError: the file cannot be written.
    """
    write = partial(json.dump, plain(result), indent=2, allow_nan=False)  # in pieces: it is long
    if target == '-':
        with readers_may_leave(sys.stdout):
            write(fp=sys.stdout)
            print()
        return
    try:
        with Path(target).open('w', encoding='utf-8') as stream:
            write(fp=stream)
            stream.write('\n')
    except OSError as error:
        raise GrayBoxError(f'cannot write {target}: {error.strerror}') from error
