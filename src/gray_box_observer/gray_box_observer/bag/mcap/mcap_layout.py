"""Layout of one MCAP file, found by walking its records, in cut and damaged files too.

The format is specified at https://mcap.dev/spec. Lengths in a damaged file are lies until they have
been checked against the size of the file, so nothing here reads or allocates more than the file can
hold. A walk over all record heads (instead of the trust that mcap's seeking reader puts in the
summary) makes an intact, a killed and a damaged file one and the same case.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO

from gray_box_observer.bag.limits import LARGEST_DECLARATION_BYTES
from gray_box_observer.bag.mcap.mcap_end import End, read_end
from gray_box_observer.bag.mcap.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FIRST_PRIVATE,
    FOOTER,
    HEAD,
    LAST_KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA,
    SCHEMA,
    UNFINISHED,
    Channel,
    Definitions,
    Statistics,
    metadata_name,
)

_CHUNK_HEAD = struct.Struct('<QQQII')
_LONGEST_COMPRESSION_NAME = 32
_NEVER_NS = (1 << 64) - 1
_RUN_BYTES = 1 << 20
_LONGEST_MARK = 256


@dataclass(frozen=True)
class Piece:
    """A part of the file with messages: one chunk, or a run of messages outside chunks.

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


@dataclass(frozen=True)
class Damage:
    """Bytes that hold no readable message although they should."""

    offset: int
    byte_count: int
    what: str


@dataclass(slots=True)
class Layout:
    """What a walk found.

    Attributes:
        size: Bytes of the file that were looked at.
        pieces: Everything that holds messages, in the order of the file.
        channels: The topics that are declared outside chunks, by number.
        damages: What could not be made sense of.
        end: What the file's end tells; None if it was never written or is lost.
        is_unfinished: Whether the file says that its writer never came to its end.
        fits: Whether the end's index and counts agree with what was found; only then are they to be
            believed.
    """

    size: int
    pieces: list[Piece] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    damages: list[Damage] = field(default_factory=list)
    end: End | None = None
    is_unfinished: bool = False
    fits: bool = False

    @property
    def stated_statistics(self) -> Statistics | None:
        """What the file's end says that it holds; None if that is unknown."""
        return None if self.end is None else self.end.statistics

    @property
    def statistics(self) -> Statistics | None:
        """The same if it is to be believed."""
        return self.stated_statistics if self.fits else None


def walk(stream: BinaryIO, size: int) -> Layout:
    """Find every piece of a file that starts with the magic; costs a few reads per chunk.

    Args:
        stream: The opened file.
        size: Its size in bytes; nothing beyond is looked at, so a file that still grows is fine.

    Raises:
        OSError: The file cannot be read.
    """
    return _Scanner(stream, size).run()


