"""What ``ros2 bag record --compression-mode`` packs by zstd: whole files, or single messages.

Chunks that are packed inside an MCAP file are the format's own affair
(`gray_box_observer.bag.mcap.mcap_content`). Here too the sizes that a head claims are held against
the limits before anything is unpacked.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import zstandard

from gray_box_observer.bag.limits import MESSAGE_OVERHEAD_BYTES, ReadLimits
from gray_box_observer.bag.mcap.mcap_content import RawMessage, TooLarge, Unreadable, check_size
from gray_box_observer.errors import BagError

SUFFIX = '.zstd'
"""What rosbag2 adds to the name of a file that it packs."""

MARK = b'\x28\xb5\x2f\xfd'
"""A frame of zstd begins with it, and no message does: the first byte of CDR is 0."""

_LONGEST_HEAD_BYTES = 18
_STEP_BYTES = 1 << 16
"""What is unpacked at a time, and at most lost before a place that is damaged."""
_SMALLEST_WINDOW_BYTES = 1 << 20
_LARGEST_WINDOW_BYTES = 1 << 27


def is_packed(stream: BinaryIO) -> bool:
    """Whether a file is packed as a whole; it stands at its start again afterwards."""
    start = stream.read(len(MARK))
    stream.seek(0)
    return start == MARK


def unpack_file(path: Path, stream: BinaryIO, limits: ReadLimits) -> tuple[BinaryIO, str]:
    """Unpack a file into memory, as far as it goes.

    Args:
        path: Of the file, for the error.
        stream: The opened file.
        limits: How much it may unpack to: no more than a chunk.

    Returns:
        The unpacked file, and what is wrong with the packed one; empty where nothing is.

    Raises:
        BagError: It would unpack to more, or to nothing.
        OSError: The file cannot be read.
    """
    packed_bytes = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    head = stream.read(_LONGEST_HEAD_BYTES)
    stream.seek(0)
    content = io.BytesIO()
    complaint = ''
    try:
        claimed_bytes = max(zstandard.frame_content_size(head), 0)  # -1: the head does not tell
        check_size(max(claimed_bytes, packed_bytes), packed_bytes, limits)
        window = min(max(limits.chunk_bytes, _SMALLEST_WINDOW_BYTES), _LARGEST_WINDOW_BYTES)
        reader = zstandard.ZstdDecompressor(max_window_size=window).stream_reader(stream)
        while piece := reader.read(_STEP_BYTES):
            content.write(piece)
            check_size(content.tell(), packed_bytes, limits)
        if content.tell() < claimed_bytes:
            sizes = f'{content.tell()} of {claimed_bytes}'
            complaint = f'the packed file is cut: {sizes} bytes are there'
    except TooLarge as error:
        raise BagError(
            f'{path} is packed as a whole: {error}; or unpack it first: unzstd --rm {path}'
        ) from None
    except zstandard.ZstdError as error:
        complaint = f'the packed file is damaged after {content.tell()} bytes ({error})'
    if not content.tell():
        raise BagError(f'{path}: {complaint or "the packed file is empty"}')
    content.seek(0)
    return content, complaint


def unpack_messages(
    messages: Sequence[RawMessage], room: int, limits: ReadLimits
) -> tuple[list[RawMessage], str]:
    """Unpack the messages that are packed one by one.

    Args:
        messages: As they stand in the file.
        room: Bytes of memory that they may take when they are unpacked.
        limits: How large each may become.

    Returns:
        The messages that could be unpacked, and how many could not and why; empty where all could.

    Raises:
        TooLarge: Together they would take more.
    """
    sizes = [_claimed_bytes(message.data) for message in messages]
    needed_bytes = sum(sizes) + MESSAGE_OVERHEAD_BYTES * len(messages)
    if needed_bytes > room:
        raise TooLarge(
            f'its messages unpack to {needed_bytes / 1e6:.0f} MB; {limits.remedy(needed_bytes / 2)}'
        )
    unpacker = zstandard.ZstdDecompressor()
    unpacked_messages: list[RawMessage] = []
    reason = ''
    failure_count = 0
    for message, size in zip(messages, sizes, strict=True):
        if not message.data.startswith(MARK):
            unpacked_messages.append(message)
            continue
        try:
            if not size:
                raise Unreadable('its head does not tell its size')
            check_size(size, len(message.data), limits)
            unpacked_messages.append(message._replace(data=unpacker.decompress(message.data)))
        except (Unreadable, zstandard.ZstdError) as error:
            reason = str(error)
            failure_count = failure_count + 1
    return (
        unpacked_messages,
        f'{failure_count} packed messages that cannot be unpacked ({reason})'
        if failure_count
        else '',
    )


def _claimed_bytes(data: bytes) -> int:
    """What a packed message says that it unpacks to; 0 where it does not say, or is not packed."""
    if not data.startswith(MARK):
        return 0
    try:
        return max(int(zstandard.frame_content_size(data)), 0)
    except zstandard.ZstdError:
        return 0
