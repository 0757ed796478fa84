"""What operators read: levels, advice and numbers of the running observer."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from gray_box_observer.ros.observer.diagnostics import REJECTIONS
from gray_box_observer.safe_io.bounded_yaml import read_yaml
from gray_box_observer.samples import Rejection

pytestmark = pytest.mark.system

CONFIG = Path(__file__).resolve().parents[3] / 'src' / 'gray_box_observer' / 'config'
EXCITATION = 'R[5,15]D[0.1,1]'
START_NS = 1_000_000_000
CHUNK = 20


def test_every_reason_of_refusal_has_its_advice():
    assert set(REJECTIONS) == set(Rejection)


def test_the_numbers_of_a_healthy_motor(rig, record):
    recording = record(EXCITATION, 12.0, torque_noise_relative=0.01)
    rig.start()
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    said = []
    for k in range(
        600, 1100, 10
    ):  # the level is that of the last second: it has to be heard while samples come
        rig.send(recording, range(k, k + 10))
        rig.peer.executor.spin_once(timeout_sec=0.05)
        said += [(s.level, s.message) for array in rig.diagnostics for s in array.status]
    rig.wait_for(samples_used=1100)
    identified = [message for level, message in said if level == DiagnosticStatus.OK]
    assert any(
        message.startswith('every parameter identified; assumed: ') for message in identified
    )
    status = rig.status()
    assert (status.name, status.hardware_id) == ('gray_box_observer: motor', 'motor')
    values = rig.values()
    for key in ('samples missing', 'pauses', 'signal restarts', 'motor changes'):
        assert values[key] == '0', key
    assert values['rejected'] == 'none'
    assert values['age of checkpoint [s]'] == 'unknown'
    assert 0.0 <= float(values['CPU of this process [%]']) < 200.0
    assert 0.0 <= float(values['time spent on messages [%]']) <= 100.0
    assert float(values['age of newest sample [s]']) > 1e8, 'stamps of a recording are long ago'


def test_observers_in_namespaces_are_told_apart_and_the_aggregator_finds_them(make_rig):
    for namespace in ('', '/r1', '/r2/arm'):
        make_rig(namespace).start('--ros-args', '-r', f'__ns:={namespace or "/"}')
    rig = make_rig()
    wanted = {
        ('gray_box_observer: motor', 'motor'),
        ('r1/gray_box_observer: motor', 'r1/motor'),
        ('r2/arm/gray_box_observer: motor', 'r2/arm/motor'),
    }

    def heard() -> set[tuple[str, str]]:
        return {
            (status.name, status.hardware_id)
            for array in rig.diagnostics
            for status in array.status
        }

    rig.peer.wait(lambda: heard() == wanted, 'the diagnostics of three observers')
    parameters = read_yaml(CONFIG / 'diagnostic_aggregator.yaml')['/**']['ros__parameters']
    (word,) = parameters['motors']['contains']
    assert all(word in name for name, _ in wanted)


def test_a_signal_that_falls_silent_is_named_and_so_is_a_driver_that_is_gone(rig, record):
    recording = record(EXCITATION, 60.0)
    rig.start()
    voltage, torque = rig.signals()
    rig.send(recording, range(100))
    rig.wait_for(samples_used=100)
    stamps_ns = (START_NS + int(recording.stamp_ns[k]) for k in itertools.count(100))

    def told() -> bool:
        voltage.publish(rig.state('motor', next(stamps_ns), 5.0))
        wanted = 'no new sample: motor/torque has fallen silent: does its driver run?'
        return any(
            (status.level, status.message) == (DiagnosticStatus.STALE, wanted)
            for array in rig.diagnostics
            for status in array.status
        )

    rig.peer.wait(told, 'the word that torque has fallen silent')
    rig.peer.node.destroy_publisher(torque)
    rig.wait_for_level(
        DiagnosticStatus.STALE, 'no new sample: nobody publishes /motor/torque: start its driver'
    )
    rig.peer.node.destroy_publisher(voltage)
    rig.wait_for_level(DiagnosticStatus.STALE, 'nobody publishes /motor/voltage: start its driver')


def test_refusals_name_what_to_look_at(rig, record):
    recording = record(EXCITATION, 8.0)
    rig.start()
    voltage, torque = rig.signals()
    rig.diagnostics.clear()
    rig.peer.wait(
        lambda: rig.diagnostics, 'diagnostics to count from'
    )  # what came before them is in no second
    for k in range(CHUNK):
        torque.publish(
            rig.state('motor', START_NS + int(recording.stamp_ns[k]))
        )  # a name without a value
    rig.wait_for_level(
        DiagnosticStatus.WARN,
        'messages refused in 1 s: see rejected (1 names but 0 values of effort: names and values',
    )
    rig.wait_for_level(
        DiagnosticStatus.ERROR, 'could be read: see rejected (1 names but 0 values of effort)'
    )
    rig.send(recording, range(100))
    rig.wait_for(samples_used=100)
    for _ in range(CHUNK):
        voltage.publish(rig.state('motor', START_NS, math.inf))
    rig.wait_for_level(DiagnosticStatus.WARN, '(NaN or infinity: is the sensor connected?)')


def test_an_estimate_far_from_the_data_sheet_is_told(rig, record):
    recording = record(EXCITATION, 40.0, torque_noise_relative=0.01)
    rig.start(motor__initial__resistance=0.5, motor__initial_relative_std__resistance=0.05)
    rest = iter(range(0, 4000, CHUNK))
    told = 'from the 0.5 ohm +- 5 % given: check torque_constant'

    def is_told() -> bool:
        if (k := next(rest, None)) is not None:
            rig.send(recording, range(k, k + CHUNK))
        statuses = [status for array in rig.diagnostics for status in array.status]
        return any(
            status.level == DiagnosticStatus.WARN and told in status.message for status in statuses
        )

    rig.peer.wait(is_told, 'the word that R is not what was given')


def test_a_change_that_is_followed_is_told_as_one(rig, record):
    recording = record(
        EXCITATION, 16.0, torque_noise_relative=0.01, schedule=('motor.resistance=2.0@8.0',)
    )
    rig.start(**{'predictor': 'true', 'training__period': 100000}, alarm__learn=300)
    rig.send(recording, range(800))
    rig.wait_for(samples_used=800, residual_alarm='armed')
    told: list[str] = []

    def is_told() -> bool:
        if (k := next(rest, None)) is not None:
            rig.send(recording, range(k, k + 2))
        statuses = [status for array in rig.diagnostics for status in array.status]
        values = [{pair.key: pair.value for pair in status.values} for status in statuses]
        changed = [v['changes since last identified'] != '0' for v in values]
        told.extend(
            status.message for status, since in zip(statuses, changed, strict=True) if since
        )
        return bool(told)

    rest = iter(range(800, 1600, 2))
    rig.peer.wait(is_told, 'the word that the motor has changed')
    # a machine that is too slow for this test has something else to say first
    assert all('followed' in message or 'queue up' in message for message in told), told
    rig.peer.wait(lambda: rig.values()['motor changes'] == '1', 'the count')
