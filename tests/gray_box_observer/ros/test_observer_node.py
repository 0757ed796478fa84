"""The observer as a process of its own, on real DDS."""

from __future__ import annotations

import math
import re
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import State, Transition
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from tests.ended_starts import parameter_words

from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS
from gray_box_observer.settings.configuration import Configuration

pytestmark = pytest.mark.system

MODULE = 'gray_box_observer.ros.observer.observer_node'
NODE = '/gray_box_observer'
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
EXCITATION = 'R[5,15]D[0.1,1]'
START_NS = 1_000_000_000
CHUNK = 20
END_S = 20.0
"""A node that is asked to end has done so after this time."""


def rejected(rig) -> dict[str, int]:
    text = rig.values()['rejected']
    return (
        {}
        if text == 'none'
        else {k: int(n) for k, n in (pair.split(': ') for pair in text.split(', '))}
    )


SMALL_NETWORK = {
    'predictor': 'true',
    'variant': 'main',
    'training__hidden': 2,
    'training__context': 16,
    'training__period': 32,
    'training__steps': 1,
    'training__minibatch': 2,
}


def test_every_topic_has_its_name_type_and_quality_of_service(rig):
    rig.start()
    rig.signals()
    node = rig.peer.node
    reliable = ReliabilityPolicy.RELIABLE
    latched = DurabilityPolicy.TRANSIENT_LOCAL
    volatile = DurabilityPolicy.VOLATILE

    def described(endpoints) -> list[tuple]:
        own = [e for e in endpoints if e.node_name == 'gray_box_observer']
        return [(e.topic_type, e.qos_profile.reliability, e.qos_profile.durability) for e in own]

    published = {
        f'{NODE}/motor/inductance': ('std_msgs/msg/Float64', reliable, latched),
        f'{NODE}/motor/resistance': ('std_msgs/msg/Float64', reliable, latched),
        f'{NODE}/motor/hysteresis': ('std_msgs/msg/Float64', reliable, latched),
        f'{NODE}/motor/identified': ('std_msgs/msg/Bool', reliable, latched),
        f'{NODE}/motor/fit': ('std_msgs/msg/Float64', reliable, latched),
        f'{NODE}/motor/resistance/identified': ('std_msgs/msg/Bool', reliable, latched),
        f'{NODE}/motor/alarm': ('std_msgs/msg/Bool', reliable, latched),
        f'{NODE}/motor/covariance': ('std_msgs/msg/Float64MultiArray', reliable, latched),
        f'{NODE}/predicted_torque': ('sensor_msgs/msg/JointState', reliable, volatile),
        '/diagnostics': ('diagnostic_msgs/msg/DiagnosticArray', reliable, volatile),
    }
    for topic, expected in published.items():
        rig.peer.wait(
            lambda topic=topic: described(node.get_publishers_info_by_topic(topic)), topic
        )
        assert described(node.get_publishers_info_by_topic(topic)) == [expected], topic
    for topic in ('/motor/voltage', '/motor/torque'):
        expected = 'sensor_msgs/msg/JointState', reliable, volatile
        assert described(node.get_subscriptions_info_by_topic(topic)) == [expected]
    services = dict(node.get_service_names_and_types_by_node('gray_box_observer', '/'))
    trigger = ['std_srvs/srv/Trigger']
    boolean = ['std_srvs/srv/SetBool']
    wanted = {'reset': trigger, 'save': trigger, 'load': trigger, 'freeze': boolean}
    assert {name: services[f'{NODE}/{name}'] for name in wanted} == wanted


def test_a_noise_free_motor_is_identified_and_whoever_comes_late_is_told(rig, record):
    rig.start()
    rig.send(record(EXCITATION, 4.0), range(400))
    rig.wait_for(samples_used=400)
    assert rig.latched(Bool, 'motor/identified').data is True
    assert rig.estimates() == pytest.approx(TRUTH, rel=1e-3)
    covariance = rig.latched(Float64MultiArray, 'motor/covariance')
    assert [dim.label for dim in covariance.layout.dim] == ['inductance,resistance,hysteresis'] * 2
    assert [(dim.size, dim.stride) for dim in covariance.layout.dim] == [(3, 9), (3, 3)]
    matrix = np.array(covariance.data).reshape(3, 3)
    assert matrix == pytest.approx(matrix.T, rel=1e-9)
    assert np.all(np.linalg.eigvalsh(matrix) > 0.0)
    rig.wait_for_level(DiagnosticStatus.STALE, 'no new sample')
    assert rig.values()['inductance verdict'] == 'identified'


