"""The general decoder against mcap_ros2's, and against bytes and types that ask for too much."""

from __future__ import annotations

import math
import random
import struct
import tracemalloc
from typing import Any

import pytest
from mcap.records import Schema
from mcap_ros2._dynamic import serialize_dynamic
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Char

from gray_box_observer.bag.limits import MOST_MESSAGE_VALUES, MOST_NESTING
from gray_box_observer.bag.message_decoder import message_decoder

LITTLE, BIG = b'\x00\x01\x00\x00', b'\x00\x00\x00\x00'
SEPARATOR = '\n' + '=' * 80 + '\nMSG: test/'
EVERY_KIND = (
    'bool a\nbyte b\nchar c\nfloat64 d\nint8 e\nuint16 f\nint32 g\nuint64 h\nfloat32 i\nint64 j\n'
    'string k\nuint8[] l\nbyte[3] m\nint16[] n\nfloat64[] o\nfloat64[2] p\nbool[] q\nstring[] r\n'
    'string[2] s\nPart[] t\nPart[2] u\nNone v\nbuiltin_interfaces/Time w\nint32 CONSTANT=4\n'
    'string<=20 x "is said"\nuint32[<=5] y\nuint8 z'
    f'{SEPARATOR}Part\nuint8 a\nfloat64[] b\nNone[] c{SEPARATOR}None\n# empty'
)


def decoded(definition: str, data: bytes, name: str = 'test/msg/Top') -> Any:
    return message_decoder(name, definition)(data)


def reference(definition: str, data: bytes, name: str = 'test/msg/Top') -> Any:
    schema = Schema(1, definition.encode(), 'ros2msg', name)
    return DecoderFactory().decoder_for('cdr', schema)(data)


def plain(value: Any) -> Any:
    """Fields by name, and so on downwards."""
    if isinstance(value, list):
        return [plain(entry) for entry in value]
    fields = getattr(type(value), '__slots__', None)
    if fields is None or isinstance(value, str | bytes):
        return value
    return {field: plain(getattr(value, field)) for field in fields}


def random_values(generator: random.Random) -> dict[str, Any]:
    def many(make: Any) -> list[Any]:
        return [make() for _ in range(generator.randrange(4))]

    def word() -> str:
        return ''.join(generator.choice('aµ漢 ') for _ in range(generator.randrange(6)))

    def part() -> dict[str, Any]:
        return {'a': generator.randrange(256), 'b': many(generator.random), 'c': many(dict)}

    return {
        'a': generator.random() < 0.5,
        **{key: generator.randrange(100) for key in 'bcefghjz'},
        'd': generator.gauss(0, 1),
        'i': generator.randrange(100) / 4,
        **{key: word() for key in 'kx'},
        'l': generator.randbytes(generator.randrange(9)),
        'm': generator.randbytes(3),
        'n': many(lambda: generator.randrange(-9, 9)),
        'o': many(generator.random),
        'p': [generator.random(), 2.0],
        'q': many(lambda: generator.random() < 0.5),
        'r': many(word),
        's': [word(), word()],
        't': many(part),
        'u': [part(), part()],
        'v': {},
        'w': {'sec': 3, 'nanosec': 5},
        'y': many(lambda: generator.randrange(9)),
    }


def test_random_messages_decode_as_mcap_ros2_decodes_them() -> None:
    generator = random.Random(1)
    encode = serialize_dynamic('test/msg/Top', EVERY_KIND)['test/msg/Top']
    for _ in range(200):
        values = random_values(generator)
        data = encode(values)
        ours = plain(decoded(EVERY_KIND, data))
        assert ours == plain(reference(EVERY_KIND, data))
        assert ours == values


def test_either_byte_order_decodes_as_mcap_ros2_decodes_it() -> None:
    kinds = ['bool', 'int16', 'uint64', 'int8', 'uint32', 'int64', 'uint16', 'byte']
    arrays = '\n'.join(f'{kind}[3] b{k}' for k, kind in enumerate(kinds) if kind != 'byte')
    definition = '\n'.join(f'{kind} a{k}' for k, kind in enumerate(kinds)) + '\n' + arrays
    generator = random.Random(2)
    for header in (LITTLE, BIG):
        data = header + generator.randbytes(400)
        assert plain(decoded(definition, data)) == plain(reference(definition, data))
    floats = 'float32 a\nfloat64[2] b'
    for header, form in ((LITTLE, '<'), (BIG, '>')):
        data = header + struct.pack(f'{form}f4xdd', 0.5, -2.25, math.pi)
        assert plain(decoded(floats, data)) == {'a': 0.5, 'b': [-2.25, math.pi]}


def test_a_char_is_the_unsigned_number_that_ros_makes_of_it() -> None:
    data = serialize_message(Char(data=200))
    message = decoded('char data', data, 'std_msgs/msg/Char')
    assert message.data == deserialize_message(data, Char).data == 200
    array = 'char[] data\nchar[2] pair'
    message = decoded(array, LITTLE + struct.pack('<I', 2) + bytes([200, 7, 255, 1]))
    assert message.data == bytes([200, 7])
    assert message.pair == bytes([255, 1])


