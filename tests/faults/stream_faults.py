"""Faults between a driver and the observer, by network, clock or driver, on messages.

Seeded, and without ROS: the campaigns put it before the core (`core_campaign`) and between two
nodes (`node_campaign`).
"""

from __future__ import annotations

import heapq
import math
import random
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from gray_box_observer.bag.joint_state import JointStateView, encode_joint_state

NANOSECONDS = 1_000_000_000
MILLION = 1_000_000
NAMES = (
    '',
    ' ',
    'motör',
    '電動機',
    '⚙️',
    'a\u0301',
    '\u202emotor',
    'motor\n',
    'MOTOR',
    'motor ',
    '\U0001f9f2' * 50,
    'x' * 10_000,
)
"""No motor is called so, and yet somebody will send it."""
DENORMALS = (5e-324, -5e-324, 2.2e-308, -1e-310, 0.0, -0.0)
EXTREME_STAMPS_NS = (0, 1, -1, -(2**31) * NANOSECONDS, (2**31 - 1) * NANOSECONDS)


class Kind(str, Enum):
    """What is done to a message."""

    DROPPED = 'dropped'
    DELAYED = 'delayed'
    REORDERED = 'reordered'
    DUPLICATED = 'duplicated'
    NAN = 'NaN'
    INFINITE = 'infinity'
    HUGE = '1e300'
    DENORMAL = 'denormal or zero'
    WRONG_LENGTH = 'wrong lengths'
    EMPTY = 'empty names'
    STRANGE_NAME = 'strange names'
    MILLION_ENTRIES = 'a million entries'
    FROZEN = 'frozen, then in a burst'
    JUMPED_BACK = 'stamp jumped back'
    JUMPED_FORWARD = 'stamp jumped forward'
    CLOCK_SET = 'clock set anew'
    EXTREME_STAMP = 'stamp of another age'
    DAMAGED_BYTES = 'bytes damaged'


@dataclass(frozen=True, slots=True)
class FaultSettings:
    """How much goes wrong, and what.

    Attributes:
        share: of the messages, touched by a fault.
        weights: how much of that falls to each kind.
        most_frozen: messages that a frozen link holds back at most; more than the observer's queue
            holds would be lost.
    """

    share: float = 0.3
    weights: Mapping[Kind, float] = field(default_factory=lambda: WEIGHTS)
    most_frozen: int = 400


WEIGHTS: Mapping[Kind, float] = {
    **dict.fromkeys(Kind, 1.0),
    Kind.MILLION_ENTRIES: 1e-4,  # sixteen megabytes each
    Kind.CLOCK_SET: 0.03,
    Kind.EXTREME_STAMP: 0.1,
}
"""Equal parts, but for what is rare or expensive."""

CORE_WEIGHTS: Mapping[Kind, float] = {
    kind: w for kind, w in WEIGHTS.items() if kind is not Kind.DAMAGED_BYTES
}
"""Bytes are there only where messages are sent."""

RUNS: Mapping[Kind, tuple[int, int]] = {Kind.JUMPED_BACK: (1, 50), Kind.JUMPED_FORWARD: (1, 50)}
"""Kinds that last for a run of messages: shortest and longest."""


class Delivery(NamedTuple):
    """What arrives: the message of a signal, or the bytes of what was one."""

    signal: str
    message: JointStateView | bytes


