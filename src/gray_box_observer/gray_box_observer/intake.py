"""From messages to measurements: the same reading of the same fields for live topics and for bags.

Messages are taken by the names of their fields, so those of rclpy and those decoded from a bag do alike.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.configuration import Configuration
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.observer import Observer, Result
from gray_box_observer.parameters import SIGNALS
from gray_box_observer.samples import Rejection

MOST_STRANGERS = 100
"""Names that are not ours, as many as are remembered."""

LONGEST_NAME = 64
"""Of them, as much as is remembered: a message may hold anything."""


class Signal:
    """One measured quantity in the messages of one topic.

    Attributes:
        topic: where it comes from; empty where it has no topic of its own.
        type_name: message type.
        scale: factor from the field to SI units.
        unknown: names in messages that no configured motor has, and how often they came; not all where there are many.
    """

    def __init__(self, name: str, configuration: Configuration) -> None:
        self.name = name
        self.topic: str = configuration[f'{name}.topic']
        self.type_name: str = configuration[f'{name}.type']
        self._path = FieldPath(configuration[f'{name}.field'])
        self.scale: float = configuration[f'{name}.scale']
        self._motors = tuple(configuration.motors)
        self.unknown: Counter[str] = Counter()
        self._readable = False

    def read(self, message: Any) -> list[tuple[str, float]]:
        """Return motor and value in SI units for every configured motor in the message.

        Raises:
            SampleError: names and values differ in number, or a motor is named twice.
            ConfigurationError: the message has no such field, or one value stands for several motors.
        """
        try:
            value = self._path(message)
        except SampleError as error:
            if self._readable:  # this one message is short of something
                raise
            raise ConfigurationError(f'{self.name}.field {self._path.text!r} on {self.topic}: {error}') from error
        self._readable = True
        names = names_of(message)
        if isinstance(value, (int, float)):
            return [(self._only_motor(), self.scale * value)]
        if names is None:
            if len(value) == 1:
                return [(self._only_motor(), self.scale * float(value[0]))]
            raise ConfigurationError(
                f'{self.name}.field {self._path.text} holds {len(value)} values without names: add an index'
            )
        if len(names) != len(value):
            raise SampleError(f'{len(names)} names but {len(value)} values of {self._path.text}')
        wanted = self._motors
        if len(names) == 1 and names[0] in wanted:  # the usual case, without building a list twice
            return [(names[0], self.scale * float(value[0]))]
        found: dict[str, float] = {}
        for motor, number in zip(names, value, strict=True):
            if motor not in wanted:
                self._note(motor)
            elif motor in found:
                raise SampleError(f'{motor} is named twice')
            else:
                found[motor] = self.scale * float(number)
        return list(found.items())

    def _note(self, stranger: str) -> None:
        """Remember some of the names that are not ours, so that diagnostics can tell them."""
        if stranger in self.unknown or len(self.unknown) < MOST_STRANGERS:
            self.unknown[stranger[:LONGEST_NAME]] += 1

    def _only_motor(self) -> str:
        if len(self._motors) != 1:
            raise ConfigurationError(
                f'{self.name}.field {self._path.text} is one number, but there are {len(self._motors)} motors: '
                'use a message with names, or one observer a motor'
            )
        return self._motors[0]


def stamp_of(message: Any, arrival_ns: int = 0) -> int:
    """Return the stamp in ns: the header's; where the type has none, the time it arrived with."""
    ready: int | None = getattr(message, 'stamp_ns', None)  # a view of the bag reader
    if ready is not None:
        return ready
    stamp = getattr(getattr(message, 'header', None), 'stamp', None)
    return arrival_ns if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def names_of(message: Any) -> Sequence[str] | None:
    """Return the names that a message gives its values; None where its type has none."""
    names = getattr(message, 'names', None)  # a view of the bag reader
    if names is None:
        names = getattr(message, 'name', None)
    return None if names is None or isinstance(names, str) else names


class Taken(NamedTuple):
    """What one message held and what it has led to.

    Attributes:
        stamp_ns: its stamp.
        values: motor and value in SI units for every configured motor it speaks of; none where it cannot be read.
        results: of the samples that it completed.
    """

    stamp_ns: int
    values: Sequence[tuple[str, float]]
    results: list[Result]


class Intake:
    """Takes messages of the configured topics and feeds the observer.

    Attributes:
        received: messages by signal; of each motor that one speaks of, :class:`Pairing` counts on.
        rejected: messages that could not be read at all, by signal and reason.
        others: messages that spoke of no configured motor, by signal.
    """

    def __init__(self, observer: Observer, configuration: Configuration) -> None:
        self._observer = observer
        self.signals = {name: Signal(name, configuration) for name in SIGNALS}
        self.rejected: dict[str, Counter[Rejection]] = {name: Counter() for name in SIGNALS}
        self.received: Counter[str] = Counter()
        self.others: Counter[str] = Counter()
        self._own_speed_topic = bool(self.signals['speed'].topic)

    def take(self, name: str, message: Any, arrival_ns: int) -> Taken:
        """Take one message of a signal; return what it held and what it has led to.

        Args:
            name: ``voltage``, ``torque`` or ``speed``.
            message: the message.
            arrival_ns: stamp of messages without header: the middleware's source time, or the time in the bag.

        Raises:
            ConfigurationError: the message does not have the configured field.
        """
        self.received[name] += 1
        stamp_ns = stamp_of(message, arrival_ns)
        try:
            values = self.signals[name].read(message)
        except (SampleError, TypeError, ValueError):
            self.malformed(name)
            return Taken(stamp_ns, (), [])
        if not values:
            self.others[name] += 1
        results: list[Result] = []
        speeds = self._speeds(message) if name == 'torque' else {}
        for motor, value in values:
            if name == 'voltage':
                results += self._observer.voltage(motor, stamp_ns, value)
            elif name == 'speed':
                results += self._observer.speed(motor, stamp_ns, value)
            else:
                results += self._observer.torque(motor, stamp_ns, value, speeds.get(motor, math.nan))
        return Taken(stamp_ns, values, results)

    def malformed(self, name: str) -> None:
        """Count a message that could not be read; it leads to nothing."""
        self.rejected[name][Rejection.MALFORMED] += 1

    def _speeds(self, message: Any) -> dict[str, float]:
        """Speed by motor from the torque message's velocity; none where speed has a topic of its own."""
        if self._own_speed_topic:
            return {}
        velocity = getattr(message, 'velocity', None)
        names = names_of(message)
        if velocity is None or names is None or len(velocity) != len(names):
            return {}
        scale = self.signals['speed'].scale
        return {motor: scale * float(v) for motor, v in zip(names, velocity, strict=True)}
