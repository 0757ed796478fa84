"""The files of a bag: opened one at a time, read piecewise, compared with their metadata."""

from __future__ import annotations

import io
import shlex
from collections import Counter
from collections.abc import Collection, Container
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from gray_box_observer.bag import packed
from gray_box_observer.bag.data_loss import UNFINISHED, Losses
from gray_box_observer.bag.limits import MESSAGE_OVERHEAD_BYTES, ReadLimits
from gray_box_observer.bag.mcap.mcap_content import (
    RawMessage,
    TooLarge,
    Unreadable,
    parse_definitions,
    parse_messages,
    read_records,
    survey_messages,
)
from gray_box_observer.bag.mcap.mcap_layout import Layout, Piece, walk
from gray_box_observer.bag.mcap.mcap_records import END_BYTES, MAGIC, MESSAGE_HEAD, Definitions
from gray_box_observer.bag.metadata import ListedFile, conversion, list_files
from gray_box_observer.errors import BagError

LOG_SUFFIXES = ('.csv', '.mat', '.tsv', '.txt')
"""Of files that hold columns of numbers."""


@dataclass(slots=True)
class BagFile:
    """One file of a bag: where it is, what stands in it, and what ``metadata.yaml`` tells of it."""

    path: Path
    layout: Layout
    listed_file: ListedFile