def test_whoever_comes_late_is_told_how_well_the_white_box_fits_and_which_parameters_are_identified(
    rig, record
):
    rig.start()
    rig.send(record(EXCITATION, 8.0, torque_noise_relative=0.01), range(800))
    rig.wait_for(samples_used=800)
    values = rig.values()
    assert values['fit verdict'] == 'ok'
    assert rig.latched(Float64, 'motor/fit').data == pytest.approx(
        float(values['fit ratio']), rel=1e-3
    )
    assert values['suspects'] == 'none'
    assert 'Kb is left at its default' in values['assumptions']
    for name in ('inductance', 'resistance', 'hysteresis'):
        identified = values[f'{name} verdict'] in ('identified', 'negligible')
        assert rig.latched(Bool, f'motor/{name}/identified').data is identified
    heard = rig.peer.listen(Float64, f'{NODE}/motor/fit', LATCHED_QOS)
    rig.peer.wait(lambda: heard, 'the ratio')
    assert rig.call(Trigger, 'reset').success
    rig.peer.wait(lambda: heard[-1].data == 0.0, 'the end of the ratio, for who listens')
    assert rig.latched(Float64, 'motor/fit').data == 0.0


def test_a_motor_that_is_told_in_mv_is_a_warning_with_its_remedy_and_nothing_of_it_is_identified(
    rig, record
):
    recording = record(EXCITATION, 8.0, torque_noise_relative=0.01)
    rig.start()
    rig.send(replace(recording, voltage_v=1e3 * recording.voltage_v), range(800))
    rig.wait_for_level(DiagnosticStatus.WARN, 'set voltage.scale: 0.001')
    assert rig.values()['suspects'].startswith('units_of_voltage')
    assert rig.latched(Bool, 'motor/identified').data is False


def test_the_live_node_learns_bit_for_bit_what_the_core_learns_and_junk_in_between_costs_nothing(
    rig, record, learnt_offline
):
    recording = record(EXCITATION, 6.0)
    rig.start()
    rig.send(recording, range(300))
    voltage, torque = rig.signals()
    newest_ns = START_NS + int(recording.stamp_ns[299])
    for value in (math.nan, math.inf, -math.inf):
        voltage.publish(rig.state('motor', newest_ns + 1, value))
        torque.publish(rig.state('motor', newest_ns + 1, value))
    torque.publish(rig.state('motor', newest_ns, 0.07))
    torque.publish(rig.state('motor', newest_ns - 500_000_000, 0.07))
    voltage.publish(rig.state('motor', newest_ns - 500_000_000, 7.0))
    torque.publish(rig.state('motor', newest_ns + 2, 1e300))
    torque.publish(rig.state('motor', newest_ns + 3))  # a name without a value
    torque.publish(rig.state('stranger', newest_ns + 4, 0.07))
    message = bytes(serialize_message(rig.state('motor', newest_ns + 5, 0.07)))
    for data in (
        message[:40],
        b'\0',
        b'\x00\x07' + message[2:],
    ):  # cut, of one byte, in another encoding
        torque.publish(data)
    rig.send(recording, range(300, 600))
    rig.wait_for(samples_used=600)
    counts = {'non_finite': 6, 'duplicate': 1, 'out_of_order': 2, 'absurd': 1, 'malformed': 4}
    assert rejected(rig) == counts
    values = rig.values()
    received = int(values['torque messages']), int(values['voltage messages'])
    assert received == (600 + 3 + 1 + 1 + 1, 600 + 3 + 1), (
        'every message is used or counted under its reason'
    )
    of_topic = {
        name: int(values[f'torque topic: {name}'])
        for name in ('messages', 'unreadable', 'of no motor here')
    }
    assert of_topic == {'messages': received[0] + 5, 'unreadable': 4, 'of no motor here': 1}
    assert rig.estimates() == learnt_offline(recording, range(600))


def test_a_clock_that_is_set_back_begins_a_new_history_and_forgets_nothing(rig, record):
    recording = record(EXCITATION, 4.0)
    rig.start()
    rig.send(recording, range(200, 400))
    rig.wait_for(samples_used=200)
    rig.send(recording, range(200))
    rig.wait_for(samples_used=400)
    assert int(rig.values()['signal restarts']) >= 1
    assert rig.estimates() == pytest.approx(TRUTH, rel=1e-3)