class StreamFaults:
    """Spoils a stream of messages.

    Args:
        rules: how much, and what.
        seed: of everything random.

    Attributes:
        seen: messages taken.
        counts: messages that each kind of fault has touched.
        delivered: messages handed on, by signal.
    """

    def __init__(self, rules: FaultSettings, seed: int) -> None:
        self.seen = 0
        self.counts: Counter[Kind] = Counter()
        self.delivered: Counter[str] = Counter()
        self._rules = rules
        self._random = random.Random(seed)
        self._kinds = [kind for kind, weight in rules.weights.items() if weight > 0.0]
        lengths = {kind: sum(self._run_of(kind)) / 2 for kind in self._kinds}
        # a kind that lasts is begun less often
        self._weights = [rules.weights[kind] / lengths[kind] for kind in self._kinds]
        mean = sum(rules.weights[kind] for kind in self._kinds) / sum(self._weights)
        self._begin = rules.share / (mean * (1.0 - rules.share) + rules.share)
        self._running: Kind | None = None
        self._left = 0
        self._jump_ns = 0
        self._clock_ns = 0
        self._late: list[tuple[int, int, Delivery]] = []
        self._frozen: list[Delivery] = []

    @property
    def touched(self) -> int:
        """Messages that any fault has touched."""
        return self.counts.total()

    def take(self, signal: str, message: JointStateView) -> list[Delivery]:
        """Take one message as it was sent; return what arrives now, in this order."""
        self.seen += 1
        kind = self._draw()
        if kind is not None:
            self.counts[kind] += 1
        if kind is Kind.CLOCK_SET:
            self._clock_ns += self._drawn_jump_ns() * self._random.choice((-1, 1))
        shifted = message._replace(stamp_ns=message.stamp_ns + self._clock_ns)
        arriving = self._due() + self._spoilt(kind, signal, shifted)
        if kind is Kind.FROZEN or self._frozen:
            self._frozen += arriving
            arriving = []
        if self._frozen and self._running is not Kind.FROZEN:
            arriving, self._frozen = self._frozen, []
        return self._counted(arriving)

    def flush(self) -> list[Delivery]:
        """Deliver what is still on its way."""
        late = [delivery for _, _, delivery in sorted(self._late)]
        arriving, self._frozen, self._late = self._frozen + late, [], []
        self._running = None
        self._left = 0
        return self._counted(arriving)

    def _counted(self, arriving: list[Delivery]) -> list[Delivery]:
        self.delivered.update(delivery.signal for delivery in arriving)
        return arriving

    def _run_of(self, kind: Kind) -> tuple[int, int]:
        return (10, self._rules.most_frozen) if kind is Kind.FROZEN else RUNS.get(kind, (1, 1))

    def _draw(self) -> Kind | None:
        """Choose what happens to the next message; a run that has begun goes on."""
        if self._running is None:
            if self._random.random() >= self._begin:
                return None
            (self._running,) = self._random.choices(self._kinds, self._weights)
            self._left = self._random.randint(*self._run_of(self._running))
            self._jump_ns = self._drawn_jump_ns()
        kind = self._running
        self._left = self._left - 1
        if self._left == 0:
            self._running = None
        return kind

    def _drawn_jump_ns(self) -> int:
        """A jump of a clock: from a millisecond to a day, all sizes alike."""
        return round(
            math.exp(self._random.uniform(math.log(1e-3), math.log(86400.0))) * NANOSECONDS
        )

    def _due(self) -> list[Delivery]:
        due = []
        while self._late and self._late[0][0] <= self.seen:
            due.append(heapq.heappop(self._late)[2])
        return due

    def _later(self, signal: str, message: JointStateView, most: int) -> list[Delivery]:
        arrival = self.seen + self._random.randint(2, most)
        heapq.heappush(self._late, (arrival, self.seen, Delivery(signal, message)))
        return []

    def _spoilt(self, kind: Kind | None, signal: str, message: JointStateView) -> list[Delivery]:
        if kind is Kind.DROPPED:
            return []
        if kind is Kind.DELAYED:
            return self._later(signal, message, 200)
        if kind is Kind.REORDERED:
            return self._later(signal, message, 6)
        if kind is Kind.DUPLICATED:
            return [Delivery(signal, message)] * self._random.randint(2, 5)
        if kind is Kind.DAMAGED_BYTES:
            return [Delivery(signal, damaged(message, self._random))]
        change = CHANGES.get(kind) if kind is not None else None
        if change is not None:
            message = change(message, self._random)
        elif kind in (Kind.JUMPED_BACK, Kind.JUMPED_FORWARD):
            sign = -1 if kind is Kind.JUMPED_BACK else 1
            message = message._replace(stamp_ns=message.stamp_ns + sign * self._jump_ns)
        return [Delivery(signal, message)]


def damaged(message: JointStateView, draw: random.Random) -> bytes:
    """Cut the bytes of a message short, or let its first length claim what is not there."""
    data = encoded(message)
    if draw.random() < 0.5:
        return data[: draw.randrange(4, len(data))]
    at = 12  # behind encapsulation and stamp: the length of the frame
    return (
        data[:at] + draw.choice((2**32 - 1, 2**31, 10_000)).to_bytes(4, 'little') + data[at + 4 :]
    )


def encoded(message: JointStateView) -> bytes:
    """The bytes that a publisher sends; stamps beyond what a message can say come to its ends."""
    stamp_ns = min(max(message.stamp_ns, EXTREME_STAMPS_NS[3]), EXTREME_STAMPS_NS[4])
    return encode_joint_state(
        stamp_ns,
        message.names,
        position=message.position,
        velocity=message.velocity,
        effort=message.effort,
    )


def _values(values: Sequence[float]) -> Callable[[JointStateView, random.Random], JointStateView]:
    def change(message: JointStateView, draw: random.Random) -> JointStateView:
        value = draw.choice(values)
        return message._replace(effort=(value,) * len(message.effort))

    return change


def _wrong_length(message: JointStateView, draw: random.Random) -> JointStateView:
    names = message.names
    effort = message.effort
    changed = draw.choice(
        (
            {'effort': ()},
            {'effort': effort + effort},
            {'names': names + names},
            {'names': ()},
            {'names': names + names, 'effort': effort + effort},
            {'names': (*names, 'other'), 'effort': (*effort, 1.0), 'velocity': (1.0,) * 7},
            {'velocity': (1.0, 2.0, 3.0)},
        )
    )
    return message._replace(**changed)


def _empty(message: JointStateView, draw: random.Random) -> JointStateView:
    if draw.random() < 0.5:
        return message._replace(names=('',) * len(message.names))
    return message._replace(names=(), effort=(), velocity=())


def _strange_name(message: JointStateView, draw: random.Random) -> JointStateView:
    return message._replace(
        names=tuple(draw.choice(NAMES) + str(draw.randrange(10**6)) for _ in message.names)
    )


def _million_entries(message: JointStateView, draw: random.Random) -> JointStateView:
    name = draw.choice(('', *message.names))
    return message._replace(names=(name,) * MILLION, effort=message.effort[:1] * MILLION)


def _extreme_stamp(message: JointStateView, draw: random.Random) -> JointStateView:
    return message._replace(stamp_ns=draw.choice(EXTREME_STAMPS_NS))


CHANGES: Mapping[Kind, Callable[[JointStateView, random.Random], JointStateView]] = {
    Kind.NAN: _values((math.nan,)),
    Kind.INFINITE: _values((math.inf, -math.inf)),
    Kind.HUGE: _values((1e300, -1e300)),
    Kind.DENORMAL: _values(DENORMALS),
    Kind.WRONG_LENGTH: _wrong_length,
    Kind.EMPTY: _empty,
    Kind.STRANGE_NAME: _strange_name,
    Kind.MILLION_ENTRIES: _million_entries,
    Kind.EXTREME_STAMP: _extreme_stamp,
}
