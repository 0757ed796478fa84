"""Recorder and player as processes of their own, on real DDS."""

from __future__ import annotations

import itertools
import resource
import signal
import time
from pathlib import Path

import pytest
import rclpy
from mcap.reader import make_reader
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from gray_box_observer.bag.joint_state import TYPE_NAME, decode_joint_state, encode_joint_state
from gray_box_observer.bag.metadata import parse_qos_text
from gray_box_observer.bag.pacer import BURST
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.ros.bags import recorder_node
from gray_box_observer.ros.bags.player_arguments import PLAYER_PARAMETERS
from gray_box_observer.ros.bags.player_node import CLOCK_QOS
from gray_box_observer.ros.bags.recorder_arguments import RECORDER_PARAMETERS
from gray_box_observer.ros.running import Stop
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS

pytestmark = pytest.mark.system

TIMEOUT_S = 120.0
RECORDER = 'gray_box_observer.ros.bags.recorder_node'
PLAYER = 'gray_box_observer.ros.bags.player_node'


def series(count: int, step_s: float = 0.01) -> list[JointState]:
    """A known series of messages."""
    messages = []
    for index in range(count):
        message = JointState(
            name=['motor', 'zweiter'], effort=[0.1 * index, -index], velocity=[1.0, 2.0]
        )
        message.header.stamp = rclpy.time.Time(
            nanoseconds=10**9 + round(index * step_s * 1e9)
        ).to_msg()
        message.header.frame_id = 'x' * (index % 5)
        messages.append(message)
    return messages


def make_bag(
    folder: Path, times_s: list[float], topic: str = '/motor/torque', log_s: int = 0
) -> Path:
    """A bag whose message k has effort k, logged at the k-th time, `log_s` after its stamp."""
    with BagWriter(folder) as writer:
        writer.add_topic(topic, TYPE_NAME, schema_text(TYPE_NAME, built_in_lookup))
        for index, time_s in enumerate(times_s):
            stamp_ns = 10**9 + round(time_s * 1e9)
            data = encode_joint_state(stamp_ns, ['motor'], effort=[index])
            writer.write(topic, data, stamp_ns + log_s * 10**9, stamp_ns)
    return folder


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


def interrupted_twice(peer, process) -> tuple[int, str]:
    """Interrupt a process twice at once, as terminal and launch do; return its end."""
    process.send_signal(signal.SIGINT)
    code, _, said = peer.end(process, signal.SIGINT)
    return code, said


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


def test_a_player_that_is_interrupted_twice_at_once_ends_well(peer, tmp_path):
    heard = peer.listen(JointState, 'motor/torque', SIGNAL_QOS)
    bag = make_bag(tmp_path / 'bag', [0.0, 0.1, 0.2, 3600.0])
    player = peer.start(PLAYER, str(bag))
    peer.wait(lambda: len(heard) == 3, 'the messages before the pause')
    code, said = interrupted_twice(peer, player)
    assert code == 0
    assert '3 messages replayed' in said


