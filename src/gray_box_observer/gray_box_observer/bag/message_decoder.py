"""Decodes messages of any type from the definition in their bag; bytes that are missing are missed.

`mcap_ros2` parses the definitions. Its own decoder takes byte arrays past the end of the data for
shorter ones, and makes as many objects as a definition asks for. Here every read stays within the
data, and the values of a message are counted before they are made.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from mcap_ros2._dynamic import TimeDefinition, _for_each_msgdef

from gray_box_observer.bag.limits import MOST_MESSAGE_VALUES, MOST_NESTING

_HEADER_BYTES = 4
_NUMBERS = {
    'bool': '?',
    'char': 'b',
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
_BYTES = ('byte', 'uint8')


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
    read, value_count = _Types(specifications).compile(type_name, 0)
    if value_count > MOST_MESSAGE_VALUES:
        raise ValueError(
            f'every message makes {value_count} values, expected at most {MOST_MESSAGE_VALUES}'
        )
    spare_count = MOST_MESSAGE_VALUES - value_count
    return lambda data: read(_Cdr(data, spare_count))


class _Types:
    """The types of one definition, each compiled once."""

    def __init__(self, specifications: dict[str, Any]) -> None:
        self._specifications = specifications
        self._by_name: dict[str, tuple[_Read, int]] = {}

    def compile(self, name: str, level: int) -> tuple[_Read, int]:
        """Return what reads a type, and how many values one makes without those of sequences.

        Args:
            name: Of the type.
            level: Of nesting; a type that holds itself has no end of them.

        Raises:
            ValueError: There are too many levels.
        """
        if name in self._by_name:
            return self._by_name[name]
        if level > MOST_NESTING:
            raise ValueError(f'more than {MOST_NESTING} levels of types in types')
        specification = self._specifications.get(name)
        if specification is None:
            return _refusal(f'there is no definition of {name}'), 1
        fields: list[tuple[str, _Read]] = []
        value_count = 1
        for field in specification.fields:
            read, field_count = self._field(field.type, level)
            fields.append((field.name, read))
            value_count += field_count
        kind = type(specification.msg_name, (), {'__slots__': [name for name, _ in fields]})
        # IDL has no empty type: a byte takes its place.
        read_message = _message(kind, fields) if fields else _empty_message(kind)
        self._by_name[name] = read_message, value_count
        return self._by_name[name]

    def _field(self, field_type: Any, level: int) -> tuple[_Read, int]:
        """Return what reads a field, and how many values it makes without those of sequences."""
        name = field_type.type
        size = field_type.array_size if field_type.is_fixed_size_array() else None
        if not field_type.is_primitive_type():
            read, count = self.compile(f'{field_type.pkg_name}/{name}', level + 1)
            if not field_type.is_array:
                return read, count
            if size is not None:
                return _fixed_array(read, size), 1 + size * count
            return _sequence(read, count), 1
        if name == 'string':
            if not field_type.is_array:
                return _text, 1
            return (_sequence(_text, 1), 1) if size is None else (_fixed_array(_text, size), 1)
        if name not in _NUMBERS:
            return _refusal(f'{name} is not supported'), 1
        if not field_type.is_array:
            return _number(_NUMBERS[name]), 1
        if name in _BYTES:
            return _byte_array(size), 1
        return _number_array(_NUMBERS[name], size), 1


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
