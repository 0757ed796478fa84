"""Damaged bags, made from recorded ones, and the seeded ways in which they are damaged."""

from __future__ import annotations

import random
import shutil
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

from mcap.writer import CompressionType, Writer

from gray_box_observer.bag.mcap.mcap_content import RawMessage
from gray_box_observer.bag.metadata import METADATA_NAME
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.writer import BagOptions, BagWriter

BAGS = Path(__file__).resolve().parents[2] / 'bags'
CHUNK = 6
HEAD = struct.Struct('<BQ')
HUGE = (1 << 31, (1 << 32) - 1, 1 << 60, (1 << 63) - 1, (1 << 64) - 1)
OWN = {
    'ours': BagOptions(chunk_bytes=6000),
    'ours, lz4': BagOptions(chunk_bytes=6000, compression='lz4'),
    'ours, zstd': BagOptions(chunk_bytes=6000, compression='zstd'),
    'ours, split': BagOptions(chunk_bytes=4000, compression='zstd', max_file_bytes=12_000),
    'ours, killed': BagOptions(chunk_bytes=6000, max_file_bytes=40_000),
}
FOREIGN = {
    'mcap, lz4 without checksums': {'compression': CompressionType.LZ4, 'enable_crcs': False},
    'mcap, zstd': {'compression': CompressionType.ZSTD},
    'mcap, without chunks': {'use_chunking': False},
    'mcap, without summary': {
        'use_statistics': False,
        'use_summary_offsets': False,
        'repeat_schemas': False,
    },
}
CHECKED = (*OWN, 'mcap, zstd')
"""Forms whose every message is covered by a checksum: there, no wrong message may ever come out."""

Harm = Callable[[random.Random, Path], None]


def make_sources(folder: Path, seconds: float) -> dict[str, list[Path]]:
    """Write the first seconds of every recorded bag in every form.

    Returns:
        The bags by the name of their form.
    """
    made: dict[str, list[Path]] = {form: [] for form in (*OWN, *FOREIGN)}
    for bag in sorted(path.parent for path in BAGS.glob(f'*/{METADATA_NAME}')):
        with BagReader(bag) as reader:
            topics = reader.topics
            end_ns = reader.start_ns + round(seconds * 1e9)
            messages = [message for message in reader.messages() if message.log_time_ns < end_ns]
        schemas = {name: (info.type_name, info.schema_text) for name, info in topics.items()}
        for number, (form, options) in enumerate(OWN.items()):
            writer = BagWriter(folder / f'{bag.name}_{number}', options)
            _write_own(writer, messages, schemas)
            if form.endswith('killed'):
                writer.flush()
            else:
                writer.close()
            made[form].append(writer.folder)
        for number, (form, arguments) in enumerate(FOREIGN.items()):
            path = folder / f'{bag.name}_foreign_{number}.mcap'
            _write_foreign(path, messages, schemas, arguments)
            made[form].append(path)
    return made


def _write_own(
    writer: BagWriter, messages: Sequence[RawMessage], schemas: dict[str, tuple[str, str]]
) -> None:
    for name, schema in schemas.items():
        writer.add_topic(name, *schema)
    for message in messages:
        writer.write(message.topic, message.data, message.log_time_ns, message.publish_time_ns)


def _write_foreign(
    path: Path,
    messages: Sequence[RawMessage],
    schemas: dict[str, tuple[str, str]],
    arguments: dict[str, object],
) -> None:
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=6000, **arguments)
        writer.start(profile='ros2')
        channels = {}
        for topic, (type_name, text) in schemas.items():
            channels[topic] = writer.register_channel(
                topic, 'cdr', writer.register_schema(type_name, 'ros2msg', text.encode())
            )
        for m in messages:
            writer.add_message(channels[m.topic], m.log_time_ns, m.data, m.publish_time_ns)
        writer.finish()


