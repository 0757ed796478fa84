"""The recorder as a process of its own, on real DDS; the player reads back what it wrote."""

from __future__ import annotations

import resource
import signal
import time

import pytest
import rclpy
from mcap.reader import make_reader
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from gray_box_observer.bag.joint_state import decode_joint_state
from gray_box_observer.bag.metadata import parse_qos_text
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.ros.bags import recorder_node
from gray_box_observer.ros.bags.recorder_arguments import RECORDER_PARAMETERS
from gray_box_observer.ros.running import Stop
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS

from .bag_processes import (
    PLAYER,
    RECORDER,
    TIMEOUT_S,
    check_defaults,
    check_help,
    check_refusal,
    check_refusal_here,
    interrupted_twice,
    series,
)

pytestmark = pytest.mark.system


def test_what_is_published_is_recorded_replayed_and_received_byte_by_byte(peer, tmp_path):
    folder = tmp_path / 'bag'
    recorder = peer.start(RECORDER, '-o', str(folder))
    publisher = peer.publisher(JointState, 'motor/voltage', SIGNAL_QOS, readers=1)
    sent = [serialize_message(message) for message in series(500)]
    for data in sent:
        publisher.publish(data)
    assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=TIMEOUT_S))
    before_ns = time.time_ns()
    code, _, said = peer.end(recorder)
    assert code == 0
    assert '500 messages of 1 topics' in said
    with BagReader(folder) as bag:
        recorded = list(bag.messages())
        assert bag.loss is None
        (qos,) = parse_qos_text(bag.topics['/motor/voltage'].qos_profiles)
        assert bag.topics['/motor/voltage'].type_hash.startswith('RIHS01_')
    assert [message.data for message in recorded] == sent
    assert all(m.publish_time_ns <= m.log_time_ns <= before_ns for m in recorded)
    assert (qos['reliability'], qos['durability']) == ('reliable', 'volatile')

    rosbags = pytest.importorskip('rosbags.highlevel')
    with rosbags.AnyReader([folder]) as theirs:
        assert [bytes(raw) for _, _, raw in theirs.messages()] == sent

    peer.node.destroy_publisher(publisher)
    heard: list[bytes] = []
    peer.node.create_subscription(JointState, 'motor/voltage', heard.append, SIGNAL_QOS, raw=True)
    player = peer.start(PLAYER, str(folder), rate=0, wait_for_subscribers=1)
    code, _, _ = peer.end(player, None)
    assert code == 0
    peer.wait(lambda: len(heard) >= len(sent), 'the replayed messages')
    assert heard == sent


def test_a_recorder_that_is_interrupted_twice_at_once_completes_its_bag(peer, tmp_path):
    folder = tmp_path / 'bag'
    recorder = peer.start(RECORDER, '-o', str(folder))
    publisher = peer.publisher(JointState, 'motor/voltage', SIGNAL_QOS, readers=1)
    sent = [serialize_message(message) for message in series(200)]
    for data in sent:
        publisher.publish(data)
    assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=TIMEOUT_S))
    code, said = interrupted_twice(peer, recorder)
    assert code == 0
    assert '200 messages of 1 topics' in said
    with BagReader(folder) as bag:
        assert bag.loss is None
        assert [message.data for message in bag.messages()] == sent


def test_a_killed_recorder_leaves_a_readable_bag_with_little_lost(peer, tmp_path):
    folder = tmp_path / 'bag'
    recorder = peer.start(RECORDER, '-o', str(folder))
    publisher = peer.publisher(JointState, 'motor/torque', SIGNAL_QOS, readers=1)
    messages = iter(series(1000))  # no more than 600 are sent
    until_s = time.monotonic() + 3.0
    count = 0
    while time.monotonic() < until_s:
        publisher.publish(next(messages))
        count += 1
        time.sleep(0.005)
    code, _, _ = peer.end(recorder, signal.SIGKILL)
    assert code == -signal.SIGKILL
    with BagReader(folder) as bag:
        efforts = [decode_joint_state(message.data).effort[1] for message in bag.messages()]
    assert efforts == [-k for k in range(len(efforts))]
    assert len(efforts) > count / 2, 'no more than half of three seconds may be lost'


