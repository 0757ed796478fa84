"""The node as a process of its own, on real DDS."""

from __future__ import annotations

import re
import signal
import time
from dataclasses import fields

import psutil
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from sensor_msgs.msg import JointState
from tests.ended_starts import parameter_words

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.quantity import quantity_of
from dc_motor_sim.ros import topics
from dc_motor_sim.simulation import Simulation

pytestmark = pytest.mark.system

MODULE = 'dc_motor_sim.ros.motor_sim'


class Listener:
    """Keeps whatever motor_sim publishes, and can talk to it."""

    def __init__(self, peer):
        self.peer = peer
        self.wait = peer.wait
        self.voltage, self.torque, self.clock = (
            peer.listen(topic.type, topic.name)
            for topic in (topics.VOLTAGE, topics.TORQUE, topics.CLOCK)
        )
        self.command = peer.publisher(
            topics.VOLTAGE_COMMAND.type, topics.VOLTAGE_COMMAND.name, topics.VOLTAGE_COMMAND.qos
        )

    def call(self, type_, service, request):
        """Call a service of motor_sim and return its answer."""
        return self.peer.call(type_, f'/motor_sim/{service}', request)

    def send(self, **voltages):
        """Command voltages by motor, once motor_sim listens."""
        self.wait(self.command.get_subscription_count, 'motor_sim to listen')
        self.command.publish(JointState(name=list(voltages), effort=list(voltages.values())))


@pytest.fixture
def listener(peer):
    return Listener(peer)


@pytest.fixture
def launch(peer):
    def launch_one(**values):
        return peer.start(MODULE, wait_for_subscribers=1, **values)

    return launch_one