def test_diagnostics_come_once_a_second_and_say_what_to_do(rig, record):
    recording = record('C[10]', 40.0)
    rig.start()
    voltage, torque = rig.signals()
    rig.wait_for_level(
        DiagnosticStatus.STALE, 'nothing received for this motor: is motor/voltage and motor/torque'
    )
    voltage.publish(rig.state('motor', START_NS - 1, 10.0))
    rig.wait_for_level(DiagnosticStatus.STALE, 'nothing received for this motor: is motor/torque')
    rig.send(recording, range(3000, 3900))  # long settled
    rig.wait_for_level(DiagnosticStatus.WARN, 'not excited: vary the voltage')
    rig.wait_for(samples_used=900)
    nothing = [rig.state('motor', START_NS + int(recording.stamp_ns[3899]) + 1, math.nan)] * CHUNK
    for message in nothing:
        torque.publish(message)
    rig.wait_for_level(DiagnosticStatus.WARN, f'{CHUNK} messages refused in 1 s: see rejected')
    assert rejected(rig) == {'non_finite': CHUNK}
    stamps = [
        array.header.stamp.sec + 1e-9 * array.header.stamp.nanosec for array in rig.diagnostics
    ]
    rig.peer.wait(lambda: len(rig.diagnostics) >= len(stamps) + 2, 'two more')
    stamps = [
        array.header.stamp.sec + 1e-9 * array.header.stamp.nanosec for array in rig.diagnostics
    ]
    assert np.median(np.diff(stamps)) == pytest.approx(1.0, abs=0.1)
    assert {s.name for array in rig.diagnostics for s in array.status} == {
        'gray_box_observer: motor'
    }


def test_a_delay_that_was_not_declared_is_a_warning_and_an_asked_for_one_is_applied(rig, record):
    recording = record('R[5,15]D[0.2,2]', 10.0, torque_noise_relative=0.01)
    early = replace(
        recording, voltage_v=np.roll(recording.voltage_v, -5, axis=1)
    )  # voltage leads by 50 ms
    rig.start()
    rig.send(early, range(900))
    rig.wait_for_level(DiagnosticStatus.WARN, 'voltage seems to lead torque by ')
    assert 'motor.delay to 0.0' in rig.status().message
    assert float(rig.values()['delay [s]']) == pytest.approx(0.05, abs=1e-3)
    assert 0.0 < float(rig.values()['delay std [s]']) < 1e-3
    assert rig.values()['delay verdict'] == 'undeclared'
    words = r'found in the data: 0\.0\d+ \+- \S+ s; applied: 0 s, as declared'
    assert re.fullmatch(words, rig.values()['delay in words'])
    rig.peer.end(rig.process)
    rig.start(motor__delay='estimate')
    rig.wait_for(samples_used=0)
    rig.send(early, range(900))
    rig.wait_for(delay_verdict='estimated')
    assert float(rig.values()['delay applied [s]']) == pytest.approx(0.05, abs=1e-3)
    assert rig.values()['delay in words'].endswith(
        f'applied: {rig.values()["delay applied [s]"]} s, as estimated'
    )
    said = rig.call(GetParameters, 'get_parameters', names=['motor.delay']).values[0]
    assert said.string_value == 'estimate'


def test_torque_of_the_wrong_sign_is_called_implausible(rig, record):
    rig.start(torque__scale=-1.0)
    rig.send(record(EXCITATION, 8.0), range(800))
    rig.wait_for_level(DiagnosticStatus.WARN, ': check torque_constant, units and sign')
    assert any(
        ' bound of ' in status.message for array in rig.diagnostics for status in array.status
    )
    assert rig.latched(Bool, 'motor/identified').data is False


