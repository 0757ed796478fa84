"""Reading bags: rosbag2 folders and single MCAP files, whole, killed, cut or damaged.

Messages come in the order of their log times. What cannot be read is left out and accounted for in
`BagReader.lost`; only a bag of which nothing can be read is an error.
"""

from __future__ import annotations

import io
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from gray_box_observer.bag.contents import Loss, TopicInfo
from gray_box_observer.bag.losses import UNFINISHED, Losses
from gray_box_observer.bag.mcap_content import (
    RawMessage,
    Unreadable,
    parse_definitions,
    parse_messages,
    read_records,
)
from gray_box_observer.bag.mcap_layout import Layout, Piece, walk
from gray_box_observer.bag.mcap_records import END_BYTES, MAGIC, Channel, Definitions
from gray_box_observer.bag.metadata import ListedFile, list_files
from gray_box_observer.errors import BagError

_LOG_TIME = itemgetter(4)


@dataclass(slots=True)
class _File:
    path: Path
    layout: Layout
    listed: ListedFile


class BagReader:
    """A bag opened for reading.

    Args:
        path: A rosbag2 folder (``metadata.yaml`` and its MCAP files) or a single MCAP file.

    Raises:
        BagError: There is no bag, or nothing of it can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._opened: tuple[Path, BinaryIO] | None = None
        self._is_closed = False
        self._losses = Losses()
        try:
            listing = list_files(self.path)
            self._losses.of_bag += listing.complaints
            self._files = self._open_files(listing.files)
            self._account()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        self._is_closed = True
        if self._opened is not None:
            self._opened[1].close()
            self._opened = None

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Every topic by name."""
        return self._topics

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return self._start_ns

    @property
    def duration_ns(self) -> int:
        """From the first log time to the last."""
        return self._end_ns - self._start_ns

    @property
    def message_count(self) -> int:
        """Messages that can be read; an undamaged file's own account is believed."""
        return self._message_count

    @property
    def lost(self) -> Loss | None:
        """What could not be read so far, or None; ask again once all messages have been read."""
        return self._losses.total(with_names=len(self._files) > 1)

    def messages(self, topics: Collection[str] | None = None, start_ns: int | None = None) -> Iterator[RawMessage]:
        """Every message in the order of log times; messages of equal time in the order of the files.

        Args:
            topics: Names of the topics that are wanted; None for all. Unknown names give nothing.
            start_ns: The first log time that is wanted.

        Raises:
            BagError: The files can no longer be read at all.
        """
        earliest = -1 if start_ns is None else start_ns
        pieces = [
            (piece, order, file)
            for order, (file, piece) in enumerate((f, p) for f in self._files for p in f.layout.pieces)
            if piece.end_ns >= earliest or not piece.is_chunk
        ]
        pieces.sort(key=lambda item: item[0].start_ns)
        waiting: dict[int, list[RawMessage]] = {}
        for index, (piece, order, file) in enumerate(pieces):
            found = self._read(file, piece, topics)
            # Linear for a list that is already in order, and stable.
            found.sort(key=_LOG_TIME)
            if found and found[0].log_time_ns < earliest:
                found = found[bisect_left(found, earliest, key=_LOG_TIME) :]
            following = index + 1
            limit = pieces[following][0].start_ns if following < len(pieces) else None
            if found and not waiting and (limit is None or found[-1].log_time_ns < limit):
                yield from found
                continue
            waiting[order] = found
            yield from _take_before(waiting, limit)

    def decoded(self, topics: Collection[str] | None = None) -> Iterator[tuple[RawMessage, Any]]:
        """Every message with its decoded content, whatever its type; the order is that of `messages`.

        Messages whose bytes do not fit their type are left out and counted in `lost`.

        Args:
            topics: Names of the topics that are wanted; None for all.

        Raises:
            BagError: A wanted topic is not CDR with a ros2msg definition.
        """
        decoders: dict[tuple[str, str], Callable[[bytes], Any]] = {}
        for message in self.messages(topics):
            key = (message.type_name, message.schema_text)
            decoder = decoders.get(key)
            if decoder is None:
                decoder = decoders[key] = self._decoder(message, len(decoders) + 1)
            try:
                content = decoder(message.data)
            except Exception as error:  # whatever a foreign decoder makes of foreign bytes
                reason = ' '.join(str(error).split()) or type(error).__name__
                self._losses.undecodable(message.topic, reason)
                continue
            yield message, content

    def _decoder(self, message: RawMessage, number: int) -> Callable[[bytes], Any]:
        if not message.schema_text:
            raise BagError(f'{self.path}: no definition of {message.type_name or message.topic} in the bag')
        schema = Schema(number, message.schema_text.encode(), 'ros2msg', message.type_name)
        encoding = self._topics[message.topic].encoding
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):  # the parser prints what it refuses
                decoder = DecoderFactory().decoder_for(encoding, schema)
        except Exception as error:  # whatever a foreign parser makes of a foreign text
            reason = ' '.join(f'{message.type_name} cannot be understood: {error}'.split())
            raise BagError(f'{self.path}: the definition of {reason}') from None
        if decoder is None:
            raise BagError(f"{self.path}: {message.topic} is encoded as {encoding!r}, expected 'cdr'")
        return decoder

    def _stream(self, path: Path) -> BinaryIO:
        """The opened file; only one stands open at a time, for a bag may have thousands."""
        if self._is_closed:
            raise BagError(f'{self.path}: the bag is closed')
        if self._opened is None or self._opened[0] != path:
            stream = path.open('rb')
            if self._opened is not None:
                self._opened[1].close()
            self._opened = (path, stream)
        return self._opened[1]

    def _open_files(self, listed: Collection[ListedFile]) -> list[_File]:
        """Look at every file; one that cannot be used costs only itself, as long as another can be."""
        files: list[_File] = []
        refused: list[BagError] = []
        for entry in listed:
            try:
                files.append(_File(entry.path, self._look_at(entry.path), entry))
            except BagError as error:
                refused.append(error)
        if refused and not files:
            raise refused[0]
        self._losses.of_bag += [str(error) for error in refused]
        return files

    def _look_at(self, path: Path) -> Layout:
        try:
            size = path.stat().st_size
            if not size:
                raise BagError(f'{path} is empty')
            stream = self._stream(path)
            if stream.read(len(MAGIC)) != MAGIC:
                raise BagError(f"{path} is no MCAP file; another kind of bag can be converted with 'ros2 bag convert'")
            return walk(stream, size)
        except OSError as error:
            raise BagError(f'{path}: cannot be read: {error.strerror or error}') from None

    def _read(self, file: _File, piece: Piece, topics: Collection[str] | None) -> list[RawMessage]:
        channels = file.layout.channels
        wanted = channels
        if topics is not None:
            wanted = {number: channel for number, channel in channels.items() if channel.topic in topics}
            if not wanted:
                return []
        try:
            records = read_records(self._stream(file.path), piece)
        except Unreadable as error:
            self._damage(file, piece, piece.length, f'a damaged chunk at byte {piece.offset} ({error})')
            return []
        except OSError as error:
            raise BagError(f'{file.path}: cannot be read: {error.strerror or error}') from None
        found, left, orphans = parse_messages(records, channels, wanted)
        if piece.is_cut:
            self._damage(file, piece, left + END_BYTES, 'the file ends in the middle of a chunk')
        elif left:
            self._damage(file, piece, left, f'a malformed record in the chunk at byte {piece.offset}')
        elif orphans:
            self._damage(file, piece, 0, f'{orphans} messages of a topic that the file does not declare')
        return found

    def _damage(self, file: _File, piece: Piece, byte_count: int, what: str) -> None:
        self._losses.damage(file.path, piece.offset, byte_count, what)

    def _account(self) -> None:
        """Find topics, counts and times: from the summaries where they can be believed, else by reading."""
        counts: Counter[str] = Counter()
        declared: dict[str, Channel] = {}
        spans: list[tuple[int, int]] = []
        for file in self._files:
            found = self._count(file, spans)
            counts.update(found)
            for channel in file.layout.channels.values():
                declared.setdefault(channel.topic, channel)
            self._compare(file, found.total())
        self._message_count = counts.total()
        if not spans or not self._message_count:
            reason = f': {self.lost}' if self.lost is not None else ''
            raise BagError(f'{self.path}: no message in this bag{reason}')
        self._start_ns, self._end_ns = min(s for s, _ in spans), max(e for _, e in spans)
        self._topics = {
            name: TopicInfo(c.type_name, counts.get(name, 0), c.schema_text, c.encoding, c.qos_profiles, c.type_hash)
            for name, c in declared.items()
        }

    def _count(self, file: _File, spans: list[tuple[int, int]]) -> Counter[str]:
        """The messages of one file by topic; their first and last times are added to the spans."""
        statistics, counts = file.layout.statistics, Counter[str]()
        if statistics is None:
            spans += self._count_by_reading(file, counts)
        elif statistics.message_count:
            spans.append((statistics.start_ns, statistics.end_ns))
            for number, count in statistics.channel_message_counts.items():
                if number in file.layout.channels:
                    topic = file.layout.channels[number].topic
                    counts[topic] += count
        return counts

    def _compare(self, file: _File, found: int) -> None:
        """Say where a file holds something else than it should, and where it was never finished."""
        layout, listed = file.layout, file.listed
        expected = layout.expected
        if expected is not None and found < expected.message_count:
            what = f'{expected.message_count - found} of {expected.message_count} messages cannot be read'
            self._losses.damage(file.path, layout.size, 0, what)
        elif expected is not None and found > expected.message_count:
            what = f'{found} messages are there, but only {expected.message_count} according to its summary'
            self._losses.damage(file.path, layout.size, 0, what)
        if layout.is_unfinished:
            self._losses.damage(file.path, layout.size, 0, UNFINISHED)
        elif not self._losses.has_damage(file.path):
            if listed.message_count is not None and found < listed.message_count:
                what = f'it holds {found} messages, but {listed.message_count} according to metadata.yaml'
                self._losses.damage(file.path, layout.size, 0, what)
            elif expected is not None and listed.message_count and listed.start_ns not in (None, expected.start_ns):
                self._losses.damage(file.path, layout.size, 0, 'it does not begin when it should by metadata.yaml')

    def _count_by_reading(self, file: _File, counts: Counter[str]) -> list[tuple[int, int]]:
        """Count the messages of a file without a summary, and put the true times of its pieces in place."""
        layout, definitions = file.layout, Definitions()
        for piece in layout.pieces:
            try:
                parse_definitions(read_records(self._stream(file.path), piece), definitions)
            except (Unreadable, OSError):
                continue  # the second look below says so
        layout.channels = definitions.channels | layout.channels
        held: dict[Piece, Counter[str]] = {}
        for piece in layout.pieces:
            found = self._read(file, piece, None)
            if found:
                times = [message.log_time_ns for message in found]
                true = replace(piece, start_ns=min(times), end_ns=max(times))
                held[true] = Counter(message.topic for message in found)
        self._leave_out_strangers(file, held)
        layout.pieces = list(held)
        for topics in held.values():
            counts.update(topics)
        self._losses.of_layout(file.path, layout)
        return [(piece.start_ns, piece.end_ns) for piece in held]

    def _leave_out_strangers(self, file: _File, held: dict[Piece, Counter[str]]) -> None:
        """Leave out what stands outside chunks if the chunks alone hold all that the summary tells of.

        One wrong byte makes any record into such a message, and no checksum covers it.
        """
        expected = file.layout.expected
        loose = {piece: counts.total() for piece, counts in held.items() if not piece.is_chunk}
        in_chunks = sum(counts.total() for piece, counts in held.items() if piece.is_chunk)
        if expected is not None and in_chunks == expected.message_count > 0:
            for piece, count in loose.items():
                what = f'{count} messages outside the chunks at byte {piece.offset} that the summary does not know'
                self._damage(file, piece, piece.length, what)
                del held[piece]


def _take_before(waiting: dict[int, list[RawMessage]], limit: int | None) -> Iterator[RawMessage]:
    """Take what is earlier than ``limit`` out of the waiting pieces, which are keyed by their place in the bag.

    Whatever is taken is complete: no piece that is still to be read holds anything earlier than ``limit``.
    """
    taken: list[RawMessage] = []
    for order in sorted(waiting):
        part = waiting[order]
        count = len(part) if limit is None else bisect_left(part, limit, key=_LOG_TIME)
        taken += part[:count]
        if count < len(part):
            waiting[order] = part[count:]
        else:
            del waiting[order]
    taken.sort(key=_LOG_TIME)
    yield from taken