@pytest.mark.parametrize(
    ('arguments', 'compression'),
    [
        (['-d', '0.5', '--compression-format', 'lz4'], 'lz4'),
        (['--max-bag-size', '9000', '--storage-preset-profile', 'zstd_fast'], 'zstd'),
        (['-b', '9000', '--ros-args', '-p', 'compression:=zstd'], 'zstd'),
    ],
)
def test_a_recording_is_split_and_compressed_as_asked_and_replayed_whole(
    peer, tmp_path, arguments, compression
):
    recorder = peer.start(RECORDER, '/motor/torque', '-o', str(tmp_path / 'bag'), *arguments)
    publisher = peer.publisher(JointState, 'motor/torque', SIGNAL_QOS, readers=1)
    expected = [serialize_message(message) for message in series(300)]
    for data in expected:
        publisher.publish(data)
        time.sleep(0.005)
    assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=TIMEOUT_S))
    assert peer.end(recorder)[0] == 0
    files = sorted((tmp_path / 'bag').glob('*.mcap'))
    assert len(files) > 1
    with files[0].open('rb') as stream:
        assert {index.compression for index in make_reader(stream).get_summary().chunk_indexes} == {
            compression
        }
    with BagReader(tmp_path / 'bag') as bag:
        assert [message.data for message in bag.messages()] == expected
        assert bag.loss is None
    peer.node.destroy_publisher(publisher)
    heard: list[bytes] = []
    peer.node.create_subscription(JointState, 'motor/torque', heard.append, SIGNAL_QOS, raw=True)
    player = peer.start(PLAYER, str(tmp_path / 'bag'), rate=0, wait_for_subscribers=1)
    assert peer.end(player, None)[0] == 0
    peer.wait(lambda: len(heard) >= len(expected), 'the replayed messages')
    assert heard == expected


def test_a_full_disk_ends_the_recorder_with_one_line_and_a_readable_bag(peer, tmp_path):
    recorder = peer.start(RECORDER, '-o', str(tmp_path / 'bag'), flush_period_s=0.1)
    publisher = peer.publisher(JointState, 'motor/torque', SIGNAL_QOS, readers=1)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    for count, message in enumerate(series(2000)):
        publisher.publish(message)
        if count == 200:  # the disk is full only once a part of them stands on it
            peer.wait(lambda: file.stat().st_size > 15_000, 'a chunk')
            size = file.stat().st_size + 10_000
            resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (size, size))
        if recorder.poll() is not None:
            break
        time.sleep(0.002)
    code, _, said = peer.end(recorder, None)
    assert code == 2
    (line,) = [line for line in said.splitlines() if 'error:' in line]
    assert (
        line.startswith('recorder: error: ')
        and 'bag_0.mcap: cannot be written: File too large' in line
    )
    with BagReader(tmp_path / 'bag') as bag:
        efforts = [decode_joint_state(message.data).effort[1] for message in bag.messages()]
        assert 'it was never finished' in str(bag.loss)
    assert efforts == [-k for k in range(len(efforts))]
    assert len(efforts) > 50


def test_topics_that_appear_later_are_recorded_with_their_own_quality_of_service(peer, tmp_path):
    folder = tmp_path / 'bag'
    recorder = peer.start(
        RECORDER,
        'fast',
        '-s',
        'mcap',
        '--topics',
        '/latched',
        '--ros-args',
        '-p',
        f'output:={folder}',
    )
    peer.wait(lambda: any(n == 'bag_recorder' for n in peer.node.get_node_names()), 'the recorder')
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    latched = peer.publisher(Float64, '/latched', LATCHED_QOS)
    latched.publish(Float64(data=4.0))
    fast = peer.publisher(Float64, '/fast', best_effort, readers=1)
    peer.wait(lambda: latched.get_subscription_count(), 'the reader of /latched')
    ignored = peer.publisher(Float64, '/ignored', SIGNAL_QOS)
    for _ in range(20):
        fast.publish(Float64(data=5.0))
        time.sleep(0.01)
    assert ignored.get_subscription_count() == 0
    assert latched.wait_for_all_acked(rclpy.duration.Duration(seconds=TIMEOUT_S))
    assert peer.end(recorder, signal.SIGTERM)[0] == 0
    with BagReader(folder) as bag:
        values = {m.topic: content.data for m, content in bag.decoded_messages()}
        profiles = {name: parse_qos_text(info.qos_profiles)[0] for name, info in bag.topics.items()}
    assert values == {'/latched': 4.0, '/fast': 5.0}
    assert profiles['/fast']['reliability'] == 'best_effort'
    assert profiles['/latched']['durability'] == 'transient_local'


def test_a_best_effort_publisher_that_joins_a_recorded_topic_is_heard(peer, tmp_path):
    recorder = peer.start(RECORDER, '/mixed', output=tmp_path / 'bag')
    peer.publisher(Float64, '/mixed', QoSProfile(depth=10), readers=1)
    loose = peer.publisher(
        Float64, '/mixed', QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT), 1
    )
    for _ in range(10):
        loose.publish(Float64(data=7.0))
        time.sleep(0.01)
    time.sleep(0.2)
    assert peer.end(recorder)[0] == 0
    with BagReader(tmp_path / 'bag') as bag:
        assert {content.data for _, content in bag.decoded_messages()} == {7.0}


