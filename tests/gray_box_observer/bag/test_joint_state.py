"""The fast decoder against mcap_ros2's and rclpy's."""

from __future__ import annotations

import random
import struct
import tracemalloc

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from gray_box_observer.bag.joint_state import (
    TYPE_NAME,
    JointStateDecoder,
    decode_joint_state,
    encode_joint_state,
)
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.errors import SampleError

LETTERS = 'aZ_0 /µΩ漢字🤖\t"'


def reference_decoder():
    schema = Schema(1, schema_text(TYPE_NAME, built_in_lookup).encode(), 'ros2msg', TYPE_NAME)
    return DecoderFactory().decoder_for('cdr', schema)


def random_text(generator: random.Random, longest: int) -> str:
    return ''.join(generator.choice(LETTERS) for _ in range(generator.randrange(longest + 1)))


def random_message(generator: random.Random) -> dict:
    names = [random_text(generator, 12) for _ in range(generator.choice([0, 1, 1, 1, 2, 7]))]
    arrays = {
        key: [generator.gauss(0, 1e3) for _ in range(generator.choice([0, len(names)]))]
        for key in ('position', 'velocity', 'effort')
    }
    stamp_ns = generator.randrange(-(2**31) * 10**9, 2**31 * 10**9)
    return {'stamp_ns': stamp_ns, 'names': names, 'frame_id': random_text(generator, 40), **arrays}


