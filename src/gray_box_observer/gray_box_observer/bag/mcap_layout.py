"""What stands where in one MCAP file, found by walking its records; finds its way in cut and damaged files.

The format is specified at https://mcap.dev/spec. Lengths in a damaged file are lies until they have been checked
against the size of the file, so nothing here reads or allocates more than the file can hold. A walk over all
record heads (instead of the trust that mcap's seeking reader puts in the summary) makes an intact, a killed and a
damaged file one and the same case.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import BinaryIO

from gray_box_observer.bag.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FIRST_PRIVATE,
    FOOTER,
    HEAD,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    STATISTICS,
    Channel,
    Definitions,
    Statistics,
    parse_statistics,
)

_CHUNK_HEAD = struct.Struct('<QQQII')
_FOOTER = struct.Struct('<QQI')
_FOOTER_LENGTH = HEAD.size + _FOOTER.size
_LONGEST_COMPRESSION_NAME = 32
_NEVER_NS = (1 << 64) - 1
_RUN_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of the file that holds messages: one chunk, or a run of messages that stand outside chunks.

    Attributes:
        offset: Byte in the file where its first record starts.
        length: Bytes, heads included.
        start_ns: Earliest log time in it.
        end_ns: Latest log time in it.
        is_chunk: Whether it is a chunk.
        is_cut: Whether the file ends inside it; then its checksum says nothing.
    """

    offset: int
    length: int
    start_ns: int
    end_ns: int
    is_chunk: bool
    is_cut: bool = False


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes that hold no readable message although they should."""

    offset: int
    byte_count: int
    what: str


@dataclass(slots=True)
class Layout:
    """What a walk found; ``statistics`` is None unless the file's summary can be believed."""

    size: int
    pieces: list[Piece] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)
    statistics: Statistics | None = None
    is_finished: bool = False


def walk(stream: BinaryIO, size: int) -> Layout:
    """Find every piece of a file that starts with the magic; costs a few reads per chunk.

    Args:
        stream: The opened file.
        size: Its size in bytes; nothing beyond is looked at, so a file that still grows is fine.

    Raises:
        OSError: The file cannot be read.
    """
    return _Walk(stream, size).run()


