"""From messages to measurements: the same reading of the same fields for live topics and for bags.

Messages are taken by the names of their fields, so those of rclpy and those decoded from a bag do alike.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.configuration import Configuration
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.observer import Observer, Result
from gray_box_observer.samples import Rejection

SIGNALS = ('voltage', 'torque', 'speed')


class Signal:
    """One measured quantity in the messages of one topic.

    Attributes:
        topic: where it comes from; empty where it has no topic of its own.
        type_name: message type.
        unknown: names in messages that no configured motor has, and how often they came.
    """

    def __init__(self, name: str, configuration: Configuration) -> None:
        self.name = name
        self.topic: str = configuration[f'{name}.topic']
        self.type_name: str = configuration[f'{name}.type']
        self._path = FieldPath(configuration[f'{name}.field'])
        self._scale: float = configuration[f'{name}.scale']
        self._motors = tuple(configuration.motors)
        self.unknown: Counter[str] = Counter()

    def read(self, message: Any) -> list[tuple[str, float]]:
        """Return motor and value in SI units for every configured motor in the message.

        Raises:
            SampleError: names and values differ in number.
            ConfigurationError: the message has no such field, or one value stands for several motors.
        """
        value = self._path(message)
        names = getattr(message, 'name', None)
        if isinstance(value, (int, float)):
            return [(self._only_motor(), self._scale * value)]
        if names is None or isinstance(names, str):
            if len(value) == 1:
                return [(self._only_motor(), self._scale * float(value[0]))]
            raise ConfigurationError(
                f'{self.name}.field {self._path} holds {len(value)} values without names: choose one, like {self._path}[0]'
            )
        if len(names) != len(value):
            raise SampleError(f'{len(names)} names but {len(value)} values of {self._path}')
        wanted = self._motors
        if len(names) == 1 and names[0] in wanted:  # the usual case, without building a list twice
            return [(names[0], self._scale * float(value[0]))]
        pairs = []
        for motor, number in zip(names, value, strict=True):
            if motor in wanted:
                pairs.append((motor, self._scale * float(number)))
            elif len(self.unknown) < 100:
                self.unknown[motor] += 1
        return pairs

    def _only_motor(self) -> str:
        if len(self._motors) != 1:
            raise ConfigurationError(
                f'{self.name}.field {self._path} is one number without name, but there are {len(self._motors)} motors: '
                'use a message with names, or one observer a motor'
            )
        return self._motors[0]


def stamp_of(message: Any) -> int | None:
    """Return the header's stamp in ns; None where the type has no header."""
    header = getattr(message, 'header', None)
    stamp = getattr(header, 'stamp', None)
    if stamp is not None:
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    ready: int | None = getattr(message, 'stamp_ns', None)  # a view of the bag reader
    return ready


class Intake:
    """Takes messages of the configured topics and feeds the observer.

    Attributes:
        rejected: messages that could not be read at all, by signal and reason.
    """

    def __init__(self, observer: Observer, configuration: Configuration) -> None:
        self._observer = observer
        self.signals = {name: Signal(name, configuration) for name in SIGNALS}
        self.rejected: dict[str, Counter[Rejection]] = {name: Counter() for name in SIGNALS}
        self.received: Counter[str] = Counter()
        self._own_speed_topic = bool(self.signals['speed'].topic)
        self._speed: dict[str, float] = {}

    def take(self, name: str, message: Any, arrival_ns: int) -> list[Result]:
        """Take one message of a signal; return what it has led to.

        Args:
            name: ``voltage``, ``torque`` or ``speed``.
            message: the message.
            arrival_ns: stamp of messages without header: the middleware's source time, or the time in the bag.

        Raises:
            ConfigurationError: the message does not have the configured field.
        """
        self.received[name] += 1
        stamp_ns = stamp_of(message)
        if stamp_ns is None:
            stamp_ns = arrival_ns
        try:
            pairs = self.signals[name].read(message)
        except (SampleError, TypeError, ValueError):
            self.rejected[name][Rejection.MALFORMED] += 1
            return []
        if name == 'voltage':
            return [r for motor, value in pairs for r in self._observer.voltage(motor, stamp_ns, value)]
        if name == 'speed':
            self._speed.update(pairs)
            return []
        speeds = self._speeds(message)
        results: list[Result] = []
        for motor, value in pairs:
            results += self._observer.torque(motor, stamp_ns, value, speeds.get(motor, math.nan))
        return results

    def motors_in(self, name: str, message: Any) -> Sequence[str]:
        """Return the configured motors that a message speaks of; none where it cannot be read."""
        try:
            return [motor for motor, _ in self.signals[name].read(message)]
        except (SampleError, TypeError, ValueError):
            return []

    def _speeds(self, message: Any) -> dict[str, float]:
        """Speed by motor: from its own topic (the newest), else from the torque message's velocity."""
        if self._own_speed_topic:
            return self._speed
        velocity = getattr(message, 'velocity', None)
        names = getattr(message, 'name', None)
        if velocity is None or names is None or len(velocity) != len(names):
            return {}
        return {motor: float(v) for motor, v in zip(names, velocity, strict=True)}