class BagFiles:
    """The files of one bag.

    Args:
        path: A rosbag2 folder or a single MCAP file.
        losses: Is told what cannot be read.
        limits: How much may be held in memory at one time.

    Raises:
        BagError: There is no bag, or none of its files can be used.
    """

    def __init__(self, path: Path, losses: Losses, limits: ReadLimits) -> None:
        self.path = path
        self.limits = limits
        self._losses = losses
        self._open_file: tuple[Path, BinaryIO] | None = None
        self._is_closed = False
        try:
            listing = list_files(path)
            losses.of_bag += listing.complaints
            self.all = self._open_files(listing.files)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the file that is open; reading afterwards is an error."""
        self._is_closed = True
        if self._open_file is not None:
            self._open_file[1].close()
            self._open_file = None

    def read(
        self, file: BagFile, piece: Piece, topics: Collection[str] | None, room: int
    ) -> list[RawMessage]:
        """The messages of one piece in the order of the file; what cannot be read is noted.

        Args:
            file: The file.
            piece: What of it.
            topics: Names of the topics that are wanted; None for all.
            room: Bytes of memory that the messages may take; a piece that needs more is left out.

        Raises:
            BagError: The file can no longer be read at all, or the bag is closed.
        """
        channels = file.layout.channels
        wanted_channels = channels
        if topics is not None:
            wanted_channels = {
                number: channel for number, channel in channels.items() if channel.topic in topics
            }
            if not wanted_channels:
                return []
        records = self._records(file, piece)
        if records is None or not self._fits(file, piece, records, wanted_channels, room):
            return []
        messages, unread_bytes, orphan_count = parse_messages(records, channels, wanted_channels)
        self._note_rest(file, piece, unread_bytes, orphan_count)
        if messages and messages[0].data.startswith(packed.MARK):
            return self._unpacked(file, piece, messages, room)
        return messages

    def _unpacked(
        self, file: BagFile, piece: Piece, messages: list[RawMessage], room: int
    ) -> list[RawMessage]:
        """The messages of a piece that rosbag2 has packed one by one."""
        try:
            unpacked_messages, complaint = packed.unpack_messages(messages, room, self.limits)
        except TooLarge as error:
            self._damage(
                file,
                piece,
                piece.length,
                f'what stands at byte {piece.offset} is left out: {error}',
            )
            return []
        if complaint:
            self._damage(file, piece, 0, f'at byte {piece.offset} {complaint}')
        return unpacked_messages

    def _records(self, file: BagFile, piece: Piece) -> bytes | None:
        """The records of a piece; None, and a note, where they cannot be read."""
        try:
            return read_records(self._stream(file.path), piece, self.limits)
        except TooLarge as error:
            self._damage(
                file,
                piece,
                piece.length,
                f'what stands at byte {piece.offset} is left out: {error}',
            )
        except Unreadable as error:
            self._damage(
                file, piece, piece.length, f'a damaged chunk at byte {piece.offset} ({error})'
            )
        except OSError as error:
            raise BagError(f'{file.path}: cannot be read: {error.strerror or error}') from None
        return None

    def _fits(
        self,
        file: BagFile,
        piece: Piece,
        records: bytes,
        wanted_channels: Container[int],
        room: int,
    ) -> bool:
        """Whether the wanted messages fit the memory limit; weighed only where that is in doubt."""
        if len(records) // MESSAGE_HEAD.size * MESSAGE_OVERHEAD_BYTES + len(records) <= room:
            return True
        weight = survey_messages(records, wanted_channels).weight
        if weight <= room:
            return True
        limit = self.limits.message_bytes
        needed_bytes = limit - room + weight
        overlap_note = ', with those of overlapping chunks,' if room < limit else ''
        complaint = (
            f'the messages at byte {piece.offset} are left out: they would take '
            f'{needed_bytes / 1e6:.0f} MB '
            f'of memory{overlap_note} where {limit / 1e6:.0f} MB are the limit; '
            f'{self.limits.remedy(needed_bytes / 2)}'
        )
        self._damage(file, piece, piece.length, complaint)
        return False

    def _note_rest(self, file: BagFile, piece: Piece, unread_bytes: int, orphan_count: int) -> None:
        """Note what of a piece is no message that can be read."""
        if piece.is_cut:
            self._damage(
                file, piece, unread_bytes + END_BYTES, 'the file ends in the middle of a chunk'
            )
        elif unread_bytes:
            self._damage(
                file, piece, unread_bytes, f'a malformed record in the chunk at byte {piece.offset}'
            )
        elif orphan_count:
            self._damage(
                file, piece, 0, f'{orphan_count} messages of a topic that the file does not declare'
            )

    def _damage(self, file: BagFile, piece: Piece, byte_count: int, complaint: str) -> None:
        self._losses.damage(file.path, piece.offset, byte_count, complaint)

    def count(self, file: BagFile, spans: list[tuple[int, int]]) -> Counter[str]:
        """The messages of one file by topic; its first and last log times extend the spans."""
        counts = self._count_messages(file, spans)
        self._compare(file, counts.total())
        return counts

    def _count_messages(self, file: BagFile, spans: list[tuple[int, int]]) -> Counter[str]:
        """From the summary where it can be believed, else by reading."""
        statistics = file.layout.statistics
        counts = Counter[str]()
        if statistics is None:
            spans += self._count_by_reading(file, counts)
        elif statistics.message_count:
            spans.append((statistics.start_ns, statistics.end_ns))
            for number, count in statistics.channel_message_counts.items():
                if number in file.layout.channels:
                    topic = file.layout.channels[number].topic
                    counts[topic] += count
        return counts

    def _compare(self, file: BagFile, message_count: int) -> None:
        """Say where a file holds something else than it should, and where it was never finished."""
        layout = file.layout
        listed_file = file.listed_file
        statistics = layout.stated_statistics
        if statistics is not None and message_count < statistics.message_count:
            complaint = (
                f'{statistics.message_count - message_count} of {statistics.message_count} '
                'messages cannot be '
                'read'
            )
            self._losses.damage(file.path, layout.size, 0, complaint)
        elif statistics is not None and message_count > statistics.message_count:
            complaint = (
                f'{message_count} messages are there, but only {statistics.message_count} '
                'according to its '
                'summary'
            )
            self._losses.damage(file.path, layout.size, 0, complaint)
        if layout.is_unfinished:
            self._losses.damage(file.path, layout.size, 0, UNFINISHED)
        elif not self._losses.has_damage(file.path):
            if listed_file.message_count is not None and message_count < listed_file.message_count:
                complaint = (
                    f'it holds {message_count} messages, but {listed_file.message_count} according '
                    'to '
                    'metadata.yaml'
                )
                self._losses.damage(file.path, layout.size, 0, complaint)
            elif (
                statistics is not None
                and listed_file.message_count
                and listed_file.start_ns not in (None, statistics.start_ns)
            ):
                self._losses.damage(
                    file.path, layout.size, 0, 'it does not begin when it should by metadata.yaml'
                )

    def _count_by_reading(self, file: BagFile, counts: Counter[str]) -> list[tuple[int, int]]:
        """Count the messages of a file without a summary, and note the true times of its pieces."""
        layout = file.layout
        definitions = Definitions()
        for piece in layout.pieces:
            try:
                parse_definitions(
                    read_records(self._stream(file.path), piece, self.limits), definitions
                )
            except (Unreadable, OSError):
                continue  # the second look below says so
        layout.channels = definitions.channels | layout.channels
        message_counts: dict[Piece, int] = {}
        in_chunks = Counter[int]()
        outside = Counter[int]()
        for piece in layout.pieces:
            records = self._records(file, piece)
            if records is None:
                continue
            survey = survey_messages(records, layout.channels)
            self._note_rest(file, piece, survey.rest, survey.orphan_count)
            if survey.counts:
                true = replace(piece, start_ns=survey.start_ns, end_ns=survey.end_ns)
                message_counts[true] = survey.counts.total()
                (in_chunks if piece.is_chunk else outside).update(survey.counts)
        if self._leave_out_strangers(file, message_counts, in_chunks.total()):
            outside.clear()
        layout.pieces = list(message_counts)
        for number, count in (in_chunks + outside).items():
            counts[layout.channels[number].topic] += count
        self._losses.of_layout(file.path, layout)
        return [(piece.start_ns, piece.end_ns) for piece in message_counts]

    def _leave_out_strangers(
        self, file: BagFile, message_counts: dict[Piece, int], in_chunks: int
    ) -> bool:
        """Leave out what stands outside chunks if the chunks alone hold all summarised messages.

        One wrong byte makes any record into such a message, and no checksum covers it.
        """
        statistics = file.layout.stated_statistics
        if statistics is None or not in_chunks == statistics.message_count > 0:
            return False
        for piece in [piece for piece in message_counts if not piece.is_chunk]:
            complaint = (
                f'{message_counts[piece]} messages outside the chunks at byte {piece.offset} that '
                'the '
                'summary does not know'
            )
            self._damage(file, piece, piece.length, complaint)
            del message_counts[piece]
        return True

    def _stream(self, path: Path) -> BinaryIO:
        """The opened file; only one stands open at a time, for a bag may have thousands."""
        if self._is_closed:
            raise BagError(f'{self.path}: the bag is closed')
        if self._open_file is None or self._open_file[0] != path:
            stream: BinaryIO = path.open('rb')
            if packed.is_packed(stream):
                stream = self._unpacked_file(path, stream)
            if self._open_file is not None:
                self._open_file[1].close()
            self._open_file = (path, stream)
        return self._open_file[1]

    def _unpacked_file(self, path: Path, stream: BinaryIO) -> BinaryIO:
        """The content of a file that rosbag2 has packed as a whole."""
        with stream:
            unpacked_stream, complaint = packed.unpack_file(path, stream, self.limits)
        if complaint:
            self._losses.damage(path, unpacked_stream.seek(0, io.SEEK_END), 0, complaint)
            unpacked_stream.seek(0)
        return unpacked_stream

    def _open_files(self, listed_files: Collection[ListedFile]) -> list[BagFile]:
        """Look at every file; an unusable one is left out, as long as another is usable."""
        files: list[BagFile] = []
        errors: list[BagError] = []
        for entry in listed_files:
            try:
                files.append(BagFile(entry.path, self._look_at(entry.path), entry))
            except BagError as error:
                errors.append(error)
        if errors and not files:
            raise errors[0]
        self._losses.of_bag += [str(error) for error in errors]
        return files

    def _look_at(self, path: Path) -> Layout:
        try:
            if not path.stat().st_size:
                raise BagError(f'{path} is empty')
            stream = self._stream(path)
            size = stream.seek(0, io.SEEK_END)  # of a packed file, what it unpacks to
            stream.seek(0)
            if stream.read(len(MAGIC)) != MAGIC:
                if path.suffix.lower() in LOG_SUFFIXES:
                    command = f'identify NEW_BAG --from-csv {shlex.quote(str(path))} --columns ...'
                    remedy = f'`{command}` makes a bag of columns'
                else:
                    remedy = f'of another kind of bag, {conversion(path)} makes one'
                raise BagError(f'{path} is no MCAP file; {remedy}')
            return walk(stream, size)
        except OSError as error:
            raise BagError(f'{path}: cannot be read: {error.strerror or error}') from None
