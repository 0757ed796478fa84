"""From messages to measurements: the same reading of the same fields for live topics and for bags.

Messages are taken by the names of their fields, so those of rclpy and those decoded from a bag do
alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gray_box_observer.bag.fields import FieldPath, MissingFieldError
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.observer.observer import GroupResult, Observer
from gray_box_observer.safe_io.bounded_cache import BoundedCache, size_of_names, worth_remembering
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.parameters import SIGNALS
from gray_box_observer.white_box.interface import Array

MOST_STRANGERS = 100
"""Names that no configured motor has, of which it is counted how often they came."""

LONGEST_NAME = 64
"""Of such a name, as much as is remembered: a message may hold anything."""

LATEST_NS = 1 << 62
"""Stamps are kept in 64 bits, with room for differences and delays; headers of ROS end in 2038,
which is half of it."""

MAX_LISTS = 64
"""Lists of names of which it is remembered who is in them."""

MAX_LIST_BYTES = 8_000_000
"""What these lists may take together."""


class _NameCheck(NamedTuple):
    """Names in a list: whether a motor of ours, which of them twice, and unknown ones."""

    has_our_motor: bool
    twice: str | None
    strangers: tuple[str, ...]


class Signal:
    """One measured quantity in the messages of one topic.

    Attributes:
        topic: where it comes from; empty where it has no topic of its own.
        type_name: message type.
        scale: factor from the field to SI units.
        offset: what is added then, in SI units.
        unknown: names in messages that no configured motor has, and how often they came; not all
            where there are many.
    """

    def __init__(self, name: str, configuration: Configuration) -> None:
        self.name = name
        self.topic: str = configuration[f'{name}.topic']
        self.type_name: str = configuration[f'{name}.type']
        self._path = FieldPath(configuration[f'{name}.field'])
        self.scale: float = configuration[f'{name}.scale']
        self.offset: float = configuration[f'{name}.offset']
        self._motors = dict.fromkeys(configuration.motors)
        self._lists: BoundedCache[tuple[str, ...], _NameCheck] = BoundedCache(
            MAX_LISTS, MAX_LIST_BYTES
        )
        self.unknown_names: Counter[str] = Counter()
        self._readable = False

    def read(self, message: Any) -> tuple[tuple[str, ...], Sequence[float] | Array, bool]:
        """Return the motor names, a value in SI units for each, and whether any is configured.

        Raises:
            SampleError: names and values differ in number, an array is too short or too long for
                the field, or a motor is named twice.
            ConfigurationError: the message has no such field, or one value stands for several
                motors.
        """
        try:
            value = self._path(message)
        except MissingFieldError as error:
            if self._readable:  # this one message is of another type
                raise
            raise ConfigurationError(
                f'{self.name}.field {self._path.text!r} on {self.topic}: {error}'
            ) from error
        names = names_of(message)
        if isinstance(value, (int, float)):
            self._readable = True
            return self._only_motor(), (self.scale * value + self.offset,), True
        if names is None:
            if len(value) == 1:
                self._readable = True
                return self._only_motor(), (self.scale * float(value[0]) + self.offset,), True
            raise SampleError(
                f'{self.name}.field {self._path.text} holds {len(value)} values without names: '
                'add an index'
            )
        if len(names) != len(value):
            raise SampleError(f'{len(names)} names but {len(value)} values of {self._path.text}')
        self._readable = True
        motor_names = tuple(names)
        if len(motor_names) == 1:  # the usual case, in plain floats
            values: Sequence[float] | Array = (self.scale * float(value[0]) + self.offset,)
        else:
            values = self.scale * np.asarray(value, dtype=float) + self.offset
        name_check = self._lists.get(motor_names) or self._check_names(motor_names)
        if name_check.twice is not None:
            raise SampleError(f'{name_check.twice} is named twice')
        for name in name_check.strangers:  # remember some of them, for diagnostics
            if len(self.unknown_names) < MOST_STRANGERS or name in self.unknown_names:
                self.unknown_names[name] += 1
        return motor_names, values, name_check.has_our_motor

    def _check_names(self, names: tuple[str, ...]) -> _NameCheck:
        """Find out who is in a list of names, and remember it."""
        ours = Counter(name for name in names if name in self._motors)
        strangers = dict.fromkeys(name[:LONGEST_NAME] for name in names if name not in self._motors)
        twice = next((name for name, count in ours.items() if count > 1), None)
        name_check = _NameCheck(bool(ours), twice, tuple(strangers)[:MOST_STRANGERS])
        if worth_remembering(names):
            self._lists.remember(names, name_check, size_of_names(names))
        return name_check

    def _only_motor(self) -> tuple[str, ...]:
        if len(self._motors) != 1:
            raise ConfigurationError(
                f'{self.name}.field {self._path.text} is one number, but there are '
                f'{len(self._motors)} motors: '
                'use a message with names, or one observer a motor'
            )
        return tuple(self._motors)


def stamp_of(message: Any, arrival_ns: int = 0) -> int:
    """Return the stamp in ns: the header's; where the type has none, the time it arrived with.

    Raises:
        SampleError: it lies further from 1970 than a century, which differences of stamps would not
            bear.
    """
    ready: int | None = getattr(message, 'stamp_ns', None)  # a view of the bag reader
    if ready is not None:
        return ready
    stamp = getattr(getattr(message, 'header', None), 'stamp', None)
    stamp_ns = arrival_ns if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    if not -LATEST_NS < stamp_ns < LATEST_NS:
        raise SampleError(f'stamp of {stamp_ns} ns is beyond {LATEST_NS} ns')
    return stamp_ns


def names_of(message: Any) -> Sequence[str] | None:
    """Return the names that a message gives its values; None where its type has none."""
    names = getattr(message, 'names', None)  # a view of the bag reader
    if names is None:
        names = getattr(message, 'name', None)
    return None if names is None or isinstance(names, str) else names


class InputResult(NamedTuple):
    """What one message held and what it has led to.

    Attributes:
        stamp_ns: its stamp.
        names: motors it speaks of, configured or not; none where it cannot be read.
        groups: of the samples that it completed, group by group.
    """

    stamp_ns: int
    names: tuple[str, ...]
    groups: list[GroupResult]


class MessageInput:
    """Takes messages of the configured topics and feeds the observer.

    Attributes:
        received: messages by signal; of each motor that one speaks of, :class:`Pairing` counts on.
        rejected: messages that could not be read at all, by signal and reason.
        complaints: what was wrong with the last of them that was decoded, by signal.
        others: messages that spoke of no configured motor, by signal.
        max_message_bytes: a larger message is refused before it is decoded; whoever decodes sees to
            it.
    """

    def __init__(self, observer: Observer, configuration: Configuration) -> None:
        self._observer = observer
        self.signals = {name: Signal(name, configuration) for name in SIGNALS}
        self.rejected: dict[str, Counter[Rejection]] = {name: Counter() for name in SIGNALS}
        self.complaints: dict[str, str] = {}
        self.received: Counter[str] = Counter()
        self.others: Counter[str] = Counter()
        self._own_speed_topic = bool(self.signals['speed'].topic)
        self.max_message_bytes = round(configuration['max_message_mb'] * 1e6)

    def ingest(self, name: str, message: Any, arrival_ns: int) -> InputResult:
        """Take one message of a signal; return what it held and what it has led to.

        Args:
            name: ``voltage``, ``torque`` or ``speed``.
            message: the message.
            arrival_ns: stamp of messages without header: the middleware's source time, or the time
                in the bag.

        Raises:
            ConfigurationError: the message does not have the configured field.
        """
        self.received[name] += 1
        try:
            stamp_ns = stamp_of(message, arrival_ns)
        except (SampleError, TypeError, ValueError, OverflowError, AttributeError):
            self.rejected[name][Rejection.MALFORMED] += 1
            return InputResult(0, (), [])
        try:
            names, values, has_our_motor = self.signals[name].read(message)
            speeds = self._speeds(message) if name == 'torque' else None
        except (
            SampleError,
            TypeError,
            ValueError,
            ArithmeticError,
            LookupError,
            AttributeError,
        ) as error:
            self.complaints[name] = (
                str(error) if isinstance(error, SampleError) else 'it holds no numbers'
            )
            self.rejected[name][Rejection.MALFORMED] += 1
            return InputResult(stamp_ns, (), [])
        if not has_our_motor:
            self.others[name] += 1
        return InputResult(
            stamp_ns, names, self._observer.ingest(name, names, stamp_ns, values, speeds)
        )

    def refuse(self, name: str, reason: Rejection) -> None:
        """Count a message that came and was not read; it leads to nothing."""
        self.received[name] += 1
        self.rejected[name][reason] += 1

    def _speeds(self, message: Any) -> Sequence[float] | Array | None:
        """Speeds from the torque message's velocity; None if absent or on a topic of their own."""
        velocity = None if self._own_speed_topic else getattr(message, 'velocity', None)
        if velocity is None or not len(velocity):  # an array of numpy has no truth
            return None
        names = names_of(message)
        if names is None or len(velocity) != len(names):
            return None
        speed = self.signals['speed']
        if len(names) == 1:
            return (speed.scale * float(velocity[0]) + speed.offset,)
        return speed.scale * np.asarray(velocity, dtype=float) + speed.offset