def test_torque_is_predicted_before_it_is_measured(rig, record):
    rig.start(**SMALL_NETWORK)
    recording = record(EXCITATION, 30.0)
    indices = iter(range(3000))
    while not rig.predicted:  # the training process needs a few seconds to start
        rig.send(recording, [next(indices)])
        rig.peer.executor.spin_once(timeout_sec=0.01)
    voltage, torque = rig.signals()
    for k in (next(indices) for _ in range(30)):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        voltage.publish(rig.state('motor', stamp_ns, float(recording.voltage_v[0, k])))
        expected = rig.state('motor', stamp_ns).header.stamp
        rig.peer.wait(
            lambda stamp=expected: rig.predicted[-1].header.stamp == stamp, 'the prediction'
        )
        torque.publish(rig.state('motor', stamp_ns, float(recording.torque_nm[0, k])))
    stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for m in rig.predicted]
    assert stamps == sorted(set(stamps)), 'each stamp is predicted once'
    assert all(list(m.name) == ['motor'] and math.isfinite(m.effort[0]) for m in rig.predicted)
    rig.wait_for_level(DiagnosticStatus.STALE, 'no new sample')
    assert int(rig.values()['training jobs done']) >= 1


def test_an_open_brush_raises_the_alarm_for_whoever_listens_and_in_diagnostics(rig, record):
    recording = record(
        EXCITATION, 10.0, torque_noise_relative=0.01, schedule=('motor.resistance=1000@8.0',)
    )
    rig.start(**{**SMALL_NETWORK, 'variant': 'physics', 'training__hidden': 12}, alarm__learn=300)
    assert rig.latched(Bool, 'motor/alarm').data is False, 'it is told at activation'
    said = rig.peer.listen(Bool, f'{NODE}/motor/alarm', LATCHED_QOS)
    rig.send(recording, range(800))
    rig.wait_for(samples_used=800, residual_alarm='armed', alarms_raised=0)
    assert float(rig.values()['residual std [N m]']) > 0.0
    rig.send(recording, range(800, 840))
    rig.wait_for(samples_used=840, residual_alarm='raised', alarms_raised=1)
    rig.peer.wait(
        lambda: len(said) > 1, 'the alarm'
    )  # another topic than that of diagnostics: either may be first
    assert [message.data for message in said] == [False, True]
    rig.send(recording, range(840, 860))
    rig.wait_for_level(
        DiagnosticStatus.WARN,
        'blocked rotor, open brush, changed winding, weak magnet or a wrong sensor?',
    )
    assert rig.call(Trigger, 'reset').success
    assert rig.latched(Bool, 'motor/alarm').data is False


def test_where_a_held_voltage_leads_is_published_with_the_stamp_of_the_horizon(rig, record):
    recording = record(EXCITATION, 2.0)
    forecasts = rig.peer.listen(JointState, f'{NODE}/forecast_torque', SIGNAL_QOS)
    rig.start(**{'predictor': 'true', 'training__period': 100000}, horizon_s=0.25)
    voltage, torque = rig.signals()
    core = Observer(Configuration.from_flat({'training.period': 100000}), InlineTraining)
    expected = {}
    heard: dict[int, float] = {}
    for k in range(80):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        voltage_v = float(recording.voltage_v[0, k])
        torque_nm = float(recording.torque_nm[0, k])
        voltage.publish(rig.state('motor', stamp_ns, voltage_v))
        core.voltage('motor', stamp_ns, voltage_v)
        held = core.forecast_held('motor', 0.25)
        if held is not None:
            expected[held.stamp_ns] = held.torque_nm
            wanted = rig.state('motor', held.stamp_ns).header.stamp
            rig.peer.wait(
                lambda stamp=wanted: forecasts and forecasts[-1].header.stamp == stamp,
                'the forecast',
            )
            assert list(forecasts[-1].name) == ['motor']
            heard[held.stamp_ns] = forecasts[-1].effort[0]
        torque.publish(rig.state('motor', stamp_ns, torque_nm))
        core.torque('motor', stamp_ns, torque_nm)
        if k == 0:
            rig.wait_for(samples_used=1)
    assert len(expected) == 79
    # a voltage may overtake the torque of the sample before, which is then predicted on the way
    assert heard == pytest.approx(expected, abs=0.01 * float(recording.torque_nm.std()))


def test_the_default_predictor_speaks_from_the_second_sample_on(rig, record):
    rig.start(predictor='true')
    recording = record(EXCITATION, 8.0)
    voltage, torque = rig.signals()
    for k in range(20):
        stamp_ns = START_NS + int(recording.stamp_ns[k])
        voltage.publish(rig.state('motor', stamp_ns, float(recording.voltage_v[0, k])))
        if k:
            expected = rig.state('motor', stamp_ns).header.stamp
            rig.peer.wait(
                lambda stamp=expected: rig.predicted and rig.predicted[-1].header.stamp == stamp,
                'the prediction',
            )
        torque.publish(rig.state('motor', stamp_ns, float(recording.torque_nm[0, k])))
        rig.wait_for(samples_used=k + 1) if k == 0 else None
    assert all(math.isfinite(m.effort[0]) for m in rig.predicted)
    assert len(rig.predicted) == 19


