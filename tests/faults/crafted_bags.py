"""Bags of at most a megabyte that ask for much memory; records are written byte by byte."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, repeat
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import zstandard

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text

MAGIC = b'\x89MCAP0\r\n'
HEADER = 1
FOOTER = 2
SCHEMA = 3
CHANNEL = 4
MESSAGE = 5
CHUNK = 6
ATTACHMENT = 9
STATISTICS = 11
METADATA = 12
PRIVATE = 200
MB = 1_000_000
START_NS = 10**18
TORQUE = '/motor/torque'
VOLTAGE = '/motor/voltage'
BLOCK_BYTES = 1 << 20


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    """One record; its length may lie."""
    return struct.pack('<BQ', opcode, len(content) if length is None else length) + content


def text(value: str) -> bytes:
    """A text as MCAP writes it."""
    raw = value.encode()
    return struct.pack('<I', len(raw)) + raw


def schema(number: int, name: str, definition: str) -> bytes:
    """A schema of ROS."""
    return record(
        SCHEMA, struct.pack('<H', number) + text(name) + text('ros2msg') + text(definition)
    )


def channel(number: int, topic: str, schema_number: int = 1) -> bytes:
    """A topic."""
    return record(
        CHANNEL,
        struct.pack('<HH', number, schema_number)
        + text(topic)
        + text('cdr')
        + struct.pack('<I', 0),
    )


def message(number: int, data: bytes, time_ns: int = START_NS, length: int | None = None) -> bytes:
    """A message; the length of its record may lie."""
    return record(MESSAGE, struct.pack('<HIQQ', number, 0, time_ns, time_ns) + data, length)


def declarations(type_name: str = TYPE_NAME, definition: str | None = None) -> bytes:
    """Voltage and torque as channels 1 and 2."""
    known = schema_text(TYPE_NAME, built_in_lookup) if definition is None else definition
    return schema(1, type_name, known) + channel(1, VOLTAGE) + channel(2, TORQUE)


def samples(count: int = 200) -> bytes:
    """What a motor says, so that there is something to identify."""
    out = bytearray()
    for k in range(count):
        stamp_ns = START_NS + k * 10**7
        for number, value in ((1, 5.0 + k % 7), (2, 0.01 * (k % 5))):
            out += message(
                number, encode_joint_state(stamp_ns, ['motor'], effort=[value]), stamp_ns
            )
    return bytes(out)


def packed(blocks: Iterable[bytes], compression: str) -> tuple[bytes, int]:
    """Blocks compressed one after another, so that nobody holds them all; and their size."""
    size = 0
    out = bytearray()
    if compression == 'zstd':
        packer = zstandard.ZstdCompressor(level=3).compressobj()
        for block in blocks:
            size += len(block)
            out += packer.compress(block)
        return bytes(out + packer.flush()), size
    unpacked = lz4.frame.LZ4FrameCompressor()
    out += unpacked.begin()
    for block in blocks:
        size += len(block)
        out += unpacked.compress(block)
    return bytes(out + unpacked.flush()), size


def chunk(
    content: bytes,
    size: int,
    compression: str = '',
    span_ns: tuple[int, int] = (START_NS, START_NS + 10**10),
) -> bytes:
    """A chunk of these compressed records, whose size may lie."""
    head = (
        struct.pack('<QQQI', *span_ns, size, 0)
        + text(compression)
        + struct.pack('<Q', len(content))
    )
    return record(CHUNK, head + content)


def packed_chunk(blocks: Iterable[bytes], compression: str = 'zstd') -> bytes:
    """A chunk of blocks of whole records."""
    return chunk(*packed(blocks, compression), compression)


def empties(byte_count: int, number: int = 2) -> Iterator[bytes]:
    """Blocks of messages without a byte of data."""
    each = message(number, b'')
    block = each * (BLOCK_BYTES // len(each))
    return repeat(block, max(1, byte_count // len(block)))


def padded(blocks: Iterable[bytes], seed: int, byte_count: int) -> Iterator[bytes]:
    """The same behind incompressible noise, so that the whole looks like data."""
    yield record(PRIVATE, random.Random(seed).randbytes(byte_count))
    yield from blocks


class Hole(NamedTuple):
    """So many bytes of a file that hold nothing and take no place on the disk."""

    byte_count: int


def write(path: Path, *parts: bytes | Hole, has_end: bool = False) -> None:
    """Write a file of these parts after samples of a motor, so that a reader goes on."""
    with path.open('wb') as stream:
        stream.write(MAGIC + record(HEADER, text('ros2') + text('')))
        for part in parts:
            if isinstance(part, Hole):
                stream.seek(part.byte_count, 1)
            else:
                stream.write(part)
        stream.truncate()
        if has_end:
            stream.write(record(FOOTER, struct.pack('<QQI', 0, 0, 0)) + MAGIC)


Craft = Callable[[Path], None]


def one_chunk_of_empty_messages(path: Path) -> None:
    """34.6 million of them in 99 kB."""
    write(path, declarations(), packed_chunk(empties(1 << 30)))


def overlapping_chunks(path: Path) -> None:
    """Chunks of a gibibyte each that cover the same time."""
    huge = packed_chunk(empties(1 << 30))
    write(path, declarations(), *([huge] * 3))


def chunks_within_the_limits(path: Path) -> None:
    """Each chunk may be read, and all of them wait for each other."""
    chunks = [packed_chunk(padded(empties(15 * MB), k, 20_000)) for k in range(12)]
    write(path, declarations(), samples(), *chunks)


def one_chunk_just_within_the_limits(path: Path) -> None:
    """79 MB, and its messages would take nine times as much."""
    write(path, declarations(), samples(), packed_chunk(padded(empties(79 * MB), 1, 90_000)))


def lz4_chunks(path: Path) -> None:
    """The other compression, at its best."""
    chunks = [packed_chunk(empties(74 * MB), 'lz4')] * 3
    write(path, declarations(), samples(), *chunks)


def large_messages(path: Path) -> None:
    """A few messages that fill the limit."""
    data = encode_joint_state(START_NS, ['motor'], effort=[1.0]) + bytes(19 * MB)
    chunks = [packed_chunk(padded([message(2, data)] * 4, k, 90_000)) for k in range(6)]
    write(path, declarations(), samples(), *chunks)


def claims(path: Path) -> None:
    """Chunks that claim sizes of any order."""
    small, _ = packed([message(2, b'')], 'zstd')
    sizes = (1 << 27, 1 << 30, 1 << 31, 1 << 40, (1 << 64) - 1)
    chunks = [chunk(small, size, kind) for size in sizes for kind in ('zstd', 'lz4', '')]
    write(path, declarations(), samples(), *chunks)


def wide_window(path: Path) -> None:
    """A frame of zstd that wants a window of two gibibytes."""
    frame = struct.pack('<I', 0xFD2FB528) + bytes([0x00, 21 << 3]) + bytes([0x03, 0x00, 0x00, 0x41])
    write(path, declarations(), samples(), chunk(frame, 70 * MB, 'zstd'))


def a_packed_file(path: Path) -> None:
    """A whole file in rosbag2's compression, which unpacks to just below the limit."""
    write(
        path,
        declarations(),
        samples(),
        *[packed_chunk(padded(empties(12 * MB), k, 20_000)) for k in range(8)],
    )
    with path.open('ab') as stream:
        stream.write(record(PRIVATE, bytes(78 * MB)))
    path.write_bytes(zstandard.compress(path.read_bytes()))


