"""The messages inside one piece of an MCAP file: decompression, checksums, records."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from gray_box_observer.bag.limits import MESSAGE_OVERHEAD_BYTES, ReadLimits
from gray_box_observer.bag.mcap.mcap_layout import Piece
from gray_box_observer.bag.mcap.mcap_records import (
    CHANNEL,
    END_BYTES,
    FIRST_PRIVATE,
    HEAD,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    Channel,
    Definitions,
)

_DECLARATIONS = (SCHEMA, CHANNEL)
_NEVER_NS = (1 << 64) - 1
_STEP_BYTES = 1 << 20
_CHUNK_SIZES = struct.Struct('<QII')
"""Uncompressed size, checksum, length of the compression's name; they follow the two times."""
_CHUNK_HEAD_BYTES = HEAD.size + 16 + _CHUNK_SIZES.size


class RawMessage(NamedTuple):
    """One recorded message, not decoded.

    Attributes:
        topic: Full name of the topic.
        type_name: Such as ``sensor_msgs/msg/JointState``.
        schema_text: The ros2msg definition with all dependencies, as the bag holds it.
        data: CDR bytes with their four bytes of encapsulation.
        log_time_ns: When the recorder received it.
        publish_time_ns: When its publisher sent it, as far as the recorder knew.
    """

    topic: str
    type_name: str
    schema_text: str
    data: bytes
    log_time_ns: int
    publish_time_ns: int


class Unreadable(Exception):  # noqa: N818 - a value between two modules, never shown to a user
    """A piece cannot be read; the message says why."""


class TooLarge(Unreadable):
    """A piece would exceed the memory limit; the message names the size and the remedy."""


def read_records(stream: BinaryIO, piece: Piece, limits: ReadLimits) -> bytes:
    """The records of a piece, decompressed and checked against the chunk's checksum.

    Args:
        stream: The opened file.
        piece: What of it.
        limits: How long the piece and its records may be.

    Raises:
        TooLarge: The piece is larger than the limits.
        Unreadable: The piece is damaged or uses an unknown compression.
        OSError: The file cannot be read.
    """
    stream.seek(piece.offset)
    if not piece.is_chunk:
        check_size(piece.length, piece.length, limits)
        return stream.read(piece.length)
    head = stream.read(_CHUNK_HEAD_BYTES)
    size, checksum, name_length = _CHUNK_SIZES.unpack_from(
        head, _CHUNK_HEAD_BYTES - _CHUNK_SIZES.size
    )
    compression = stream.read(name_length).decode('ascii', 'replace')
    packed_length = piece.length - _CHUNK_HEAD_BYTES - name_length - 8
    check_size(max(size, packed_length), packed_length, limits)
    packed_records = stream.read(8 + packed_length)[8:]
    if piece.is_cut:
        return packed_records[
            :-END_BYTES
        ]  # a write over an older end may have been cut just before that was all replaced
    records = _decompress(packed_records, compression, size)
    if len(records) != size:
        raise Unreadable(f'{len(records)} bytes instead of {size}')
    if checksum and zlib.crc32(records) != checksum:
        raise Unreadable('wrong checksum')
    return records


def check_size(size: int, packed_length: int, limits: ReadLimits) -> None:
    """Refuse what would unpack to more than it may.

    Raises:
        TooLarge: It would.
    """
    if size > limits.chunk_bytes and size <= limits.expansion * packed_length:
        raise TooLarge(
            f'{_mb(size)} in one piece, where {_mb(limits.chunk_bytes)} are the limit; '
            f'{limits.remedy(size)}'
        )
    if size > _STEP_BYTES and size > limits.expansion * packed_length:
        times = f'{limits.expansion:.0f} times as much'
        raise TooLarge(
            f'it claims {_mb(size)} in {_mb(packed_length)}, and no recording holds {times}; '
            f'{limits.remedy(size)}'
        )


def _mb(byte_count: int) -> str:
    return f'{byte_count / 1e6:.3g} MB' if byte_count < 10**9 else f'{byte_count // 10**6} MB'


def _decompress(packed_records: bytes, compression: str, size: int) -> bytes:
    """Decompress to no more than what the head claims, which is checked before."""
    if not compression:
        return packed_records
    try:
        if compression == 'zstd':
            content_size = zstandard.frame_content_size(
                packed_records
            )  # -1: its own head does not tell
            if content_size not in (-1, size):
                raise Unreadable(f'{content_size} bytes instead of {size}')
            return zstandard.ZstdDecompressor().decompress(packed_records, max_output_size=size)
        if compression == 'lz4':
            unpacker = lz4.frame.LZ4FrameDecompressor()
            parts = [unpacker.decompress(packed_records, max_length=_STEP_BYTES)]
            total = len(parts[0])
            while parts[-1] and not unpacker.eof and total <= size:
                parts.append(unpacker.decompress(b'', max_length=_STEP_BYTES))
                total += len(parts[-1])
            return b''.join(parts)
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise Unreadable(str(error) or type(error).__name__) from None
    raise Unreadable(f'unknown compression {compression!r}')


