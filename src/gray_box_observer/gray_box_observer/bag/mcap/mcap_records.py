"""The declaring and counting records of an MCAP file (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from gray_box_observer.bag.limits import (
    DECLARATION_OVERHEAD_BYTES,
    LARGEST_DECLARATION_BYTES,
    MOST_DECLARED_BYTES,
)

MAGIC = b'\x89MCAP0\r\n'
FOOTER = 2
SCHEMA = 3
CHANNEL = 4
MESSAGE = 5
CHUNK = 6
CHUNK_INDEX = 8
STATISTICS = 11
METADATA = 12
DATA_END = 15
LAST_KNOWN, FIRST_PRIVATE = 15, 128
OF_SUMMARY = (SCHEMA, CHANNEL, CHUNK_INDEX, 10, STATISTICS, 13, 14)
"""What may stand in a summary; 10, 13 and 14 are the indexes of attachments and metadata, and
offsets."""
UNFINISHED = 'gray_box_observer unfinished'
"""Name of the metadata record in a file that is still being written, or whose writer was killed."""

HEAD = struct.Struct('<BQ')
END_BYTES = HEAD.size + 20 + len(MAGIC)
"""Footer and magic, which every complete file ends with."""
_CHANNEL_KEYS = ('offered_qos_profiles', 'topic_type_hash')
MESSAGE_HEAD = struct.Struct('<BQHIQQ')
"""Opcode, length, channel, sequence, log time, publish time."""


@dataclass(frozen=True)
class Channel:
    """One topic as a file declares it; texts are empty where the file has none."""

    topic: str
    type_name: str
    schema_text: str
    encoding: str
    qos_profiles: str = ''
    type_hash: str = ''


@dataclass(frozen=True)
class Statistics:
    """The file's own account of what it holds."""

    message_count: int
    chunk_count: int
    start_ns: int
    end_ns: int
    channel_message_counts: dict[int, int]


class Definitions:
    """Collects schema and channel records in any order, repeated or not, up to a limit of bytes."""

    def __init__(self) -> None:
        self._byte_count = 0
        self._schemas: dict[int, tuple[str, str]] = {}
        self.channels: dict[int, Channel] = {}

    def add(self, opcode: int, content: bytes) -> bool:
        """Add one record's content; False if malformed or too large; other opcodes are ignored."""
        if len(content) > LARGEST_DECLARATION_BYTES:
            return False
        try:
            if opcode == SCHEMA:
                return self._add_schema(content)
            if opcode == CHANNEL:
                return self._add_channel(content)
        except (struct.error, IndexError):
            return False
        return True

    def _has_room(self, byte_count: int) -> bool:
        self._byte_count += byte_count + DECLARATION_OVERHEAD_BYTES
        return self._byte_count <= MOST_DECLARED_BYTES

    def _add_schema(self, content: bytes) -> bool:
        (number,) = struct.unpack_from('<H', content)
        name, at = _text(content, 2)
        _, at = _text(content, at)
        text, _ = _text(content, at)
        if self._schemas.get(number) == (name, text):  # most writers repeat it in every chunk
            return True
        if not self._has_room(len(content)):
            return False
        self._schemas[number] = (name, text)
        return True

    def _add_channel(self, content: bytes) -> bool:
        number, schema = struct.unpack_from('<HH', content)
        topic, at = _text(content, 4)
        encoding, at = _text(content, at)
        (length,) = struct.unpack_from('<I', content, at)
        at, end = at + 4, at + 4 + length
        if end > len(content):
            raise IndexError
        extra = dict.fromkeys(_CHANNEL_KEYS, '')
        while at < end:
            key, at = _text(content, at)
            value, at = _text(content, at)
            if key in extra:
                extra[key] = value
        if number in self.channels:
            return True
        if not self._has_room(len(content)):
            return False
        name, text = self._schemas.get(schema, ('', ''))
        self.channels[number] = Channel(topic, name, text, encoding, *extra.values())
        return True


def metadata_name(content: bytes) -> str:
    """The name in the content of a metadata record; empty if it is malformed."""
    try:
        return _text(content, 0)[0]
    except (struct.error, IndexError):
        return ''


def _text(content: bytes, at: int) -> tuple[str, int]:
    """Read a length-prefixed text; bad letters are replaced, a bad length raises IndexError."""
    (length,) = struct.unpack_from('<I', content, at)
    end = at + 4 + length
    if end > len(content):
        raise IndexError
    return content[at + 4 : end].decode('utf-8', 'replace'), end


def parse_statistics(content: bytes) -> Statistics | None:
    """The content of a statistics record; None if it contradicts itself."""
    fixed_part = struct.Struct('<QHIIIIQQI')
    if len(content) < fixed_part.size:
        return None
    messages, _, _, _, _, chunks, start_ns, end_ns, byte_count = fixed_part.unpack_from(content)
    if byte_count % 10 or fixed_part.size + byte_count > len(content) or start_ns > end_ns:
        return None
    counts = dict(
        struct.iter_unpack('<HQ', content[fixed_part.size : fixed_part.size + byte_count])
    )
    if sum(counts.values()) != messages:
        return None
    return Statistics(messages, chunks, start_ns, end_ns, counts)
