"""A writer that is killed: what everybody reads afterwards, whatever it was doing."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader, make_reader

from gray_box_observer.bag import writer
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.mcap import mcap_file, mcap_tail
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter

TEXT = schema_text(TYPE_NAME, built_in_lookup)
KINDS = ['none', 'lz4', 'zstd']

Change = tuple[str, int, bytes]
"""What one system call does to a file: its name, from which byte on it is replaced, and by what
(nothing: cut)."""


def ours(folder: Path) -> list[bytes]:
    with BagReader(folder) as bag:
        return [message.data for message in bag.messages()]


def everybody(folder: Path) -> Iterator[list[bytes]]:
    """What each reader of other people finds in a folder."""
    for make in (make_reader, NonSeekingReader):
        found = []
        for path in sorted(folder.glob('*.mcap')):
            with path.open('rb') as stream:
                found += [message.data for _, _, message in make(stream).iter_messages()]
        yield found
    rosbags = pytest.importorskip('rosbags.highlevel')
    with rosbags.AnyReader([folder]) as reader:
        yield [bytes(raw) for _, _, raw in reader.messages()]


@pytest.mark.parametrize('compression', KINDS)
@pytest.mark.parametrize('split_s', [0.0, 2.0])
def test_a_killed_writer_leaves_a_bag_that_everybody_reads(tmp_path, compression, split_s):
    script = """
        import os, sys
        from gray_box_observer.bag.writer import BagOptions, BagWriter
        compression, split_s = sys.argv[2:]
        options = BagOptions(compression=compression, max_file_duration_s=float(split_s))
        writer = BagWriter(sys.argv[1], options)
        for topic in ('/a', '/b'):
            writer.add_topic(topic, 'std_msgs/msg/Int32', 'int32 data', [])
        for index in range(1000):
            # received out of order, as by a recorder that reads one topic after the other
            at_ns = (index + 25 * (-1) ** index) * 10**7 + 10**9
            content = b'\\0\\1\\0\\0' + index.to_bytes(4, 'little')
            writer.write('/a' if index % 2 else '/b', content, at_ns, 0)
            if index % 100 == 0:
                writer.flush()
        os.kill(os.getpid(), 9)
    """
    command = [
        sys.executable,
        '-c',
        textwrap.dedent(script),
        str(tmp_path / 'run'),
        compression,
        str(split_s),
    ]
    done = subprocess.run(command, timeout=30, check=False)
    assert done.returncode == -signal.SIGKILL
    found = [int.from_bytes(data[4:], 'little') for data in ours(tmp_path / 'run')]
    assert sorted(found) == list(range(len(found)))
    assert 901 <= len(found) < 1000
    with BagReader(tmp_path / 'run') as bag:
        assert 'it was never finished' in str(bag.loss)
    for theirs in everybody(tmp_path / 'run'):
        assert sorted(int.from_bytes(data[4:], 'little') for data in theirs) == sorted(found)


def test_a_file_too_long_for_an_index_at_every_chunk_is_still_read_by_everybody(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(mcap_tail, 'LARGEST_PROVISIONAL_BYTES', 2000)
    made = BagWriter(tmp_path / 'run')
    made.add_topic('/t', TYPE_NAME, TEXT)
    expected = [encode_joint_state(index, ['m']) for index in range(100)]
    for index, data in enumerate(expected):
        made.write('/t', data, index, index)
        made.flush()
    size = (tmp_path / 'run' / 'run_0.mcap').stat().st_size
    assert ours(tmp_path / 'run') == expected
    for theirs in everybody(tmp_path / 'run'):
        assert theirs == expected
    made.close()
    assert (tmp_path / 'run' / 'run_0.mcap').stat().st_size > size
    with BagReader(tmp_path / 'run') as bag:
        assert bag.loss is None


def test_a_bag_that_is_still_recorded_can_be_read(tmp_path):
    with BagWriter(tmp_path / 'run') as made:
        made.add_topic('/t', TYPE_NAME, TEXT)
        for index in range(10):
            made.write('/t', encode_joint_state(index, ['m']), index, index)
            made.flush()
            with BagReader(tmp_path / 'run') as bag:
                assert bag.message_count == index + 1
                assert 'or still records' in str(bag.loss)
    with BagReader(tmp_path / 'run') as bag:
        assert (bag.message_count, bag.loss) == (10, None)


class Disk:
    """Notes each change of a writer to its files, so that it can be killed after any of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.changes: list[Change] = []
        self.flushed: list[int] = []
        """Messages that had to be on the disk before each change."""
        self.count = 0
        disk = self

        class File(mcap_file.McapFile):
            def __init__(self, path: Path, **options: object) -> None:
                disk.note((path.name, 0, b''))
                super().__init__(path, **options)
                self._stream = Stream(self._stream, path.name)

            def _write(self, content: bytes, *, is_last: bool = False) -> None:
                if not isinstance(self._stream, Stream):
                    self._stream = Stream(self._stream, self.path.name)
                super()._write(content, is_last=is_last)
                disk.count = disk.done + self.written_counts[2]
                if is_last:
                    disk.done += self.written_counts[2]

        class Stream:
            def __init__(self, stream, name: str) -> None:
                self._stream = stream._stream if isinstance(stream, Stream) else stream
                self._name = name

            def write(self, content) -> int:
                disk.note((self._name, self._stream.tell(), bytes(content)))
                return self._stream.write(content)

            def truncate(self, size: int) -> None:
                disk.note((self._name, size, b''))
                self._stream.truncate(size)

            def __getattr__(self, name: str):
                return getattr(self._stream, name)

        self.done = 0
        monkeypatch.setattr(writer, 'McapFile', File)

    def note(self, change: Change) -> None:
        """Take in a change that is about to be made."""
        self.changes.append(change)
        self.flushed.append(self.count)

    def states(self, random: random.Random) -> Iterator[tuple[dict[str, bytes], int]]:
        """Files after each change or part of it, with the messages that must be in them."""
        files: dict[str, bytes] = {}
        for (name, start, content), flushed in zip(self.changes, self.flushed, strict=True):
            before = files.get(name, b'')
            for length in sorted(
                {0, 1, *random.sample(range(len(content) + 1), min(len(content), 6)), len(content)}
            ):
                if length or not content:
                    end = start + length
                    kept = before[end:] if content else b''
                    files[name] = before[:start] + content[:length] + kept
                yield dict(files), flushed


