"""Written bags, read back by other people's readers, and what happens when the disk refuses."""

from __future__ import annotations

import os
import resource
import signal

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter
from gray_box_observer.errors import BagError

TEXT = schema_text(TYPE_NAME, built_in_lookup)
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
QOS = {
    'history': 'keep_last',
    'depth': 7,
    'reliability': 'reliable',
    'durability': 'transient_local',
    'deadline': FOREVER,
    'lifespan': FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': FOREVER,
    'avoid_ros_namespace_conventions': False,
}
OPTIONS = [
    BagOptions(),
    BagOptions(compression='zstd', chunk_bytes=800),
    BagOptions(compression='zstd', compression_level=19),
    BagOptions(compression='lz4', compression_level=9),
    BagOptions(max_file_bytes=6000, chunk_bytes=500, compression='lz4'),
]


def add(writer: BagWriter, topic: str = '/t') -> None:
    writer.add_topic(topic, TYPE_NAME, TEXT, [QOS], 'RIHS01_' + 64 * 'a')


@pytest.mark.parametrize('options', OPTIONS)
def test_rosbags_reads_the_folder(make_bag, options):
    rosbags = pytest.importorskip('rosbags.highlevel')
    folder = make_bag(60, options=options)
    with BagReader(folder) as bag:
        ours = [(m.topic, m.log_time_ns, m.data) for m in bag.messages()]
    with rosbags.AnyReader([folder]) as theirs:
        assert theirs.message_count == 120
        assert [(c.topic, time, bytes(raw)) for c, time, raw in theirs.messages()] == ours
        connection = theirs.topics['/motor/torque'].connections[0]
        raw = next(raw for c, _, raw in theirs.messages() if c.topic == '/motor/torque')
        assert theirs.deserialize(raw, connection.msgtype).name == ['motor']


@pytest.mark.parametrize('options', OPTIONS)
def test_mcap_reads_the_file_with_checksums_and_mcap_ros2_decodes_it(make_bag, options):
    for path in sorted(make_bag(60, options=options).glob('*.mcap')):
        with path.open('rb') as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            raw = list(reader.iter_messages())
            assert reader.get_header().profile == 'ros2'
        assert summary.statistics.message_count == len(raw) > 0
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        decoded = list(read_ros2_messages(str(path)))
        assert [m.ros_msg.header.stamp.nanosec for m in decoded] == [
            r[2].log_time % 10**9 for r in raw
        ]