def test_a_killed_recorder_leaves_a_readable_bag_with_little_lost(peer, tmp_path):
    folder = tmp_path / 'bag'
    recorder = peer.start(RECORDER, '-o', str(folder))
    publisher = peer.publisher(JointState, 'motor/torque', SIGNAL_QOS, readers=1)
    messages = iter(series(100_000))
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
    'words', ['--ros-args -p paused:=true', '-p --ros-args', '--start-paused --ros-args']
)
def test_a_paused_player_sends_single_messages_and_goes_on_when_told(peer, tmp_path, words):
    heard: list[float] = []
    peer.node.create_subscription(
        JointState, '/elsewhere', lambda m: heard.append(m.effort[0]), SIGNAL_QOS
    )
    bag = make_bag(tmp_path / 'bag', [0.0, 3600.0, 3600.1, 3600.2])
    player = peer.start(
        PLAYER,
        str(bag),
        *words.split(),
        '-r',
        '/motor/torque:=/elsewhere',
        '-p',
        'wait_for_subscribers:=1',
    )
    for count in (1, 2):
        assert peer.call(Trigger, '/bag_player/play_next').success
        peer.wait(lambda count=count: len(heard) == count, 'the next message')
    assert heard == [0.0, 1.0]
    assert peer.call(Trigger, '/bag_player/toggle_paused').message == 'playing'
    assert not peer.call(Trigger, '/bag_player/play_next').success
    code, _, _ = peer.end(player, None)
    peer.wait(lambda: len(heard) == 4, 'the rest')
    assert (code, heard) == (0, [0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    'words', ['--ros-args -p clock:=true -p loop:=true', '--clock -l --ros-args']
)
def test_the_clock_follows_the_recorded_time_and_jumps_back_when_the_loop_begins_again(
    peer, tmp_path, words
):
    clocks: list[int] = []
    peer.node.create_subscription(
        Clock, '/clock', lambda m: clocks.append(rclpy.time.Time.from_msg(m.clock).nanoseconds), 100
    )
    bag = make_bag(tmp_path / 'bag', [0.0, 0.5, 1.0])
    player = peer.start(PLAYER, str(bag), *words.split(), rate=4.0, wait_for_subscribers=0)
    peer.wait(lambda: sum(b < a for a, b in itertools.pairwise(clocks)) >= 2, 'two jumps back')
    assert peer.end(player, signal.SIGTERM)[0] == 0
    assert min(clocks) >= 10**9 and max(clocks) == 2 * 10**9
    assert set(clocks) - {10**9, 15 * 10**8, 2 * 10**9}, 'the clock ticks between the messages too'
    assert CLOCK_QOS.depth >= 10, 'messages that the transport drops are sent again'


WANTED = {
    'parameters': '--ros-args -p rate:=2000.0 -p start_offset_s:=1000 -p topics:=[motor/torque]',
    'options of ros2 bag': '-r 2000 --start-offset 1000 --storage mcap --topics motor/torque',
    'options before parameters': '--rate 2000 -s mcap --ros-args -p rate:=0.001 '
    '-p start_offset_s:=1000',
}


@pytest.mark.parametrize('words', WANTED.values(), ids=WANTED)
def test_only_wanted_topics_and_times_are_replayed_at_the_wanted_rate(peer, tmp_path, words):
    heard: list[float] = []
    peer.node.create_subscription(
        JointState, 'motor/torque', lambda m: heard.append(m.effort[0]), SIGNAL_QOS
    )
    bag = make_bag(
        tmp_path / 'bag', [200.0 * k for k in range(11)]
    )  # at any other rate it would not end in time
    player = peer.start(PLAYER, str(bag), *words.split())
    assert peer.end(player, None)[0] == 0
    peer.wait(lambda: len(heard) == 6, 'the last six messages')
    assert heard == [5.0, 6.0, 7.0, 8.0, 9.0, 10.0]


def test_a_player_waits_for_its_readers_without_being_asked_and_says_so(peer, tmp_path):
    bag = make_bag(tmp_path / 'bag', [0.001 * k for k in range(200)])
    player = peer.start(PLAYER, str(bag))
    while 'waiting up to 10 s for 1 readers, found 0 of /motor/torque' not in (
        line := player.stderr.readline()
    ):
        assert line, 'the end of what it says'
    heard = peer.listen(JointState, 'motor/torque', SIGNAL_QOS)
    assert peer.end(player, None)[0] == 0
    peer.wait(lambda: len(heard) == 200, 'every message')
    assert [message.effort[0] for message in heard] == list(range(200))


def test_a_player_that_was_not_told_to_wait_begins_without_readers_in_the_end(peer, tmp_path):
    bag = make_bag(tmp_path / 'bag', [0.0, 0.1])
    code, _, said = peer.end(peer.start(PLAYER, str(bag), wait_timeout_s=0.3), None)
    assert code == 0
    assert 'no reader within 0.3 s (0 of /motor/torque); going on without' in said
    assert '2 messages replayed' in said


def test_what_an_observer_published_is_replayed_only_if_asked_for(peer, tmp_path):
    topics = [
        '/motor/torque',
        '/r1/gray_box_observer/motor/resistance',
        '/gray_box_observer/estimates',
        '/diagnostics',
    ]
    with BagWriter(tmp_path / 'bag') as writer:
        for k, topic in enumerate(topics):
            writer.add_topic(topic, TYPE_NAME, schema_text(TYPE_NAME, built_in_lookup))
            writer.write(topic, encode_joint_state(1, ['motor'], effort=[1.0]), 10**9 + k, 10**9)
    asked = {
        '1 messages': {},
        '4 messages': {'observer_outputs': 'true'},
        '2 messages': {'topics': '[/diagnostics, /gray_box_observer/estimates]'},
    }
    players = {
        count: peer.start(PLAYER, tmp_path / 'bag', wait_for_subscribers=0, **p)
        for count, p in asked.items()
    }
    for count, player in players.items():
        code, _, said = peer.end(player, None)
        assert (code, f'{count} replayed' in said) == (0, True), said
        assert ('3 topics that an observer published are left out' in said) == (
            count == '1 messages'
        )


def test_as_fast_as_possible_publishes_no_faster_than_the_stated_limit(peer, tmp_path):
    bag = make_bag(
        tmp_path / 'bag', [0.02 * k for k in range(400)]
    )  # 50 a second: the limit alone counts
    heard: list[float] = []
    published_ns: list[int] = []

    def hear(message: JointState, info: dict) -> None:
        heard.append(message.effort[0])
        published_ns.append(info['source_timestamp'])

    peer.node.create_subscription(JointState, '/motor/torque', hear, QoSProfile(depth=1000))
    player = peer.start(PLAYER, str(bag), rate=0, max_messages_per_s=200, wait_for_subscribers=1)
    code, _, _ = peer.end(player, None)
    assert code == 0
    peer.wait(lambda: len(heard) >= 400, 'every message')
    assert heard == list(range(400))
    assert published_ns[-1] - published_ns[0] > 0.95 * (400 - BURST) / 200 * 1e9


def test_latched_messages_are_replayed_latched(peer, tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        profile = {'reliability': 'reliable', 'durability': 'transient_local', 'depth': 1}
        writer.add_topic('/latched', 'std_msgs/msg/Float64', 'float64 data\n', [profile])
        for index, time_ns in enumerate((0, 3600 * 10**9)):
            writer.write(
                '/latched', serialize_message(Float64(data=float(index))), time_ns, time_ns
            )
    player = peer.start(PLAYER, str(tmp_path / 'bag'))
    publishers: list = []
    peer.wait(
        lambda: publishers.extend(peer.node.get_publishers_info_by_topic('/latched')) or publishers,
        'it',
    )
    assert publishers[0].qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    heard: list[float] = []
    peer.node.create_subscription(Float64, '/latched', lambda m: heard.append(m.data), LATCHED_QOS)
    peer.wait(lambda: heard == [0.0], 'the latched message')
    assert peer.end(player)[0] == 0


def test_a_damaged_bag_is_replayed_as_far_as_it_goes_and_a_topic_with_a_damaged_name_is_left_out(
    peer, tmp_path
):
    text = schema_text(TYPE_NAME, built_in_lookup)
    writer = BagWriter(tmp_path / 'bag')
    for topic, type_name in (
        ('/good', TYPE_NAME),
        ('/b\x01d', TYPE_NAME),
        ('/odd', 'sensor_msgs/msg/Joint\x01tate'),
    ):
        writer.add_topic(topic, type_name, text)
        writer.write(topic, encode_joint_state(1, ['motor'], effort=[4.0]), 10**9, 10**9)
        writer.flush()
    writer.write('/good', encode_joint_state(1, ['motor'], effort=[5.0]), 10**9, 10**9)
    writer.close()
    path = tmp_path / 'bag' / 'bag_0.mcap'
    with path.open('rb') as stream:
        last = make_reader(stream).get_summary().chunk_indexes[-1]
    content = bytearray(path.read_bytes())
    content[last.chunk_start_offset + 80] ^= 1
    path.write_bytes(content)
    heard = peer.listen(JointState, '/good', SIGNAL_QOS)
    code, _, said = peer.end(
        peer.start(PLAYER, str(tmp_path / 'bag'), rate=0, wait_for_subscribers=1), None
    )
    assert code == 0
    peer.wait(lambda: heard, 'the first message')
    assert [message.effort[0] for message in heard] == [4.0]
    for part in (
        "'/b\\x01d' is not replayed: Invalid topic name",
        'is not installed here',
        'wrong checksum',
    ):
        assert part in said


@pytest.mark.parametrize(
    ('module', 'arguments', 'message'),
    [
        (PLAYER, [], 'player: error: no bag to replay'),
        (PLAYER, ['{tmp}/none'], 'no such bag'),
        (PLAYER, ['{tmp}/text.mcap'], 'is no MCAP file'),
        (PLAYER, ['{tmp}/damaged'], 'no message in this bag: '),
        (
            PLAYER,
            ['{tmp}/bag', '--ros-args', '-p', 'topics:=[/x]'],
            'has no /x; there are: /motor/torque',
        ),
        (
            PLAYER,
            ['{tmp}/bag', '--ros-args', '-p', 'rate:=fast'],
            "rate must be of type float, got 'fast'",
        ),
        (
            PLAYER,
            ['{tmp}/bag', '--ros-args', '-p', 'start_offset_s:=99'],
            'the bag lasts only 1.000 s',
        ),
        (
            PLAYER,
            [
                '{tmp}/bag',
                '--ros-args',
                '-p',
                'wait_for_subscribers:=1',
                '-p',
                'wait_timeout_s:=0.3',
            ],
            'waited 0.3 s for 1 readers, found 0 of /motor/torque',
        ),
        (
            PLAYER,
            ['{tmp}/bag', '--ros-args', '-p', 'ratee:=2.0'],
            'ratee (did you mean rate?); --help lists them',
        ),
        (
            RECORDER,
            ['--ros-args', '-p', 'bag_recorder:duration:=2.0'],
            'duration (did you mean duration_s?)',
        ),
        (
            RECORDER,
            ['--ros-args', '-p', 'frobnicate:=2'],
            'not a parameter of this node: frobnicate; --help',
        ),
        (
            PLAYER,
            ['{tmp}/bag', '--delay', '4'],
            '--delay of ros2 bag is not known here; it waits for readers: ',
        ),
        (
            PLAYER,
            ['{tmp}/bag', '-x', '/rosout'],
            '-x of ros2 bag is not known here; name what is wanted: --topics',
        ),
        (PLAYER, ['{tmp}/bag', '-r', 'fast'], "argument -r/--rate: 'fast' is no number"),
        (PLAYER, ['{tmp}/bag', '-s', 'sqlite3'], "invalid choice: 'sqlite3' (choose from 'mcap')"),
        (
            PLAYER,
            ['{tmp}/own'],
            'holds only what an observer published; -p observer_outputs:=true replays it',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '--compression-mode', 'file'],
            'leave it out: --compression-format compresses',
        ),
        (RECORDER, ['-o', '{tmp}/bag'], 'exists already and is not overwritten'),
        (
            RECORDER,
            ['-o', '{tmp}/bag/metadata.yaml/new'],
            'metadata.yaml/new: cannot be made: Not a directory',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '--ros-args', '-p', 'compression:=lzma'],
            'must be one of none, lz4, zstd',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '--ros-args', '-p', 'storage_preset_profile:=x'],
            'must be one of none, fastwrite',
        ),
        (
            RECORDER,
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
            RECORDER,
            [
                *('-o', '{tmp}/new', '--ros-args'),
                *('-p', 'storage_preset_profile:=zstd_fast', '-p', 'compression:=lz4'),
            ],
            'sets the compression; leave compression out',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '--max-bag-size', '-1'],
            'max_file_bytes must be in [0, 1e+15], got -1',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '-d', 'long'],
            "argument -d/--max-bag-duration: 'long' is no number",
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '-d', '1_0'],
            "argument -d/--max-bag-duration: '1_0' is no number",
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '-d', 'nan'],
            'max_file_duration_s must be in [0, 1e+09], got nan',
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '-b', '1_0'],
            "argument -b/--max-bag-size: '1_0' is no whole number",
        ),
        (
            RECORDER,
            ['-o', '{tmp}/new', '-b', '9' * 25],
            'max_file_bytes must be in [0, 1e+15], got 99',
        ),
        (PLAYER, ['{tmp}/late', '--ros-args', '-p', 'clock:=true'], 'which /clock cannot tell'),
        (
            RECORDER,
            ['-o', '{tmp}/new', '--ros-args', '-p', 'duration_s:=-1'],
            'duration_s must be in [0, 1e+09]',
        ),
        (RECORDER, ['not a topic'], 'error: '),
        (RECORDER, ['--frobnicate'], 'unrecognized arguments: --frobnicate'),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(peer, tmp_path, module, arguments, message):
    make_bag(tmp_path / 'bag', [0.0, 1.0])
    make_bag(tmp_path / 'late', [0.0], log_s=2**32)
    make_bag(tmp_path / 'own', [0.0], topic='/gray_box_observer/predicted_torque')
    (tmp_path / 'text.mcap').write_text('no bag')
    spoilt = make_bag(tmp_path / 'damaged', [0.0, 1.0]) / 'damaged_0.mcap'
    spoilt.write_bytes(spoilt.read_bytes()[:400] + bytes(2000))
    process = peer.start(module, *(argument.format(tmp=tmp_path) for argument in arguments))
    code, _, said = peer.end(process, None)
    assert code == 2
    lines = [line for line in said.splitlines() if 'error:' in line]
    assert len(lines) == 1 and message in lines[0]


@pytest.mark.parametrize('module', [RECORDER, PLAYER])
def test_help_names_every_parameter(peer, module):
    code, out, _ = peer.end(peer.start(module, '--help'), None)
    assert code == 0
    specs = PLAYER_PARAMETERS if module == PLAYER else RECORDER_PARAMETERS
    assert all(f'\n  {spec.name} ' in out for spec in specs)


def test_a_parameter_of_the_player_cannot_be_changed_while_it_runs(peer, tmp_path):
    player = peer.start(PLAYER, str(make_bag(tmp_path / 'bag', [0.0, 1.0])), paused='true')
    change = SetParameters.Request(parameters=[Parameter('rate', value=2.0).to_parameter_msg()])
    answer = peer.call(SetParameters, '/bag_player/set_parameters', change)
    assert not answer.results[0].successful and 'read-only' in answer.results[0].reason
    assert peer.end(player)[0] == 0


def test_the_defaults_of_player_and_recorder_are_those_that_they_accept():
    for spec in (*PLAYER_PARAMETERS, *RECORDER_PARAMETERS):
        assert spec.check(spec.default) == spec.default
        assert spec.description.endswith('.')