@pytest.mark.parametrize('compression', KINDS)
def test_whatever_the_writer_was_doing_everything_before_is_read(
    tmp_path, monkeypatch, compression
):
    disk = Disk(monkeypatch)
    options = BagOptions(compression=compression, chunk_bytes=1200, max_file_bytes=5000)
    expected = [encode_joint_state(index, ['m'], effort=[index]) for index in range(150)]
    with BagWriter(tmp_path / 'run', options) as made:
        made.add_topic('/t', TYPE_NAME, TEXT)
        for index, data in enumerate(expected):
            made.write('/t', data, index, index)
    files = {path.name: path.read_bytes() for path in (tmp_path / 'run').glob('*.mcap')}
    torn = tmp_path / 'torn'
    count = 0
    for state, flushed in disk.states(random.Random(7)):
        count += 1
        torn.mkdir()
        for name, content in state.items():
            (torn / name).write_bytes(content)
        if flushed:
            found = ours(torn)
            assert found == expected[: len(found)]
            assert len(found) >= flushed
        shutil.rmtree(torn)
    assert state == files, 'every change of the disk was noted'
    assert count > 100


@pytest.mark.parametrize('compression', KINDS)
def test_a_writer_that_splits_all_the_time_can_be_killed_at_any_moment(tmp_path, compression):
    script = """
        import os, sys
        from gray_box_observer.bag.writer import BagOptions, BagWriter
        options = BagOptions(compression=sys.argv[2], max_file_bytes=1500, flush_period_s=0.0)
        writer = BagWriter(sys.argv[1], options)
        writer.add_topic('/t', 'std_msgs/msg/UInt32', 'uint32 data', [])
        for index in range(10**6):
            writer.write('/t', b'\\0\\1\\0\\0' + index.to_bytes(4, 'little') * 50, index, 0)
            os.write(1, index.to_bytes(4, 'little'))
    """
    draw = random.Random(compression)
    for number in range(6):
        folder = tmp_path / str(number)
        command = [sys.executable, '-c', textwrap.dedent(script), str(folder), compression]
        child = subprocess.Popen(command, stdout=subprocess.PIPE)
        try:
            kept = child.stdout.read(
                4 * draw.randrange(1, 300)
            )  # a moment that the child's progress decides
        finally:
            child.kill()
            kept += child.communicate(timeout=30)[0]
        kept = kept[: len(kept) // 4 * 4]
        found = [int.from_bytes(data[4:8], 'little') for data in ours(folder)]
        assert found == list(range(len(found)))
        assert len(found) > int.from_bytes(kept[-4:], 'little'), 'what was written is there'