def test_metadata_is_what_jazzy_writes(tmp_path):
    with BagWriter(tmp_path / 'run') as writer:
        add(writer)
        add(writer, '/silent')
        for time_ns in (5, 9, 7):
            writer.write('/t', encode_joint_state(0, []), time_ns, time_ns)
    information = yaml.safe_load((tmp_path / 'run' / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information'
    ]
    file = {
        'path': 'run_0.mcap',
        'duration': {'nanoseconds': 4},
        'starting_time': {'nanoseconds_since_epoch': 5},
    }
    topic = {
        'name': '/t',
        'type': TYPE_NAME,
        'serialization_format': 'cdr',
        'offered_qos_profiles': [QOS],
        'type_description_hash': 'RIHS01_' + 64 * 'a',
    }
    assert information == {
        'version': 9,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': 4},
        'starting_time': {'nanoseconds_since_epoch': 5},
        'message_count': 3,
        'topics_with_message_count': [
            {'topic_metadata': topic, 'message_count': 3},
            {'topic_metadata': topic | {'name': '/silent'}, 'message_count': 0},
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': ['run_0.mcap'],
        'files': [file | {'message_count': 3}],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


@pytest.mark.parametrize('is_finished', [True, False])
def test_the_file_itself_tells_rosbag2_the_distribution(tmp_path, is_finished):
    """``ros2 bag info`` and ``reindex`` rely on it where ``metadata.yaml`` is absent."""
    writer = BagWriter(tmp_path / 'run', BagOptions(custom_data={'plant': 'one'}))
    add(writer)
    writer.write('/t', encode_joint_state(0, []), 5, 5)
    writer.close() if is_finished else writer.flush()
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        (found,) = [record for record in reader.iter_metadata() if record.name == 'rosbag2']
        assert reader.get_summary().statistics.metadata_count == 1
    told = yaml.safe_load(found.metadata['serialized_metadata'])
    whole = yaml.safe_load((tmp_path / 'run' / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information'
    ]
    assert told.keys() == whole.keys(), 'rosbag2 asks for every one'
    assert (told['ros_distro'], told['version'], told['custom_data']) == (
        'jazzy',
        9,
        {'plant': 'one'},
    )


def test_the_level_of_a_compression_counts(make_bag):
    sizes = [
        sum(path.stat().st_size for path in make_bag(300, f'level_{k}', options).glob('*.mcap'))
        for k, options in enumerate(
            BagOptions(compression='zstd', compression_level=level) for level in (-5, 19)
        )
    ]
    assert sizes[1] < 0.9 * sizes[0]


def test_channels_carry_the_qos_and_the_hash_of_their_topic(tmp_path):
    with BagWriter(tmp_path / 'run') as writer:
        add(writer)
        writer.write('/t', encode_joint_state(0, []), 1, 1)
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        _, channel, _ = next(make_reader(stream).iter_messages())
    assert yaml.safe_load(channel.metadata['offered_qos_profiles']) == [QOS]
    assert channel.metadata['topic_type_hash'].startswith('RIHS01_')
    with BagReader(tmp_path / 'run') as bag:
        assert yaml.safe_load(bag.topics['/t'].qos_profiles) == [QOS]


@pytest.mark.parametrize(
    ('options', 'counts'),
    [
        (BagOptions(max_file_duration_s=0.3), [60, 60, 60, 20]),
        (BagOptions(max_file_bytes=12_000, chunk_bytes=2000), [105, 95]),
    ],
)
def test_files_are_numbered_and_the_metadata_lists_the_times_and_counts_that_are_in_them(
    make_bag, options, counts
):
    folder = make_bag(100, options=options)
    names = [f'run_{k}.mcap' for k in range(len(counts))]
    assert sorted(path.name for path in folder.glob('*.mcap')) == names
    information = yaml.safe_load((folder / 'metadata.yaml').read_text())[
        'rosbag2_bagfile_information'
    ]
    assert information['relative_file_paths'] == names
    for entry, name, count in zip(information['files'], names, counts, strict=True):
        with (folder / name).open('rb') as stream:
            times = [message.log_time for _, _, message in make_reader(stream).iter_messages()]
        assert (entry['path'], entry['message_count'], len(times)) == (name, count, count)
        assert entry['starting_time'] == {'nanoseconds_since_epoch': min(times)}
        assert entry['duration'] == {'nanoseconds': max(times) - min(times)}
    assert information['message_count'] == sum(counts) == 200
    assert information['duration'] == {'nanoseconds': 990_000_000}


@pytest.mark.parametrize(
    'name', ['ran: [a, \'b\'] # "c"', '1e3', 'fährt', '-', 'true', '{}\n  files: []']
)
def test_a_folder_of_any_name_is_listed_as_it_is_called(make_bag, name):
    folder = make_bag(5, name=name)
    information = yaml.safe_load((folder / 'metadata.yaml').read_text(encoding='utf-8'))[
        'rosbag2_bagfile_information'
    ]
    assert information['relative_file_paths'] == [f'{name}_0.mcap']
    assert [entry['path'] for entry in information['files']] == [f'{name}_0.mcap']
    with BagReader(folder) as bag:
        assert (bag.message_count, bag.loss) == (10, None)


def test_an_existing_folder_is_never_touched(tmp_path):
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'precious').write_text('data')
    with pytest.raises(BagError, match='exists already and is not overwritten'):
        BagWriter(tmp_path / 'run')
    assert [p.name for p in (tmp_path / 'run').iterdir()] == ['precious']


def test_what_was_written_longer_ago_than_the_flush_period_is_on_the_disk(tmp_path):
    now_s = [0.0]
    writer = BagWriter(tmp_path / 'run', BagOptions(flush_period_s=1.0), clock=lambda: now_s[0])
    add(writer)
    for index in range(50):
        now_s[0] += 0.1
        writer.write('/t', encode_joint_state(index, ['m']), index, index)
    with BagReader(tmp_path / 'run') as bag:
        assert bag.message_count >= 40
    now_s[0] += 2.0
    writer.flush_if_due()
    with BagReader(tmp_path / 'run') as bag:
        assert bag.message_count == 50
    writer.close()


def test_a_full_disk_is_one_clear_line_and_what_was_written_stays_readable(tmp_path):
    writer = BagWriter(tmp_path / 'run', BagOptions(chunk_bytes=1000))
    add(writer)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(
            BagError, match=r'run_0\.mcap: cannot be written: File too large'
        ) as caught:
            for index in range(1000):
                writer.write('/t', encode_joint_state(index, ['m']), index, index)
        assert '\n' not in str(caught.value)
        with pytest.raises(BagError, match='cannot be written'):
            writer.write('/t', b'', 1, 1)
        writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    with BagReader(tmp_path / 'run') as bag:
        assert 50 < bag.message_count < 1000
        assert bag.message_count == len(list(bag.messages()))


@pytest.mark.skipif(os.geteuid() == 0, reason='nothing is forbidden to root')
def test_a_folder_that_may_not_be_made_is_one_clear_line(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(BagError, match='cannot be made: Permission denied'):
        BagWriter(tmp_path / 'run')


def test_a_file_in_the_way_is_one_clear_line(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot be made'):
        BagWriter(tmp_path / 'file' / 'run')


def test_misuse_is_refused(tmp_path):
    with BagWriter(tmp_path / 'run') as writer:
        add(writer)
        with pytest.raises(BagError, match='declared already'):
            add(writer)
        with pytest.raises(BagError, match='/other is not declared'):
            writer.write('/other', b'', 1, 1)
        with pytest.raises(BagError, match='out of range'):
            writer.write('/t', b'', -1, 1)
    with pytest.raises(BagError, match='closed'):
        writer.write('/t', b'', 1, 1)
    writer.close()
    with pytest.raises(BagError, match='expected'):
        BagOptions(compression='lzma')
    with pytest.raises(BagError, match='expected'):
        BagOptions(flush_period_s=float('nan'))
    with pytest.raises(BagError, match='compression_level is 23, expected -7 to 22 for zstd'):
        BagOptions(compression='zstd', compression_level=23)
