"""The player as a process of its own, on real DDS."""

from __future__ import annotations

import itertools
import signal

import pytest
import rclpy
from mcap.reader import make_reader
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.pacer import BURST
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.ros.bags.player_arguments import PLAYER_PARAMETERS
from gray_box_observer.ros.bags.player_node import CLOCK_QOS
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS

from .bag_processes import (
    PLAYER,
    check_defaults,
    check_help,
    check_refusal,
    check_refusal_here,
    interrupted_twice,
    make_bag,
)

pytestmark = pytest.mark.system

WANTED = {
    'parameters': '--ros-args -p rate:=2000.0 -p start_offset_s:=1000 -p topics:=[motor/torque]',
    'options of ros2 bag': '-r 2000 --start-offset 1000 --storage mcap --topics motor/torque',
    'options before parameters': '--rate 2000 -s mcap --ros-args -p rate:=0.001 '
    '-p start_offset_s:=1000',
}


def test_a_player_that_is_interrupted_twice_at_once_ends_well(peer, tmp_path):
    heard = peer.listen(JointState, 'motor/torque', SIGNAL_QOS)
    bag = make_bag(tmp_path / 'bag', [0.0, 0.1, 0.2, 3600.0])
    player = peer.start(PLAYER, str(bag))
    peer.wait(lambda: len(heard) == 3, 'the messages before the pause')
    code, said = interrupted_twice(peer, player)
    assert code == 0
    assert '3 messages replayed' in said


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


def test_a_parameter_of_the_player_cannot_be_changed_while_it_runs(peer, tmp_path):
    player = peer.start(PLAYER, str(make_bag(tmp_path / 'bag', [0.0, 1.0])), paused='true')
    change = SetParameters.Request(parameters=[Parameter('rate', value=2.0).to_parameter_msg()])
    answer = peer.call(SetParameters, '/bag_player/set_parameters', change)
    assert not answer.results[0].successful and 'read-only' in answer.results[0].reason
    assert peer.end(player)[0] == 0


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ([], 'player: error: no bag to replay'),
        (['{tmp}/text.mcap'], 'is no MCAP file'),
        (
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
            ['{tmp}/bag', '--ros-args', '-p', 'ratee:=2.0'],
            'ratee (did you mean rate?); --help lists them',
        ),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(peer, tmp_path, arguments, message):
    check_refusal(peer, tmp_path, PLAYER, arguments, message)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['{tmp}/none'], 'no such bag'),
        (['{tmp}/damaged'], 'no message in this bag: '),
        (['{tmp}/bag', '--ros-args', '-p', 'topics:=[/x]'], 'has no /x; there are: /motor/torque'),
        (['{tmp}/bag', '--ros-args', '-p', 'rate:=fast'], "rate must be of type float, got 'fast'"),
        (['{tmp}/bag', '--ros-args', '-p', 'start_offset_s:=99'], 'the bag lasts only 1.000 s'),
        (
            ['{tmp}/bag', '--delay', '4'],
            '--delay of ros2 bag is not known here; it waits for readers: ',
        ),
        (
            ['{tmp}/bag', '-x', '/rosout'],
            '-x of ros2 bag is not known here; name what is wanted: --topics',
        ),
        (['{tmp}/bag', '-r', 'fast'], "argument -r/--rate: 'fast' is no number"),
        (['{tmp}/bag', '-s', 'sqlite3'], "invalid choice: 'sqlite3' (choose from 'mcap')"),
        (
            ['{tmp}/own'],
            'holds only what an observer published; -p observer_outputs:=true replays it',
        ),
        (['{tmp}/late', '--ros-args', '-p', 'clock:=true'], 'which /clock cannot tell'),
    ],
)
def test_so_is_any_other_in_the_process_of_the_test(end_here, tmp_path, arguments, message):
    check_refusal_here(end_here, tmp_path, PLAYER, arguments, message)


def test_help_names_every_parameter(end_here):
    check_help(end_here, PLAYER, PLAYER_PARAMETERS)


def test_the_defaults_are_those_that_are_accepted():
    check_defaults(PLAYER_PARAMETERS)