def a_packed_file_without_size(path: Path) -> None:
    """The same without its size of a gibibyte in the head; noise keeps a log's ratio."""
    frame, _ = packed(
        chain([MAGIC, random.Random(1).randbytes(900_000)], repeat(bytes(BLOCK_BYTES), 1 << 10)),
        'zstd',
    )
    path.write_bytes(frame)


def packed_messages(path: Path) -> None:
    """Messages packed singly; each unpacks to its limit, together to ten times the limit."""
    data = encode_joint_state(START_NS, ['motor'], effort=[1.0]) + random.Random(1).randbytes(
        80_000
    )
    frame = zstandard.compress(data + bytes(78 * MB))
    chunks = [chunk(message(2, frame) * 2, 2 * len(message(2, frame))) for _ in range(5)]
    write(path, declarations(), samples(), *chunks)


def sparse_declaration(path: Path) -> None:
    """A schema of a terabyte, all of it a hole."""
    write(path, declarations(), samples(), record(SCHEMA, b'', 1 << 40), Hole(1 << 40), samples())


def sparse_message(path: Path) -> None:
    """A message of 30 GB outside any chunk."""
    size = 30_000 * MB
    write(
        path, declarations(), samples(), message(2, b'', START_NS, size), Hole(size - 22), samples()
    )


