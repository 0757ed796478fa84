"""Messages of several topics, put together by stamp: one topic leads, the others are held."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

REMEMBERED = 64
"""Newest messages of each topic from which one is chosen."""

PACED_BY = 8
"""Newest messages whose mean interval is the pace of a topic."""

FEWEST_PACED = 3
"""Messages that tell a pace."""

FASTER = 2.0
"""How often as often as the leading topic another one comes before it takes over."""


@dataclass(slots=True)
class _Track:
    """Newest messages of one topic: their stamps in ns, and what they hold."""

    messages: deque[tuple[int, Any]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    @property
    def newest_ns(self) -> int | None:
        return self.messages[-1][0] if self.messages else None

    @property
    def interval_ns(self) -> float:
        """Mean time between the newest messages; infinite where they are too few."""
        count = min(len(self.messages), PACED_BY)
        if count < FEWEST_PACED:
            return float('inf')
        return (self.messages[-1][0] - self.messages[-count][0]) / (count - 1)

    def at(self, stamp_ns: int) -> tuple[int, Any] | None:
        """Return the newest message not later than a stamp; None where there is none."""
        return next((m for m in reversed(self.messages) if m[0] <= stamp_ns), None)


@dataclass(frozen=True, slots=True)
class Aligned:
    """Messages that belong together.

    Attributes:
        stamp_ns: of the leading one.
        contents: by topic.
        complaint: why nothing can be made of them; empty where something can.
    """

    stamp_ns: int
    contents: Mapping[str, Any]
    complaint: str = ''


class InputAlignment:
    """Puts messages of several topics together.

    The topic that comes most often leads: each of its messages makes one whole, with the newest
    message of every other topic that is not later. A message of the leading topic waits for topics
    that come about as often until they have come as far; it waits until the next one of its own at
    most. Stamps and the order of messages settle all, never a clock.

    Args:
        stale_ns: by topic, how old a message may be that is held.
        jump_back_ns: a stamp that goes back by more is of a restarted clock.
    """

    def __init__(self, stale_ns: Mapping[str, int], jump_back_ns: int) -> None:
        self._stale_ns = stale_ns
        self._jump_back_ns = jump_back_ns
        self._tracks = {topic: _Track() for topic in stale_ns}
        self._leader = next(iter(stale_ns))
        self._waiting_message: tuple[int, Any] | None = None

    def add(self, topic: str, stamp_ns: int, content: Any) -> list[Aligned]:
        """Take a message; return what it completes, in the order of time."""
        if len(self._stale_ns) == 1:
            return [Aligned(stamp_ns, {topic: content})]
        newest_ns = self._tracks[topic].newest_ns
        if newest_ns is not None and stamp_ns < newest_ns:
            if newest_ns - stamp_ns <= self._jump_back_ns:
                return self._out_of_order(topic, stamp_ns, content)
            self.restart()
        self._tracks[topic].messages.append((stamp_ns, content))
        wholes = self._choose_leader()
        if topic == self._leader:
            wholes += self._release()
            self._waiting_message = (stamp_ns, content)
        if self._waiting_message is not None and self._is_complete(self._waiting_message[0]):
            wholes += self._release()
        return wholes

    def flush(self) -> list[Aligned]:
        """Return what still waits for others, at the end of a recording."""
        return self._release()

    def restart(self) -> None:
        """Forget every message, for the clock begins anew."""
        self._tracks = {topic: _Track() for topic in self._stale_ns}
        self._leader = next(iter(self._stale_ns))
        self._waiting_message = None

    def _out_of_order(self, topic: str, stamp_ns: int, content: Any) -> list[Aligned]:
        """Pass a late message of the leading topic on, for it to be refused; drop any other."""
        if topic != self._leader:
            return []
        return [self._whole(stamp_ns, content)]

    def _choose_leader(self) -> list[Aligned]:
        """Let the topic lead that comes most often; return what waited for others until then."""
        paces = {topic: track.interval_ns for topic, track in self._tracks.items()}
        fastest = min(paces, key=paces.__getitem__)
        if FASTER * paces[fastest] >= paces[self._leader]:
            return []
        wholes = self._release()
        self._leader = fastest
        return wholes

    def _is_complete(self, stamp_ns: int) -> bool:
        """Tell whether every topic has come as far as a stamp, or is too slow to be waited for."""
        limit_ns = FASTER * self._tracks[self._leader].interval_ns
        return all(
            topic == self._leader
            or track.interval_ns >= limit_ns
            or (track.newest_ns is not None and track.newest_ns >= stamp_ns)
            for topic, track in self._tracks.items()
        )

    def _release(self) -> list[Aligned]:
        if self._waiting_message is None:
            return []
        stamp_ns, content = self._waiting_message
        self._waiting_message = None
        return [self._whole(stamp_ns, content)]

    def _whole(self, stamp_ns: int, content: Any) -> Aligned:
        """Put a message of the leading topic together with what was in force then."""
        contents = {self._leader: content}
        for topic, track in self._tracks.items():
            if topic == self._leader:
                continue
            message = track.at(stamp_ns)
            if message is None:
                return Aligned(stamp_ns, {}, _absence(topic, track, stamp_ns))
            age_ns = stamp_ns - message[0]
            if age_ns > self._stale_ns[topic]:
                return Aligned(stamp_ns, {}, f'{topic} is {age_ns * 1e-9:.3g} s old')
            contents[topic] = message[1]
        return Aligned(stamp_ns, contents)


def _absence(topic: str, track: _Track, stamp_ns: int) -> str:
    """Say why a topic holds nothing for a stamp."""
    if track.newest_ns is None:
        return f'{topic} has brought nothing yet'
    ahead_s = (track.newest_ns - stamp_ns) * 1e-9
    return f'{topic} is stamped {ahead_s:.3g} s later: by another clock?'


def stale_limits(ages_s: Sequence[tuple[str, float]]) -> dict[str, int]:
    """Return how old a message of each topic may be, in ns: as its strictest input says."""
    limits: dict[str, int] = {}
    for topic, age_s in ages_s:
        age_ns = round(age_s * 1e9)
        limits[topic] = min(limits.get(topic, age_ns), age_ns)
    return limits
