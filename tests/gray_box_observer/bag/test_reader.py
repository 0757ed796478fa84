"""Whole bags: rosbag2 folders, single files, order, topics."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from gray_box_observer.bag.joint_state import TYPE_NAME, decode_joint_state, encode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions
from gray_box_observer.errors import BagError

VOLTAGE = '/motor/voltage'
TORQUE = '/motor/torque'


def write_with_mcap(path: Path, log_times: list[int], **options: object) -> None:
    """An MCAP file made by mcap's own writer; message k holds k as effort."""
    with path.open('wb') as stream:
        writer = Writer(stream, **options)
        writer.start(profile='ros2')
        schema = writer.register_schema(
            TYPE_NAME, 'ros2msg', schema_text(TYPE_NAME, built_in_lookup).encode()
        )
        channel = writer.register_channel(TORQUE, 'cdr', schema)
        for index, log_time in enumerate(log_times):
            data = encode_joint_state(log_time, ['motor'], effort=[float(index)])
            writer.add_message(channel, log_time, data, log_time)
        writer.finish()


def indices(path: Path) -> list[int]:
    with BagReader(path) as bag:
        return [int(decode_joint_state(message.data).effort[0]) for message in bag.messages()]


def test_a_folder_gives_back_every_message_with_its_times(make_bag):
    with BagReader(make_bag(100)) as bag:
        messages = list(bag.messages())
        assert bag.loss is None
        assert (bag.message_count, bag.start_ns, bag.duration_ns) == (
            200,
            1_000_000_000,
            990_000_000,
        )
    assert [m.topic for m in messages[:2]] == [VOLTAGE, TORQUE]
    assert all(m.publish_time_ns == m.log_time_ns - 7 for m in messages)
    assert [decode_joint_state(m.data).effort[0] for m in messages[::2]] == [
        5.0 + k for k in range(100)
    ]


def test_topics_tell_type_count_and_definition(make_bag):
    with BagReader(make_bag(30)) as bag:
        assert set(bag.topics) == {VOLTAGE, TORQUE}
        info = bag.topics[TORQUE]
    assert (info.type_name, info.message_count, info.encoding) == (TYPE_NAME, 30, 'cdr')
    assert 'MSG: std_msgs/Header' in info.schema_text
    assert info.type_hash.startswith('RIHS01_')


def test_a_bare_file_and_its_folder_hold_the_same(make_bag):
    folder = make_bag(50)
    with BagReader(folder) as whole, BagReader(folder / 'run_0.mcap') as bare:
        assert list(whole.messages()) == list(bare.messages())


def test_several_files_read_as_one_bag(make_bag):
    one = make_bag(80, 'one')
    many = make_bag(80, 'many', BagOptions(chunk_bytes=500, max_file_duration_s=0.2))
    assert len(list(many.glob('*.mcap'))) == 4
    with BagReader(one) as a, BagReader(many) as b:
        assert list(a.messages()) == list(b.messages())
        assert a.topics[TORQUE].message_count == b.topics[TORQUE].message_count == 80


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('use_chunking', [True, False])
def test_files_of_the_reference_writer_are_read(tmp_path, compression, use_chunking):
    path = tmp_path / 'reference.mcap'
    times = [1000 + k for k in range(300)]
    write_with_mcap(
        path, times, compression=compression, use_chunking=use_chunking, chunk_size=1000
    )
    assert indices(path) == list(range(300))


def test_the_order_is_that_of_mcaps_reader_even_where_chunks_overlap(tmp_path):
    path = tmp_path / 'shuffled.mcap'
    times = [(k * 7919) % 1000 for k in range(1000)]
    write_with_mcap(path, times, chunk_size=2000)
    with path.open('rb') as stream:
        expected = [(m.log_time, m.data) for _, _, m in make_reader(stream).iter_messages()]
    with BagReader(path) as bag:
        assert [(m.log_time_ns, m.data) for m in bag.messages()] == expected


@pytest.mark.parametrize('use_chunking', [True, False])
def test_messages_of_equal_time_keep_the_order_of_the_file(tmp_path, use_chunking):
    path = tmp_path / 'ties.mcap'
    times = [5, 9, 5, 5, 9, 1, 5] * 40
    write_with_mcap(path, times, chunk_size=300, use_chunking=use_chunking)
    assert indices(path) == sorted(range(len(times)), key=lambda k: times[k])