def big_endian(message: dict) -> bytes:
    """A second, plain implementation of the encoding, in the other byte order."""
    out = bytearray()

    def put(form: str, *values: object) -> None:
        size = struct.calcsize(f'>{form[-1]}')
        out.extend(bytes(-len(out) % size))
        out.extend(struct.pack(f'>{form}', *values))

    def put_text(text: str) -> None:
        raw = text.encode() + b'\0'
        put('I', len(raw))
        out.extend(raw)

    put('i', message['stamp_ns'] // 10**9)
    put('I', message['stamp_ns'] % 10**9)
    put_text(message['frame_id'])
    put('I', len(message['names']))
    for name in message['names']:
        put_text(name)
    for key in ('position', 'velocity', 'effort'):
        put('I', len(message[key]))
        for value in message[key]:
            put('d', value)
    return b'\x00\x00\x00\x00' + bytes(out)


def test_random_messages_decode_as_mcap_ros2_decodes_them_in_both_byte_orders():
    reference = reference_decoder()
    fast = JointStateDecoder()
    generator = random.Random(1)
    for _ in range(400):
        message = random_message(generator)
        for data in (encode_joint_state(**message), big_endian(message)):
            expected = reference(data)
            for view in (decode_joint_state(data), fast(data)):
                assert view.stamp_ns == message['stamp_ns']
                stamp = expected.header.stamp
                assert view.stamp_ns % 10**9 == stamp.nanosec
                assert list(view.names) == expected.name == message['names']
                assert list(view.position) == expected.position == message['position']
                assert list(view.velocity) == expected.velocity == message['velocity']
                assert list(view.effort) == expected.effort == message['effort']


def test_what_rclpy_serializes_is_decoded_and_what_is_encoded_rclpy_deserializes():
    serialization = pytest.importorskip('rclpy.serialization')
    joint_state = pytest.importorskip('sensor_msgs.msg').JointState
    generator = random.Random(2)
    for _ in range(50):
        message = random_message(generator)
        data = encode_joint_state(**message)
        theirs = serialization.deserialize_message(data, joint_state)
        assert theirs.name == message['names'] and list(theirs.effort) == message['effort']
        assert theirs.header.frame_id == message['frame_id']
        assert decode_joint_state(serialization.serialize_message(theirs)) == decode_joint_state(
            data
        )


def test_texts_that_are_no_utf_8_or_lack_their_final_zero_are_read_as_rclpy_reads_them():
    serialization = pytest.importorskip('rclpy.serialization')
    joint_state = pytest.importorskip('sensor_msgs.msg').JointState
    good = encode_joint_state(5, ['motor', 'other'], effort=[1.0, 2.0], frame_id='welle')
    for told in (b'w\xe4lle\0', b'm\xf6tor\0', b'motors', b'wellen'):
        data = good.replace(b'welle\0' if told[:1] == b'w' else b'motor\0', told)
        assert data != good
        theirs = serialization.deserialize_message(data, joint_state)
        for view in (decode_joint_state(data), JointStateDecoder()(data)):
            assert list(view.names) == theirs.name
            assert list(view.effort) == list(theirs.effort) == [1.0, 2.0]


def test_a_remembered_layout_is_not_used_for_a_message_of_the_same_length_but_other_arrays():
    decode = JointStateDecoder()
    position = encode_joint_state(1, ['m'], position=[2.0])
    velocity = encode_joint_state(1, ['m'], velocity=[2.0])
    other = encode_joint_state(1, ['n'], position=[3.0])
    assert len(position) == len(other)
    for _ in range(2):
        assert decode(position).position == (2.0,)
        assert decode(velocity).velocity == (2.0,)
        assert decode(other).names == ('n',)


def test_two_messages_that_differ_only_late_in_their_names_are_told_apart():
    decode = JointStateDecoder()
    for name in ('a_rather_long_motor_name_left', 'a_rather_long_motor_name_rigt') * 2:
        assert decode(encode_joint_state(1, [name], effort=[1.0])).names == (name,)


@pytest.mark.parametrize(
    'message', [{'names': ['motor'], 'effort': [1.0]}, {'names': ['a', 'b'], 'effort': [1, 2]}]
)
def test_a_message_cut_anywhere_is_refused_with_a_reason(message):
    data = encode_joint_state(5, **message)
    decode = JointStateDecoder()
    decode(data)
    for length in range(len(data)):
        with pytest.raises(SampleError, match='JointState'):
            decode(data[:length])


def test_random_bytes_and_flipped_bits_raise_nothing_but_a_sample_error():
    generator = random.Random(3)
    good = encode_joint_state(5, ['motor'], effort=[1.0], velocity=[2.0])
    decode = JointStateDecoder()
    refused = 0
    for _ in range(500):
        data = bytearray(
            good if generator.random() < 0.7 else b'\0\1\0\0' + generator.randbytes(60)
        )
        data[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
        try:
            decode(bytes(data))
        except SampleError:
            refused += 1
    assert 100 < refused < 500


@pytest.mark.parametrize('kind', [b'\x00\x02', b'\x00\x03', b'\x00\x07', b''])
def test_other_encapsulations_are_refused_by_name(kind):
    data = encode_joint_state(5, ['motor'])
    with pytest.raises(SampleError, match='encapsulation'):
        decode_joint_state(kind + data[2:] if kind else b'')


def test_a_stamp_that_no_message_can_carry_is_refused():
    with pytest.raises(SampleError, match='does not fit'):
        encode_joint_state(2**31 * 10**9, ['motor'])


@pytest.mark.parametrize('text', ['names', 'frame_id'])
def test_ever_new_messages_with_very_long_texts_do_not_fill_the_memory(text):
    decode = JointStateDecoder()
    size = 2_000_000
    tracemalloc.start()
    try:
        for k in range(4):
            long = 'x' * (size + 8 * k)
            message = (
                {'names': [long]} if text == 'names' else {'names': ['motor'], 'frame_id': long}
            )
            assert len(decode(encode_joint_state(k, **message)).names) == 1
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 3 * size, 'the last one and its view, at most'


@pytest.mark.slow
def test_ever_new_lists_of_very_many_names_do_not_fill_the_memory():
    decode = JointStateDecoder()
    count = 30_000
    tracemalloc.start()
    try:
        for k in range(6):
            assert (
                len(decode(encode_joint_state(k, [f'{k}_{j}' for j in range(count)])).names)
                == count
            )
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 50 * count, 'one list of such names takes more'