def test_what_was_learnt_is_saved_forgotten_and_loaded(rig, record, tmp_path, learnt_offline):
    path = tmp_path / 'new' / 'motor.safetensors'
    recording = record(EXCITATION, 12.0)
    rig.start(checkpoint__path=path)
    answer = rig.call(Trigger, 'save')
    assert (answer.success, answer.message) == (
        False,
        'nothing to save yet: no motor has been seen',
    )
    answer = rig.call(Trigger, 'load')
    assert (answer.success, answer.message) == (
        False,
        f'cannot read {path}: No such file or directory',
    )
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    learnt = rig.estimates()
    answer = rig.call(Trigger, 'save')
    assert (answer.success, answer.message) == (True, f'saved to {path}')
    assert [entry.name for entry in path.parent.iterdir()] == ['motor.safetensors']

    assert rig.call(Trigger, 'reset').success
    assert rig.latched(Bool, 'motor/identified').data is False
    rig.wait_for(samples_used=0)
    rig.send(recording, range(60))
    rig.wait_for(samples_used=60)
    assert rig.estimates() == learnt_offline(recording, range(60))
    assert rig.call(Trigger, 'load').message == f'loaded from {path}'
    assert rig.estimates() == learnt
    assert rig.latched(Bool, 'motor/identified').data is True
    path.write_bytes(b'no checkpoint')
    assert (
        rig.call(Trigger, 'load').message
        == f'{path} is not a checkpoint of this package, or was cut short'
    )
    assert rig.estimates() == learnt


def test_a_frozen_observer_learns_nothing_and_stays_frozen_when_it_is_reset(rig, record):
    recording = record(EXCITATION, 8.0)
    rig.start()
    rig.send(recording, range(400))
    rig.wait_for(samples_used=400)
    before = rig.estimates()
    assert rig.call(SetBool, 'freeze', data=True).message == 'frozen'
    assert rig.call(GetParameters, 'get_parameters', names=['freeze']).values[0].bool_value
    rig.send(recording, range(400, 600))
    rig.wait_for(samples_used=600)
    assert rig.estimates() == before
    assert rig.values()['resistance verdict'] == 'frozen'
    assert rig.call(Trigger, 'reset').success
    rig.send(recording, range(600, 700))
    rig.wait_for(samples_used=100)
    assert rig.values()['resistance verdict'] == 'frozen'
    thaw = Parameter(
        name='freeze', value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=False)
    )
    assert rig.call(SetParameters, 'set_parameters', parameters=[thaw]).results[0].successful
    rig.send(recording, range(700, 800))
    rig.wait_for(samples_used=200)
    assert rig.values()['resistance verdict'] != 'frozen'


def test_the_life_cycle_is_followed_and_only_cleaning_up_forgets(rig, record, learnt_offline):
    recording = record(EXCITATION, 8.0)
    rig.start(autostart='false')
    assert rig.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    assert not rig.call(Trigger, 'reset').success
    assert rig.change(Transition.TRANSITION_CONFIGURE)
    assert rig.lifecycle_state() == State.PRIMARY_STATE_INACTIVE
    rig.wait_for_level(DiagnosticStatus.STALE, 'inactive: activate the node')
    assert rig.peer.node.count_subscribers('/motor/voltage') == 0
    assert rig.change(Transition.TRANSITION_ACTIVATE)
    rig.send(recording, range(300))
    rig.wait_for(samples_used=300)

    assert rig.change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_until_deaf()
    assert rig.change(Transition.TRANSITION_ACTIVATE)
    rig.send(recording, range(300, 600))
    rig.wait_for(samples_used=600)
    assert rig.estimates() == learnt_offline(recording, range(600)), 'a pause costs nothing'

    assert rig.change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_until_deaf()
    assert rig.change(Transition.TRANSITION_CLEANUP)
    assert rig.change(Transition.TRANSITION_CONFIGURE)
    assert rig.change(Transition.TRANSITION_ACTIVATE)
    assert rig.latched(Bool, 'motor/identified').data is False
    rig.wait_for_level(DiagnosticStatus.STALE, 'nothing received for this motor')
    rig.send(recording, range(100))
    rig.wait_for(samples_used=100)
    assert rig.estimates() == learnt_offline(recording, range(100))
    assert rig.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert rig.lifecycle_state() == State.PRIMARY_STATE_FINALIZED
    assert rig.peer.end(rig.process)[0] == 0


