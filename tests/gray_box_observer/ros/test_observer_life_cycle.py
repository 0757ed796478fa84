"""Every transition of the observer's life cycle, what it leaves, and its end under load."""

from __future__ import annotations

import itertools
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from lifecycle_msgs.msg import State, Transition
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.ros.observer.observer_node import ObserverNode
from gray_box_observer.ros.periodic_task import PeriodicTask
from gray_box_observer.ros.running import Stop

pytestmark = pytest.mark.system

EXCITATION = 'R[5,15]D[0.1,1]'
INITIAL = {'inductance': 1.5, 'resistance': 3.0, 'hysteresis': 1.0}
START_NS = 1_000_000_000
END_S = 20.0
"""A node that is asked to end has done so after this time."""

CONFIGURE = Transition.TRANSITION_CONFIGURE
CLEANUP = Transition.TRANSITION_CLEANUP
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
SHUTDOWN = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_INACTIVE_SHUTDOWN,
    State.PRIMARY_STATE_ACTIVE: Transition.TRANSITION_ACTIVE_SHUTDOWN,
}


@pytest.mark.parametrize(
    ('steps', 'state', 'words'),
    [
        ([], State.PRIMARY_STATE_UNCONFIGURED, 'unconfigured: configure the node'),
        ([CONFIGURE], State.PRIMARY_STATE_INACTIVE, 'inactive: activate the node'),
        ([CONFIGURE, ACTIVATE], State.PRIMARY_STATE_ACTIVE, 'nothing received'),
        (
            [CONFIGURE, ACTIVATE, DEACTIVATE],
            State.PRIMARY_STATE_INACTIVE,
            'inactive: activate the node',
        ),
        (
            [CONFIGURE, CLEANUP],
            State.PRIMARY_STATE_UNCONFIGURED,
            'unconfigured: configure the node',
        ),
    ],
)
def test_from_every_state_it_is_told_what_to_do_and_can_be_shut_down(rig, steps, state, words):
    rig.start(autostart='false')
    for step in steps:
        assert rig.change(step)
    assert rig.lifecycle_state() == state
    rig.wait_for_level(b'\x03', words)
    assert rig.change(SHUTDOWN[state])
    assert rig.lifecycle_state() == State.PRIMARY_STATE_FINALIZED
    rig.wait_for_level(b'\x03', 'finalized: start the node anew')
    assert not rig.change(CONFIGURE)
    assert rig.call(Trigger, 'reset').success is False
    assert rig.call(Trigger, 'save').success is False
    code, _, said = rig.peer.end(rig.process)
    assert (code, 'rror' in said) == (0, False)


def test_transitions_that_do_not_exist_change_nothing(rig):
    rig.start(autostart='false')
    for step in (ACTIVATE, DEACTIVATE, CLEANUP):
        assert not rig.change(step)
    assert rig.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    assert rig.change(CONFIGURE)
    assert not rig.change(CONFIGURE)
    assert rig.lifecycle_state() == State.PRIMARY_STATE_INACTIVE


def test_a_transition_that_fails_for_a_reason_tells_it_and_can_be_tried_again(rig):
    rig.start(
        '--ros-args',
        '-p',
        'autostart:=false',
        '-p',
        'qos_overrides./motor/torque.subscription.reliability:=mostly',
    )
    for _ in range(2):
        assert rig.change(CONFIGURE)
        assert not rig.change(ACTIVATE)
        assert rig.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
        assert rig.peer.node.count_subscribers('/motor/voltage') == 0
    said = rig.peer.end(rig.process)[2]
    assert said.count('could not activate: quality of service of motor/torque: ') == 2


@pytest.fixture
def node(peer) -> Iterator[Callable[..., ObserverNode]]:
    """Make an observer in the test's own process, to break it from inside."""
    made: list[ObserverNode] = []
    rclpy.init(
        domain_id=peer.domain,
        args=['--ros-args', '-p', 'predictor:=false', '-p', 'autostart:=false'],
    )

    def make() -> ObserverNode:
        made.append(ObserverNode(Stop()))
        return made[-1]

    yield make
    for one in made:
        one.close()
        one.destroy_node()
    rclpy.shutdown()


def broken(*_: Any) -> None:
    raise ArithmeticError('a defect')


