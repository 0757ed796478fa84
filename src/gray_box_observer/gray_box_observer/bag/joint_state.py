"""sensor_msgs/JointState to and from its CDR bytes, without ROS and without a general decoder.

The layout is plain CDR (OMG CORBA 3.1 part 2, section 9.3; XCDR1 in DDS-XTypes 1.3): four bytes of
encapsulation, then every value aligned to its own size, counted from behind these four bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from gray_box_observer.errors import SampleError
from gray_box_observer.safe_io.bounded_cache import (
    MAX_LETTERS,
    MAX_NAMES,
    BoundedCache,
    size_of_names,
)

TYPE_NAME = 'sensor_msgs/msg/JointState'

_ENCAPSULATIONS = {b'\x00\x00': '>', b'\x00\x01': '<'}
_HEADER_BYTES = 4
_PREFIX_START = 12
"""Encapsulation and stamp come first; the frame and the names follow."""
_MAX_LAYOUTS = 64
"""A publisher keeps its frame and names, so few layouts are enough; more are forgotten at once."""
_MAX_LAYOUT_BYTES = 8_000_000
"""What they may take together: somebody who sends ever other frames and names would fill the
memory."""


class JointStateView(NamedTuple):
    """What a JointState says.

    Attributes:
        stamp_ns: The header's stamp.
        names: One per motor.
        position: In rad, as long as ``names`` or empty.
        velocity: In rad/s, likewise.
        effort: In N m (or V, where the topic says so), likewise.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


class _Layout(NamedTuple):
    """Offsets in messages that agree in length, byte order, frame, names and array lengths.

    Attributes:
        size: bytes of the whole message.
        encapsulation: the first two bytes.
        prefix: frame and names.
        prefix_end: where they end.
        numbers: stamp, and length and values of every array.
        names: one per motor.
        counts: lengths of the arrays.
        counts_of: finds these among the numbers.
        arrays: where the values of every array stand among the numbers.
    """

    size: int
    encapsulation: bytes
    prefix: bytes
    prefix_end: int
    numbers: struct.Struct
    names: tuple[str, ...]
    counts: tuple[int, int, int]
    counts_of: Callable[[tuple[Any, ...]], tuple[int, int, int]]
    arrays: tuple[slice, slice, slice]

    def view(self, data: bytes) -> JointStateView | None:
        """The message's content, or None if it does not agree with this layout."""
        if not (
            len(data) == self.size
            and data[_PREFIX_START : self.prefix_end] == self.prefix
            and data[:2] == self.encapsulation
        ):
            return None
        flat = self.numbers.unpack_from(data)
        if self.counts_of(flat) != self.counts:
            return None
        position, velocity, effort = self.arrays
        stamp_ns = flat[0] * 1_000_000_000 + flat[1]
        # As JointStateView(...) does, without the call that every message would pay for.
        return tuple.__new__(
            JointStateView, (stamp_ns, self.names, flat[position], flat[velocity], flat[effort])
        )


def decode_joint_state(data: bytes) -> JointStateView:
    """Decode one message; `JointStateDecoder` is faster for many.

    Args:
        data: CDR of either byte order, with its encapsulation; bytes behind the message are
            ignored.

    Raises:
        SampleError: The bytes are no JointState; the message says where they stop making sense.
    """
    return _first_view(_layout(data), data)


def _first_view(layout: _Layout, data: bytes) -> JointStateView:
    """The content of the message that a layout was found in."""
    view = layout.view(data)
    if view is None:  # cannot be: the layout comes from these bytes
        raise SampleError('JointState whose lengths contradict themselves')
    return view


class JointStateDecoder:
    """Decodes many messages of few publishers; remembers the offsets by frame and name list."""

    def __init__(self) -> None:
        self._layouts: BoundedCache[tuple[int, bytes], _Layout] = BoundedCache(
            _MAX_LAYOUTS, _MAX_LAYOUT_BYTES
        )
        self._newest_layout: _Layout | None = None  # mostly that of the next message too

    def __call__(self, data: bytes) -> JointStateView:
        """Decode one message; the same as `decode_joint_state`."""
        layout = self._newest_layout
        view = None if layout is None else layout.view(data)
        return self._other_view(data) if view is None else view

    def _other_view(self, data: bytes) -> JointStateView:
        """The content of a message that has another layout than the one before."""
        # Length and first names find a candidate; the candidate is then compared in full.
        key = (len(data), data[12:48])
        layout = self._layouts.get(key)
        view = None if layout is None else layout.view(data)
        if view is not None:
            self._newest_layout = layout
            return view
        layout = _layout(data)
        view = _first_view(layout, data)
        if len(layout.names) <= MAX_NAMES and layout.prefix_end <= MAX_LETTERS:
            self._newest_layout = layout
            self._layouts.remember(key, layout, layout.prefix_end + size_of_names(layout.names))
        return view