def test_several_motors_share_their_messages_in_a_namespace(make_rig, record):
    rig = make_rig('/plant')
    recording = record('R[5,15]D[0.1,1]', 4.0, motors=('left', 'right'))
    rig.start('--ros-args', '-r', '__ns:=/plant', motors='[right, left]')
    rig.send(recording, range(400))
    rig.wait_for('left', samples_used=400)
    rig.wait_for('right', samples_used=400)
    assert rig.estimates('left') == pytest.approx(TRUTH, rel=1e-3)
    assert rig.estimates('right') == pytest.approx({**TRUTH, 'resistance': 1.5}, rel=1e-3)


def test_other_message_types_are_read_by_field_path_and_stamped_by_the_middleware(rig):
    """The truth: the closed form without hysteresis, at the times of the wall clock."""
    rig.start(
        voltage__topic='drive/volts',
        voltage__type='std_msgs/msg/Float64',
        voltage__field='data',
        torque__topic='sensor/wrench',
        torque__type='geometry_msgs/msg/WrenchStamped',
        torque__field='wrench.torque.z',
        motor__context_nodes='[inductance, resistance]',
        motor__back_emf_constant=0.0,
    )
    volts = rig.peer.publisher(Float64, 'drive/volts', SIGNAL_QOS, readers=1)
    wrenches = rig.peer.publisher(WrenchStamped, 'sensor/wrench', SIGNAL_QOS, readers=1)
    rng = np.random.default_rng(1)
    current_a = 0.0
    voltage_v = 0.0
    before_ns = time.time_ns()
    for k in range(200):
        wrench = WrenchStamped()
        now_ns = time.time_ns()
        decay = math.exp(-(now_ns - before_ns) * 1e-9 * 2.0 / 0.5)  # 0.5 H, 2 ohm
        current_a = voltage_v / 2.0 + (current_a - voltage_v / 2.0) * decay
        wrench.header.stamp.sec, wrench.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
        wrench.wrench.torque.z = 0.01 * current_a
        if k:
            wrenches.publish(wrench)
        before_ns = now_ns
        if k % 20 == 0:
            voltage_v = rng.uniform(5.0, 15.0)
        volts.publish(Float64(data=voltage_v))
        rig.peer.executor.spin_once(timeout_sec=0.0)
        time.sleep(0.01)
    # the last torque waits for the voltage at its stamp, which came after it
    rig.wait_for(torque_messages=199)
    found = {
        name: rig.latched(Float64, f'motor/{name}').data for name in ('inductance', 'resistance')
    }
    assert found == pytest.approx({'inductance': 0.5, 'resistance': 2.0}, rel=0.05)
    _, _, said = rig.peer.end(rig.process)
    assert (
        said.count('std_msgs/msg/Float64 has no header: voltage is stamped by the middleware') == 1
    )


def test_a_field_that_the_type_has_not_is_refused_before_any_message(end_here):
    wrench = {
        'torque__type': 'geometry_msgs/msg/WrenchStamped',
        'torque__field': 'wrench.torque.zz',
    }
    code, _, said = end_here(MODULE, *parameter_words(predictor='false', **wrench))
    errors = [line for line in said.splitlines() if 'error' in line]
    assert code == 2
    assert errors == [
        "observer: error: torque.field 'wrench.torque.zz' on motor/torque: "
        "WrenchStamped.wrench.torque has no field 'zz'; there are: x, y, z"
    ]