def test_a_message_cut_anywhere_does_not_fit_its_type() -> None:
    values = random_values(random.Random(3))
    data = serialize_dynamic('test/msg/Top', EVERY_KIND)['test/msg/Top'](values)
    decode = message_decoder('test/msg/Top', EVERY_KIND)
    decode(data)
    for end in range(len(data)):
        with pytest.raises((ValueError, struct.error)):
            decode(data[:end])


@pytest.mark.parametrize(
    'definition', ['uint8[8] x', 'uint8[] x', 'byte[8] x', 'string x', 'float64[1] x', 'None[8] x']
)
def test_an_array_that_is_longer_than_the_data_is_refused(definition: str) -> None:
    data = LITTLE + struct.pack('<I', 8) + b'abc'
    with pytest.raises(ValueError, match='ends after 11 bytes, expected'):
        decoded(f'{definition}{SEPARATOR}None', data)


@pytest.mark.parametrize('leaf', ['', 'uint8[1] x', 'uint8 x'])
def test_types_nested_in_a_binary_tree_are_refused_before_any_is_made(leaf: str) -> None:
    levels = [f'{SEPARATOR}A{k}\nA{k + 1} x\nA{k + 1} y' for k in range(40)]
    definition = f'A0 effort{"".join(levels)}{SEPARATOR}A40\n{leaf}'
    with pytest.raises(ValueError, match=r'every message makes \d{13} values, expected at most'):
        message_decoder('test/msg/Top', definition)


@pytest.mark.parametrize('part', ['uint8[1] x', 'uint8 x', 'string x', ''])
def test_fixed_arrays_of_very_many_parts_are_refused_before_any_is_made(part: str) -> None:
    with pytest.raises(ValueError, match=r'every message makes \d{10} values'):
        message_decoder('test/msg/Top', f'Part[4000000000] effort{SEPARATOR}Part\n{part}')


def test_entries_of_sequences_are_counted_before_they_are_made() -> None:
    wide = SEPARATOR + 'Wide\n' + 'Chain x\n'
    chain = ''.join(f'{SEPARATOR}C{k}\nC{k + 1} x' for k in range(50))
    definition = f'Wide[] effort{wide}{SEPARATOR}Chain\nC0 x{chain}{SEPARATOR}C50\nuint8 x'
    decode = message_decoder('test/msg/Top', definition)
    assert len(decode(LITTLE + struct.pack('<I', 100) + bytes(100)).effort) == 100
    data = LITTLE + struct.pack('<I', 200_000) + bytes(200_000)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=f'more than {MOST_MESSAGE_VALUES} values'):
            decode(data)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_the_values_of_sequences_in_sequences_are_counted_together() -> None:
    definition = f'Row[] rows{SEPARATOR}Row\nPart[] parts{SEPARATOR}Part\n' + 'uint8 x'
    row_count = 30
    part_count = 10_000
    row = struct.pack('<I', part_count) + bytes(part_count)
    data = LITTLE + struct.pack('<I', row_count) + row * row_count
    with pytest.raises(ValueError, match=f'more than {MOST_MESSAGE_VALUES} values'):
        decoded(definition, data)


@pytest.mark.parametrize('field', ['Part x', 'Part[] x', 'Part[2] x'])
def test_a_type_that_holds_itself_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match=f'more than {MOST_NESTING} levels'):
        message_decoder('test/msg/Top', f'Part effort{SEPARATOR}Part\n{field}')


def chain(letter: str, count: int, end: str) -> str:
    """Types that hold each other in a row, the last of them another field."""
    fields = [f'{letter}{k + 1} x' for k in range(count - 1)] + [end]
    return ''.join(f'{SEPARATOR}{letter}{k}\n{field}' for k, field in enumerate(fields))


@pytest.mark.parametrize('field', ['A0 x', 'A0[] x', 'A0[2] x'])
def test_types_met_before_at_a_shallower_level_are_nested_no_deeper_either(field: str) -> None:
    levels = MOST_NESTING // 2
    shallow = chain('A', levels, 'uint8 x')
    fits = f'A0 first\nB0 second{shallow}{chain("B", levels, field)}'
    message_decoder('test/msg/Top', fits)
    beyond = f'A0 first\nB0 second{shallow}{chain("B", levels + 1, field)}'
    with pytest.raises(ValueError, match=f'more than {MOST_NESTING} levels'):
        message_decoder('test/msg/Top', beyond)
    with pytest.raises(ValueError, match=f'more than {MOST_NESTING} levels'):
        message_decoder('test/msg/Top', beyond.replace('A0 first\n', ''))


def test_what_cannot_be_decoded_is_refused_only_where_it_stands() -> None:
    definition = 'uint8 a\nGone[] b\nwstring[] c'
    assert plain(decoded('uint8 a\nGone[] b', LITTLE + bytes(8))) == {'a': 0, 'b': []}
    with pytest.raises(NotImplementedError, match='wstring is not supported'):
        decoded(definition, LITTLE + bytes(8))
    with pytest.raises(NotImplementedError, match='there is no definition of test/Gone'):
        decoded('uint8 a\nGone b', LITTLE + bytes(8))
