"""The topics of the two devices whose latency is compared, by the observer's own list."""

from __future__ import annotations

import struct

from gray_box_observer.ros import topics

MOTOR = 'motor'
PARAMETERS = ('inductance', 'resistance', 'hysteresis')
DEVICES = ('relay', 'observer')
"""Namespaces; each device lives in one."""

NODE = 'gray_box_observer'
LAST = 'identified'
"""What is published last of an estimate."""

_STAMP = struct.Struct('<iI')
HEADER_BYTES = 4
"""Length of the encapsulation header, which the stamp of a message with a header follows."""


def estimate_topics() -> dict[str, topics.Topic]:
    """Topics of one estimate by short name, in the order in which they are published."""
    return {
        **dict.fromkeys(PARAMETERS, topics.PARAMETER),
        'covariance': topics.COVARIANCE,
        LAST: topics.IDENTIFIED,
    }


def full_name(device: str, topic: topics.Topic, parameter: str = '') -> str:
    """The name of a device's topic from the root on."""
    name = topic.name.format(motor=MOTOR, parameter=parameter)
    return f'/{device}/{name}'.replace('~', NODE)


def stamp_ns(data: bytes) -> int:
    """The stamp of a serialised message that begins with a header."""
    sec, nanosec = _STAMP.unpack_from(data, HEADER_BYTES)
    return int(sec) * 1_000_000_000 + int(nanosec)


def stamped(data: bytearray, at_ns: int) -> bytearray:
    """Write a stamp into a serialised message that begins with a header."""
    _STAMP.pack_into(data, HEADER_BYTES, *divmod(at_ns, 1_000_000_000))
    return data
