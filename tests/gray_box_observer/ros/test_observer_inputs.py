"""What robots publish: message types, field paths, QoS, motors that come and go."""

from __future__ import annotations

import math
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Float64, Float64MultiArray
from tests.ended_starts import parameter_words

pytestmark = pytest.mark.system

MODULE = 'gray_box_observer.ros.observer.observer_node'

EXCITATION = 'R[5,15]D[0.1,1]'
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
START_NS = 1_000_000_000
CHUNK = 20
RELIABLE = QoSProfile(depth=CHUNK, reliability=ReliabilityPolicy.RELIABLE)
SLOW = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Of a single message at a time: with a full history DDS asks its readers at once."""
BEST_EFFORT = QoSProfile(depth=CHUNK, reliability=ReliabilityPolicy.BEST_EFFORT)


def stamped(message: Any, stamp_ns: int) -> Any:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


def publish(rig: Any, senders: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """Publish rows of messages by sender, in order, within the depth of the queues."""
    rig.settle()
    for k, row in enumerate(rows, start=1):
        for name, message in row.items():
            senders[name].publish(message)
        if k % CHUNK == 0:
            for sender in senders.values():
                assert sender.wait_for_all_acked(Duration(seconds=20))


@pytest.mark.parametrize('rate', [1.0, 0.05])
def test_current_and_speed_come_from_topics_and_fields_of_their_own(rig, record, rate):
    """Voltage in an array, current in joint states, speed in a wrench: all by their paths."""
    recording = record(EXCITATION, 4.0)
    rig.start(
        voltage__topic='drive/state',
        voltage__type='sensor_msgs/msg/JointState',
        voltage__field='position[2]',
        voltage__scale=rate,
        torque__topic='joint_states',
        torque__type='sensor_msgs/JointState',
        torque__field='effort[1]',
        torque__scale=0.01 / rate,
        speed__topic='encoder',
        speed__type='geometry_msgs/msg/WrenchStamped',
        speed__field='wrench.force.x',
        # sent faster than time runs, one topic may overtake another by more than it would live
        hold_s=60.0,
    )
    senders = {
        'voltage': rig.peer.publisher(JointState, 'drive/state', RELIABLE, readers=1),
        'speed': rig.peer.publisher(WrenchStamped, 'encoder', RELIABLE, readers=1),
        'torque': rig.peer.publisher(JointState, 'joint_states', RELIABLE, readers=1),
    }
    rows = []
    for k in range(400):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        voltage_v = float(recording.voltage_v[0, k])
        torque_nm = float(recording.torque_nm[0, k])
        wrench = stamped(WrenchStamped(), stamp_ns)
        wrench.wrench.force.x = torque_nm  # of the thesis's motor: w = Kt i, the torque in numbers
        current = JointState(name=['arm', 'wheel'], effort=[9.0, torque_nm / 0.01 * rate])
        rows.append(
            {
                'voltage': stamped(JointState(position=[0.0, 1.0, voltage_v / rate]), stamp_ns),
                'speed': wrench,
                'torque': stamped(current, stamp_ns),
            }
        )
    publish(rig, senders, rows)
    rig.wait_for(samples_used=400)
    assert rig.estimates() == pytest.approx(TRUTH, rel=5e-3)


def test_an_element_of_a_plain_array_is_stamped_by_the_middleware(rig):
    rig.start(
        voltage__topic='drive',
        voltage__type='std_msgs/msg/Float64MultiArray',
        voltage__field='data[1]',
        torque__topic='current',
        torque__type='std_msgs/msg/Float64',
        torque__field='data',
        torque__scale=0.01,
    )
    volts = rig.peer.publisher(Float64MultiArray, 'drive', RELIABLE, readers=1)
    amperes = rig.peer.publisher(Float64, 'current', RELIABLE, readers=1)
    for _ in range(10):
        volts.publish(Float64MultiArray(data=[0.0, 7.0]))
        amperes.publish(Float64(data=2.0))
    volts.publish(Float64MultiArray(data=[0.0]))  # short of one: malformed, not fatal
    volts.publish(Float64MultiArray(data=[0.0, 7.0]))
    rig.wait_for(torque_messages=10, voltage_messages=11)
    assert 'malformed: 1' in rig.values()['rejected']
    assert int(rig.values()['samples used']) + int(rig.values()['samples waiting for voltage']) >= 9


def test_duty_and_battery_make_the_voltage_and_a_current_the_torque(rig, record):
    """The battery comes once a second and a half; the joint has another name than the motor."""
    recording = record(EXCITATION, 4.0)
    rig.start(
        voltage__expression='duty * battery',
        duty__topic='duty',
        duty__type='sensor_msgs/msg/JointState',
        duty__field='effort',
        battery__topic='battery_state',
        battery__type='sensor_msgs/msg/BatteryState',
        battery__field='voltage',
        torque__topic='joint_states',
        torque__quantity='current',
        motor__joint='wheel_joint',
        hold_s=60.0,
    )
    senders = {
        'battery': rig.peer.publisher(BatteryState, 'battery_state', SLOW, readers=1),
        'duty': rig.peer.publisher(JointState, 'duty', RELIABLE, readers=1),
        'torque': rig.peer.publisher(JointState, 'joint_states', RELIABLE, readers=1),
    }
    rig.settle()
    first = stamped(BatteryState(voltage=16.0), START_NS)
    senders['battery'].publish(first)
    rig.peer.wait(lambda: senders['battery'].wait_for_all_acked(Duration(seconds=5)), 'the battery')
    rows = []
    for k in range(400):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        duty = float(recording.voltage_v[0, k]) / 16.0
        current_a = float(recording.torque_nm[0, k]) / 0.01
        states = JointState(name=['arm', 'wheel_joint'], effort=[9.0, current_a])
        row = {
            'duty': stamped(JointState(name=['motor'], effort=[duty]), stamp_ns),
            'torque': stamped(states, stamp_ns),
        }
        if k % 150 == 149:
            row['battery'] = stamped(BatteryState(voltage=16.0), stamp_ns)
        rows.append(row)
    publish(rig, senders, rows)
    rig.wait_for(samples_used=400)
    assert rig.estimates() == pytest.approx(TRUTH, rel=5e-3)


def test_a_battery_that_falls_silent_is_named(rig):
    rig.start(
        voltage__expression='duty * battery',
        duty__topic='duty',
        duty__type='sensor_msgs/msg/JointState',
        duty__field='effort',
        battery__topic='battery_state',
        battery__stale_s=0.2,
    )
    battery = rig.peer.publisher(Float64, 'battery_state', RELIABLE, readers=1)
    duty = rig.peer.publisher(JointState, 'duty', RELIABLE, readers=1)
    torque = rig.peer.publisher(JointState, 'motor/torque', RELIABLE, readers=1)
    battery.publish(Float64(data=12.0))
    assert battery.wait_for_all_acked(Duration(seconds=20))
    start_ns = rig.peer.node.get_clock().now().nanoseconds + 10_000_000_000
    for k in range(CHUNK):
        stamp_ns = start_ns + k * 10_000_000
        duty.publish(stamped(JointState(name=['motor'], effort=[0.5]), stamp_ns))
        torque.publish(rig.state('motor', stamp_ns, 0.01))
    rig.wait_for_level(DiagnosticStatus.WARN, 'battery_state is')
    assert 's old: an input of the expression is silent' in rig.status().message
    assert 'stale_input' in rig.values()['rejected']


def test_an_expression_that_cannot_be_used_ends_the_start_in_one_line(end_here):
    topics = {'duty__topic': 'duty', 'battery__topic': 'battery_state'}
    words = parameter_words(predictor='false', voltage__expression='duty * batery', **topics)
    code, _, said = end_here(MODULE, *words)
    assert code == 2
    assert 'batery.topic is not given: did you mean battery?' in said
    assert 'Traceback' not in said


def test_a_publisher_by_best_effort_is_heard_without_an_override(rig, record):
    recording = record(EXCITATION, 8.0)
    rig.start()
    voltage = rig.peer.publisher(JointState, 'motor/voltage', RELIABLE, readers=1)
    torque = rig.peer.publisher(JointState, 'motor/torque', BEST_EFFORT)
    rig.peer.wait(torque.get_subscription_count, 'the observer to listen by best effort')
    for k in range(3):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        voltage.publish(rig.state('motor', stamp_ns, 5.0))
        torque.publish(rig.state('motor', stamp_ns, 0.01))
        rig.wait_for(torque_messages=k + 1)
    said = rig.peer.end(rig.process)[2]
    assert said.count('a publisher of /motor/torque offers best effort') == 1
    assert 'offers less' not in said


def test_a_battery_by_best_effort_is_heard_as_an_input_without_an_override(rig):
    """It is sent anew until it has come, for nothing else makes up for what is lost."""
    rig.start(
        voltage__expression='duty * battery',
        duty__topic='duty',
        duty__type='sensor_msgs/msg/JointState',
        duty__field='effort',
        battery__topic='battery_state',
        battery__type='sensor_msgs/msg/BatteryState',
        battery__field='voltage',
        battery__stale_s=60.0,
    )
    duty = rig.peer.publisher(JointState, 'duty', RELIABLE, readers=1)
    torque = rig.peer.publisher(JointState, 'motor/torque', RELIABLE, readers=1)
    battery = rig.peer.publisher(BatteryState, 'battery_state', BEST_EFFORT)
    rig.peer.wait(battery.get_subscription_count, 'the observer to listen by best effort')
    stamp_ns = START_NS

    def samples_used() -> bool:
        nonlocal stamp_ns
        stamp_ns += 10_000_000
        battery.publish(stamped(BatteryState(voltage=12.0), stamp_ns))
        duty.publish(stamped(JointState(name=['motor'], effort=[0.5]), stamp_ns))
        torque.publish(rig.state('motor', stamp_ns, 0.01))
        return int(rig.values().get('samples used', '0')) > 10

    rig.peer.wait(samples_used, 'samples whose voltage needs the battery')
    said = rig.peer.end(rig.process)[2]
    assert said.count('a publisher of /battery_state offers best effort') == 1
    assert 'offers less' not in said


def test_a_publisher_of_lesser_quality_is_named_with_the_override_that_mends_it(rig):
    """Reliability that was asked for is not given up."""
    override = 'qos_overrides./motor/torque.subscription.reliability:=reliable'
    rig.start('--ros-args', '-p', override, '-p', 'predictor:=false')
    voltage = rig.peer.publisher(JointState, 'motor/voltage', RELIABLE, readers=1)
    torque = rig.peer.publisher(JointState, 'motor/torque', BEST_EFFORT)
    voltage.publish(rig.state('motor', START_NS, 5.0))
    remedy = 'start with qos_overrides./motor/torque.subscription.reliability'
    rig.wait_for_level(DiagnosticStatus.ERROR, remedy)
    assert (
        'a publisher of /motor/torque offers less reliability than is asked for'
        in rig.status().message
    )
    assert torque.get_subscription_count() == 0
    assert remedy in rig.peer.end(rig.process)[2]

    override = 'qos_overrides./motor/torque.subscription.reliability:=best_effort'
    rig.start('--ros-args', '-p', override, '-p', 'predictor:=false')
    rig.peer.wait(torque.get_subscription_count, 'a match')
    asked = rig.call(
        GetParameters,
        'get_parameters',
        names=['qos_overrides./motor/torque.subscription.reliability'],
    )
    assert asked.values[0].string_value == 'best_effort'


def test_what_the_observer_publishes_can_be_overridden_too_and_an_unknown_topic_is_told(rig):
    name = 'qos_overrides./gray_box_observer/motor/inductance.publisher.durability'
    unknown = 'qos_overrides./motor/voltge.subscription.depth'
    rig.start('--ros-args', '-p', f'{name}:=volatile', '-p', f'{unknown}:=5')
    rig.signals()

    def durability() -> list[Any]:
        found = rig.peer.node.get_publishers_info_by_topic('/gray_box_observer/motor/inductance')
        return [endpoint.qos_profile.durability for endpoint in found]

    rig.peer.wait(durability, 'the topic')
    assert durability() == [DurabilityPolicy.VOLATILE]
    other = rig.peer.node.get_publishers_info_by_topic('/gray_box_observer/motor/resistance')
    assert [endpoint.qos_profile.durability for endpoint in other] == [
        DurabilityPolicy.TRANSIENT_LOCAL
    ]
    said = rig.peer.end(rig.process)[2]
    assert f'no such topic here, ignored: {unknown}' in said


@pytest.mark.parametrize(
    ('override', 'words'),
    [
        (
            '/motor/voltage.subscription.reliability:=mostly',
            'quality of service of motor/voltage: ',
        ),
        ('/motor/voltage.subscription.depth:=deep', 'quality of service of motor/voltage: '),
        ('/diagnostics.publisher.history:=some', 'quality of service of /diagnostics: '),
    ],
)
def test_an_override_that_does_not_exist_is_one_line(end_here, override, words):
    override_words = ('-p', f'qos_overrides.{override}', '-p', 'predictor:=false')
    code, _, said = end_here(MODULE, '--ros-args', *override_words)
    assert code == 2
    (line,) = [line for line in said.splitlines() if line.startswith('observer: error: ')]
    assert words in line
    assert 'see the parameters qos_overrides.' in line


def test_silence_is_explained_nobody_there_another_type_and_other_names(rig):
    rig.start(torque__topic='motor/twist')
    rig.wait_for_level(
        DiagnosticStatus.STALE,
        'nothing received for this motor: nobody publishes /motor/voltage: start its driver, or '
        'set voltage.topic; '
        'nobody publishes /motor/twist: start its driver, or set torque.topic',
    )
    voltage = rig.peer.publisher(JointState, 'motor/voltage', RELIABLE, readers=1)
    wrong = rig.peer.publisher(Float64, 'motor/twist', RELIABLE)
    rig.wait_for_level(
        DiagnosticStatus.ERROR,
        '/motor/twist is published as std_msgs/msg/Float64, but torque.type is '
        'sensor_msgs/msg/JointState',
    )
    rig.peer.node.destroy_publisher(wrong)
    torque = rig.peer.publisher(JointState, 'motor/twist', RELIABLE, readers=1)
    rig.wait_for_level(
        DiagnosticStatus.STALE, 'is motor/voltage and motor/twist published with its name?'
    )
    for publisher in (voltage, torque):
        publisher.publish(rig.state('left right', START_NS, 1.0, 2.0))
    rig.wait_for_level(
        DiagnosticStatus.STALE,
        'published with its name?; names there: left, right; see the parameter',
    )


def test_one_number_for_several_motors_is_counted_and_told_and_ends_nothing(rig):
    types = {f'{name}__type': 'std_msgs/msg/Float64' for name in ('voltage', 'torque')}
    fields = {f'{name}__field': 'data' for name in ('voltage', 'torque')}
    rig.start(motors='[left, right]', **types, **fields)
    senders = [
        rig.peer.publisher(Float64, f'motor/{name}', RELIABLE, readers=1)
        for name in ('voltage', 'torque')
    ]
    for sender in senders:
        sender.publish(Float64(data=6.0))
    rig.wait_for_level(
        DiagnosticStatus.ERROR,
        'no message so far could be read: see rejected (voltage.field data is one number, but '
        'there are 2 motors: use a message with names',
    )
    assert rig.process.poll() is None


def test_a_motor_that_is_silent_disturbs_no_other_and_may_join_and_leave(
    rig, record, learnt_offline
):
    both = record(EXCITATION, 12.0, motors=('left', 'right'))
    alone = record(EXCITATION, 12.0)  # the same motor and voltage as left
    rig.start(motors='[left, right, spare]')
    voltage, torque = rig.signals()

    def send(names: str, indices: range) -> None:
        columns = [both.motors.index(name) for name in names.split()]
        publish(
            rig,
            {'voltage': voltage, 'torque': torque},
            [
                {
                    'voltage': rig.state(
                        names,
                        START_NS + int(both.stamp_ns[k]),
                        *both.voltage_v[columns, k].tolist(),
                    ),
                    'torque': rig.state(
                        names,
                        START_NS + int(both.stamp_ns[k]),
                        *both.torque_nm[columns, k].tolist(),
                    ),
                }
                for k in indices
            ],
        )

    send('left', range(300))
    rig.wait_for('left', samples_used=300)
    assert rig.status('right').level == DiagnosticStatus.STALE
    send('left right', range(300, 600))  # right joins
    rig.wait_for('right', samples_used=300)
    send('left', range(600, 900))  # and leaves
    rig.wait_for('left', samples_used=900)
    left_alone = iter(range(900, 1150))

    def told() -> bool:
        send('left', range(k := next(left_alone), k + 1))  # the topics go on, without right
        gone = (
            'no new sample: motor/voltage speaks of it no more and motor/torque speaks of it no '
            'more'
        )
        return any(
            gone in s.message
            for array in rig.diagnostics
            for s in array.status
            if s.hardware_id == 'right'
        )

    rig.peer.wait(told, 'the word that it has left')
    done = next(left_alone)
    send('right left', range(done, 1200))  # and is back, after a gap
    rig.wait_for('right', samples_used=300 + 1200 - done, pauses=1)
    rig.wait_for('left', samples_used=1200, pauses=0, samples_missing=0)
    assert rig.estimates('right') == pytest.approx({**TRUTH, 'resistance': 1.5}, rel=1e-3)
    assert rig.estimates('left') == learnt_offline(alone, range(1200))
    assert rig.status('spare').level == DiagnosticStatus.STALE
    assert 'nothing received for this motor' in rig.status('spare').message


def test_simulated_time_stamps_messages_without_a_header(rig):
    rig.start(
        use_sim_time='true',
        voltage__type='std_msgs/msg/Float64',
        voltage__field='data',
        torque__type='std_msgs/msg/Float64',
        torque__field='data',
        torque__scale=0.01,
    )
    clock = rig.peer.publisher(Clock, '/clock', SLOW, readers=1)
    volts = rig.peer.publisher(Float64, 'motor/voltage', SLOW, readers=1)
    amperes = rig.peer.publisher(Float64, 'motor/torque', SLOW, readers=1)
    current_a = 0.0
    voltage_v = 5.0
    decay = math.exp(-0.01 / 0.5)
    rig.settle()
    for k in range(60):
        now = Clock()
        now.clock.sec, now.clock.nanosec = divmod(START_NS + 10_000_000 * k, 1_000_000_000)
        for sender, message in (
            (clock, now),
            (amperes, Float64(data=current_a)),
            (volts, Float64(data=voltage_v)),
        ):
            sender.publish(message)
            assert sender.wait_for_all_acked(Duration(seconds=20))
        rig.peer.executor.spin_once(timeout_sec=0.02)
        current_a = voltage_v + (current_a - voltage_v) * decay
    rig.wait_for(torque_messages=60, voltage_messages=60)
    assert float(rig.values()['age of newest sample [s]']) < 1.0, 'by /clock, not by the wall clock'
    header = rig.diagnostics[-1].header.stamp
    assert (header.sec, header.nanosec) == divmod(START_NS + 590_000_000, 1_000_000_000)
    assert 'is stamped by /clock, when it arrives' in rig.peer.end(rig.process)[2]


def test_a_clock_that_stands_still_stops_neither_samples_nor_diagnostics(rig, record):
    recording = record(EXCITATION, 8.0)
    rig.start(use_sim_time='true')
    rig.send(recording, range(400))
    rig.wait_for(samples_used=400)
    rig.send(recording, range(400, 800))
    rig.wait_for(samples_used=800)
    assert any(
        'nothing comes on /clock: publish it, or set it false' in s.message
        for array in rig.diagnostics
        for s in array.status
    )
    assert rig.estimates() == pytest.approx(TRUTH, rel=1e-3)


def test_late_duplicate_and_missing_samples_are_counted_and_nothing_is_lost(rig, record):
    recording = record(EXCITATION, 12.0)
    rig.start()
    dropped = {301, 333, 400, 401, 402}
    indices = [k for k in range(800) if k not in dropped]
    rig.send(recording, indices)
    voltage, torque = rig.signals()
    newest_ns = START_NS + int(recording.stamp_ns[799])
    for stamp_ns in (newest_ns, newest_ns - 30_000_000, newest_ns - 500_000_000):
        voltage.publish(rig.state('motor', stamp_ns, 5.0))
        torque.publish(rig.state('motor', stamp_ns, 0.01))
    rig.send(recording, range(900, 1000))  # a second is missing: a gap
    rig.wait_for(samples_used=895, samples_missing=len(dropped), pauses=1)
    counts = dict(pair.split(': ') for pair in rig.values()['rejected'].split(', '))
    assert counts == {'duplicate': '2', 'out_of_order': '4'}
    assert rig.estimates() == pytest.approx(TRUTH, rel=1e-3)
    rig.send(recording, range(100))  # a bag that begins again
    rig.wait_for(samples_used=995, signal_restarts=1, pauses=2, samples_missing=len(dropped))
    assert rig.estimates() == pytest.approx(TRUTH, rel=1e-3)
