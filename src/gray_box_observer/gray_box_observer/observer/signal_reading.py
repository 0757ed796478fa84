"""Reads one field of the messages of one topic: names of motors, and their values in SI units."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from gray_box_observer.bag.fields import (
    ByName,
    Entries,
    FieldPath,
    MissingFieldError,
    entry_names,
)
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.safe_io.bounded_cache import BoundedCache, size_of_names, worth_remembering
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT
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


NOBODY = ''
"""Stands where a name is that of a motor which has a joint of another name."""


ReadValues = tuple[tuple[str, ...], Sequence[float] | Array, bool]
"""What a :class:`Reading` holds, as the plain tuple that is quicker to make."""


class Reading(NamedTuple):
    """What one message says.

    Attributes:
        names: motors, configured or not.
        values: one each.
        has_our_motor: whether any is configured.
    """

    names: tuple[str, ...]
    values: Sequence[float] | Array
    has_our_motor: bool


class _NameCheck(NamedTuple):
    """Names in a list, as motors: whether one is ours, which is there twice, unknown ones."""

    names: tuple[str, ...]
    has_our_motor: bool
    twice: str | None
    strangers: tuple[str, ...]


class _Usual(NamedTuple):
    """The usual message: one motor of ours, named, with one value.

    Attributes:
        message_type: of the message.
        names_getter: finds the names in it.
        names: as they stand in the message.
        value_type: of what holds the value.
        motors: the same names, as motors.
    """

    message_type: type
    names_getter: Callable[[Any], Sequence[str] | None]
    names: Sequence[str]
    value_type: Any
    motors: tuple[str, ...]


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
        self._field = self._path.plain_getter
        self.scale: float = configuration[f'{name}.scale']
        self.offset: float = configuration[f'{name}.offset']
        self._motors = dict.fromkeys(configuration.motors)
        self._joints = {
            motor.joint: name
            for name, motor in configuration.motors.items()
            if motor.values['joint']
        }
        self._torque_constants = _torque_constants(name, configuration)
        self._lists: BoundedCache[tuple[str, ...], _NameCheck] = BoundedCache(
            MAX_LISTS, MAX_LIST_BYTES
        )
        self.unknown_names: Counter[str] = Counter()
        self._readable = False
        self._usual: _Usual | None = None

    def read(self, message: Any) -> ReadValues:
        """Return the motor names, a value in SI units for each, and whether any is configured.

        Raises:
            SampleError: names and values differ in number, an array is too short or too long for
                the field, a motor is named twice, or one value stands for several motors.
            ConfigurationError: the message has no such field.
        """
        usual = self._usual
        if usual is not None and type(message) is usual.message_type:
            value = self._field(message)
            if (
                type(value) is usual.value_type
                and len(value) == 1
                and usual.names_getter(message) == usual.names
            ):
                return usual.motors, (self.scale * float(value[0]) + self.offset,), True
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
            return self._single(self.scale * value + self.offset)
        if self._path.may_have_entries and isinstance(value, Entries):
            names, value = value
        if names is None:
            if len(value) == 1:
                self._readable = True
                return self._single(self.scale * float(value[0]) + self.offset)
            raise SampleError(
                f'{self.name}.field {self._path.text} holds {len(value)} values without names: '
                'add an index'
            )
        if len(names) != len(value):
            raise SampleError(f'{len(names)} names but {len(value)} values of {self._path.text}')
        self._readable = True
        message_names = tuple(names)
        if len(message_names) == 1:  # the usual case, in plain floats
            values: Sequence[float] | Array = (self.scale * float(value[0]) + self.offset,)
        else:
            values = self.scale * np.asarray(value, dtype=float) + self.offset
        name_check = self._lists.get(message_names) or self._check_names(message_names)
        if name_check.twice is not None:
            raise SampleError(f'{name_check.twice} is named twice')
        for name in name_check.strangers:  # remember some of them, for diagnostics
            if len(self.unknown_names) < MOST_STRANGERS or name in self.unknown_names:
                self.unknown_names[name] += 1
        if self._torque_constants:
            values = self._as_torque(name_check.names, values)
        elif (
            len(message_names) == 1 and name_check.has_our_motor and not self._path.may_have_entries
        ):
            self._usual = _Usual(
                type(message), _names_getter(message), copy(names), type(value), name_check.names
            )
        return name_check.names, values, name_check.has_our_motor

    def speed_path(self) -> FieldPath | None:
        """Return where the velocity of the same entry stands; None where all entries are read."""
        steps = self._path.steps
        if len(steps) == 2 and not isinstance(steps[1], str):
            entry = steps[1].name if isinstance(steps[1], ByName) else steps[1]
            return FieldPath(f'velocity[{entry}]')
        return None

    def _single(self, value: float) -> ReadValues:
        """Return a value that comes without a name."""
        names = self._only_motor()
        if self._torque_constants:
            value *= self._torque_constants[names[0]]
        return names, (value,), True

    def _as_torque(
        self, names: tuple[str, ...], values: Sequence[float] | Array
    ) -> Sequence[float] | Array:
        """Multiply currents by the torque constants of their motors; strangers stay as they are."""
        constants = [self._torque_constants.get(name, 1.0) for name in names]
        if len(names) == 1:
            return (values[0] * constants[0],)
        return np.asarray(values) * constants

    def _check_names(self, message_names: tuple[str, ...]) -> _NameCheck:
        """Find out who is in a list of names, and remember it."""
        names = self._motor_names(message_names)
        ours = Counter(name for name in names if name in self._motors)
        strangers = dict.fromkeys(
            own[:LONGEST_NAME]
            for own, name in zip(message_names, names, strict=True)
            if name not in self._motors
        )
        twice = next((name for name, count in ours.items() if count > 1), None)
        name_check = _NameCheck(names, bool(ours), twice, tuple(strangers)[:MOST_STRANGERS])
        if worth_remembering(message_names):
            size_bytes = size_of_names(message_names)
            self._lists.remember(message_names, name_check, size_bytes)
        return name_check

    def _motor_names(self, message_names: tuple[str, ...]) -> tuple[str, ...]:
        """Call joints by the names of their motors.

        A motor whose joint is not among the names may be there by its own name.
        """
        motor_names = {self._joints[name] for name in message_names if name in self._joints}
        if not motor_names:
            return message_names
        return tuple(
            self._joints.get(name, NOBODY if name in motor_names else name)
            for name in message_names
        )

    def _only_motor(self) -> tuple[str, ...]:
        if len(self._motors) != 1:
            raise SampleError(
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
    if names is None or isinstance(names, str):
        return entry_names(message)
    return names  # type: ignore[no-any-return]


def _names_getter(message: Any) -> Callable[[Any], Sequence[str] | None]:
    """Return what finds the names in messages of this one's type, as :func:`names_of` does."""
    for field in ('names', 'name'):
        names = getattr(message, field, None)
        if names is not None:
            return attrgetter(field) if isinstance(names, (list, tuple)) else names_of
    return names_of


def _torque_constants(name: str, configuration: Configuration) -> Mapping[str, float]:
    """Return Kt of every motor where a signal is a current that stands for torque; else none."""
    if name != 'torque' or configuration['torque.quantity'] != 'current':
        return {}
    return {
        motor.name: float(motor.values[TORQUE_CONSTANT]) for motor in configuration.motors.values()
    }
