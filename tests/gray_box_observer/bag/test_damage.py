"""Cut, killed or damaged bags: read as far as they go, or one clear line."""

from __future__ import annotations

import random
import resource
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions
from gray_box_observer.errors import BagError

MEMORY_BYTES = 300_000_000


@contextmanager
def little_memory() -> Iterator[None]:
    """Makes a giant allocation fail instead of succeed lazily."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def read(path: Path) -> tuple[list[tuple[int, bytes]], str | None] | str:
    """The messages and the loss, or the text of the error."""
    try:
        with BagReader(path) as bag:
            messages = [(m.log_time_ns, m.data) for m in bag.messages()]
            list(bag.decoded_messages())
            return messages, None if bag.loss is None else str(bag.loss)
    except BagError as error:
        assert '\n' not in str(error)
        return str(error)


def file_of(kind: str, folder: Path, make_bag) -> Path:
    if kind.startswith('ours'):
        options = BagOptions(chunk_bytes=1500, compression=kind.partition(', ')[2] or 'none')
        return make_bag(100, options=options) / 'run_0.mcap'
    path = folder / 'reference.mcap'
    with path.open('wb') as stream:
        compression = CompressionType.LZ4 if kind == 'reference, lz4' else CompressionType.NONE
        writer = Writer(
            stream, chunk_size=1500, compression=compression, use_chunking='unchunked' not in kind
        )
        writer.start(profile='ros2')
        schema = writer.register_schema(
            TYPE_NAME, 'ros2msg', schema_text(TYPE_NAME, built_in_lookup).encode()
        )
        channel = writer.register_channel('/motor/torque', 'cdr', schema)
        for index in range(200):
            data = encode_joint_state(index, ['motor'], effort=[float(index)])
            writer.add_message(channel, 10**9 + index * 10**7, data, 0)
        writer.finish()
    return path


KINDS = ['ours', 'ours, zstd', 'ours, lz4', 'reference, lz4', 'reference, unchunked']


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_a_file_cut_anywhere_gives_its_first_messages_and_says_what_was_lost(
    tmp_path, make_bag, kind
):
    path = file_of(kind, tmp_path, make_bag)
    whole = path.read_bytes()
    expected, lost = read(path)
    assert lost is None
    cut = tmp_path / 'cut.mcap'
    generator = random.Random(3)
    counts = []
    for length in sorted(generator.sample(range(1, len(whole) - 1), 60)):
        cut.write_bytes(whole[:length])
        outcome = read(cut)
        if isinstance(outcome, str):
            assert 'no message' in outcome or 'no MCAP' in outcome
            counts.append(0)
            continue
        messages, lost = outcome
        assert messages == expected[: len(messages)]
        assert lost is not None and (
            'bytes could not be read' in lost or 'without an end mark' in lost
        )
        counts.append(len(messages))
    assert counts == sorted(counts), 'a longer piece must not give fewer messages'
    assert counts[-1] > 0.9 * len(expected)


@pytest.mark.slow
@pytest.mark.parametrize('kind', KINDS)
def test_flipped_bits_never_raise_anything_else_nor_allocate_much(tmp_path, make_bag, kind):
    whole = file_of(kind, tmp_path, make_bag).read_bytes()
    damaged = tmp_path / 'damaged.mcap'
    generator = random.Random(4)
    outcomes = []
    with little_memory():
        for _ in range(80):
            content = bytearray(whole)
            for _ in range(generator.choice([1, 1, 1, 5, 40])):
                content[generator.randrange(len(content))] ^= 1 << generator.randrange(8)
            damaged.write_bytes(content)
            outcomes.append(read(damaged))
    assert sum(not isinstance(outcome, str) for outcome in outcomes) > 20


def test_a_flipped_bit_in_a_checked_chunk_never_gives_a_wrong_message(tmp_path, make_bag):
    path = file_of('ours', tmp_path, make_bag)
    whole = path.read_bytes()
    expected = set(read(path)[0])
    damaged = tmp_path / 'damaged.mcap'
    generator = random.Random(5)
    fewer = 0
    for _ in range(60):
        content = bytearray(whole)
        content[generator.randrange(3000, len(whole) // 2)] ^= 1 << generator.randrange(8)
        damaged.write_bytes(content)
        messages, lost = read(damaged)
        assert set(messages) <= expected
        if len(messages) < len(expected):
            fewer += 1
            assert lost is not None
    assert fewer > 30


def test_one_damaged_chunk_costs_only_its_own_messages(tmp_path, make_bag):
    path = file_of('ours', tmp_path, make_bag)
    content = bytearray(path.read_bytes())
    with BagReader(path) as bag:
        content[bag._files.all[0].layout.pieces[3].offset + 200] ^= 1
    path.write_bytes(content)
    messages, lost = read(path)
    assert 150 < len(messages) < 200
    assert 'a damaged chunk at byte' in lost and 'wrong checksum' in lost


def test_an_absurd_length_costs_only_what_stands_before_the_next_chunk(tmp_path, make_bag):
    path = file_of('ours', tmp_path, make_bag)
    content = bytearray(path.read_bytes())
    with BagReader(path) as bag:
        third = bag._files.all[0].layout.pieces[2].offset
    struct.pack_into('<Q', content, third + 1, 1 << 60)
    path.write_bytes(content)
    messages, lost = read(path)
    assert 150 < len(messages) < 200
    assert f'a record with a wrong length at byte {third}' in lost


def test_the_loss_of_a_cut_file_names_seconds_and_bytes(tmp_path, make_bag):
    path = file_of('ours', tmp_path, make_bag)
    with BagReader(path) as bag:
        last = bag._files.all[0].layout.pieces[-1]
    path.write_bytes(path.read_bytes()[: last.offset + 500])
    messages, lost = read(path)
    span_s = (messages[-1][0] - messages[0][0]) * 1e-9
    assert lost.startswith(f'the file ends after {span_s:.1f} s in the middle of a chunk; ')


def test_a_file_that_was_never_finished_is_read_whole_with_a_warning(tmp_path, make_bag):
    path = file_of('ours', tmp_path, make_bag)
    with BagReader(path) as bag:
        last = bag._files.all[0].layout.pieces[-1]
    expected = read(path)[0]
    path.write_bytes(path.read_bytes()[: last.offset + last.length])
    messages, lost = read(path)
    assert messages == expected
    assert lost.endswith('without an end mark, so its last messages may be missing'), (
        'and nothing of 0 bytes'
    )


def test_garbage_behind_the_magic_is_one_clear_line(tmp_path):
    generator = random.Random(6)
    path = tmp_path / 'garbage.mcap'
    with little_memory():
        for _ in range(60):
            path.write_bytes(b'\x89MCAP0\r\n' + generator.randbytes(generator.randrange(1, 400)))
            assert isinstance(read(path), str)


def test_a_chunk_that_claims_to_be_huge_is_not_allocated(tmp_path, make_bag):
    path = file_of('ours, zstd', tmp_path, make_bag)
    content = bytearray(path.read_bytes())
    with BagReader(path) as bag:
        first = bag._files.all[0].layout.pieces[0].offset
    struct.pack_into('<Q', content, first + 9 + 16, (1 << 30) - 1)
    path.write_bytes(content)
    with little_memory():
        messages, lost = read(path)
    assert 150 < len(messages) < 200
    assert 'it claims 1073 MB in ' in lost