class _Walk:
    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream = stream
        self._layout = Layout(size)
        self._data, self._summary = Definitions(), Definitions()
        self._definitions = self._data
        self._summary_start = 0
        self._summary_is_sound = False
        self._statistics: Statistics | None = None
        self._run: Piece | None = None
        self._chunk_count = 0

    def run(self) -> Layout:
        layout, at = self._layout, len(MAGIC)
        while at < layout.size and not layout.is_finished:
            at = self._step(at)
        self._end_run()
        # A file that was never finished has no summary; its declarations stand between and inside the chunks.
        if self._summary_is_sound:
            self._data.channels.update(self._summary.channels)
        believed = self._statistics if self._summary_is_sound and not layout.damages else None
        if believed is not None and believed.chunk_count != self._chunk_count:
            layout.damages.append(
                Damage(0, 0, f'{believed.chunk_count} chunks should be there, {self._chunk_count} are')
            )
            believed = None
        layout.statistics = believed
        layout.channels = self._data.channels
        return layout

    def _step(self, at: int) -> int:
        """Look at the record at ``at``; the result is where the next one starts."""
        self._stream.seek(at)
        head = self._stream.read(MESSAGE_HEAD.size)
        if len(head) < HEAD.size:
            return self._give_up(at, 'in the middle of a record', is_cut=True)
        opcode, length = HEAD.unpack_from(head)
        end: int = at + HEAD.size + length
        if opcode == 0 or LAST_KNOWN < opcode < FIRST_PRIVATE:
            return self._give_up(at, f'a record of unknown kind {opcode} at byte {at}')
        if end > self._layout.size:
            return self._cut(at, opcode, length)
        if opcode == MESSAGE:
            return self._message(at, head, end)
        self._end_run()
        if opcode == CHUNK:
            self._chunk(at, length)
        elif opcode == DATA_END:
            self._definitions, self._summary_start = self._summary, end
        elif opcode == FOOTER:
            self._footer(at, length)
        elif opcode in (SCHEMA, CHANNEL):
            if not self._definitions.add(opcode, self._content(at, length)):
                self._damage(at, end - at, f'a malformed declaration at byte {at}')
        elif opcode == STATISTICS:
            self._statistics = parse_statistics(self._content(at, length))
        return end

    def _content(self, at: int, length: int) -> bytes:
        self._stream.seek(at + HEAD.size)
        return self._stream.read(length)

    def _damage(self, at: int, byte_count: int, what: str) -> None:
        self._layout.damages.append(Damage(at, byte_count, what))

    def _message(self, at: int, head: bytes, end: int) -> int:
        """Add a message outside any chunk to the present run of such."""
        if len(head) < MESSAGE_HEAD.size or end - at < MESSAGE_HEAD.size:
            self._damage(at, end - at, f'a malformed message at byte {at}')
            self._end_run()
            return end
        log_ns = MESSAGE_HEAD.unpack(head)[4]
        run = self._run
        if run is not None and run.length < _RUN_BYTES:
            start_ns, end_ns = min(run.start_ns, log_ns), max(run.end_ns, log_ns)
            self._run = Piece(run.offset, end - run.offset, start_ns, end_ns, is_chunk=False)
        else:
            self._end_run()
            self._run = Piece(at, end - at, log_ns, log_ns, is_chunk=False)
        return end

    def _end_run(self) -> None:
        if self._run is not None:
            self._layout.pieces.append(self._run)
            self._run = None

    def _chunk(self, at: int, length: int, *, is_cut: bool = False) -> bool:
        """Add the chunk at ``at`` if its own head agrees with the record's length."""
        self._chunk_count += not is_cut
        start = self._content(at, min(length, _CHUNK_HEAD.size + _LONGEST_COMPRESSION_NAME + 8))
        sound = len(start) >= _CHUNK_HEAD.size + 8
        if sound:
            start_ns, end_ns, _, _, name_length = _CHUNK_HEAD.unpack_from(start)
            if (start_ns, end_ns) == (_NEVER_NS, 0):
                start_ns = 0  # some writers leave their initial values in a chunk without messages
            sound = start_ns <= end_ns and name_length <= min(
                _LONGEST_COMPRESSION_NAME, len(start) - _CHUNK_HEAD.size - 8
            )
        if sound:
            (byte_count,) = struct.unpack_from('<Q', start, _CHUNK_HEAD.size + name_length)
            sound = _CHUNK_HEAD.size + name_length + 8 + byte_count == length
        if not sound:
            if not is_cut:
                self._damage(at, HEAD.size + length, f'a chunk with a damaged head at byte {at}')
            return False
        if is_cut:
            if name_length:
                return False  # part of a compressed chunk is worth nothing
            length = self._layout.size - at - HEAD.size
        self._layout.pieces.append(Piece(at, HEAD.size + length, start_ns, end_ns, is_chunk=True, is_cut=is_cut))
        return True

    def _cut(self, at: int, opcode: int, length: int) -> int:
        """The record at ``at`` claims more bytes than the file has."""
        if opcode != CHUNK:
            return self._give_up(at, 'in the middle of a record', is_cut=True)
        if not self._next_chunk(at) and self._chunk(at, length, is_cut=True):
            return self._layout.size  # whoever reads it tells how much of it was lost
        return self._give_up(at, 'in the middle of a chunk', is_cut=True)

    def _give_up(self, at: int, what: str, *, is_cut: bool = False) -> int:
        """Go on at the next chunk that the index at the end of the file knows, or at the end of the file."""
        self._end_run()
        goal = self._next_chunk(at) or self._layout.size
        if is_cut and goal < self._layout.size:
            what = f'a record with an absurd length at byte {at}'
        elif is_cut:
            what = f'the file ends {what}'
        self._damage(at, goal - at, what)
        return goal

    def _next_chunk(self, at: int) -> int:
        """Where the index at the end of the file says that the next chunk starts; 0 if nowhere."""
        return next((offset for offset in self._indexed_chunks() if offset > at), 0)

    def _indexed_chunks(self) -> list[int]:
        size = self._layout.size
        if size < len(MAGIC) * 2 + _FOOTER_LENGTH:
            return []
        self._stream.seek(size - len(MAGIC) - _FOOTER_LENGTH)
        footer = self._stream.read(_FOOTER_LENGTH + len(MAGIC))
        start = _FOOTER.unpack_from(footer, HEAD.size)[0]
        if not (footer.endswith(MAGIC) and footer[0] == FOOTER and len(MAGIC) < start < size):
            return []
        self._stream.seek(start)
        summary, at = self._stream.read(size - start), 0
        offsets: list[int] = []
        while at + HEAD.size <= len(summary):
            opcode, length = HEAD.unpack_from(summary, at)
            if opcode == CHUNK_INDEX and length >= 24 and at + HEAD.size + 24 <= len(summary):
                offset: int = struct.unpack_from('<Q', summary, at + HEAD.size + 16)[0]
                offsets.append(offset)
            at += HEAD.size + length
        return sorted(offset for offset in offsets if offset < start)

    def _footer(self, at: int, length: int) -> None:
        """The end of the file; the summary before it is believed only if its checksum is right."""
        self._layout.is_finished = True
        if length != _FOOTER.size:
            return
        start, _, expected = _FOOTER.unpack(self._content(at, length))
        if expected and len(MAGIC) < start <= at:
            self._stream.seek(start)
            covered = self._stream.read(at + HEAD.size + 16 - start)
            self._summary_is_sound = zlib.crc32(covered) == expected
        else:
            self._summary_is_sound = start != 0 and start == self._summary_start