def test_only_wanted_topics_and_times_come(make_bag):
    with BagReader(make_bag(100)) as bag:
        found = list(bag.messages([TORQUE], start_ns=1_500_000_000))
    assert len(found) == 50
    assert {m.topic for m in found} == {TORQUE}
    assert found[0].log_time_ns == 1_500_000_000


def test_decoded_messages_have_the_fields_of_their_type(make_bag):
    with BagReader(make_bag(10)) as bag:
        pairs = list(bag.decoded_messages([VOLTAGE]))
    assert [content.effort for _, content in pairs] == [[5.0 + k] for k in range(10)]
    assert pairs[3][1].header.stamp.nanosec == 30_000_000


def test_a_message_that_does_not_fit_its_type_is_left_out_and_counted(tmp_path):
    path = tmp_path / 'odd.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        schema = writer.register_schema(
            TYPE_NAME, 'ros2msg', schema_text(TYPE_NAME, built_in_lookup).encode()
        )
        channel = writer.register_channel(TORQUE, 'cdr', schema)
        good = encode_joint_state(1, ['m'], effort=[1.0])
        for index, data in enumerate([good, good[:17], b'', good]):
            writer.add_message(channel, index, data, index)
        writer.finish()
    with BagReader(path) as bag:
        assert len(list(bag.decoded_messages())) == 2
        assert f'2 messages of {TORQUE} could not be decoded' in str(bag.loss)


def test_reading_twice_gives_the_same(make_bag):
    with BagReader(make_bag(20)) as bag:
        assert list(bag.messages()) == list(bag.messages())


def test_reading_after_closing_is_an_error(make_bag):
    bag = BagReader(make_bag(5))
    bag.close()
    with pytest.raises(BagError, match='closed'):
        list(bag.messages())


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('missing', None, 'no such bag'),
        ('empty.mcap', b'', 'is empty'),
        ('text.mcap', b'time,voltage\n0,1\n', 'is no MCAP file'),
        ('log.CSV', b'time,voltage\n0,1\n', r'--from-csv \S+log.CSV --columns'),
        ('short.mcap', b'\x89MC', 'is no MCAP file'),
        ('sqlite.db3', b'SQLite format 3\x00' + bytes(100), 'ros2 bag convert'),
        ('magic.mcap', b'\x89MCAP0\r\n', 'no message'),
    ],
)
def test_what_is_no_bag_is_one_clear_line(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BagError, match=message) as caught:
        BagReader(path)
    assert '\n' not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_pipe_is_refused_instead_of_waited_for(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(BagError, match='neither a folder nor a regular file'):
        BagReader(tmp_path / 'pipe')


def test_a_bag_without_messages_is_an_error(make_bag):
    with pytest.raises(BagError, match='no message in this bag'):
        BagReader(make_bag(0))


METADATA = """rosbag2_bagfile_information:
  storage_identifier: mcap
  relative_file_paths: [{}]
"""


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (METADATA.format('gone.mcap'), "'gone.mcap', listed in metadata.yaml, is missing"),
        (
            METADATA.format('gone.mcap, ../run_1.mcap'),
            "'gone.mcap', listed in metadata.yaml, is missing, and 1 more",
        ),
        (METADATA.format('run_0.mcap').replace('mcap\n', 'sqlite3\n', 1), "'sqlite3'"),
        (
            METADATA.format('run_0.mcap').replace('mcap\n', '[a]\n', 1),
            "stored as a list, expected 'mcap'",
        ),
        (METADATA.format('run_0.mcap') + '  compression_mode: FILE\n', "compressed by 'file'"),
    ],
)
def test_metadata_of_another_kind_of_bag_is_one_clear_line(make_bag, text, message):
    folder = make_bag(5)
    (folder / 'metadata.yaml').write_text(text)
    with pytest.raises(BagError, match=message) as caught:
        BagReader(folder)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (None, 'has no metadata.yaml'),
        (METADATA.format(''), 'lists no files'),
        (METADATA.format('3'), 'lists no files'),
        ('rosbag2_bagfile_information: 3', "has no 'rosbag2_bagfile_information'"),
        ('- a\n- b', "has no 'rosbag2_bagfile_information'"),
        ('', "has no 'rosbag2_bagfile_information'"),
        ('a: [b', 'cannot be understood'),
        ('a: 2024-99-99', "has no 'rosbag2_bagfile_information'"),
        ('[' * 1200, 'cannot be understood'),
        (b'\xff\xfe\x00', 'byte 0 is no UTF-8'),
        ('a: !!python/object/apply:os.system [ls]', 'cannot be understood'),
    ],
)
def test_without_usable_metadata_the_files_are_read_by_their_numbers_with_a_warning(
    make_bag, text, message
):
    folder = make_bag(300, options=BagOptions(chunk_bytes=500, max_file_duration_s=0.25))
    with BagReader(folder) as bag:
        expected = list(bag.messages())
    metadata = folder / 'metadata.yaml'
    metadata.unlink()
    if isinstance(text, bytes):
        metadata.write_bytes(text)
    elif text is not None:
        metadata.write_text(text)
    with BagReader(folder) as bag:
        assert list(bag.messages()) == expected
        assert message in str(bag.loss)
        assert 'its 12 .mcap files are read all the same' in str(bag.loss)
        assert '\n' not in str(bag.loss)
    for path in folder.glob('*.mcap'):
        path.unlink()
    with pytest.raises(BagError, match='no rosbag2 bag') as caught:
        BagReader(folder)
    assert '\n' not in str(caught.value)