def damaged_copy(seed: str, source: Path, folder: Path) -> tuple[Path, str]:
    """Copy a bag into an empty folder and damage the copy.

    Returns:
        The path of the copy, and what was done to it.
    """
    draw = random.Random(seed)
    target = folder / source.name
    if source.is_dir():
        shutil.copytree(source, target)
        name = draw.choices(
            [*HARMS, *FOLDER_HARMS], [3.0] * len(HARMS) + [1.0] * len(FOLDER_HARMS)
        )[0]
    else:
        shutil.copyfile(source, target)
        name = draw.choice([*HARMS])
    if name in FOLDER_HARMS:
        FOLDER_HARMS[name](draw, target)
    else:
        files = sorted(target.glob('*.mcap')) if target.is_dir() else [target]
        HARMS[name](draw, draw.choice(files))
    return target, name


def _truncate(draw: random.Random, path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: draw.randrange(len(content))])


def _append(draw: random.Random, path: Path) -> None:
    tail = draw.randbytes(draw.choice([1, 8, 100, 5000]))
    with path.open('ab') as stream:
        stream.write(draw.choice([tail, bytes(len(tail))]))


def _changed(change: Callable[[random.Random, bytearray], None]) -> Harm:
    """A harm to a file's bytes."""

    def harm(draw: random.Random, path: Path) -> None:
        content = bytearray(path.read_bytes())
        if content:
            change(draw, content)
            path.write_bytes(content)

    return harm


def _place(draw: random.Random, content: bytearray) -> int:
    """A byte: anywhere, or in the first or last thousand (declarations and summary)."""
    size = len(content)
    near = min(1000, size)
    start, end = draw.randrange(near), size - 1 - draw.randrange(near)
    return draw.choice([draw.randrange(size), draw.randrange(size), start, end])


def _flip(draw: random.Random, content: bytearray) -> None:
    content[_place(draw, content)] ^= 1 << draw.randrange(8)


def _flip_many(draw: random.Random, content: bytearray) -> None:
    for _ in range(draw.choice([2, 5, 50])):
        _flip(draw, content)


def _burst(draw: random.Random, content: bytearray) -> None:
    start = _place(draw, content)
    length = draw.choice([2, 8, 64, 700])
    for at in range(start, min(start + length, len(content))):
        content[at] ^= draw.randrange(256)


def _zero(draw: random.Random, content: bytearray) -> None:
    start = _place(draw, content)
    end = min(start + draw.choice([1, 8, 512, 4096, len(content)]), len(content))
    content[start:end] = bytes(end - start)


def _remove(draw: random.Random, content: bytearray) -> None:
    start = _place(draw, content)
    del content[start : start + draw.choice([1, 9, 300, 4096])]


def _repeat(draw: random.Random, content: bytearray) -> None:
    start = _place(draw, content)
    content[start:start] = content[start : start + draw.choice([1, 9, 300, 4096])]


def _records(content: bytearray) -> list[tuple[int, int, int]]:
    """Start, opcode and length with the head of every record that stands outside chunks."""
    found = []
    at = 8
    while at + HEAD.size <= len(content):
        opcode, length = HEAD.unpack_from(content, at)
        if at + HEAD.size + length > len(content):
            break
        found.append((at, opcode, HEAD.size + length))
        at += HEAD.size + length
    return found


def _lie_about_a_length(draw: random.Random, content: bytearray) -> None:
    """Give a record, or one of the numbers at the start of its content, an absurd value."""
    start, _, length = draw.choice(_records(content) or [(8, 0, 64)])
    at = start + draw.choice([1, 1, 9, 17, 25, 33, 37, 41, 45])
    if draw.random() < 0.3:
        at = start + draw.randrange(1, max(2, length))
    raw = draw.choice(HUGE).to_bytes(8, 'little')[: draw.choice([4, 8])]
    content[at : at + len(raw)] = raw[: max(0, len(content) - at)]


def _change_kind(draw: random.Random, content: bytearray) -> None:
    start, _, _ = draw.choice(_records(content) or [(0, 0, 0)])
    content[start] = draw.randrange(256)