class _Cursor:
    """Reads along CDR bytes; every length is checked before it is believed."""

    def __init__(self, data: bytes, order: str, at: int) -> None:
        self.data = data
        self.at = at
        self._count = struct.Struct(f'{order}I')

    def count(self, label: str) -> int:
        self.align(4)
        if self.at + 4 > len(self.data):
            raise SampleError(
                f'JointState cut before {label}, at byte {self.at} of {len(self.data)}'
            )
        value: int = self._count.unpack_from(self.data, self.at)[0]
        self.at += 4
        return value

    def align(self, size: int) -> None:
        self.at += (_HEADER_BYTES - self.at) % size

    def skip(self, byte_count: int, label: str) -> int:
        """Step over the bytes of ``label``; the result is where they start."""
        start = self.at
        if start + byte_count > len(self.data):
            raise SampleError(
                f'JointState with {byte_count} bytes of {label} at byte {start}, but only '
                f'{len(self.data)} in all'
            )
        self.at += byte_count
        return start

    def text(self, label: str) -> bytes:
        """The bytes of a text, without its final zero."""
        start = self.skip(self.count(f'the length of {label}'), label)
        return self.data[start : self.at].removesuffix(b'\0')


def _layout(data: bytes) -> _Layout:
    encapsulation = bytes(data[:2])
    order = _ENCAPSULATIONS.get(encapsulation)
    if order is None:
        raise SampleError(
            f'JointState with encapsulation {encapsulation.hex() or "none"}, expected plain CDR '
            '(0000 or 0001)'
        )
    cursor = _Cursor(data, order, _PREFIX_START)
    cursor.text('the frame')
    name_count = cursor.count('the number of names')
    if name_count * 4 > len(data):
        raise SampleError(f'JointState that claims {name_count} names in {len(data)} bytes')
    # As rclpy reads them: one name in Latin-1 is a name that nobody has, and no reason to refuse
    # what others measured.
    names = tuple(cursor.text('a name').decode('utf-8', 'replace') for _ in range(name_count))
    prefix_end = cursor.at
    form = [f'{order}4xiI{prefix_end - _PREFIX_START}x']
    end = prefix_end
    counts = []
    for array_name in ('position', 'velocity', 'effort'):
        count = cursor.count(f'the length of {array_name}')
        form.append(f'{cursor.at - 4 - end}xI')
        end = cursor.at
        if count:  # an empty array is not aligned
            cursor.align(8)
            start = cursor.skip(8 * count, array_name)
            form.append(f'{start - end}x{count}d')
            end = cursor.at
        counts.append(count)
    after_position = 3 + counts[0]
    after_velocity = after_position + 1 + counts[1]
    return _Layout(
        len(data),
        encapsulation,
        bytes(data[_PREFIX_START:prefix_end]),
        prefix_end,
        struct.Struct(''.join(form)),
        names,
        (counts[0], counts[1], counts[2]),
        itemgetter(2, after_position, after_velocity),
        (
            slice(3, after_position),
            slice(after_position + 1, after_velocity),
            slice(after_velocity + 1, None),
        ),
    )


def encode_joint_state(
    stamp_ns: int,
    names: Sequence[str],
    *,
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
    frame_id: str = '',
) -> bytes:
    """The little-endian CDR bytes of one JointState, as a publisher would send them.

    Args:
        stamp_ns: The header's stamp; from -2**31 s to 2**31 s, the range of
            builtin_interfaces/Time.
        names: One per motor.
        position: In rad.
        velocity: In rad/s.
        effort: In N m, or V on a voltage topic.
        frame_id: The header's frame.

    Raises:
        SampleError: The stamp does not fit into the message.
    """
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    if not -(1 << 31) <= seconds < 1 << 31:
        raise SampleError(
            f'stamp of {stamp_ns} ns does not fit into a message; expected less than 2**31 s'
        )
    out = bytearray(struct.pack('<4siI', b'\x00\x01\x00\x00', seconds, nanoseconds))
    _append_text(out, frame_id)
    _append_count(out, len(names))
    for name in names:
        _append_text(out, name)
    for values in (position, velocity, effort):
        _append_count(out, len(values))
        if len(values):
            out += bytes((_HEADER_BYTES - len(out)) % 8)
            out += struct.pack(f'<{len(values)}d', *values)
    return bytes(out)


def _append_count(out: bytearray, count: int) -> None:
    out += bytes((_HEADER_BYTES - len(out)) % 4)
    out += struct.pack('<I', count)


def _append_text(out: bytearray, text: str) -> None:
    raw = text.encode('utf-8') + b'\x00'
    _append_count(out, len(raw))
    out += raw