TRANSITIONS = {
    'configure': ([], '_begin'),
    'activate': (['configure'], '_announce'),
    'deactivate': (['configure', 'activate'], '_deactivate'),
    'cleanup': (['configure'], '_drop_observer'),
    'shutdown': (['configure', 'activate'], '_end'),
}


@pytest.mark.parametrize('transition', list(TRANSITIONS))
def test_a_defect_in_any_transition_leads_back_to_unconfigured_and_from_there_on(
    node, transition, monkeypatch, capfd
):
    """Every action of a transition fails unexpectedly; afterwards the node must work."""
    before, action = TRANSITIONS[transition]
    one = node()
    for step in before:
        assert getattr(one, f'trigger_{step}')() == TransitionCallbackReturn.SUCCESS
    with monkeypatch.context() as patch:
        patch.setattr(one, action, broken)
        assert getattr(one, f'trigger_{transition}')() == TransitionCallbackReturn.ERROR
    assert one._state_machine.current_state[1] == 'unconfigured'
    assert one.count_subscribers('/motor/voltage') == 0
    verb = {'cleanup': 'clean up', 'shutdown': 'shut down'}.get(transition, transition)
    said = capfd.readouterr().err
    assert f'could not {verb}: Traceback' in said
    assert 'ArithmeticError: a defect' in said
    for step in ('configure', 'activate', 'deactivate', 'cleanup'):
        assert getattr(one, f'trigger_{step}')() == TransitionCallbackReturn.SUCCESS


def test_an_alarm_still_to_be_told_goes_out_before_what_is_loaded(node, monkeypatch):
    one = node()
    one.trigger_configure()
    one.trigger_activate()
    told: list[bool] = []

    def tell(data: bytes) -> None:
        told.append(deserialize_message(data, Bool).data)

    tell.correct = tell
    monkeypatch.setitem(one._outputs._alarm, 'motor', tell)
    monkeypatch.setattr(one._keeper, 'load', lambda observer: 'c')
    one._session.deferred_results = [
        SimpleNamespace(
            group=SimpleNamespace(names=('motor',), observer=None), alarm=np.array([True])
        )
    ]
    assert one._load(Trigger.Request(), Trigger.Response()).success
    one._tell()
    assert told == [True, False], 'latched: what stands after loading'


FAILED = ConfigurationError('device cuda failed: out of memory')


@pytest.mark.parametrize('place', ['forecast_group', 'precompute_forecast'])
def test_a_device_that_fails_while_it_predicts_asks_for_the_end(node, monkeypatch, place):
    one = node()
    one.trigger_configure()
    one.trigger_activate()
    monkeypatch.setattr(one._session.observer, place, failed)
    for k in range(3):
        for topic in ('voltage', 'torque'):
            message = encode_joint_state(START_NS + k * 10_000_000, ['motor'], effort=[0.1])
            one._inputs._subscriptions[topic].callback(message)
    assert one._stop.error is FAILED


@pytest.mark.parametrize('state', ['active', 'inactive'])
def test_no_number_of_a_motor_that_has_stopped_stays_on_estimates_where_nobody_tells_it_again(
    node, state
):
    one = node()
    one.trigger_configure()
    one.trigger_activate()
    for k in range(3):
        for topic in ('voltage', 'torque'):
            message = encode_joint_state(START_NS + k * 10_000_000, ['motor'], effort=[0.1])
            one._inputs._subscriptions[topic].callback(message)
    one._announce()
    estimates = '/gray_box_observer/estimates'
    assert one.count_publishers(estimates) == 1
    if state == 'inactive':
        one.trigger_deactivate()
    session = one._session
    session.observer.stop(session.observer.group_of('motor'), ArithmeticError('a defect'))
    session.report_incidents()
    assert one.count_publishers(estimates) == 0


def test_a_device_that_fails_beside_the_messages_asks_for_the_end(node, monkeypatch):
    one = node()
    one.trigger_configure()
    one.trigger_activate()
    monkeypatch.setattr(one._outputs, 'alarms', failed)
    answer = one._save(Trigger.Request(), Trigger.Response())
    assert (answer.success, answer.message) == (False, str(FAILED))
    one._tasks.by_name['diagnostics'].do()
    assert one._stop.error is FAILED