def sparse_chunks(path: Path) -> None:
    """Chunks of 10 GB in the file, compressed and not."""
    size = 10_000 * MB
    parts: list[bytes | Hole] = []
    for kind in ('', 'zstd', 'lz4'):
        head = (
            struct.pack('<QQQI', START_NS, START_NS, size, 0) + text(kind) + struct.pack('<Q', size)
        )
        parts += [record(CHUNK, head, len(head) + size), Hole(size)]
    write(path, declarations(), samples(), *parts, samples())


def sparse_attachments(path: Path) -> None:
    """Attachments and metadata of a gigabyte each, all of them holes."""
    parts: list[bytes | Hole] = []
    for opcode in (ATTACHMENT, METADATA) * 20:
        parts += [record(opcode, b'', 1000 * MB), Hole(1000 * MB)]
    write(path, declarations(), samples(), *parts, samples(), has_end=True)


def sparse_summary(path: Path) -> None:
    """A summary of a terabyte with a checksum, which somebody would have to compute."""
    with path.open('wb') as stream:
        stream.write(MAGIC + record(HEADER, text('ros2') + text('')) + declarations() + samples())
        start = stream.tell()
        stream.seek(1 << 40, 1)
        stream.write(record(FOOTER, struct.pack('<QQI', start, 0, 1)) + MAGIC)


def statistics_of_many(path: Path) -> None:
    """Counts of six million channels, most of them a hole."""
    with path.open('wb') as stream:
        stream.write(MAGIC + record(HEADER, text('ros2') + text('')) + declarations() + samples())
        start = stream.tell()
        size = 60 * MB
        stream.write(
            record(STATISTICS, struct.pack('<QHIIIIQQI', 0, 1, 1, 0, 0, 0, 0, 0, size), 46 + size)
        )
        stream.seek(size, 1)
        stream.write(record(FOOTER, struct.pack('<QQI', start, 0, 0)) + MAGIC)


def many_topics(path: Path) -> None:
    """All the channels that there can be, with long names, in one chunk."""
    blocks = (channel(k, f'/{k}/' + 'x' * 1000) for k in range(3, 65_000))
    write(path, declarations(), samples(), packed_chunk(padded(blocks, 1, 80_000)))


def many_counts(path: Path) -> None:
    """Chunks with a message of every one of 30,000 topics."""
    declared = packed_chunk(channel(k, f'/{k}') for k in range(3, 30_000))
    each = packed_chunk(message(k, b'') for k in range(3, 30_000))
    count = (MB - len(declared) - 100_000) // len(each)
    write(path, declarations(), declared, samples(), *([each] * count))


def long_definitions(path: Path) -> None:
    """Schemas that are longer than any book."""
    blocks = (schema(k, f'pkg/msg/T{k}', 'float64 x\n' * 200_000) for k in range(3, 40))
    write(path, declarations(), samples(), packed_chunk(padded(blocks, 1, 80_000)))


def many_keys(path: Path) -> None:
    """A channel with a million words about itself."""
    words = b''.join(text(f'{k:x}') + text('') for k in range(250_000))
    body = (
        struct.pack('<HH', 3, 1) + text('/x') + text('cdr') + struct.pack('<I', len(words)) + words
    )
    write(path, declarations(), samples(), packed_chunk([record(CHANNEL, body)]))


def tiny_records(path: Path) -> None:
    """As many attachments and pieces of metadata as there is room for."""
    write(
        path,
        declarations(),
        samples(20),
        (record(ATTACHMENT, b'') + record(METADATA, b'')) * 50_000,
    )


def tiny_chunks(path: Path) -> None:
    """As many chunks as there is room for, all at the same time."""
    records = message(2, b'')
    write(path, declarations(), samples(20), chunk(records, len(records)) * 9000)


def a_million_motors(path: Path) -> None:
    """Messages with so many names and values."""
    names = [f'm{k}' for k in range(300_000)]
    data = encode_joint_state(START_NS, names, effort=[1.0] * len(names))
    write(path, declarations(), samples(), packed_chunk([message(2, data)] * 4))


