"""Writing one MCAP file in chunks that reach the disk whole, so that a killed recorder leaves a readable file.

mcap's own writer ends a chunk only when it is full; a recorder of slow topics would then hold minutes of data in
memory. Here a chunk ends whenever the owner says so. Declarations stand outside the chunks: a damaged chunk never
takes the meaning of the others with it.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)

from gray_box_observer.bag.mcap_records import HEAD, MAGIC, MESSAGE_HEAD
from gray_box_observer.errors import BagError

_MESSAGE_FIXED_BYTES = MESSAGE_HEAD.size - HEAD.size
_INDEX_ENTRY = struct.Struct('<QQ')


class McapFile:
    """One MCAP file being written. Every method raises `BagError` when the disk refuses.

    Args:
        path: The file; must not exist.
        library: Who writes it, for the header.
        compression: ``''`` or ``'zstd'``, for the chunks.
    """

    def __init__(self, path: Path, *, library: str, compression: str = '') -> None:
        self.path = path
        self.size = 0
        self.start_ns = 0
        self.end_ns = 0
        self.message_count = 0
        self._compression = compression
        self._compressor = zstandard.ZstdCompressor() if compression == 'zstd' else None
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._chunk_indexes: list[ChunkIndex] = []
        self._new_chunk()
        try:
            self._stream = path.open('xb', buffering=0)
        except OSError as error:
            raise _refused(path, error) from None
        self._write(MAGIC + _bytes_of(Header(profile='ros2', library=library)))

    @property
    def pending_bytes(self) -> int:
        """Bytes of messages that are not yet in the file."""
        return self._chunk_bytes

    def add_channel(self, topic: str, type_name: str, schema_text: str, metadata: dict[str, str]) -> int:
        """Declare a topic; the result is the number by which `add_message` knows it."""
        text = schema_text.encode()
        schema = next((s for s in self._schemas if s.name == type_name and s.data == text), None)
        if schema is None:
            schema = Schema(id=len(self._schemas) + 1, data=text, encoding='ros2msg', name=type_name)
            self._write(_bytes_of(schema))
            self._schemas.append(schema)
        channel = Channel(len(self._channels) + 1, topic, 'cdr', metadata, schema.id)
        self._write(_bytes_of(channel))
        self._channels.append(channel)
        return int(channel.id)

    def add_message(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
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
            MESSAGE_HEAD.pack(5, length, channel, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns),
            data,
        )
        self._chunk_bytes += MESSAGE_HEAD.size + len(data)

    def flush(self) -> None:
        """End the chunk and hand it to the operating system, which keeps it even if this process is killed."""
        if not self._chunk:
            return
        records = b''.join(self._chunk)
        packed = self._compressor.compress(records) if self._compressor is not None else records
        times = [time for entries in self._chunk_index.values() for time, _ in entries]
        name = self._compression.encode()
        head = struct.pack(
            f'<QQQII{len(name)}sQ',
            min(times),
            max(times),
            len(records),
            zlib.crc32(records),
            len(name),
            name,
            len(packed),
        )
        chunk = HEAD.pack(Opcode.CHUNK, len(head) + len(packed)) + head + packed
        index_offsets, indexes = {}, bytearray()
        for channel, entries in self._chunk_index.items():
            index_offsets[channel] = self.size + len(chunk) + len(indexes)
            content = b''.join(_INDEX_ENTRY.pack(*entry) for entry in entries)
            indexes += HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(content))
            indexes += struct.pack('<HI', channel, len(content)) + content
        index = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=self.size,
            compression=self._compression,
            compressed_size=len(packed),
            message_end_time=max(times),
            message_index_length=len(indexes),
            message_index_offsets=index_offsets,
            message_start_time=min(times),
            uncompressed_size=len(records),
        )
        self._write(chunk + indexes)
        self._chunk_indexes.append(index)
        self._new_chunk()

    def finish(self) -> None:
        """Write what is left, the summary and the end mark, and close the file."""
        try:
            self.flush()
            self._write(_bytes_of(DataEnd(data_section_crc=0)))
            self._write(self._summary())
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is."""
        self._stream.close()

    def _new_chunk(self) -> None:
        self._chunk: list[bytes] = []
        self._chunk_bytes = 0
        self._chunk_index: dict[int, list[tuple[int, int]]] = defaultdict(list)

    def _summary(self) -> bytes:
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=self.message_count,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=0,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indexes]),
        ]
        out, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            content = b''.join(_bytes_of(record) for record in records)
            if content:
                offsets += _bytes_of(SummaryOffset(opcode, self.size + len(out), len(content)))
                out += content
        start, offsets_start = self.size, self.size + len(out)
        out += offsets
        covered = out + struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offsets_start)
        return bytes(out) + _bytes_of(Footer(start, offsets_start, zlib.crc32(covered))) + MAGIC

    def _write(self, content: bytes | bytearray) -> None:
        """Write all of it or, if the disk refuses, leave the file as it was."""
        rest = memoryview(content)
        try:
            while rest:
                rest = rest[self._stream.write(rest) :]
        except (OSError, ValueError) as error:
            self._undo()
            raise _refused(self.path, error) from None
        self.size += len(content)

    def _undo(self) -> None:
        try:
            self._stream.truncate(self.size)
        except (OSError, ValueError):
            return  # then the reader meets a cut record, which it can take


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _refused(path: Path, error: Exception) -> BagError:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return BagError(f'{path}: cannot be written: {reason}')