def test_a_missing_file_costs_only_its_own_messages(make_bag):
    folder = make_bag(80, options=BagOptions(chunk_bytes=500, max_file_duration_s=0.2))
    (folder / 'run_1.mcap').unlink()
    (folder / 'run_2.mcap').write_bytes(b'')
    with BagReader(folder) as bag:
        assert len(list(bag.messages())) == 80
        assert "'run_1.mcap', listed in metadata.yaml, is missing" in str(bag.loss)
        assert 'run_2.mcap is empty' in str(bag.loss)


def test_a_file_with_fewer_messages_than_the_metadata_says_is_told(make_bag):
    folder = make_bag(50)
    shorter = make_bag(30, 'shorter')
    (shorter / 'shorter_0.mcap').replace(folder / 'run_0.mcap')
    with BagReader(folder) as bag:
        assert len(list(bag.messages())) == 60
        assert 'it holds 60 messages, but 100 according to metadata.yaml' in str(bag.loss)


def test_nothing_outside_the_folder_is_read(make_bag, tmp_path):
    folder = make_bag(5)
    other = make_bag(7, 'other')
    for name in ('../other/other_0.mcap', str(other / 'other_0.mcap')):
        (folder / 'metadata.yaml').write_text(METADATA.format(name))
        with pytest.raises(BagError, match=r"'other_0.mcap', listed in metadata.yaml, is missing"):
            BagReader(folder)


def test_a_link_that_leads_out_of_the_folder_is_not_read_and_one_inside_is(make_bag, tmp_path):
    folder = make_bag(80, options=BagOptions(max_file_duration_s=0.2))
    other = make_bag(70, 'other')
    first = folder / 'run_0.mcap'
    second = folder / 'run_1.mcap'
    first.rename(folder / 'kept.bin')
    first.symlink_to('kept.bin')
    with BagReader(folder) as bag:
        whole = len(list(bag.messages()))
        assert bag.loss is None
    second.unlink()
    second.symlink_to(other / 'other_0.mcap')
    for metadata in (True, False):
        if not metadata:
            (folder / 'metadata.yaml').unlink()
        with BagReader(folder) as bag:
            assert 0 < len(list(bag.messages())) < whole
            assert (
                not metadata
                or "'run_1.mcap', listed in metadata.yaml, leads out of it by a link"
                in str(bag.loss)
            )


def test_nor_is_metadata_that_lies_elsewhere(make_bag, tmp_path):
    folder = make_bag(5)
    (folder / 'metadata.yaml').rename(tmp_path / 'secret.yaml')
    (folder / 'metadata.yaml').symlink_to(tmp_path / 'secret.yaml')
    with BagReader(folder) as bag:
        assert len(list(bag.messages())) == 10
        assert 'metadata.yaml is a link that leads out of the bag; it is not read' in str(bag.loss)
