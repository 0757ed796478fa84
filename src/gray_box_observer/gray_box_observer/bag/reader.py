"""Reading bags: rosbag2 folders and single MCAP files, whole, killed, cut or damaged.

Messages come in the order of their log times. What cannot be read is left out and accounted for in
`BagReader.loss`; only a bag of which nothing can be read is an error.
"""

from __future__ import annotations

import io
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any

from gray_box_observer.bag.bag_files import BagFiles
from gray_box_observer.bag.contents import Loss, TopicInfo
from gray_box_observer.bag.data_loss import Losses
from gray_box_observer.bag.limits import (
    LARGEST_DEFINITION_BYTES,
    LARGEST_GENERAL_MESSAGE_BYTES,
    MESSAGE_OVERHEAD_BYTES,
    ReadLimits,
)
from gray_box_observer.bag.mcap.mcap_content import RawMessage
from gray_box_observer.bag.mcap.mcap_records import Channel
from gray_box_observer.bag.message_decoder import message_decoder
from gray_box_observer.errors import BagError

_LOG_TIME = itemgetter(4)
_NEVER_NS = 1 << 64


class BagReader:
    """A bag opened for reading.

    Args:
        path: A rosbag2 folder (``metadata.yaml`` and its MCAP files) or a single MCAP file.
        limits: How much of it may be held in memory at one time; None for the defaults.

    Raises:
        BagError: There is no bag, or nothing of it can be read.
    """

    def __init__(self, path: str | Path, limits: ReadLimits | None = None) -> None:
        self.path = Path(path)
        self._losses = Losses()
        self._files = BagFiles(self.path, self._losses, limits or ReadLimits())
        try:
            self._account()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the file; reading afterwards is an error."""
        self._files.close()

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
    def loss(self) -> Loss | None:
        """What could not be read so far, or None; ask again once all messages have been read."""
        return self._losses.total(with_names=len(self._files.all) > 1)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Every message in log-time order; messages of equal time in the order of the files.

        Args:
            topics: Names of the topics that are wanted; None for all. Unknown names give nothing.
            start_ns: The first log time that is wanted.

        Raises:
            BagError: The files can no longer be read at all.
        """
        earliest = -1 if start_ns is None else start_ns
        pieces = [
            (piece, order, file)
            for order, (file, piece) in enumerate(
                (f, p) for f in self._files.all for p in f.layout.pieces
            )
            if piece.end_ns >= earliest or not piece.is_chunk
        ]
        pieces.sort(key=lambda item: item[0].start_ns)
        later_messages = _Waiting()
        capacity = self._files.limits.message_bytes
        for index, (piece, order, file) in enumerate(pieces):
            messages = self._files.read(file, piece, topics, capacity - later_messages.weight)
            # Linear for a list that is already in order, and stable.
            messages.sort(key=_LOG_TIME)
            if messages and messages[0].log_time_ns < earliest:
                messages = messages[bisect_left(messages, earliest, key=_LOG_TIME) :]
            next_index = index + 1
            limit = pieces[next_index][0].start_ns if next_index < len(pieces) else None
            if (
                messages
                and not later_messages.parts
                and (limit is None or messages[-1].log_time_ns < limit)
            ):
                yield from messages
                continue
            later_messages.add(order, messages)
            yield from later_messages.before(limit)

    def decoded_messages(
        self, topics: Collection[str] | None = None
    ) -> Iterator[tuple[RawMessage, Any]]:
        """Every message with its decoded content, in the order of `messages`, of any type.

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
                decoder = decoders[key] = self._decoder(message)
            try:
                if len(message.data) > LARGEST_GENERAL_MESSAGE_BYTES:
                    raise BagError(
                        f'of {len(message.data)} bytes, expected at most '
                        f'{LARGEST_GENERAL_MESSAGE_BYTES}'
                    )
                content = decoder(message.data)
            except Exception as error:  # whatever a foreign decoder makes of foreign bytes
                reason = ' '.join(str(error).split()) or type(error).__name__
                self._losses.undecodable(message.topic, reason)
                continue
            yield message, content

    def _decoder(self, message: RawMessage) -> Callable[[bytes], Any]:
        if not message.schema_text:
            raise BagError(
                f'{self.path}: no definition of {message.type_name or message.topic} in the bag'
            )
        if len(message.schema_text) > LARGEST_DEFINITION_BYTES:
            raise BagError(
                f'{self.path}: the definition of {message.type_name[:100]} has '
                f'{len(message.schema_text)} letters, '
                f'expected at most {LARGEST_DEFINITION_BYTES}'
            )
        encoding = self._topics[message.topic].encoding
        if encoding != 'cdr':
            raise BagError(
                f"{self.path}: {message.topic} is encoded as {encoding!r}, expected 'cdr'"
            )
        try:
            with (
                redirect_stdout(io.StringIO()),
                redirect_stderr(io.StringIO()),
            ):  # the parser prints what it refuses
                return message_decoder(message.type_name, message.schema_text)
        except Exception as error:  # whatever a foreign parser makes of a foreign text
            reason = ' '.join(f'{message.type_name} cannot be used: {error}'.split())
            raise BagError(f'{self.path}: the definition of {reason}') from None

    def _account(self) -> None:
        """Find topics, counts and times, from credible summaries or else by reading."""
        counts: Counter[str] = Counter()
        channels: dict[str, Channel] = {}
        spans: list[tuple[int, int]] = []
        for file in self._files.all:
            counts.update(self._files.count(file, spans))
            for channel in file.layout.channels.values():
                channels.setdefault(channel.topic, channel)
        self._message_count = counts.total()
        if not spans or not self._message_count:
            reason = f': {self.loss}' if self.loss is not None else ''
            raise BagError(f'{self.path}: no message in this bag{reason}')
        self._start_ns, self._end_ns = min(s for s, _ in spans), max(e for _, e in spans)
        self._topics = {
            name: TopicInfo(
                c.type_name,
                counts.get(name, 0),
                c.schema_text,
                c.encoding,
                c.qos_profiles,
                c.type_hash,
            )
            for name, c in channels.items()
        }


def _weight(messages: Sequence[RawMessage]) -> int:
    """Bytes of memory that messages take."""
    return sum(len(message.data) for message in messages) + MESSAGE_OVERHEAD_BYTES * len(messages)


class _Waiting:
    """Messages of overlapping pieces that have been read, and whose turn has not come.

    Attributes:
        parts: In order of time, by the place of their piece in the bag.
        weight: Bytes of memory that they take.
    """

    def __init__(self) -> None:
        self.parts: dict[int, list[RawMessage]] = {}
        self.weight = 0
        self._first_ns = _NEVER_NS

    def add(self, order: int, messages: list[RawMessage]) -> None:
        """Let the messages of a piece wait."""
        if messages:
            self.parts[order] = messages
            self.weight += _weight(messages)
            self._first_ns = min(self._first_ns, messages[0].log_time_ns)

    def before(self, limit: int | None) -> Iterator[RawMessage]:
        """Take out what is earlier than ``limit``; all that is left where it is None.

        Whatever is taken is complete: no piece that is still to be read holds anything earlier than
        ``limit``.
        """
        if limit is not None and self._first_ns >= limit:
            return
        messages: list[RawMessage] = []
        for order in sorted(self.parts):
            part = self.parts[order]
            count = len(part) if limit is None else bisect_left(part, limit, key=_LOG_TIME)
            messages += part[:count]
            if count == len(part):
                del self.parts[order]
            elif count:
                self.parts[order] = part[count:]
        self.weight -= _weight(messages)
        self._first_ns = min(
            (part[0].log_time_ns for part in self.parts.values()), default=_NEVER_NS
        )
        messages.sort(key=_LOG_TIME)
        yield from messages