def values_without_end(path: Path) -> None:
    """Messages of 60 MB of numbers."""
    count = 7 * MB
    data = encode_joint_state(START_NS, ['motor'])[:-4] + struct.pack('<I', count)
    blocks = [message(2, data, START_NS, 22 + len(data) + 8 * count), *repeat(bytes(8 * MB), 7)]
    write(path, declarations(), samples(), packed_chunk(padded(blocks, 1, 70_000)))


def torque_without_voltage(path: Path) -> None:
    """Two hundred thousand torques that wait for their voltage."""
    blocks = (
        message(2, encode_joint_state(START_NS + k, ['motor'], effort=[0.1]), START_NS + k)
        for k in range(200_000)
    )
    write(path, declarations(), samples(), packed_chunk(padded(blocks, 1, 30_000)))


def other_type(definition: str, data: bytes) -> Craft:
    """Both signals of a type of the bag's own."""

    def craft(path: Path) -> None:
        records = message(1, data) + message(2, data)
        blocks = padded([records] * 8, 1, 90_000)
        write(path, declarations('evil/msg/Top', definition), packed_chunk(blocks))

    return craft


_PART = '\n' + '=' * 80 + '\nMSG: evil/Part\n'


def tree(depth: int, leaf: str) -> str:
    """A type that holds two of the next type, which holds two of the next, and so on."""
    separator = _PART.removesuffix('Part\n')
    levels = (f'{separator}A{k}\nA{k + 1} x\nA{k + 1} y' for k in range(depth))
    return f'A0 effort{"".join(levels)}{separator}A{depth}\n{leaf}\n'


def chain_of(depth: int) -> str:
    """Entries of one byte, each below so many types that hold the next alone."""
    separator = _PART.removesuffix('Part\n')
    levels = (f'{separator}A{k}\nA{k + 1} x' for k in range(depth))
    return f'A0[] effort{"".join(levels)}{separator}A{depth}\nuint8 x\n'


DEFINITIONS: dict[str, tuple[str, bytes]] = {
    'a_fixed_array_of_nothing': (f'Part[4000000000] effort{_PART}uint8[0] x\n', bytes(8)),
    'a_sequence_of_nothing': (
        f'Part[] effort{_PART}uint8[0] x\n',
        bytes(4) + struct.pack('<I', 4_000_000_000),
    ),
    'a_fixed_array_of_empty_parts': (f'Part[4000000000] effort{_PART}', bytes(8)),
    'a_fixed_array_of_numbers': ('float64[4000000000] effort\n', bytes(16)),
    'a_type_that_holds_itself': (f'Part effort{_PART}Part x\n', bytes(8)),
    'a_sequence_of_bytes_as_parts': (
        f'Part[] effort{_PART}uint8 x\n',
        bytes(4) + struct.pack('<I', 260_000) + bytes(260_000),
    ),
    'a_fixed_array_of_byte_arrays': (f'Part[4000000000] effort{_PART}uint8[1] x\n', bytes(8)),
    'a_sequence_of_long_byte_arrays': (
        f'Part[] effort{_PART}uint8[4000000000] x\n',
        bytes(4) + struct.pack('<I', 4_000_000_000),
    ),
    'a_tree_of_byte_arrays': (tree(40, 'uint8[1] x'), bytes(8)),
    'a_tree_of_empty_types': (tree(40, ''), bytes(4 + 260_000)),
    'a_sequence_of_chains': (
        chain_of(60),
        bytes(4) + struct.pack('<I', 260_000) + bytes(260_000),
    ),
    'a_long_definition': (
        'float64 effort\n' + ''.join(f'float64 f{k}\n' for k in range(18_000)),
        bytes(16),
    ),
}

CRAFTS: dict[str, Craft] = {
    craft.__name__: craft
    for craft in (
        one_chunk_of_empty_messages,
        overlapping_chunks,
        chunks_within_the_limits,
        one_chunk_just_within_the_limits,
        lz4_chunks,
        large_messages,
        claims,
        wide_window,
        a_packed_file,
        a_packed_file_without_size,
        packed_messages,
        sparse_declaration,
        sparse_message,
        sparse_chunks,
        sparse_attachments,
        sparse_summary,
        statistics_of_many,
        many_topics,
        many_counts,
        long_definitions,
        many_keys,
        tiny_records,
        tiny_chunks,
        a_million_motors,
        values_without_end,
        torque_without_voltage,
    )
} | {name: other_type(*definition) for name, definition in DEFINITIONS.items()}
