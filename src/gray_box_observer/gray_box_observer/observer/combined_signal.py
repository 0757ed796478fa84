"""A signal that is an expression of inputs, which may come from several topics."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gray_box_observer.errors import SampleError
from gray_box_observer.expressions.formula import LOST, Formula, Name, Past, Value
from gray_box_observer.observer.input_alignment import Aligned, InputAlignment, stale_limits
from gray_box_observer.observer.signal_reading import Reading, Signal
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.signal_parameters import TORQUE_CONSTANT
from gray_box_observer.settings.signal_sources import inputs_of

LONGER = 1.25
"""Times the interval before it, that one counts for at most: a slower rate is usual after a few."""

OF_EVERY_MOTOR = ('',)
"""Stands for the names of an input that is one number."""


class _Input(Signal):
    """One input in the messages of its topic; one number without a name is that of every motor."""

    def _only_motor(self) -> tuple[str, ...]:
        return OF_EVERY_MOTOR


class Stamped(NamedTuple):
    """What an expression gives at one stamp.

    Attributes:
        stamp_ns: of the message that led.
        reading: motors and values; None where there is none.
        reason: why there is none; None too where there is none yet.
        complaint: the same in words.
    """

    stamp_ns: int
    reading: Reading | None
    reason: Rejection | None = None
    complaint: str = ''


class _Before(NamedTuple):
    """A value that an expression may ask for with the next one.

    Attributes:
        stamp_ns: of it.
        names: motors that it is of.
        value: of each.
        passed_ns: the usual interval up to it; 0: there was no value before.
    """

    stamp_ns: int
    names: tuple[str, ...]
    value: Value
    passed_ns: int


class CombinedSignal:
    """One measured quantity that is an expression of inputs.

    Args:
        name: of the signal.
        formula: the expression.
        configuration: of the observer.
    """

    def __init__(self, name: str, formula: Formula, configuration: Configuration) -> None:
        self.name = name
        self._formula = formula
        self._scale: float = configuration[f'{name}.scale']
        self._offset: float = configuration[f'{name}.offset']
        self._motors = tuple(configuration.motors)
        self._torque_constants = {
            motor.name: float(motor.values[TORQUE_CONSTANT])
            for motor in configuration.motors.values()
        }
        self._is_current = name == 'torque' and configuration['torque.quantity'] == 'current'
        self._inputs = {own: _Input(own, configuration) for own in inputs_of(formula)}
        ages_s = [(one.topic, configuration[f'{own}.stale_s']) for own, one in self._inputs.items()]
        self._alignment = InputAlignment(
            stale_limits(ages_s), round(configuration['jump_back_s'] * 1e9)
        )
        self._gap_ns = round(configuration['gap_s'] * 1e9)
        self._before: dict[int, _Before] = {}

    @property
    def topic(self) -> str:
        """Every topic that it needs."""
        return ' and '.join(dict.fromkeys(one.topic for one in self._inputs.values()))

    @property
    def unknown_names(self) -> Counter[str]:
        """Names in messages that no configured motor has, and how often they came."""
        return sum((one.unknown_names for one in self._inputs.values()), Counter[str]())

    def ingest(self, topic: str, message: Any, stamp_ns: int) -> list[Stamped]:
        """Take a message of one topic; return the values that it leads to.

        Raises:
            SampleError: the message cannot be read.
            ConfigurationError: the message has no such field.
        """
        content = {
            own: Reading(*one.read(message))
            for own, one in self._inputs.items()
            if one.topic == topic
        }
        return [self._evaluated(one) for one in self._alignment.add(topic, stamp_ns, content)]

    def restart_clock(self) -> None:
        """Forget what is held: what comes next is another recording."""
        self._alignment.restart()
        self._before.clear()

    def flush(self) -> list[Stamped]:
        """Return the value that still waits for an input, at the end of a recording."""
        return [self._evaluated(one) for one in self._alignment.flush()]

    def _evaluated(self, whole: Aligned) -> Stamped:
        stamp_ns = whole.stamp_ns
        if whole.complaint:
            return Stamped(stamp_ns, None, Rejection.STALE_INPUT, whole.complaint)
        readings: dict[str, Reading] = {}
        for content in whole.contents.values():
            readings |= content
        names = self._names(readings)
        is_new = [False]
        values: dict[Name, Value] = {own: _by_name(one, names) for own, one in readings.items()}
        constants = self._constants(names)
        values[TORQUE_CONSTANT] = constants
        result = self._formula(values, self._past(stamp_ns, names, is_new))
        result = self._scale * result + self._offset
        if self._is_current:
            result = result * constants
        if is_new[0]:  # what looks at the value before needs two
            return Stamped(stamp_ns, None)
        result = np.broadcast_to(np.asarray(result, dtype=float), len(names))
        single = (float(result[0]),) if len(names) == 1 else result
        has_our_motor = any(name in self._torque_constants for name in names)
        return Stamped(stamp_ns, Reading(names, single, has_our_motor))

    def _names(self, readings: Mapping[str, Reading]) -> tuple[str, ...]:
        """Return the motors that every input with names speaks of.

        Raises:
            SampleError: no input has names, and there are several motors.
        """
        lists = list(
            dict.fromkeys(one.names for one in readings.values() if one.names is not OF_EVERY_MOTOR)
        )
        if not lists:
            if len(self._motors) != 1:
                raise SampleError(
                    f'{self.name}.expression is one number, but there are {len(self._motors)} '
                    'motors: use an input with names, or one observer a motor'
                )
            return self._motors
        if len(lists) == 1:
            return lists[0]
        others = [set(names) for names in lists[1:]]
        return tuple(
            name
            for name in lists[0]
            if name in self._torque_constants and all(name in other for other in others)
        )

    def _constants(self, names: tuple[str, ...]) -> Value:
        """Return Kt of every motor; NaN of one that is not ours."""
        return np.array([self._torque_constants.get(name, math.nan) for name in names])

    def _past(self, stamp_ns: int, names: tuple[str, ...], is_new: list[bool]) -> Past:
        """Return what is known of the values before; where there is none ``is_new`` is set."""

        def rate(number: int, value: Value) -> Value:
            before = self._step(number, stamp_ns, names, value, is_new)
            if before is None:
                return value * math.nan
            return (value - before.value) / ((stamp_ns - before.stamp_ns) * 1e-9)

        def value_before(number: int, value: Value) -> Value:
            before = self._step(number, stamp_ns, names, value, is_new)
            if before is None:
                return value * math.nan
            if 0 < LOST * before.passed_ns < stamp_ns - before.stamp_ns:
                is_new[0] = True
                return value * math.nan
            return before.value

        return Past(rate, value_before)

    def _step(
        self, number: int, stamp_ns: int, names: tuple[str, ...], value: Value, is_new: list[bool]
    ) -> _Before | None:
        """Remember a value; return the one before, where it is of the same history.

        Where there is none ``is_new`` is set, but not where a stamp comes again: what is made of
        that is NaN, and pairing refuses it.
        """
        before = self._before.get(number)
        passed_ns = 0 if before is None else stamp_ns - before.stamp_ns
        if before is None or before.names != names or not 0 <= passed_ns <= self._gap_ns:
            self._before[number] = _Before(stamp_ns, names, value, 0)
            is_new[0] = True
            return None
        if passed_ns == 0:
            return None
        if before.passed_ns:  # behind one loss the next one shows too
            passed_ns = min(passed_ns, round(LONGER * before.passed_ns))
        self._before[number] = _Before(stamp_ns, names, value, passed_ns)
        return before


def _by_name(reading: Reading, names: tuple[str, ...]) -> Value:
    """Return the values of these motors, or one number where it is that of every motor."""
    if reading.names is OF_EVERY_MOTOR:
        return reading.values[0]
    values = np.asarray(reading.values, dtype=float)
    if reading.names == names:
        return values
    places = [reading.names.index(name) for name in names]
    return values[places]
