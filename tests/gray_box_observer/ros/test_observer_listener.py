"""How messages are taken from a reader in a poll."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from gray_box_observer.ros.watching import observer_listener


class Handle(nullcontext):
    """The reader of a topic on which somebody sends without a pause."""

    count = 0

    def take_message(self, _kind: type, _raw: bool) -> tuple[Any, None]:
        """Return the next message; there always is one."""
        self.count += 1
        assert self.count <= 1_000_000, 'a poll without an end'
        return self.count, None


class Reader:
    """A subscription."""

    handle = Handle()
    msg_type = object


def test_a_sender_without_a_pause_does_not_keep_a_poll_from_its_end() -> None:
    first = list(observer_listener.taken(Reader()))
    assert first == list(range(1, observer_listener.MOST_TAKEN + 1))
    assert next(observer_listener.taken(Reader())) == first[-1] + 1, 'the rest waits'