def _swap_chunks(draw: random.Random, content: bytearray) -> None:
    chunks = [(start, length) for start, opcode, length in _records(content) if opcode == CHUNK]
    if len(chunks) < 2:
        return _flip(draw, content)
    (a, a_length), (b, b_length) = sorted(draw.sample(chunks, 2))
    swapped = content[b : b + b_length] + content[a + a_length : b] + content[a : a + a_length]
    content[a : b + b_length] = swapped
    return None


def _drop_chunk(draw: random.Random, content: bytearray) -> None:
    chunks = [(start, length) for start, opcode, length in _records(content) if opcode == CHUNK]
    start, length = draw.choice(chunks or [(8, 1)])
    del content[start : start + length]


HARMS: dict[str, Harm] = {
    'truncation': _truncate,
    'bytes behind the end': _append,
    **{
        name: _changed(change)
        for name, change in {
            'bit flip': _flip,
            'bit flips': _flip_many,
            'burst': _burst,
            'zeroed range': _zero,
            'removed range': _remove,
            'repeated range': _repeat,
            'absurd length': _lie_about_a_length,
            'another kind of record': _change_kind,
            'swapped chunks': _swap_chunks,
            'dropped chunk': _drop_chunk,
        }.items()
    },
}


def _remove_metadata(draw: random.Random, folder: Path) -> None:
    (folder / METADATA_NAME).unlink()


def _remove_file(draw: random.Random, folder: Path) -> None:
    draw.choice(sorted(folder.glob('*.mcap'))).unlink()


def _empty_file(draw: random.Random, folder: Path) -> None:
    draw.choice(sorted(folder.glob('*.mcap'))).write_bytes(b'')


def _foreign_file(draw: random.Random, folder: Path) -> None:
    """Put one file in the place of another: the metadata then speaks of another one."""
    files = sorted(folder.glob('*.mcap'))
    if len(files) < 2:
        return _empty_file(draw, folder)
    shutil.copyfile(*draw.sample(files, 2))
    return None


def _edit_metadata(draw: random.Random, folder: Path) -> None:
    """Put something else in the place of one value of the metadata."""
    path = folder / METADATA_NAME
    lines = path.read_text().splitlines()
    number = draw.choice([k for k, line in enumerate(lines) if ':' in line or '- ' in line])
    key = (
        lines[number].split(':')[0] if ':' in lines[number] else lines[number].split('- ')[0] + '-'
    )
    values = [
        '',
        '[]',
        '{}',
        '-1',
        '.nan',
        '9' * 40,
        '1e999',
        '2024-13-45',
        '"\\0"',
        "'..'",
        '/dev/zero',
        '*x',
    ]
    values += ['&x [*x]', '!!set']
    separator = '' if key.endswith('-') else ':'
    lines[number] = f'{key}{separator} {draw.choice(values)}'
    path.write_text('\n'.join(lines))


def _bomb_metadata(draw: random.Random, folder: Path) -> None:
    """Put a value that would be huge if it were written out in the place of one of the metadata."""
    path = folder / METADATA_NAME
    bomb = ['a0: &a0 [x, x]', *(f'a{k}: &a{k} [*a{k - 1}, *a{k - 1}]' for k in range(1, 40))]
    key = draw.choice(
        ['storage_identifier', 'compression_mode', 'relative_file_paths', 'files', 'message_count']
    )
    lines = [
        f'  {key}: *a39' if line.startswith(f'  {key}:') else line
        for line in path.read_text().splitlines()
    ]
    path.write_text('\n'.join([*bomb, *lines]))


_OF_TEXT = (
    *('truncation', 'bytes behind the end', 'bit flip', 'bit flips', 'burst'),
    *('zeroed range', 'removed range', 'repeated range'),
)
FOLDER_HARMS: dict[str, Harm] = {
    **{
        f'metadata: {name}': (lambda harm: lambda draw, folder: harm(draw, folder / METADATA_NAME))(
            HARMS[name]
        )
        for name in _OF_TEXT
    },
    'metadata: missing': _remove_metadata,
    'metadata: another value': _edit_metadata,
    'metadata: a bomb': _bomb_metadata,
    'file missing': _remove_file,
    'file empty': _empty_file,
    'file of another place': _foreign_file,
}