def failed(*_: Any) -> None:
    raise FAILED


MESSAGES = {
    'none': b'',
    'of other bytes': b'no message',
    'good': encode_joint_state(1, ['motor'], effort=[1.0]),
}


@pytest.mark.parametrize('data', MESSAGES.values(), ids=MESSAGES)
def test_whatever_messages_come_everything_that_is_late_is_done_beside_them_in_turns(node, data):
    one = node()
    one.trigger_configure()
    one.trigger_activate()
    done: list[str] = []
    tasks = {
        name: PeriodicTask(1e-9, partial(done.append, name))
        for name in ('diagnostics', 'estimates', 'checkpoint')
    }
    one._tasks.by_name = dict(tasks)
    for _ in range(6):
        one._inputs._subscriptions['torque'].callback(data)
    assert sorted(done) == sorted(2 * list(tasks))
    assert one._session.message_input.message_counts['torque'] == 6


def test_reset_publishes_at_once_what_is_known_then(rig, record):
    recording = record(EXCITATION, 8.0)
    rig.start()
    rig.signals()
    assert rig.estimates() == INITIAL, 'from the beginning'
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    assert rig.estimates() != INITIAL
    assert rig.call(Trigger, 'reset').success
    assert rig.estimates() == INITIAL
    covariance = rig.latched(Float64MultiArray, 'motor/covariance').data
    spread = math.sqrt(covariance[0]) / INITIAL['inductance']
    assert spread == pytest.approx(math.expm1(2.0), rel=0.02), (
        'as far as a log-normal of prior_relative_std reaches'
    )


def test_nothing_jumps_but_what_the_state_does(rig, record, tmp_path):
    """Freezing, thawing, saving, pausing and loading publish only freshly learnt values."""
    recording = record(EXCITATION, 12.0, torque_noise_relative=0.01)
    rig.start(checkpoint__path=tmp_path / 'c.safetensors')
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    every = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    heard = rig.peer.listen(Float64, '/gray_box_observer/motor/resistance', every)
    rig.peer.wait(lambda: heard, 'the value so far')
    learnt = heard[-1].data
    for frozen in (True, False):
        assert rig.call(SetBool, 'freeze', data=frozen).success
    assert rig.call(Trigger, 'save').success
    assert rig.change(DEACTIVATE)
    assert rig.change(ACTIVATE)
    rig.peer.wait(lambda: len(heard) >= 3, 'announcements')
    assert {message.data for message in heard} == {learnt}
    rig.send(recording, range(600, 800))
    rig.wait_for(samples_used=800)
    assert heard[-1].data != learnt
    heard.clear()
    assert rig.call(Trigger, 'load').success
    rig.peer.wait(lambda: heard, 'what was loaded')
    assert {message.data for message in heard} == {learnt}


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_soon_while_it_trains_and_a_thousand_samples_a_second_come(
    rig, record, number
):
    recording = record(EXCITATION, 60.0)
    rig.start(
        predictor='true', training__core_share=1.0, training__period=32, training__start='fresh'
    )
    voltage, torque = rig.signals()
    stop = threading.Event()
    sent = []

    def flood() -> None:
        begin_s = time.monotonic()
        for k in itertools.count():
            if stop.wait(max(0.0, begin_s + 0.001 * k - time.monotonic())):
                return
            stamp_ns = START_NS + 1_000_000 * k
            column = k % 6000
            voltage.publish(rig.state('motor', stamp_ns, float(recording.voltage_v[0, column])))
            torque.publish(rig.state('motor', stamp_ns, float(recording.torque_nm[0, column])))
            sent.append(k)

    sender = threading.Thread(target=flood)
    sender.start()
    try:
        rig.peer.wait(lambda: int(rig.values().get('samples used', 0)) > 500, 'samples')
        rig.peer.wait(lambda: int(rig.values().get('training jobs done', 0)) > 0, 'training')
        (child,) = rig.children()
        before = len(sent)
        asked_s = time.monotonic()
        code, _, said = rig.peer.end(rig.process, number)
        assert time.monotonic() - asked_s < END_S
        assert len(sent) > before, 'messages came to the end'
    finally:
        stop.set()
        sender.join()
    assert code == 0
    assert 'error' not in said.lower()
    rig.wait_until_gone(child)
