"""The whole system as processes on real DDS: simulator, observer, controller, bags, identify."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64

from gray_box_observer.bag.reader import BagReader
from gray_box_observer.identify.command import main
from gray_box_observer.ros.topics import LATCHED_QOS, SIGNAL_QOS

pytestmark = pytest.mark.system

BAGS = Path(__file__).resolve().parents[2] / 'bags'
SIMULATOR = 'dc_motor_sim.ros.motor_sim'
OBSERVER = 'gray_box_observer.ros.observer.observer_node'
RECORDER = 'gray_box_observer.ros.bags.recorder_node'
PLAYER = 'gray_box_observer.ros.bags.player_node'
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
SAME = 1e-9
"""Relative difference between estimates of the same samples that came through different doors."""

Estimates = dict[str, float]


class Controller:
    """Listens to a controller's inputs: estimates, whether they hold, predicted torque."""

    def __init__(self, peer) -> None:
        self.peer = peer
        self._estimates = {
            name: peer.listen(Float64, f'/gray_box_observer/motor/{name}', LATCHED_QOS)
            for name in TRUTH
        }
        self.identified = peer.listen(Bool, '/gray_box_observer/motor/identified', LATCHED_QOS)
        self.predicted = peer.listen(JointState, '/gray_box_observer/predicted_torque', SIGNAL_QOS)
        self._diagnostics = peer.listen(DiagnosticArray, '/diagnostics')

    def estimates(self) -> Estimates:
        """The newest estimates."""
        self.peer.wait(lambda: all(self._estimates.values()), 'estimates')
        return {name: heard[-1].data for name, heard in self._estimates.items()}

    def counts(self) -> dict[str, str]:
        """The newest diagnostics of the motor."""
        return {
            pair.key: pair.value
            for array in self._diagnostics[-1:]
            for pair in array.status[0].values
        }

    def wait_for_samples(self, count: int) -> None:
        """Wait until the observer has used so many samples and has refused none."""
        try:
            self.peer.wait(
                lambda: self.counts().get('samples used') == str(count), f'{count} samples used'
            )
        except AssertionError as error:
            raise AssertionError(f'{error}; the observer said {self.counts()}') from None
        assert self.counts()['rejected'] == 'none'


@pytest.fixture
def identify(capsys: pytest.CaptureFixture[str]) -> Callable[[Path], dict[str, Any]]:
    """Run the command in the process of the test, without predictor; return its JSON."""

    def run(bag: Path) -> dict[str, Any]:
        capsys.readouterr()
        code = main(['identify', str(bag), '--skip-predictor', '--json', '-'])
        said = capsys.readouterr()
        assert 'Traceback' not in said.err
        assert code == 0, said.err
        return json.loads(said.out)

    return run


def identify_process(*arguments: object) -> dict[str, Any]:
    """Run identify without predictor; return its JSON."""
    command = [
        sys.executable,
        '-m',
        'gray_box_observer.identify.command',
        *map(str, arguments),
        '--skip-predictor',
    ]
    done = subprocess.run(
        [*command, '--json', '-'], capture_output=True, text=True, timeout=60, check=False
    )
    assert 'Traceback' not in done.stderr
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def values_of(result: dict[str, Any]) -> Estimates:
    return {name: found['value'] for name, found in result['motors']['motor']['parameters'].items()}


def test_one_run_gives_the_same_estimates_live_replayed_and_offline(peer, tmp_path, identify):
    live = Controller(peer)
    observer = peer.start(OBSERVER, predictor='false')
    recorder = peer.start(RECORDER, '-o', str(tmp_path / 'bag'))
    peer.wait(lambda: 'bag_recorder' in peer.node.get_node_names(), 'the recorder')
    simulator = peer.start(
        SIMULATOR,
        excitation='R[5,15]D[0.1,1]',
        seed=5,
        duration_s=10.0,
        torque_noise_relative=0.002,
        publish_clock='true',
        clock_speed_up=4.0,
        start_stamp_s=100.0,
        wait_for_subscribers=2,
    )
    assert peer.end(simulator, None)[0] == 0
    live.wait_for_samples(1000)
    found = live.estimates()
    assert found == pytest.approx(TRUTH, rel=0.02)
    assert live.identified[-1].data is True
    assert peer.end(recorder)[0] == 0
    assert peer.end(observer)[0] == 0

    with BagReader(tmp_path / 'bag') as bag:
        recorded = [message.topic for message in bag.messages()]
    assert recorded.count('/motor/voltage') == recorded.count('/motor/torque') == 1000
    assert recorded.count('/gray_box_observer/motor/resistance') > 0  # it may discover it late

    again = Controller(peer)
    observer = peer.start(OBSERVER, predictor='false')
    topics = '[/motor/voltage, /motor/torque]'
    player = peer.start(
        PLAYER, str(tmp_path / 'bag'), rate=4, topics=topics, wait_for_subscribers=1
    )
    assert peer.end(player, None)[0] == 0
    again.wait_for_samples(1000)
    assert again.estimates() == pytest.approx(found, rel=SAME)
    assert peer.end(observer)[0] == 0

    offline = identify_process(tmp_path / 'bag')
    assert values_of(offline) == pytest.approx(found, rel=SAME)
    assert identify(tmp_path / 'bag')['digest'] == offline['digest']


@pytest.mark.parametrize('name', ['training_set', 'moderate', 'drift'])
def test_a_recorded_run_is_identified_within_half_a_percent_of_its_truth(name, identify):
    truth = yaml.safe_load((BAGS / name / 'truth.yaml').read_text())['motors']['motor']
    last = {key: value[-1][1] if isinstance(value, list) else value for key, value in truth.items()}
    result = identify(BAGS / name)
    assert values_of(result) == pytest.approx(last, rel=0.005)
    motor = result['motors']['motor']
    assert motor['samples'] == 12_000
    assert not any(motor['rejected'].values())
    assert {found['verdict'] for found in motor['parameters'].values()} == {'identified'}
    for key, found in motor['parameters'].items():
        assert abs(found['value'] - last[key]) < 5.0 * found['std'], (
            f'{key} is off by more than its std explains'
        )


@pytest.mark.parametrize('name', ['training_set', 'moderate', 'drift'])
def test_with_the_parameters_that_are_shipped_a_recorded_run_warns_of_nothing(name):
    command = [sys.executable, '-m', 'gray_box_observer.identify', str(BAGS / name)]
    params = ['--params', str(BAGS / 'thesis.yaml'), '--skip-predictor']
    done = subprocess.run(
        [*command, *params], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, '')


def test_a_recorded_run_is_made_again_byte_by_byte(tmp_path):
    command = [sys.executable, str(BAGS / 'make_bags.py'), '--out', str(tmp_path), 'drift']
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, '')
    made = {path.name: path.read_bytes() for path in (tmp_path / 'drift').iterdir()}
    kept = {path.name: path.read_bytes() for path in (BAGS / 'drift').iterdir()}
    assert made.keys() == kept.keys()
    assert [name for name in kept if made[name] != kept[name]] == []


def test_a_replay_faster_than_life_loses_nothing(peer):
    controller = Controller(peer)
    peer.start(OBSERVER, predictor='false')
    player = peer.start(
        PLAYER, str(BAGS / 'training_set'), rate=5, start_offset_s=105, wait_for_subscribers=1
    )
    assert peer.end(player, None)[0] == 0
    controller.wait_for_samples(1500)
    assert controller.estimates() == pytest.approx(TRUTH, rel=0.05)
