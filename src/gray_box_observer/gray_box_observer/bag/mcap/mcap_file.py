"""Writes one MCAP file in whole chunks, so that a killed recorder leaves a readable file.

mcap's own writer ends a chunk only when it is full; a recorder of slow topics would then hold
minutes of data in memory. Here a chunk ends whenever the owner says so. Declarations stand outside
the chunks: a damaged chunk never takes the meaning of the others with it. Whatever is written, the
end of an MCAP file is written behind it in the same call (`gray_box_observer.bag.mcap.mcap_tail`),
so the file is complete at any moment.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Schema

from gray_box_observer.bag.mcap.mcap_records import HEAD, MAGIC, MESSAGE_HEAD
from gray_box_observer.bag.mcap.mcap_tail import McapTail, bytes_of
from gray_box_observer.errors import BagError

COMPRESSIONS = ('none', 'lz4', 'zstd')
"""Of chunks; all that the format knows."""

_MESSAGE_FIXED_BYTES = MESSAGE_HEAD.size - HEAD.size
_INDEX_ENTRY = struct.Struct('<QQ')


class McapFile:
    """One MCAP file being written. Every method raises `BagError` when the disk refuses.

    Args:
        path: The file; must not exist.
        library: Who writes it, for the header.
        compression: One of `COMPRESSIONS`, for the chunks.
        level: Of the compression, in its own numbers; None for its default.
        about: What rosbag2 keeps in the file itself
            (`gray_box_observer.bag.metadata.storage_text`); empty for nothing.
    """

    def __init__(
        self,
        path: Path,
        *,
        library: str,
        compression: str = 'none',
        level: int | None = None,
        about: str = '',
    ) -> None:
        self.path = path
        self.size = 0
        self.start_ns = 0
        self.end_ns = 0
        self.message_count = 0
        self._compression = '' if compression == 'none' else compression
        self._pack = _packer(compression, level)
        self._counts: dict[int, int] = defaultdict(int)
        self._tail = McapTail(about)
        self._written_tail = b''
        self._new_chunk()
        try:
            self._stream = path.open('xb', buffering=0)
        except OSError as error:
            raise _write_error(path, error) from None
        try:
            self._write(MAGIC + bytes_of(Header(profile='ros2', library=library)))
        except BagError:
            self.abandon()
            raise

    @property
    def written_counts(self) -> tuple[int, int, int]:
        """First and last log time and number of the messages that are in the file."""
        return self._tail.start_ns, self._tail.end_ns, self._tail.message_count

    @property
    def pending_bytes(self) -> int:
        """Bytes of messages that are not yet in the file."""
        return self._chunk_bytes

    def add_channel(
        self, topic: str, type_name: str, schema_text: str, metadata: dict[str, str]
    ) -> int:
        """Declare a topic; the result is the number by which `add_message` knows it."""
        text = schema_text.encode()
        tail = self._tail
        schema_bytes = b''
        schema = next((s for s in tail.schemas if s.name == type_name and s.data == text), None)
        if schema is None:
            schema = Schema(id=len(tail.schemas) + 1, data=text, encoding='ros2msg', name=type_name)
            schema_bytes = bytes_of(schema)
            tail.schemas.append(schema)
        channel = Channel(len(tail.channels) + 1, topic, 'cdr', metadata, schema.id)
        tail.channels.append(channel)
        self._write(schema_bytes + bytes_of(channel))
        return int(channel.id)

    def add_message(
        self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int
    ) -> None:
        """Append one message to the chunk in memory."""
        sequence = self._counts[channel]
        self._counts[channel] = sequence + 1
        if not self.message_count:
            self.start_ns = self.end_ns = log_time_ns
        elif log_time_ns < self.start_ns:
            self.start_ns = log_time_ns
        elif log_time_ns > self.end_ns:
            self.end_ns = log_time_ns
        self.message_count += 1
        self._chunk_index[channel].append((log_time_ns, self._chunk_bytes))
        length = _MESSAGE_FIXED_BYTES + len(data)
        self._chunk += (
            MESSAGE_HEAD.pack(
                5, length, channel, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns
            ),
            data,
        )
        self._chunk_bytes += MESSAGE_HEAD.size + len(data)

    def flush(self) -> None:
        """End the chunk and hand it to the operating system, which keeps it if we are killed."""
        if self._chunk:
            self._write(self._end_chunk())

    def finish(self) -> None:
        """Write what is left, the summary and the end mark, and close the file."""
        try:
            self._write(self._end_chunk() if self._chunk else b'', is_last=True)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is; it stays readable."""
        self._stream.close()

    def _new_chunk(self) -> None:
        self._chunk: list[bytes] = []
        self._chunk_bytes = 0
        self._chunk_index: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def _end_chunk(self) -> bytes:
        """The records of the chunk in memory and of its index, and a new chunk in its place."""
        records = b''.join(self._chunk)
        packed_records = self._pack(records)
        times = [time for entries in self._chunk_index.values() for time, _ in entries]
        start_ns = min(times)
        end_ns = max(times)
        name = self._compression.encode()
        sizes = (len(records), zlib.crc32(records), len(name), name, len(packed_records))
        head = struct.pack(f'<QQQII{len(name)}sQ', start_ns, end_ns, *sizes)
        chunk = HEAD.pack(Opcode.CHUNK, len(head) + len(packed_records)) + head + packed_records
        index_offsets = {}
        indexes = bytearray()
        for channel, entries in self._chunk_index.items():
            index_offsets[channel] = self.size + len(chunk) + len(indexes)
            content = b''.join(_INDEX_ENTRY.pack(*entry) for entry in entries)
            indexes += HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(content))
            indexes += struct.pack('<HI', channel, len(content)) + content
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=self.size,
            compression=self._compression,
            compressed_size=len(packed_records),
            message_end_time=end_ns,
            message_index_length=len(indexes),
            message_index_offsets=index_offsets,
            message_start_time=start_ns,
            uncompressed_size=len(records),
        )
        self._tail.add_chunk(
            index, {channel: len(entries) for channel, entries in self._chunk_index.items()}
        )
        self._new_chunk()
        return chunk + bytes(indexes)

    def _write(self, content: bytes, *, is_last: bool = False) -> None:
        """Put the content in the place of the file's end and a new end behind it.

        If the disk refuses, the file is left as it was.
        """
        data_end = self.size + len(content)
        tail = self._tail.final(data_end) if is_last else self._tail.provisional(data_end)
        try:
            if len(content) + len(tail) < len(self._written_tail):
                self._stream.truncate(
                    self.size
                )  # nothing of the old end may stay behind the new one
            self._put(content + tail)
        except (OSError, ValueError) as error:
            self._undo()
            raise _write_error(self.path, error) from None
        self.size = data_end
        self._written_tail = tail

    def _put(self, content: bytes) -> None:
        self._stream.seek(self.size)
        remainder = memoryview(content)
        while remainder:
            remainder = remainder[self._stream.write(remainder) :]

    def _undo(self) -> None:
        with suppress(
            OSError, ValueError
        ):  # at worst the reader meets a cut record, which it can take
            self._stream.truncate(self.size)
            self._put(self._written_tail)


def _packer(compression: str, level: int | None) -> Callable[[bytes], bytes]:
    if compression == 'zstd':
        return zstandard.ZstdCompressor(level=3 if level is None else level).compress
    if compression == 'lz4':
        return lambda records: bytes(lz4.frame.compress(records, compression_level=level or 0))
    return lambda records: records


def _write_error(path: Path, error: Exception) -> BagError:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return BagError(f'{path}: cannot be written: {reason}')
