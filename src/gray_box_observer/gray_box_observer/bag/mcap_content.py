"""The messages inside one piece of an MCAP file: decompression, checksums, records."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from gray_box_observer.bag.mcap_layout import Piece
from gray_box_observer.bag.mcap_records import (
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
_STEP_BYTES = 1 << 20
_LARGEST_CHUNK_BYTES = 1 << 30
_CHUNK_SIZES = struct.Struct('<QII')
"""Uncompressed size, checksum, length of the compression's name; they follow the two times."""


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


def read_records(stream: BinaryIO, piece: Piece) -> bytes:
    """The records of a piece, decompressed and checked against the chunk's checksum.

    Raises:
        Unreadable: The piece is damaged or uses an unknown compression.
        OSError: The file cannot be read.
    """
    stream.seek(piece.offset)
    raw = stream.read(piece.length)
    if not piece.is_chunk:
        return raw
    at = HEAD.size + 16
    size, checksum, name_length = _CHUNK_SIZES.unpack_from(raw, at)
    at += _CHUNK_SIZES.size
    compression = raw[at : at + name_length].decode('ascii', 'replace')
    packed = raw[at + name_length + 8 :]
    if piece.is_cut:
        return packed[:-END_BYTES]  # a write over an older end may have been cut just before that was all replaced
    records = _decompress(packed, compression, size)
    if len(records) != size:
        raise Unreadable(f'{len(records)} bytes instead of {size}')
    if checksum and zlib.crc32(records) != checksum:
        raise Unreadable('wrong checksum')
    return records


def _decompress(packed: bytes, compression: str, size: int) -> bytes:
    """Decompress step by step: the memory follows what the data really holds, not what its head claims."""
    if not compression:
        return packed
    if size > _LARGEST_CHUNK_BYTES:
        raise Unreadable(f'claims {size} bytes')
    try:
        if compression == 'zstd':
            with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed) as source:
                return b''.join(_until_empty(source, size))
        if compression == 'lz4':
            unpacker = lz4.frame.LZ4FrameDecompressor()
            parts = [unpacker.decompress(packed, max_length=_STEP_BYTES)]
            total = len(parts[0])
            while parts[-1] and not unpacker.eof and total <= size:
                parts.append(unpacker.decompress(b'', max_length=_STEP_BYTES))
                total += len(parts[-1])
            return b''.join(parts)
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise Unreadable(str(error) or type(error).__name__) from None
    raise Unreadable(f'unknown compression {compression!r}')


def _until_empty(source: zstandard.ZstdDecompressionReader, size: int) -> Iterator[bytes]:
    total = 0
    while total <= size and (part := source.read(min(_STEP_BYTES, size + 1))):
        total += len(part)
        yield part


def parse_messages(
    records: bytes, channels: Mapping[int, Channel], wanted: Mapping[int, Channel]
) -> tuple[list[RawMessage], int, int]:
    """The messages of the wanted channels, in the order of the file.

    Args:
        records: What `read_records` returned.
        channels: Every channel that the file declares.
        wanted: The channels whose messages are asked for.

    Returns:
        The messages, the number of bytes at the end that are no whole record, and the number of messages whose
        channel nobody declared.
    """
    messages: list[RawMessage] = []
    append, select, unpack = messages.append, wanted.get, MESSAGE_HEAD.unpack_from
    at, end, orphans = 0, len(records), 0
    last_head = end - MESSAGE_HEAD.size
    while at <= last_head:
        opcode, length, number, _, log_ns, publish_ns = unpack(records, at)
        following = at + 9 + length
        if following > end:
            return messages, end - at, orphans
        if opcode == MESSAGE:
            if length < 22:
                return messages, end - at, orphans
            channel = select(number)
            if channel is not None:
                append(
                    RawMessage(
                        channel.topic,
                        channel.type_name,
                        channel.schema_text,
                        records[at + 31 : following],
                        log_ns,
                        publish_ns,
                    )
                )
            elif number not in channels:
                orphans += 1
        elif opcode not in _DECLARATIONS and opcode < FIRST_PRIVATE:
            return messages, end - at, orphans
        at = following
    return messages, _tail(records, at), orphans


def _tail(records: bytes, at: int) -> int:
    """Bytes that are no whole record, among records too short to be a message."""
    while at + HEAD.size <= len(records):
        following = at + HEAD.size + HEAD.unpack_from(records, at)[1]
        if following > len(records):
            break
        at = following
    return len(records) - at


def parse_definitions(records: bytes, definitions: Definitions) -> None:
    """Collect the schemas and channels among the records, as far as these are whole."""
    at = 0
    while at + HEAD.size <= len(records):
        opcode, length = HEAD.unpack_from(records, at)
        following = at + HEAD.size + length
        if following > len(records):
            return
        if opcode != MESSAGE:
            definitions.add(opcode, records[at + HEAD.size : following])
        at = following