def test_topics_that_appear_while_simulated_time_stands_still_are_recorded(peer, tmp_path):
    recorder = peer.start(RECORDER, '--all', output=tmp_path / 'bag', use_sim_time='true')
    for name in (
        '/early',
        '/late',
    ):  # whoever hears the first has looked round before the second was there
        publisher = peer.publisher(Float64, name, SIGNAL_QOS, readers=1)
        publisher.publish(Float64(data=7.0))
        assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=TIMEOUT_S))
    assert peer.end(recorder)[0] == 0
    with BagReader(tmp_path / 'bag') as bag:
        assert {(raw.topic, raw.log_time_ns) for raw in bag.messages()} == {
            ('/early', 0),
            ('/late', 0),
        }


def test_a_recording_ends_by_itself_after_its_duration(peer, tmp_path):
    started_s = time.monotonic()
    code, _, _ = peer.end(
        peer.start(RECORDER, '--all', output=tmp_path / 'bag', duration_s=1), None
    )
    assert code == 0
    assert time.monotonic() - started_s > 1.0


def test_a_type_that_is_not_installed_is_named_and_skipped(peer, tmp_path, monkeypatch):
    publisher = peer.publisher(Float64, '/strange', SIGNAL_QOS)
    monkeypatch.setattr(recorder_node, 'message_class', lambda name: None)
    rclpy.init(domain_id=peer.domain)
    try:
        recorder = recorder_node.BagRecorder(Stop(), ['/strange'], str(tmp_path / 'bag'))
        peer.wait(lambda: recorder.get_publishers_info_by_topic('/strange'), 'discovery')
        recorder._discover()
        assert recorder._refused_topics == {'/strange'}
        assert publisher.get_subscription_count() == 0
        recorder.close()
        recorder.destroy_node()
    finally:
        rclpy.shutdown()


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['--ros-args', '-p', 'bag_recorder:duration:=2.0'], 'duration (did you mean duration_s?)'),
        (['-o', '{tmp}/bag'], 'exists already and is not overwritten'),
        (['--frobnicate'], 'unrecognized arguments: --frobnicate'),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(peer, tmp_path, arguments, message):
    check_refusal(peer, tmp_path, RECORDER, arguments, message)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['--ros-args', '-p', 'frobnicate:=2'], 'not a parameter of this node: frobnicate; --help'),
        (
            ['-o', '{tmp}/new', '--compression-mode', 'file'],
            'leave it out: --compression-format compresses',
        ),
        (
            ['-o', '{tmp}/bag/metadata.yaml/new'],
            'metadata.yaml/new: cannot be made: Not a directory',
        ),
        (
            ['-o', '{tmp}/new', '--ros-args', '-p', 'compression:=lzma'],
            'must be one of none, lz4, zstd',
        ),
        (
            ['-o', '{tmp}/new', '--ros-args', '-p', 'storage_preset_profile:=x'],
            'must be one of none, fastwrite',
        ),
        (
            [
                '-o',
                '{tmp}/new',
                '--storage-preset-profile',
                'zstd_fast',
                '--compression-format',
                'lz4',
            ],
            'argument --compression-format: not allowed with argument --storage-preset-profile',
        ),
        (
            [
                *('-o', '{tmp}/new', '--ros-args'),
                *('-p', 'storage_preset_profile:=zstd_fast', '-p', 'compression:=lz4'),
            ],
            'sets the compression; leave compression out',
        ),
        (
            ['-o', '{tmp}/new', '--max-bag-size', '-1'],
            'max_file_bytes must be in [0, 1e+15], got -1',
        ),
        (['-o', '{tmp}/new', '-d', 'long'], "argument -d/--max-bag-duration: 'long' is no number"),
        (['-o', '{tmp}/new', '-d', '1_0'], "argument -d/--max-bag-duration: '1_0' is no number"),
        (['-o', '{tmp}/new', '-d', 'nan'], 'max_file_duration_s must be in [0, 1e+09], got nan'),
        (['-o', '{tmp}/new', '-b', '1_0'], "argument -b/--max-bag-size: '1_0' is no whole number"),
        (['-o', '{tmp}/new', '-b', '9' * 25], 'max_file_bytes must be in [0, 1e+15], got 99'),
        (
            ['-o', '{tmp}/new', '--ros-args', '-p', 'duration_s:=-1'],
            'duration_s must be in [0, 1e+09]',
        ),
        (['not a topic'], 'error: '),
    ],
)
def test_so_is_any_other_in_the_process_of_the_test(end_here, tmp_path, arguments, message):
    check_refusal_here(end_here, tmp_path, RECORDER, arguments, message)


def test_help_names_every_parameter(end_here):
    check_help(end_here, RECORDER, RECORDER_PARAMETERS)


def test_the_defaults_are_those_that_are_accepted():
    check_defaults(RECORDER_PARAMETERS)
