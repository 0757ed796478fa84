"""Decodes messages of any type from the definition in their bag; bytes that are missing are missed.

`mcap_ros2` parses the definitions. Its own decoder takes byte arrays past the end of the data for
shorter ones, and makes as many objects as a definition asks for. Here every read stays within the
data, and the values of a message are counted before they are made.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mcap_ros2._dynamic import TimeDefinition, _for_each_msgdef

from gray_box_observer.bag.limits import MOST_MESSAGE_VALUES, MOST_NESTING

_HEADER_BYTES = 4
_NUMBERS = {
    'bool': '?',
    'char': 'B',
    'int8': 'b',
    'byte': 'B',
    'uint8': 'B',
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'float32': 'f',
    'float64': 'd',
}
_BYTES = ('byte', 'char', 'uint8')
"""In ROS 2 `char` is another name of `uint8`, which `mcap_ros2` takes for a signed one."""


class _Cdr:
    """Bytes of one message and how far they have been decoded.

    Attributes:
        data: All bytes with the header of four.
        end: Their number.
        offset: Of the next byte.
        order: Of the bytes of a number, as `struct` writes it.
        spare_count: Values that sequences may still make.
    """

    __slots__ = ('data', 'end', 'offset', 'order', 'spare_count')

    def __init__(self, data: bytes, spare_count: int) -> None:
        self.data = data
        self.end = len(data)
        if self.end < _HEADER_BYTES:
            raise ValueError(f'{self.end} bytes, expected a header of {_HEADER_BYTES}')
        self.offset = _HEADER_BYTES
        self.order = '<' if data[1] & 1 else '>'
        self.spare_count = spare_count

    def raw(self, byte_count: int) -> bytes:
        """Take so many bytes out.

        Raises:
            ValueError: There are fewer.
        """
        start = self.offset
        self.offset = self.require(start, byte_count)
        return self.data[start : self.offset]

    def require(self, start: int, byte_count: int) -> int:
        """Return where so many bytes end.

        Raises:
            ValueError: The data end before them.
        """
        end = start + byte_count
        if end > self.end:
            raise ValueError(f'ends after {self.end} bytes, expected {byte_count} from {start} on')
        return end


_Read = Callable[[_Cdr], Any]


def message_decoder(type_name: str, definition: str) -> Callable[[bytes], Any]:
    """Compile a definition.

    Args:
        type_name: Of the messages, as ``std_msgs/msg/Float64``.
        definition: The text of the type and of all that it needs (ros2msg).

    Returns:
        Decodes the CDR of one message to an object with the fields of its type. Arrays of bytes
        become `bytes`, other arrays lists. It raises ValueError, `struct.error` or
        NotImplementedError where the bytes do not fit the type, or hold too many values.

    Raises:
        ValueError: A message would have too many values, or too many levels. What the parser raises
            comes through.
    """
    specifications = {
        'builtin_interfaces/Time': TimeDefinition,
        'builtin_interfaces/Duration': TimeDefinition,
    }

    def add(full_name: str, short_name: str, specification: Any) -> None:
        specifications[full_name] = specifications[short_name] = specification

    _for_each_msgdef(type_name, definition, add)
    top = _Types(specifications).compile(type_name, 0)
    if top.value_count > MOST_MESSAGE_VALUES:
        raise ValueError(
            f'every message makes {top.value_count} values, expected at most {MOST_MESSAGE_VALUES}'
        )
    spare_count = MOST_MESSAGE_VALUES - top.value_count
    return lambda data: top.read(_Cdr(data, spare_count))


@dataclass(frozen=True)
class _Reader:
    """What reads a type or a field.

    Attributes:
        read: Takes one out of the bytes.
        value_count: How many values one makes without those of sequences.
        level_count: Levels of types that lie below it.
    """

    read: _Read
    value_count: int
    level_count: int = 0


class _Types:
    """The types of one definition, each compiled once."""

    def __init__(self, specifications: dict[str, Any]) -> None:
        self._specifications = specifications
        self._readers: dict[str, _Reader] = {}

    def compile(self, name: str, level: int) -> _Reader:
        """Return what reads a type.

        Args:
            name: Of the type.
            level: Of nesting; a type that holds itself has no end of them.

        Raises:
            ValueError: There are too many levels, be they of types that are compiled already.
        """
        reader = self._readers.get(name)
        if level + (0 if reader is None else reader.level_count) > MOST_NESTING:
            raise ValueError(f'more than {MOST_NESTING} levels of types in types')
        if reader is None:
            reader = self._readers[name] = self._compile(name, level)
        return reader

    def _compile(self, name: str, level: int) -> _Reader:
        """Return what reads a type that is new."""
        specification = self._specifications.get(name)
        if specification is None:
            return _Reader(_refusal(f'there is no definition of {name}'), 1)
        names = [field.name for field in specification.fields]
        readers = [self._field(field.type, level) for field in specification.fields]
        fields = [(name, reader.read) for name, reader in zip(names, readers, strict=True)]
        kind = type(specification.msg_name, (), {'__slots__': names})
        return _Reader(
            # IDL has no empty type: a byte takes its place.
            _message(kind, fields) if fields else _empty_message(kind),
            1 + sum(reader.value_count for reader in readers),
            max((reader.level_count for reader in readers), default=0),
        )

    def _field(self, field_type: Any, level: int) -> _Reader:
        """Return what reads a field."""
        name = field_type.type
        size = field_type.array_size if field_type.is_fixed_size_array() else None
        if not field_type.is_primitive_type():
            entry = self.compile(f'{field_type.pkg_name}/{name}', level + 1)
            level_count = entry.level_count + 1
            if not field_type.is_array:
                return _Reader(entry.read, entry.value_count, level_count)
            if size is not None:
                read = _fixed_array(entry.read, size)
                return _Reader(read, 1 + size * entry.value_count, level_count)
            return _Reader(_sequence(entry.read, entry.value_count), 1, level_count)
        return _Reader(self._primitive(field_type, size), 1)

    def _primitive(self, field_type: Any, size: int | None) -> _Read:
        """Return what reads a number or a text, or an array of them."""
        name = field_type.type
        if name == 'string':
            if not field_type.is_array:
                return _text
            return _sequence(_text, 1) if size is None else _fixed_array(_text, size)
        if name not in _NUMBERS:
            return _refusal(f'{name} is not supported')
        if not field_type.is_array:
            return _number(_NUMBERS[name])
        if name in _BYTES:
            return _byte_array(size)
        return _number_array(_NUMBERS[name], size)


def _message(kind: type, fields: list[tuple[str, _Read]]) -> _Read:
    def read(cdr: _Cdr) -> Any:
        message = kind()
        for name, read_field in fields:
            setattr(message, name, read_field(cdr))
        return message

    return read


def _empty_message(kind: type) -> _Read:
    def read(cdr: _Cdr) -> Any:
        cdr.raw(1)
        return kind()

    return read


def _refusal(reason: str) -> _Read:
    def read(cdr: _Cdr) -> Any:
        raise NotImplementedError(reason)

    return read


def _number(code: str) -> _Read:
    little, big = struct.Struct(f'<{code}').unpack_from, struct.Struct(f'>{code}').unpack_from
    size = struct.calcsize(f'<{code}')
    mask = size - 1

    def read(cdr: _Cdr) -> Any:
        start = cdr.offset
        start += (_HEADER_BYTES - start) & mask
        (value,) = (little if cdr.order == '<' else big)(cdr.data, start)
        cdr.offset = start + size
        return value

    return read


_length = _number('I')


def _number_array(code: str, size: int | None) -> _Read:
    width = struct.calcsize(f'<{code}')
    mask = width - 1

    def read(cdr: _Cdr) -> list[Any]:
        count = _length(cdr) if size is None else size
        if not count:  # which is not aligned either
            return []
        start = cdr.offset
        start += (_HEADER_BYTES - start) & mask
        cdr.offset = cdr.require(start, count * width)
        return list(struct.unpack_from(f'{cdr.order}{count}{code}', cdr.data, start))

    return read


def _byte_array(size: int | None) -> _Read:
    return lambda cdr: cdr.raw(_length(cdr) if size is None else size)


def _text(cdr: _Cdr) -> str:
    """Read a string; an empty one may come with its terminator or without."""
    return cdr.raw(_length(cdr))[:-1].decode()


def _fixed_array(read_entry: _Read, size: int) -> _Read:
    def read(cdr: _Cdr) -> list[Any]:
        cdr.require(cdr.offset, size)  # every entry takes a byte at least
        return [read_entry(cdr) for _ in range(size)]

    return read


def _sequence(read_entry: _Read, value_count: int) -> _Read:
    """Return what reads entries of so many values each."""

    def read(cdr: _Cdr) -> list[Any]:
        count = _length(cdr)
        cdr.require(cdr.offset, count)  # every entry takes a byte at least
        cdr.spare_count -= count * value_count
        if cdr.spare_count < 0:
            raise ValueError(f'holds more than {MOST_MESSAGE_VALUES} values')
        return [read_entry(cdr) for _ in range(count)]

    return read