def test_a_first_message_that_is_too_short_for_the_field_is_malformed_and_the_node_goes_on(rig):
    rig.start(torque__field='effort[3]')
    torque = rig.peer.publisher(JointState, 'motor/torque', SIGNAL_QOS, readers=1)
    torque.publish(rig.state('motor', START_NS, 1.0))
    rig.wait_for(**{'torque topic: unreadable': 1})
    torque.publish(rig.state('motor a b c', START_NS, 1.0, 2.0, 3.0, 4.0))
    rig.wait_for(torque_messages=1)


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'motor__torque_constant': -0.01}, 'motor.torque_constant'),
        (
            {'voltage__type': 'std_msgs/msg/Voltage'},
            "voltage.type 'std_msgs/msg/Voltage' is not a message",
        ),
        ({'recursive__block': 'many'}, 'recursive.block'),
    ],
)
def test_a_start_that_makes_no_sense_is_one_line_and_exit_code_2(peer, parameters, words):
    check_one_line(peer.end(peer.start(MODULE, **parameters), None), words)


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [
        ({'motor__context_nodes': '[inductance, mass]'}, 'mass'),
        ({'context_update': 'magic'}, 'context_update must be one of recursive, gradient'),
        ({'voltage__type': 5}, 'voltage.type'),
        ({'motors': '[left-hand]'}, 'motors must be distinct names'),
        ({'motor__initial__resistance': 'nan'}, 'motor.initial.resistance'),
        ({'motor__delay': 'guess'}, "motor.delay must be a number or estimate, got 'guess'"),
    ],
)
def test_so_is_any_other_in_the_process_of_the_test(end_here, parameters, words):
    check_one_line(end_here(MODULE, *parameter_words(**parameters)), words)


def check_one_line(ended: tuple[int, str, str], words: str) -> None:
    """Check that a start has ended with code 2 and one line that says why."""
    code, out, said = ended
    assert code == 2
    # the middleware may tell there of a port in shared memory that another one holds
    assert all('RTPS_TRANSPORT_SHM' in line for line in out.splitlines())
    assert said.startswith('observer: error: ')
    assert words in said
    assert said.count('\n') == 1


def test_messages_of_other_motors_only_are_told_once_with_what_to_do(rig):
    rig.start(motors='[left, right]')
    for topic in rig.signals():
        topic.publish(rig.state('left', START_NS, 0.1))
        topic.publish(rig.state('motor_1 motor_0', START_NS, 0.1, 0.2))
    rig.wait_for('left', samples_used=1)
    for _ in range(2):  # two more rounds of diagnostics
        rig.diagnostics.clear()
        rig.peer.wait(lambda: rig.diagnostics, 'diagnostics')
    _, _, said = rig.peer.end(rig.process)
    (warning,) = [line for line in said.splitlines() if 'speaks of' in line]
    assert (
        'motor/voltage speaks of motor_0, motor_1 and not of right: give the parameter motors the '
        'names' in warning
    )


def test_a_robot_whose_other_joints_have_names_too_is_no_reason_to_warn(rig):
    rig.start(motors='[left]')
    for topic in rig.signals():
        topic.publish(rig.state('left elbow', START_NS, 0.1, 0.2))
    rig.wait_for('left', samples_used=1)
    assert 'speaks of' not in rig.peer.end(rig.process)[2]


def test_help_says_how_to_give_parameters(end_here):
    code, out, said = end_here(MODULE, '--help')
    assert (code, said) == (0, '')
    assert '--params-file' in out


@pytest.fixture
def training(rig, record) -> Iterator[Callable[[], psutil.Process]]:
    """Start an observer whose training process runs; return that process."""

    def begin() -> psutil.Process:
        rig.start(**SMALL_NETWORK)
        rig.send(record(EXCITATION, 8.0), range(100))
        rig.peer.wait(rig.children, 'the training process')
        (child,) = rig.children()
        return child

    return begin


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_soon_and_its_training_process_too(rig, training, number):
    child = training()
    asked_s = time.monotonic()
    code, _, said = rig.peer.end(rig.process, number)
    assert code == 0
    assert time.monotonic() - asked_s < END_S
    assert 'error' not in said
    rig.wait_until_gone(child)


@pytest.mark.timeout(660)
def test_a_killed_observer_leaves_no_training_process_behind(rig, training):
    child = training()
    assert rig.peer.end(rig.process, signal.SIGKILL)[0] == -signal.SIGKILL
    # it reads its end only when it has loaded torch, which takes a busy machine long
    rig.wait_until_gone(child)


def test_a_training_process_that_dies_is_reported_and_costs_no_sample(
    rig, training, record, learnt_offline
):
    child = training()
    child.kill()
    rig.wait_until_gone(child)  # at low priority it takes a busy machine a while to end
    rig.send(record(EXCITATION, 8.0), range(100, 800))
    rig.wait_for(samples_used=800)
    rig.wait_for_level(DiagnosticStatus.ERROR, 'training ended: exit status -9')
    assert rig.estimates() == learnt_offline(record(EXCITATION, 8.0), range(800))
