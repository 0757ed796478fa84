"""Messages as bytes in which only numbers change: serialised once, then overwritten.

That takes a fraction of the time of building a message and having it converted for every sample.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

from gray_box_observer.safe_io.bounded_cache import BoundedCache, size_of_names
from gray_box_observer.samples.sample import NANOSECONDS_PER_SECOND
from gray_box_observer.white_box import Parameter
from gray_box_observer.white_box.interface import Array

MAX_FORMS = 64
"""Lists of names of which a template is kept."""

MAX_FORM_BYTES = 8_000_000
"""What these forms may take together."""

_NUMBER = struct.Struct('=d')
_STAMP = struct.Struct('=iI')
_SECONDS = range(-(2**31), 2**31)
"""What a stamp can tell, which has 32 bits for them."""

_STAMP_AT = 4
"""Behind the four bytes that begin every serialised message; a JointState begins with its stamp."""


class MessageTemplate:
    """One serialised message, and where its numbers stand in it.

    Args:
        make: builds the message from its numbers, which must stand in it one behind the other.
        count: how many numbers.
    """

    def __init__(self, make: Callable[[array[float]], Any], count: int) -> None:
        marks = array('d', (np.arange(count) + 1234.5678).tobytes())
        self.data = bytearray(serialize_message(make(marks)))
        at = self.data.index(marks.tobytes())
        # a view, for it cannot be made longer or shorter, as a slice of the message would be
        self._numbers = memoryview(self.data)[at : at + marks.itemsize * count]

    def render(self, numbers: Array) -> bytes:
        """Return the message with these numbers.

        Args:
            numbers: of double precision, as many as the template has, in any shape.

        Raises:
            ValueError: they are of another number or precision; the template stays what it was.
        """
        self._numbers[:] = numbers.tobytes()
        return bytes(self.data)


class JointMessages:
    """Numbers at their stamp as serialised JointState; a template per list of names.

    Args:
        field: where the numbers stand: ``effort`` or ``velocity``.
    """

    def __init__(self, field: str = 'effort') -> None:
        self._field = field
        self._templates: BoundedCache[tuple[str, ...], MessageTemplate] = BoundedCache(
            MAX_FORMS, MAX_FORM_BYTES
        )

    def render(self, names: tuple[str, ...], stamp_ns: int, numbers: Array) -> bytes | None:
        """Return the message of the motors with a number; None without one or a valid stamp.

        Args:
            names: of the motors.
            stamp_ns: the stamp.
            numbers: shape (motor,).
        """
        is_finite = np.isfinite(numbers)
        if not is_finite.all():
            names = tuple(
                name for name, is_known in zip(names, is_finite.tolist(), strict=True) if is_known
            )
            numbers = numbers[is_finite]
        seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
        if not names or seconds not in _SECONDS:
            return None
        template = self._templates.get(names)
        if template is None:
            template = MessageTemplate(
                lambda marks: JointState(name=names, **{self._field: marks}), len(names)
            )
            self._templates.remember(names, template, len(template.data) + size_of_names(names))
        _STAMP.pack_into(template.data, _STAMP_AT, seconds, nanoseconds)
        return template.render(numbers)


class NumberMessages:
    """Single numbers as serialised Float64: the number is what such a message ends with."""

    def __init__(self) -> None:
        self._head = bytes(serialize_message(Float64()))[: -_NUMBER.size]

    def render(self, number: float) -> bytes:
        """Return the message with this number."""
        return self._head + _NUMBER.pack(number)


def covariance_template(parameters: tuple[Parameter, ...]) -> MessageTemplate:
    """Return the template of a covariance: square, row-major, labelled by parameter names."""
    label = ','.join(p.name for p in parameters)
    n = len(parameters)

    def make(numbers: array[float]) -> Float64MultiArray:
        message = Float64MultiArray(data=numbers)
        message.layout.dim = [
            MultiArrayDimension(label=label, size=n, stride=n * n),
            MultiArrayDimension(label=label, size=n, stride=n),
        ]
        return message

    return MessageTemplate(make, n * n)


def yes_and_no() -> dict[bool, bytes]:
    """Return both messages that say whether something holds."""
    return {value: bytes(serialize_message(Bool(data=value))) for value in (False, True)}