def stamp_ns(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def number(name, value):
    return Parameter(
        name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    )


def test_what_is_published_is_the_simulation_sample_by_sample_on_the_exact_grid(listener, launch):
    began_ns = time.time_ns()
    process = launch(
        duration_s=1.0,
        seed=7,
        sample_rate_hz=300.0,
        torque_noise_std=0.01,
        excitation='R[1,2]D[0.1,0.2]',
    )
    listener.wait(lambda: len(listener.torque) == len(listener.voltage) == 300, 'all samples')
    code, _, err = listener.peer.end(process, None)
    assert code == 0
    assert 'published 300 samples' in err

    truth = Simulation(
        {'motor': PlantParameters()},
        'R[1,2]D[0.1,0.2]',
        sample_rate_hz=300.0,
        seed=7,
        torque_noise_std=0.01,
    ).record(1.0)
    stamps = [stamp_ns(message) for message in listener.torque]
    assert [stamp - stamps[0] for stamp in stamps] == truth.stamp_ns.tolist()
    assert [stamp_ns(message) for message in listener.voltage] == stamps
    assert began_ns < stamps[0] < time.time_ns()
    assert [message.effort[0] for message in listener.voltage] == truth.voltage_v[0].tolist()
    assert [message.effort[0] for message in listener.torque] == truth.torque_nm[0].tolist()
    assert all(list(m.name) == ['motor'] and not m.velocity for m in listener.torque)


def test_a_sped_up_clock_starts_at_zero_and_finishes_early(listener, launch):
    process = launch(
        duration_s=10.0,
        sample_rate_hz=20.0,
        publish_clock='true',
        clock_speed_up=10.0,
        speed_mode='rotor',
        motors='[left, right]',
    )
    listener.wait(lambda: len(listener.torque) == len(listener.voltage) == 200, 'all samples')
    listener.wait(lambda: len(listener.clock) == 200, 'the clock')
    assert listener.peer.end(process, None)[0] == 0
    stamps = [k * 50_000_000 for k in range(200)]
    assert [stamp_ns(message) for message in listener.torque] == stamps
    clock_ns = [
        message.clock.sec * 1_000_000_000 + message.clock.nanosec for message in listener.clock
    ]
    assert clock_ns == stamps, 'every message of the clock'
    assert topics.CLOCK.qos.depth >= 100, 'messages that the transport drops are sent again'
    last = listener.torque[-1]
    assert list(last.name) == ['left', 'right']
    assert len(last.velocity) == len(last.effort) == 2
    assert last.velocity[0] == pytest.approx(
        last.effort[0], rel=0.2
    )  # unit friction: w follows Kt i


def test_a_live_resistance_takes_effect_and_a_set_with_a_bad_one_changes_nothing(listener, launch):
    launch(excitation='C[10]', motor__hysteresis=0.0, sample_rate_hz=50.0)
    settled = 0.01 * 10.0 / 1.0001
    listener.wait(
        lambda: listener.torque and listener.torque[-1].effort[0] > 0.999 * settled,
        'a settled torque',
    )

    bad = [number('motor.inductance', 0.1), number('motor.resistance', -1.0)]
    answer = listener.call(
        SetParametersAtomically,
        'set_parameters_atomically',
        SetParametersAtomically.Request(parameters=bad),
    ).result
    assert not answer.successful
    assert 'motor.resistance' in answer.reason
    answer = listener.call(
        SetParameters,
        'set_parameters',
        SetParameters.Request(parameters=[number('motor.inductance', float('nan'))]),
    ).results[0]
    assert not answer.successful
    present = listener.call(
        GetParameters,
        'get_parameters',
        GetParameters.Request(names=['motor.inductance', 'motor.resistance']),
    )
    assert [value.double_value for value in present.values] == [0.5, 1.0]

    good = SetParameters.Request(parameters=[number('motor.resistance', 2.0)])
    assert listener.call(SetParameters, 'set_parameters', good).results[0].successful
    listener.wait(
        lambda: listener.torque[-1].effort[0] < 0.501 * settled, 'the torque of the new resistance'
    )
    listener.wait(
        lambda: listener.torque[-1].effort[0] == pytest.approx(0.1 / 2.0001, rel=1e-4), 'settling'
    )


def test_what_was_fixed_at_the_start_cannot_be_set(listener, launch):
    launch()
    request = SetParameters.Request(parameters=[number('sample_rate_hz', 50.0)])
    answer = listener.call(SetParameters, 'set_parameters', request).results[0]
    assert not answer.successful
    assert 'read-only' in answer.reason


def test_a_schedule_shows_in_torque_and_parameters(listener, launch):
    process = launch(
        excitation='C[10]',
        motor__hysteresis=0.0,
        schedule='[motor.resistance=2.0@4]',
        sample_rate_hz=20.0,
        publish_clock='true',
        clock_speed_up=10.0,
    )
    listener.wait(
        lambda: listener.torque and stamp_ns(listener.torque[-1]) > 10_000_000_000, 'ten seconds'
    )
    before, after = (
        [m.effort[0] for m in listener.torque if from_ns < stamp_ns(m) <= from_ns + 500_000_000]
        for from_ns in (3_500_000_000, 9_000_000_000)
    )
    assert before, 'a slow listener may miss samples, not half a second of them'
    assert after
    assert before == pytest.approx([0.1 / 1.0001] * len(before), rel=1e-3)
    assert after == pytest.approx([0.1 / 2.0001] * len(after), rel=1e-3)

    def mirrored():
        request = GetParameters.Request(names=['motor.resistance'])
        return listener.call(GetParameters, 'get_parameters', request).values[0].double_value == 2.0

    listener.wait(mirrored, 'the parameter to follow')
    assert listener.peer.end(process, signal.SIGTERM)[0] == 0


def test_an_external_command_drives_the_plant_and_a_non_finite_one_does_not(listener, launch):
    process = launch(excitation='external', motor__hysteresis=0.0)
    listener.wait(lambda: len(listener.voltage) > 3, 'samples')
    assert {message.effort[0] for message in listener.voltage} == {0.0}
    listener.send(motor=6.0)
    listener.wait(lambda: listener.voltage[-1].effort[0] == 6.0, 'the command')
    listener.wait(lambda: listener.torque[-1].effort[0] > 0.03, 'the torque to rise')
    listener.send(motor=float('nan'))
    listener.send(stranger=3.0)
    listener.send(motor=7.0)
    listener.wait(lambda: listener.voltage[-1].effort[0] == 7.0, 'the second command')
    assert {message.effort[0] for message in listener.voltage} == {0.0, 6.0, 7.0}
    code, _, err = listener.peer.end(process, signal.SIGINT)
    assert code == 0
    assert err.count('voltage command refused') == 1  # the second warning is throttled


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_when_its_readers_have_acknowledged(listener, launch, number):
    inherited = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup hands on that it is ignored
    try:
        process = launch()
    finally:
        signal.signal(signal.SIGHUP, inherited)
    listener.wait(lambda: len(listener.torque) > 20, 'samples')
    code, _, err = listener.peer.end(process, number)
    assert code == 0
    assert 'not acknowledged' not in err
    assert f'published {len(listener.torque)} samples' in err


def test_a_background_job_of_a_script_listens_to_an_interrupt(listener, launch):
    inherited = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts `motor_sim &`
    try:
        process = launch()
    finally:
        signal.signal(signal.SIGINT, inherited)
    listener.wait(lambda: listener.torque, 'samples')
    code, _, _ = listener.peer.end(process, signal.SIGINT)
    assert code == 0


def test_who_interrupts_again_waits_no_longer_for_a_reader_that_hangs(listener, tmp_path):
    peer = listener.peer
    reader = peer.start('gray_box_observer.ros.bags.recorder_node', '-o', str(tmp_path / 'bag'))
    process = peer.start(MODULE, wait_for_subscribers=2)
    listener.wait(lambda: listener.torque, 'samples')
    reader.send_signal(signal.SIGSTOP)
    listener.wait(
        lambda: psutil.Process(reader.pid).status() == psutil.STATUS_STOPPED, 'the reader to hang'
    )
    count = len(listener.torque)
    listener.wait(lambda: len(listener.torque) > count + 5, 'samples that it does not acknowledge')
    process.send_signal(signal.SIGINT)
    while 'waiting up to 30 s for acknowledgements' not in (line := process.stderr.readline()):
        assert line, 'the end of what it says'
    told_s = time.monotonic()
    listener.wait(lambda: time.monotonic() > told_s + 0.7, 'patience to be over')
    process.send_signal(signal.SIGINT)
    code, _, err = peer.end(process, None)
    assert code == 0
    assert (
        float(re.search(r'not acknowledged by every subscriber within ([0-9.]+) s', err)[1]) < 4.5
    )


def test_a_node_waits_for_its_subscribers_only_so_long(peer):
    process = peer.start(MODULE, duration_s=0.1, wait_for_subscribers=1, wait_timeout_s=0.3)
    code, _, err = peer.end(process, None)
    assert code == 0
    assert 'fewer than 1 subscribers after 0.3 s' in err


@pytest.mark.parametrize(
    ('values', 'what'),
    [
        ({'excitation': 'R[5;15]D[1,20]'}, 'column 4'),
        ({'sample_rate_hz': 'fast'}, 'sample_rate_hz must be a number'),
        (
            {'qos_overrides./motor/voltage.publisher.depth': 'deep'},
            'quality of service of motor/voltage',
        ),
    ],
)
def test_a_start_that_makes_no_sense_ends_with_status_2_and_one_line(peer, values, what):
    check_one_line(peer.end(peer.start(MODULE, **values), None), what)


@pytest.mark.parametrize(
    ('values', 'what'),
    [
        ({'motor__resistance': -1.0}, 'motor.resistance must be from 1e-06 to 1e+06 ohm; got -1'),
        ({'sample_rate_hz': 5000.0}, 'sample_rate_hz must be from 1 to 1000 Hz'),
        ({'motors': 'motor'}, 'motors must be a list'),
        ({'speed_mode': 'gear'}, 'speed_mode must be one of thesis, rotor'),
        ({'schedule': '[motor.mass=1@1]'}, "no parameter 'mass'"),
    ],
)
def test_so_does_any_other_in_the_process_of_the_test(end_here, values, what):
    check_one_line(end_here(MODULE, *parameter_words(**values)), what)


def check_one_line(ended, what):
    """Check that a start has ended with status 2 and one line that says why."""
    code, out, err = ended
    assert code == 2
    # the middleware speaks there where a process that was killed has left its shared memory locked
    assert all('RTPS_TRANSPORT_SHM' in line for line in out.splitlines())
    assert err.startswith('motor_sim: error: ')
    assert what in err
    assert err.count('\n') == 1


def test_the_log_names_every_parameter_of_a_motor_with_its_unit(peer):
    _, _, err = peer.end(peer.start(MODULE, duration_s=0.1, motor__resistance=2.5), None)
    (line,) = [line for line in err.splitlines() if 'inductance' in line]
    assert 'motor: R[5,15]D[1,20] at 100 Hz, inductance 0.5 H, resistance 2.5 ohm, ' in line
    for field in fields(PlantParameters):
        assert f' {field.name} ' in line
        assert f' {quantity_of(field).unit}' in line
    assert 'PlantParameters' not in err


def test_a_whole_number_will_do_for_a_parameter_with_a_point(peer):
    code, _, err = peer.end(
        peer.start(MODULE, duration_s=1, motor__resistance=2, sample_rate_hz=10), None
    )
    assert code == 0
    assert 'published 10 samples' in err


@pytest.mark.parametrize(
    ('values', 'what'),
    [
        ({'motor__resistence': 2.0}, 'motor.resistence (did you mean motor.resistance?)'),
        ({'duration': 2.0}, 'duration (did you mean duration_s?)'),
        ({'motr__resistance': 2.0}, 'motr.resistance (did you mean motor.resistance?)'),
        ({'frobnicate': 1}, 'no parameter of motor_sim: frobnicate; --help lists them'),
    ],
)
def test_a_misspelt_parameter_is_refused_with_the_nearest_name(end_here, values, what):
    code, _, err = end_here(MODULE, *parameter_words(duration_s=0.1, **values))
    (line,) = [line for line in err.splitlines() if 'error:' in line]
    assert code == 2
    assert what in line


def test_a_file_may_hold_parameters_of_other_nodes_and_motors_but_no_slip(peer, tmp_path):
    path = tmp_path / 'shared.yaml'
    own = 'motors: [m_1]\n    duration_s: 0.1\n    m_1: {resistance: 2.0}\n'
    others = '    m_2: {resistance: 3.0}\n    gap_s: 1.0\n    m_1.initial.resistance: 1.0\n'
    codes = []
    said = []
    for text in (own + others, own + '    m_1.resistence: 2.0\n'):
        path.write_text(f'/**:\n  ros__parameters:\n    {text}')
        code, _, err = peer.end(peer.start(MODULE, '--ros-args', '--params-file', str(path)), None)
        codes.append(code)
        said.append(err)
    assert codes == [0, 2]
    assert 'no parameter of motor_sim, ignored: m_2.resistance; ' in said[0]
    assert 'gap_s' not in said[0]  # another node's, by the wildcard
    assert 'm_1.resistence (did you mean m_1.resistance?)' in said[1]


def test_a_section_that_names_the_simulator_holds_nothing_but_its_parameters(peer, tmp_path):
    path = tmp_path / 'own.yaml'
    path.write_text('motor_sim:\n  ros__parameters: {duration_s: 0.1, gap_s: 1.0}\n')
    code, _, said = peer.end(peer.start(MODULE, '--ros-args', '--params-file', str(path)), None)
    assert code == 0
    assert 'no parameter of motor_sim, ignored: gap_s; ' in said


def test_what_an_error_quotes_is_shown_and_not_obeyed(end_here):
    code, _, err = end_here(MODULE, '--ros-args', '--params-file', '/no\x1b[31mred')
    (line,) = [line for line in err.splitlines() if 'error:' in line]
    assert code == 2
    assert line.isprintable()
    assert r'parameter file /no\x1b[31mred: cannot be read' in line


@pytest.mark.parametrize(
    ('text', 'complaint'),
    [
        ('{seed: 1, seed: 2}', 'the key seed stands twice'),
        ('[' * 5000 + ']' * 5000, 'more than 32 levels'),
    ],
)
def test_a_file_with_a_key_twice_or_too_deep_is_one_line(end_here, tmp_path, text, complaint):
    path = tmp_path / 'bad.yaml'
    path.write_text(f'/**:\n  ros__parameters: {text}\n')
    code, _, err = end_here(MODULE, '--ros-args', '--params-file', str(path))
    assert code == 2
    assert err.startswith(f'motor_sim: error: parameter file {path}: line 2: {complaint}')
    assert err.count('\n') == 1


def test_help_names_the_parameters_and_starts_nothing(end_here):
    code, out, err = end_here(MODULE, '--help')
    assert code == 0
    assert 'torque_noise_relative' in out
    assert err == ''
