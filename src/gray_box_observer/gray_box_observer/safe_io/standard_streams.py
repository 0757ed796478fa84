"""Standard output and error whose readers may leave early, as ``head`` does: the work goes on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO


@contextmanager
def readers_may_leave(stream: TextIO) -> Iterator[None]:
    """Let what is written meanwhile, and ever after, get lost once nobody reads it any more."""
    try:
        yield
        stream.flush()
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())  # Python itself flushes once more at the end
        os.close(nowhere)
