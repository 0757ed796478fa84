"""A defect in one motor's observer in a running node: only that motor stops."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from safetensors import safe_open
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from .conftest import ACKNOWLEDGE_TIMEOUT_S, CHUNK

pytestmark = pytest.mark.system

FAULTY = 'faulty_observer'
"""A module beside this one."""

DEADLY_NM = 900.0
"""The torque that breaks it."""

NUMBERS = ('inductance', 'resistance', 'hysteresis', 'covariance')
PERIOD_NS = 10_000_000
END_S = 30.0


@pytest.fixture
def faulty(rig, monkeypatch):
    """Start an observer of two motors whose code has a defect."""

    def start(**parameters: object):
        path = os.environ.get('PYTHONPATH', '')
        monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(Path(__file__).parent), path]))
        own = {'predictor': 'false', 'motors': '[left, right]', **parameters}
        rig.process = rig.peer.start(FAULTY, **own)
        return rig

    return start


def send(rig, samples: range, *, right_nm: float | None = None) -> None:
    voltage, torque = rig.signals()
    for k in samples:
        stamp_ns = rig.start_ns + k * PERIOD_NS
        volts = 5.0 + 3.0 * ((k // 7) % 3)
        voltage.publish(rig.state('left right', stamp_ns, volts, volts))
        torque.publish(rig.state('left right', stamp_ns, 0.1 * volts, right_nm or 0.1 * volts))
        if (k + 1) % CHUNK == 0:
            for publisher in (voltage, torque):
                assert publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_TIMEOUT_S))


def publishers(rig, motor: str) -> int:
    topics = [f'/gray_box_observer/{motor}/{name}' for name in NUMBERS]
    return sum(rig.peer.node.count_publishers(topic) for topic in topics)


def end(rig) -> str:
    """End the observer as one in health ends; return its log, which may hold a traceback."""
    rig.peer._running.remove(rig.process)
    rig.process.send_signal(signal.SIGTERM)
    _, said = rig.process.communicate(timeout=END_S)
    assert rig.process.returncode == 0
    return said


def test_the_motor_stops_and_says_so_the_other_goes_on_and_a_reset_starts_it_anew(faulty, tmp_path):
    rig = faulty(checkpoint__path=tmp_path / 'state.safetensors')
    send(rig, range(50))
    rig.wait_for('right', samples_used=50)
    rig.peer.wait(lambda: publishers(rig, 'right') == len(NUMBERS), 'the numbers of the motor')

    send(rig, range(50, 51), right_nm=2.0 * DEADLY_NM)
    rig.wait_for_level(
        DiagnosticStatus.ERROR,
        'stopped by a defect: ZeroDivisionError: a defect of the test (faulty_',
    )
    assert '/gray_box_observer/reset' in rig.status('right').message
    rig.peer.wait(lambda: publishers(rig, 'right') == 0, 'the end of numbers that nobody knows')
    assert rig.latched(Bool, 'right/identified').data is False
    assert rig.latched(Bool, 'right/alarm').data is False

    send(rig, range(51, 81))
    rig.wait_for('left', samples_used=81)
    rig.wait_for('right', torque_messages=81)
    values = rig.values('right')
    assert values['samples used'] == '51'
    assert values['torque messages refused'] == values['voltage messages refused'] == 'stopped: 30'
    assert values['voltages taken'] == '51'
    assert rig.status('left').level != DiagnosticStatus.ERROR
    assert publishers(rig, 'left') == len(NUMBERS)
    file = tmp_path / 'state.incident-1.safetensors'
    rig.peer.wait(file.exists, 'the report')

    assert rig.call(Trigger, 'reset').success
    rig.peer.wait(
        lambda: publishers(rig, 'right') == len(NUMBERS), 'the numbers of a motor that begins anew'
    )
    send(rig, range(81, 111))
    rig.wait_for('right', samples_used=30)
    with safe_open(file, 'numpy') as report:
        assert 'ZeroDivisionError' in report.metadata()['traceback']
        assert report.get_tensor('samples/torque_nm') == 2.0 * DEADLY_NM
    said = end(rig)
    assert said.count('motor right stopped by a defect: ZeroDivisionError') == 1
    assert f'what led there is in {file}' in said


def test_a_defect_in_what_is_left_for_later_stops_its_motor_and_no_other(faulty, monkeypatch):
    monkeypatch.setenv('FAULT', 'fit')
    rig = faulty()
    send(rig, range(600))
    rig.wait_for_level(DiagnosticStatus.ERROR, 'stopped by a defect: ZeroDivisionError')
    rig.wait_for('left', samples_used=600)
    assert rig.status('left').level != DiagnosticStatus.ERROR
    assert 'motor right stopped by a defect' in end(rig)


def test_without_a_folder_for_checkpoints_the_log_alone_tells(faulty, tmp_path):
    rig = faulty(checkpoint__path=tmp_path / 'nowhere' / 'state.safetensors')
    send(rig, range(5))
    send(rig, range(5, 6), right_nm=2.0 * DEADLY_NM)
    rig.wait_for_level(DiagnosticStatus.ERROR, 'stopped by a defect')
    assert not (tmp_path / 'nowhere').exists()
    assert 'Traceback' in end(rig)
