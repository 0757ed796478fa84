"""The end of an MCAP file: the summary, by which readers find their way, and the footer.

A file that is still being written carries such an end too, which the next chunk overwrites: when
its writer is killed, every reader opens what is there, index and all. A metadata record called
`UNFINISHED` then tells that the writer never came to its end; it is gone from a finished file.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from gray_box_observer.bag.mcap.mcap_records import MAGIC, UNFINISHED

ROSBAG2 = 'rosbag2'
"""Name of the metadata record that tells rosbag2 of the bag where there is only the file."""

LARGEST_PROVISIONAL_BYTES = 1 << 20
"""Where the index is longer than this, a provisional end has none: it is written with every chunk,
and would only grow.

That is after fifty minutes of ten topics at two chunks a second. Whoever records longer in one file
leaves, if killed, one that every reader can scan and none can seek in.
"""


class McapTail:
    """Collects what has to stand in the summary of one file, and makes the bytes of its end.

    Args:
        about: What rosbag2 keeps in the file itself
            (`gray_box_observer.bag.metadata.storage_text`); empty for nothing.
    """

    def __init__(self, about: str = '') -> None:
        self._about = (
            bytes_of(Metadata(name=ROSBAG2, metadata={'serialized_metadata': about}))
            if about
            else b''
        )
        self.start_ns = 0
        self.end_ns = 0
        self.message_count = 0
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._chunk_count = 0
        self._chunk_indexes = bytearray()

    def add_chunk(self, index: ChunkIndex, counts: Mapping[int, int]) -> None:
        """Take in a chunk that is about to be written.

        Args:
            index: Where it will stand and what it covers.
            counts: Its messages by channel; at least one.
        """
        is_first = not self.message_count
        self.start_ns = (
            index.message_start_time if is_first else min(self.start_ns, index.message_start_time)
        )
        self.end_ns = (
            index.message_end_time if is_first else max(self.end_ns, index.message_end_time)
        )
        self.message_count += sum(counts.values())
        for channel, count in counts.items():
            self._counts[channel] += count
        self._chunk_count += 1
        self._chunk_indexes += bytes_of(index)

    def provisional(self, data_end: int) -> bytes:
        """The end of a file that goes on; without an index where that has become too long.

        Args:
            data_end: Byte of the file where this end will start.
        """
        mark = bytes_of(Metadata(name=UNFINISHED, metadata={}))
        if len(self._chunk_indexes) > LARGEST_PROVISIONAL_BYTES:
            return mark + bytes_of(DataEnd(data_section_crc=0)) + bytes_of(Footer(0, 0, 0)) + MAGIC
        return mark + self.final(data_end + len(mark))

    def final(self, data_end: int) -> bytes:
        """The end of a file that is complete.

        Args:
            data_end: Byte of the file where this end will start.
        """
        end = self._about + bytes_of(DataEnd(data_section_crc=0))
        start = data_end + len(end)
        out = bytearray()
        offsets = bytearray()
        for opcode, content in self._groups(data_end):
            if content:
                offsets += bytes_of(SummaryOffset(opcode, start + len(out), len(content)))
                out += content
        offsets_start = start + len(out)
        out += offsets
        checked_bytes = out + struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offsets_start)
        return (
            end
            + bytes(out)
            + bytes_of(Footer(start, offsets_start, zlib.crc32(checked_bytes)))
            + MAGIC
        )

    def _groups(self, data_end: int) -> list[tuple[Opcode, bytes]]:
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=1 if self._about else 0,
            schema_count=len(self.schemas),
        )
        about = MetadataIndex(offset=data_end, length=len(self._about), name=ROSBAG2)
        return [
            (Opcode.SCHEMA, b''.join(map(bytes_of, self.schemas))),
            (Opcode.CHANNEL, b''.join(map(bytes_of, self.channels))),
            (Opcode.STATISTICS, bytes_of(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, bytes_of(about) if self._about else b''),
        ]


def bytes_of(record: McapRecord) -> bytes:
    """One record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