class _Scanner:
    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream = stream
        self._layout = Layout(size, end=read_end(stream, size))
        self._stop = size if self._layout.end is None else self._layout.end.stop
        self._chunk_offsets = sorted(
            offset for offset in self._indexed_chunks() if offset < self._stop
        )
        self._definitions = Definitions()
        self._run: Piece | None = None
        self._loose_count = 0

    def _indexed_chunks(self) -> Iterable[int]:
        return () if self._layout.end is None else self._layout.end.chunks

    def run(self) -> Layout:
        layout = self._layout
        at = len(MAGIC)
        while at < self._stop:
            at = self._step(at)
        self._end_run()
        layout.channels = self._definitions.channels
        if layout.end is not None:
            self._compare(layout.end)
        return layout

    def _compare(self, end: End) -> None:
        """Hold what was found against what the file's end says."""
        if not end.is_sound:
            if end.has_summary:
                self._damage(end.stop, 0, 'the summary at the end of the file is damaged')
            return
        layout = self._layout
        layout.channels |= end.channels
        chunk_times = {p.offset: (p.start_ns, p.end_ns) for p in layout.pieces if p.is_chunk}
        index_times = {offset: _span(*times) for offset, times in end.chunks.items()}
        statistics = end.statistics
        if not layout.damages and index_times and chunk_times != index_times:
            self._damage(0, 0, 'the chunks of the file are not those of its index')
        elif (
            not layout.damages
            and statistics is not None
            and statistics.chunk_count != len(chunk_times)
        ):
            self._damage(
                0, 0, f'{statistics.chunk_count} chunks should be there, {len(chunk_times)} are'
            )
        elif (
            statistics is not None
            and not chunk_times
            and statistics.message_count != self._loose_count
        ):
            self._damage(
                0,
                0,
                f'{statistics.message_count} messages should be there, {self._loose_count} are',
            )
        # Messages beside chunks are allowed and rare: count them, for a changed byte makes other
        # records into such.
        layout.fits = not layout.damages and not (chunk_times and self._loose_count)

    def _step(self, at: int) -> int:
        """Look at the record at ``at``; the result is where the next one starts."""
        self._stream.seek(at)
        head = self._stream.read(min(MESSAGE_HEAD.size, self._stop - at))
        if len(head) < HEAD.size:
            return self._give_up(at, 'the file ends in the middle of a record')
        opcode, length = HEAD.unpack_from(head)
        end: int = at + HEAD.size + length
        if opcode == 0 or LAST_KNOWN < opcode < FIRST_PRIVATE:
            return self._give_up(at, f'a record of unknown kind {opcode} at byte {at}')
        next_chunk = self._next_chunk(at)
        if next_chunk and end > next_chunk:
            return self._give_up(at, f'a record with a wrong length at byte {at}')
        if end > self._stop:
            return self._cut(at, opcode, length)
        if opcode == MESSAGE:
            return self._message(at, head, end)
        self._end_run()
        if opcode == CHUNK:
            if not self._chunk(at, length):
                return self._give_up(
                    at, f'a chunk with a damaged head at byte {at}', goal=next_chunk or end
                )
        elif opcode == FOOTER or (opcode == DATA_END and self._chunk_offsets and end != self._stop):
            return self._give_up(at, f'an end mark in the middle of the file at byte {at}')
        elif opcode in (SCHEMA, CHANNEL):
            too_long = length > LARGEST_DECLARATION_BYTES
            if too_long or not self._definitions.add(opcode, self._content(at, length)):
                self._damage(
                    at, end - at, f'a malformed declaration, or one too long, at byte {at}'
                )
        elif opcode == METADATA and length <= _LONGEST_MARK:
            self._layout.is_unfinished |= metadata_name(self._content(at, length)) == UNFINISHED
        return end

    def _content(self, at: int, length: int) -> bytes:
        self._stream.seek(at + HEAD.size)
        return self._stream.read(length)

    def _damage(self, at: int, byte_count: int, complaint: str) -> None:
        self._layout.damages.append(Damage(at, byte_count, complaint))

    def _message(self, at: int, head: bytes, end: int) -> int:
        """Add a message outside any chunk to the present run of such."""
        if len(head) < MESSAGE_HEAD.size or end - at < MESSAGE_HEAD.size:
            self._damage(at, end - at, f'a malformed message at byte {at}')
            self._end_run()
            return end
        self._loose_count += 1
        log_ns = MESSAGE_HEAD.unpack(head)[4]
        run = self._run
        if run is not None and max(run.length, end - at) < _RUN_BYTES:
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
        start = self._content(at, min(length, _CHUNK_HEAD.size + _LONGEST_COMPRESSION_NAME + 8))
        sound = len(start) >= _CHUNK_HEAD.size + 8
        if sound:
            start_ns, end_ns, _, _, name_length = _CHUNK_HEAD.unpack_from(start)
            start_ns, end_ns = _span(start_ns, end_ns)
            sound = start_ns <= end_ns and name_length <= min(
                _LONGEST_COMPRESSION_NAME, len(start) - _CHUNK_HEAD.size - 8
            )
        if sound:
            (byte_count,) = struct.unpack_from('<Q', start, _CHUNK_HEAD.size + name_length)
            sound = _CHUNK_HEAD.size + name_length + 8 + byte_count == length
        if not sound or (is_cut and name_length):  # part of a compressed chunk is worth nothing
            return False
        if is_cut:
            length = self._stop - at - HEAD.size
        self._layout.pieces.append(
            Piece(at, HEAD.size + length, start_ns, end_ns, is_chunk=True, is_cut=is_cut)
        )
        return True

    def _cut(self, at: int, opcode: int, length: int) -> int:
        """The record at ``at`` claims more bytes than the file has, and no later chunk is known."""
        # Where the file does end, it is not cut: then a part of a chunk may go over into anything.
        if opcode == CHUNK and self._layout.end is None and self._chunk(at, length, is_cut=True):
            return self._stop  # whoever reads it tells how much of it was lost
        return self._give_up(
            at, f'the file ends in the middle of a {"chunk" if opcode == CHUNK else "record"}'
        )

    def _give_up(self, at: int, complaint: str, *, goal: int = 0) -> int:
        """Go on at the goal, or at the next chunk in the index, or at the end of the file."""
        self._end_run()
        goal = goal or self._next_chunk(at) or self._stop
        self._damage(at, goal - at, complaint)
        return goal

    def _next_chunk(self, at: int) -> int:
        """Where the index at the end of the file says that the next chunk starts; 0 if nowhere."""
        place = bisect_right(self._chunk_offsets, at)
        return self._chunk_offsets[place] if place < len(self._chunk_offsets) else 0


def _span(start_ns: int, end_ns: int) -> tuple[int, int]:
    """The times of a chunk; some writers leave their initial values in one without messages."""
    return (0, 0) if (start_ns, end_ns) == (_NEVER_NS, 0) else (start_ns, end_ns)