@dataclass(slots=True)
class Survey:
    """What the messages of some records are, without holding any.

    Attributes:
        counts: Of the messages of the declared channels, by number.
        weight: Bytes of memory that these messages would take.
        start_ns: Earliest log time of them; 0 if there are none.
        end_ns: Latest log time of them.
        rest: Bytes at the end that are no whole record.
        orphan_count: Messages whose channel nobody declared.
    """

    counts: Counter[int] = field(default_factory=Counter)
    weight: int = 0
    start_ns: int = 0
    end_ns: int = 0
    rest: int = 0
    orphan_count: int = 0


def survey_messages(records: bytes, channel_numbers: Container[int]) -> Survey:
    """Count the messages among the records, as `parse_messages` would return them.

    Args:
        records: What `read_records` returned.
        channel_numbers: Numbers of the channels whose messages count.
    """
    survey = Survey()
    unpack = MESSAGE_HEAD.unpack_from
    counts: dict[int, int] = {}
    at = 0
    end = len(records)
    start_ns = _NEVER_NS
    last_head = end - MESSAGE_HEAD.size
    while at <= last_head:
        opcode, length, number, _, log_ns, _ = unpack(records, at)
        next_at = at + 9 + length
        if next_at > end or (opcode == MESSAGE and length < 22):
            break
        if opcode == MESSAGE and number in channel_numbers:
            counts[number] = counts.get(number, 0) + 1
            survey.weight += length + MESSAGE_OVERHEAD_BYTES
            start_ns = min(start_ns, log_ns)
            survey.end_ns = max(survey.end_ns, log_ns)
        elif opcode == MESSAGE:
            survey.orphan_count += 1
        elif opcode not in _DECLARATIONS and opcode < FIRST_PRIVATE:
            break
        at = next_at
    survey.rest = end - at if at <= last_head else _tail(records, at)
    survey.counts = Counter(counts)
    survey.start_ns = start_ns if counts else 0
    return survey


def parse_messages(
    records: bytes, channels: Mapping[int, Channel], wanted_channels: Mapping[int, Channel]
) -> tuple[list[RawMessage], int, int]:
    """The messages of the wanted channels, in the order of the file.

    Args:
        records: What `read_records` returned.
        channels: Every channel that the file declares.
        wanted_channels: The channels whose messages are asked for.

    Returns:
        The messages, the number of bytes at the end that are no whole record, and the number of
        messages whose channel nobody declared.
    """
    messages: list[RawMessage] = []
    append = messages.append
    unpack = MESSAGE_HEAD.unpack_from
    make = tuple.__new__
    at = 0
    end = len(records)
    orphans = 0
    last_head = end - MESSAGE_HEAD.size
    origins = {
        number: (channel.topic, channel.type_name, channel.schema_text)
        for number, channel in wanted_channels.items()
    }
    select = origins.get
    while at <= last_head:
        opcode, length, number, _, log_ns, publish_ns = unpack(records, at)
        next_at = at + 9 + length
        if next_at > end:
            return messages, end - at, orphans
        if opcode == MESSAGE:
            if length < 22:
                return messages, end - at, orphans
            origin = select(number)
            if origin is not None:
                data = records[at + 31 : next_at]
                # As RawMessage(...) does, without the call that every message would pay for.
                append(make(RawMessage, (*origin, data, log_ns, publish_ns)))
            elif number not in channels:
                orphans += 1
        elif opcode not in _DECLARATIONS and opcode < FIRST_PRIVATE:
            return messages, end - at, orphans
        at = next_at
    return messages, _tail(records, at), orphans


def _tail(records: bytes, at: int) -> int:
    """Bytes that are no whole record, among records too short to be a message."""
    while at + HEAD.size <= len(records):
        next_at = at + HEAD.size + HEAD.unpack_from(records, at)[1]
        if next_at > len(records):
            break
        at = next_at
    return len(records) - at


def parse_definitions(records: bytes, definitions: Definitions) -> None:
    """Collect the schemas and channels among the records, as far as these are whole."""
    at = 0
    while at + HEAD.size <= len(records):
        opcode, length = HEAD.unpack_from(records, at)
        next_at = at + HEAD.size + length
        if next_at > len(records):
            return
        if opcode != MESSAGE:
            definitions.add(opcode, records[at + HEAD.size : next_at])
        at = next_at
