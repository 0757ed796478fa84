"""The end of an MCAP file, where it is credible: index, counts and declarations."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO

from gray_box_observer.bag.limits import LARGEST_DECLARATION_BYTES
from gray_box_observer.bag.mcap.mcap_records import (
    CHANNEL,
    CHUNK_INDEX,
    END_BYTES,
    FIRST_PRIVATE,
    FOOTER,
    HEAD,
    MAGIC,
    OF_SUMMARY,
    SCHEMA,
    STATISTICS,
    Channel,
    Definitions,
    Statistics,
    parse_statistics,
)

_FOOTER = struct.Struct('<QQI')
_CHUNK_TIMES = struct.Struct('<QQQ')
_STEP_BYTES = 1 << 20
_LARGEST_RECORD_BYTES = 64 << 20
_LARGEST_SUMMARY_BYTES = 1 << 30
"""A file may have holes, so that one of a few kilobytes claims any length; reading it to the end
would take hours."""
_LARGEST_STATISTICS_BYTES = 1 << 20
"""There are 65,536 channels at most, of ten bytes each."""


@dataclass(slots=True)
class End:
    """The end of a file.

    Attributes:
        stop: Byte behind the records of data.
        has_summary: Whether it claims a summary.
        is_sound: Whether the summary agrees with its checksum or, where it has none, with itself.
        chunks: First and last log time of each chunk by its offset; only of a sound summary, as all
            that follows.
        statistics: What the file holds; None if it does not tell.
        channels: Its topics by number.
    """

    stop: int
    has_summary: bool = False
    is_sound: bool = False
    chunks: dict[int, tuple[int, int]] = field(default_factory=dict)
    statistics: Statistics | None = None
    channels: dict[int, Channel] = field(default_factory=dict)


def read_end(stream: BinaryIO, size: int) -> End | None:
    """The end of a file, or None if it has none.

    Args:
        stream: The opened file.
        size: Its size in bytes.

    Raises:
        OSError: The file cannot be read.
    """
    footer_at = size - END_BYTES
    if footer_at < len(MAGIC):
        return None
    stream.seek(footer_at)
    tail = stream.read(END_BYTES)
    if tail[: HEAD.size] != HEAD.pack(FOOTER, _FOOTER.size) or not tail.endswith(MAGIC):
        return None
    start, _, checksum = _FOOTER.unpack_from(tail, HEAD.size)
    if not start:
        return End(footer_at)
    end = End(start, has_summary=True)
    is_inside = len(MAGIC) < start <= footer_at <= start + _LARGEST_SUMMARY_BYTES
    if not is_inside or (checksum and _checksum(stream, start, footer_at) != checksum):
        return End(footer_at, has_summary=True)
    return end if _read_summary(stream, start, footer_at, end) else End(footer_at, has_summary=True)


def _checksum(stream: BinaryIO, start: int, footer_at: int) -> int:
    """The checksum from the summary's start to before the footer's own checksum."""
    stream.seek(start)
    remaining_bytes = footer_at + HEAD.size + 16 - start
    value = 0
    while remaining_bytes and (part := stream.read(min(remaining_bytes, _STEP_BYTES))):
        value = zlib.crc32(part, value)
        remaining_bytes -= len(part)
    return value


def _read_summary(stream: BinaryIO, start: int, footer_at: int, end: End) -> bool:
    """Fill in what the summary says; False if it is none."""
    definitions = Definitions()
    at = start
    while at < footer_at:
        stream.seek(at)
        head = stream.read(HEAD.size)
        opcode, length = HEAD.unpack(head)
        at += HEAD.size + length
        if (
            at > footer_at
            or (opcode not in OF_SUMMARY and opcode < FIRST_PRIVATE)
            or length > _LARGEST_RECORD_BYTES
        ):
            return False
        if opcode == CHUNK_INDEX:
            content = stream.read(min(length, _CHUNK_TIMES.size))
            if len(content) < _CHUNK_TIMES.size:
                return False
            start_ns, end_ns, offset = _CHUNK_TIMES.unpack(content)
            end.chunks[offset] = (start_ns, end_ns)
        elif opcode in (SCHEMA, CHANNEL):
            if length > LARGEST_DECLARATION_BYTES or not definitions.add(
                opcode, stream.read(length)
            ):
                return False
        elif opcode == STATISTICS:
            if length > _LARGEST_STATISTICS_BYTES:
                return False
            end.statistics = parse_statistics(stream.read(length))
    end.channels = definitions.channels
    end.is_sound = True
    return True
