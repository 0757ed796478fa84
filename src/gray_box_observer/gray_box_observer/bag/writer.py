"""Writing rosbag2 folders, as ROS 2 Jazzy writes them, in MCAP storage."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import Any

from gray_box_observer.bag.mcap.mcap_file import McapFile
from gray_box_observer.bag.metadata import (
    METADATA_NAME,
    FileRecord,
    TopicRecord,
    metadata_text,
    qos_text,
    storage_text,
)
from gray_box_observer.bag.writing_options import BagOptions
from gray_box_observer.errors import BagError
from gray_box_observer.safe_io.atomic_write import atomic_write

__all__ = ['BagOptions', 'BagWriter']

_METADATA_PERIOD_S = 10.0
_LARGEST_TIME_NS = (1 << 63) - 1
"""rosbag2 keeps times in signed 64 bit integers."""


@dataclass(slots=True)
class _Topic:
    type_name: str
    schema_text: str
    qos_profiles: Sequence[Mapping[str, Any]]
    type_hash: str
    channel: int
    message_count: int = 0
    written_count: int = 0


class BagWriter:
    """A bag being written; a context manager that closes it.

    After an error of the disk the writer stays in that error: every later call raises it again, and
    what reached the disk before stays readable.

    Args:
        folder: The folder to make; must not exist, since nothing is ever overwritten.
        options: How to write; None for the defaults.
        clock: Monotonic seconds, for the flush period.

    Raises:
        BagError: The folder exists or cannot be made.
    """

    def __init__(
        self,
        folder: str | Path,
        options: BagOptions | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.folder = Path(folder)
        self.options = options or BagOptions()
        self._clock = clock
        self._topics: dict[str, _Topic] = {}
        self._finished_files: list[FileRecord] = []
        self._finished_bytes = 0
        self._error: BagError | None = None
        self._is_closed = False
        self._files_made = 0
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(
                f'{self.folder} exists already and is not overwritten; give another name'
            ) from None
        except OSError as error:
            raise BagError(f'{self.folder}: cannot be made: {error.strerror or error}') from None
        self._file = self._next_file()
        self._write_metadata()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(topic.message_count for topic in self._topics.values())

    @property
    def byte_count(self) -> int:
        """Bytes on the disk and in memory, without the indexes at the files' ends."""
        return self._finished_bytes + self._file.size + self._file.pending_bytes

    def add_topic(
        self,
        name: str,
        type_name: str,
        schema_text: str,
        qos_profiles: Sequence[Mapping[str, Any]] = (),
        type_hash: str = '',
    ) -> None:
        """Declare a topic before its first message.

        Args:
            name: Full name of the topic.
            type_name: Such as ``sensor_msgs/msg/JointState``.
            schema_text: The ros2msg definition with all dependencies
                (`gray_box_observer.bag.schemas`).
            qos_profiles: What its publishers offer, in rosbag2's form.
            type_hash: Such as ``RIHS01_...``.

        Raises:
            BagError: The topic is there already, or the disk refuses.
        """
        self._check()
        if name in self._topics:
            raise BagError(f'{self.folder}: the topic {name} is declared already')
        topic = _Topic(type_name, schema_text, tuple(qos_profiles), type_hash, channel=0)
        self._guard(lambda: self._declare(name, topic))
        self._topics[name] = topic
        self._metadata_is_stale = True

    def write(self, topic: str, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Append one message.

        Args:
            topic: A declared topic.
            data: Its CDR bytes with their encapsulation.
            log_time_ns: When it was received; from 0 to 2**63 - 1.
            publish_time_ns: When it was sent; likewise.

        Raises:
            BagError: The topic is not declared, a time is out of range, or the disk refuses.
        """
        self._check()
        record = self._topics.get(topic)
        if record is None:
            raise BagError(
                f'{self.folder}: the topic {topic} is not declared; call add_topic first'
            )
        if not (0 <= log_time_ns <= _LARGEST_TIME_NS and 0 <= publish_time_ns <= _LARGEST_TIME_NS):
            raise BagError(
                f'{self.folder}: times {log_time_ns} and {publish_time_ns} ns of a message of '
                f'{topic} '
                'are out of range; expected 0 to 2**63 - 1'
            )
        if self._is_full(log_time_ns):
            self._guard(self._split)
        self._file.add_message(record.channel, data, log_time_ns, publish_time_ns)
        record.message_count += 1
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush if the chunk is full or old enough; a timer calls this when no message comes.

        Raises:
            BagError: The disk refuses.
        """
        is_due = self._clock() - self._flushed_s >= self.options.flush_period_s
        if is_due or self._file.pending_bytes >= self.options.chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Put everything on the disk now.

        Raises:
            BagError: The disk refuses.
        """
        self._check()
        if (
            self._metadata_is_stale
        ):  # before the first message of a topic or file, so that no reader leaves it out
            self._write_metadata()
        is_first = not self._file.written_counts[2]
        self._guard(self._file.flush)
        self._count_as_written()
        self._flushed_s = self._clock()
        if (
            is_first and self._file.written_counts[2]
        ) or self._flushed_s - self._metadata_s >= _METADATA_PERIOD_S:
            self._write_metadata()

    def close(self) -> None:
        """Finish the bag; does nothing on a second call or after an error that was raised.

        Raises:
            BagError: The disk refuses.
        """
        if self._is_closed:
            return
        self._is_closed = True
        if self._error is not None:
            self._file.abandon()
            return
        self._guard(self._finish_file)
        self._write_metadata()

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
        if self._is_closed:
            raise BagError(f'{self.folder}: the bag is closed')

    def _guard(self, action: Callable[[], object]) -> None:
        try:
            action()
        except BagError as error:
            self._error = error
            raise

    def _declare(self, name: str, topic: _Topic) -> None:
        metadata = {
            'offered_qos_profiles': qos_text(topic.qos_profiles),
            'topic_type_hash': topic.type_hash,
        }
        topic.channel = self._file.add_channel(name, topic.type_name, topic.schema_text, metadata)

    def _next_file(self) -> McapFile:
        path = self.folder / f'{self.folder.resolve().name}_{self._files_made}.mcap'
        options = self.options
        file = McapFile(
            path,
            library=_library() if options.library is None else options.library,
            compression=options.compression,
            level=options.compression_level,
            about=storage_text(options.ros_distro, options.custom_data),
        )
        self._files_made += 1
        self._flushed_s = self._clock()
        self._metadata_is_stale = True
        return file

    def _is_full(self, log_time_ns: int) -> bool:
        file = self._file
        options = self.options
        if not file.message_count:
            return False
        if options.max_file_bytes and file.size + file.pending_bytes >= options.max_file_bytes:
            return True
        span_s = (log_time_ns - file.start_ns) * 1e-9
        return bool(options.max_file_duration_s and span_s >= options.max_file_duration_s)

    def _split(self) -> None:
        self._finish_file()
        self._finished_bytes += self._file.size
        self._file = self._next_file()
        for name, topic in self._topics.items():
            self._declare(name, topic)
        self._write_metadata()

    def _finish_file(self) -> None:
        self._file.finish()
        self._count_as_written()
        self._finished_files.append(self._record(self._file))

    def _count_as_written(self) -> None:
        for topic in self._topics.values():
            topic.written_count = topic.message_count

    @staticmethod
    def _record(file: McapFile) -> FileRecord:
        return FileRecord(file.path.name, *file.written_counts)

    def _write_metadata(self) -> None:
        """Put a new metadata.yaml in the place of the old one in a single step."""
        files = list(self._finished_files)
        if not self._is_closed:
            files.append(self._record(self._file))
        topics = [
            TopicRecord(
                name, topic.type_name, topic.qos_profiles, topic.type_hash, topic.written_count
            )
            for name, topic in self._topics.items()
        ]
        text = metadata_text(
            topics, files, ros_distro=self.options.ros_distro, custom_data=self.options.custom_data
        )
        path = self.folder / METADATA_NAME
        try:
            with atomic_write(path) as file:
                file.write(text.encode())
        except OSError as error:
            self._error = BagError(f'{path}: cannot be written: {error.strerror or error}')
            raise self._error from None
        self._metadata_is_stale = False
        self._metadata_s = self._clock()


def _library() -> str:
    try:
        return f'gray_box_observer {version("gray_box_observer")}'
    except PackageNotFoundError:
        return 'gray_box_observer'
