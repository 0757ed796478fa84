"""Remembering what came once, within bounds: what others send must not fill the memory."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TypeVar

K = TypeVar('K', bound=Hashable)
V = TypeVar('V')

MAX_NAMES = 20_000
"""A longer list is worked out every time: few of a million would fill any memory."""

MAX_LETTERS = 1_000_000
"""So is one of more letters, however few its names are."""

NAME_BYTES = 64
"""What a text and its place in a tuple take beside its letters."""


class BoundedCache(dict[K, V]):
    """Values by key, bounded in number and bytes; beyond either, all are forgotten.

    Whoever sends the same keeps being remembered. What is another every time is worked out anew
    every time, which is what it costs without a memory.

    Args:
        max_entries: how many values are held at most.
        max_bytes: how many bytes they take at most, as far as :meth:`remember` is told.
    """

    def __init__(self, max_entries: int, max_bytes: int) -> None:
        super().__init__()
        self._max_entries = max_entries
        self._max_bytes = max_bytes
        self._bytes = 0

    def remember(self, key: K, value: V, size_bytes: int) -> None:
        """Hold a value, unless it is larger than all that may be held."""
        if size_bytes > self._max_bytes:
            return
        if len(self) >= self._max_entries or self._bytes + size_bytes > self._max_bytes:
            self.clear()
        self[key] = value
        self._bytes += size_bytes

    def clear(self) -> None:
        """Forget everything."""
        super().clear()
        self._bytes = 0


def worth_remembering(names: Sequence[str]) -> bool:
    """Tell whether a list of names is short enough to be remembered."""
    return len(names) <= MAX_NAMES and sum(map(len, names)) <= MAX_LETTERS


def size_of_names(names: Sequence[str]) -> int:
    """Return about how many bytes a list of names takes."""
    return NAME_BYTES * len(names) + sum(map(len, names))
