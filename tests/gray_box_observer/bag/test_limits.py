"""What reading a bag may hold in memory at one time, and the line that says how to read more."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zstandard

from gray_box_observer.bag import limits
from gray_box_observer.bag.contents import name_list
from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.bag.mcap.mcap_records import CHANNEL, SCHEMA, Definitions
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.errors import BagError
from gray_box_observer.identify.command import main

START_NS = 10**18
MakeBag = Callable[..., Path]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack('<BQ', opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack('<I', len(value)) + value.encode()


def message(time_ns: int, data: bytes = b'') -> bytes:
    return record(5, struct.pack('<HIQQ', 1, 0, time_ns, time_ns) + data)


def chunk(records: bytes) -> bytes:
    packed = zstandard.compress(records)
    head = struct.pack('<QQQI', START_NS, START_NS + 10**9, len(records), 0)
    return record(6, head + text('zstd') + struct.pack('<Q', len(packed)) + packed)


def channel(number: int, topic: str) -> bytes:
    return record(
        4, struct.pack('<HH', number, 0) + text(topic) + text('cdr') + struct.pack('<I', 0)
    )


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write(*records: bytes) -> Path:
        path = tmp_path / 'bag.mcap'
        path.write_bytes(b'\x89MCAP0\r\n' + channel(1, '/x') + b''.join(records))
        return path

    return write


def count_and_loss(path: Path, read_limits: ReadLimits) -> tuple[int, str]:
    with BagReader(path, read_limits) as bag:
        return sum(1 for _ in bag.messages()), str(bag.loss)


def test_a_chunk_beyond_the_limit_is_left_out_in_a_line_that_names_the_option_to_read_it(
    write,
) -> None:
    path = write(message(START_NS), chunk(message(START_NS + 1, bytes(range(256)) * 8_000)))
    limited = ReadLimits(1_000_000, float('inf'), '--max-chunk-mb {}')
    count, loss = count_and_loss(path, limited)
    assert count == 1
    assert '2.05 MB in one piece, where 1 MB are the limit; --max-chunk-mb 3 reads it' in loss
    assert count_and_loss(path, ReadLimits.from_mb(3))[0] == 2


@pytest.mark.slow
def test_what_unpacks_to_a_thousand_times_its_size_is_left_out_unless_the_limit_was_raised(
    write,
) -> None:
    path = write(message(START_NS), chunk(message(START_NS + 1) * 200_000))
    count, loss = count_and_loss(path, ReadLimits(option='--max-chunk-mb {}'))
    assert count == 1
    assert 'no recording holds 1000 times as much; --max-chunk-mb 7 reads it' in loss
    assert count_and_loss(path, ReadLimits.from_mb(30))[0] == 200_001


def test_chunks_that_wait_for_each_other_share_one_limit(write) -> None:
    each = chunk(b''.join(message(START_NS + k, bytes(1000)) for k in range(500)))
    path = write(*[each] * 6)
    count, loss = count_and_loss(path, ReadLimits.from_mb(1, '--max-chunk-mb {}'))
    assert count == 3 * 500
    assert (
        'with those of overlapping chunks, where 2 MB are the limit; --max-chunk-mb 2 reads it'
        in loss
    )
    assert count_and_loss(path, ReadLimits.from_mb(2)) == (
        3000,
        count_and_loss(path, ReadLimits.from_mb(2))[1],
    )


def test_overlapping_chunks_within_the_limit_come_in_the_order_of_time(write) -> None:
    chunks = [chunk(b''.join(message(START_NS + 3 * k + n) for k in range(100))) for n in range(3)]
    with BagReader(write(*chunks)) as bag:
        times = [found.log_time_ns - START_NS for found in bag.messages()]
    assert times == list(range(300))


def test_a_message_outside_chunks_that_is_a_hole_in_the_file_is_left_out(write) -> None:
    path = write(message(START_NS))
    size = 10**10
    with path.open('r+b') as stream:
        stream.seek(0, 2)
        stream.write(struct.pack('<BQHIQQ', 5, size, 1, 0, START_NS, START_NS))
        stream.seek(size - 22, 1)
        stream.write(message(START_NS + 1))
    count, loss = count_and_loss(path, ReadLimits())
    assert count == 2
    assert '10000 MB in one piece' in loss


def test_declarations_are_held_up_to_a_limit_and_repeated_ones_cost_nothing() -> None:
    definitions = Definitions()

    def long_ones() -> Iterator[bytes]:
        for number in range(20):
            yield struct.pack('<H', number) + text(f'T{number}') + text('') + text('x' * 3_000_000)

    assert (
        sum(definitions.add(SCHEMA, content) for content in long_ones())
        == limits.MOST_DECLARED_BYTES // 3_000_000
    )
    again = Definitions()
    schema = struct.pack('<H', 1) + text('T') + text('') + text('x' * 3_000_000)
    assert all(again.add(SCHEMA, schema) for _ in range(100))
    assert all(again.add(CHANNEL, channel(1, '/x')[9:]) for _ in range(100_000))


def test_the_command_takes_the_limit(
    make_bag: MakeBag, write, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(chunk(message(START_NS) * 200_000))
    assert main(['identify', str(path)]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1
    assert '--max-chunk-mb 7 reads it' in said
    assert main(['identify', str(path), '--max-chunk-mb', '30']) == 2
    assert 'has no topic motor/voltage' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(['identify', str(path), '--max-chunk-mb', '0'])


def test_limits_without_sense_are_refused() -> None:
    with pytest.raises(BagError, match='expected at least 1 MB'):
        ReadLimits.from_mb(-1)


def test_a_list_of_names_fits_into_a_line() -> None:
    assert name_list([]) == 'none'
    assert name_list(['b', 'a']) == 'a, b'
    assert name_list(f'{k:05}' for k in range(50_000)).endswith('00029 and 49970 more')
    assert len(name_list(['x' * 10**6])) < 200
