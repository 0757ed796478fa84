"""Checkpoints of the observer process: kept, resumed after any end, confined to a folder."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from unittest.mock import Mock

import pytest
from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tests.ended_starts import parameter_words

from gray_box_observer.checkpoints.checkpoint import capture, encode, load, save
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.observer.observer_node import ObserverNode
from gray_box_observer.settings.configuration import Configuration

pytestmark = pytest.mark.system

MODULE = 'gray_box_observer.ros.observer.observer_node'

EXCITATION = 'R[5,15]D[0.1,1]'


def text(name: str, value: str) -> Parameter:
    return Parameter(
        name=name, value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    )


def number(name: str, value: float) -> Parameter:
    return Parameter(
        name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    )


def held_by(path: Path) -> dict[str, float]:
    """The estimates in a checkpoint."""
    core = Observer(Configuration.from_flat({'predictor': False}))
    load(core, path)
    estimate = core.estimates()['motor']
    return dict(zip((p.name for p in estimate.parameters), estimate.value[0].tolist(), strict=True))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_is_ended_continues_where_it_was(rig, record, tmp_path, number):
    path = tmp_path / 'new' / 'c.safetensors'
    recording = record(EXCITATION, 12.0)
    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.send(recording, range(400))
    rig.wait_for(samples_used=400)
    learnt = rig.estimates()
    code, _, said = rig.peer.end(rig.process, number)
    assert code == 0
    assert f'starting from the initial values: no checkpoint yet at {path}' in said
    assert held_by(path) == learnt

    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.signals()
    assert rig.estimates() == learnt, 'told before any sample has come'
    assert rig.latched(Bool, 'motor/identified').data is True
    rig.send(recording, range(400, 600))
    rig.wait_for(samples_used=200)
    assert rig.values()['resistance verdict'] == 'identified'
    assert f'continuing from {path}' in rig.peer.end(rig.process)[2]


def test_a_killed_node_continues_from_its_last_automatic_checkpoint(rig, record, tmp_path):
    path = tmp_path / 'c.safetensors'
    recording = record(EXCITATION, 12.0)
    rig.start(checkpoint__path=path, checkpoint__resume='true', checkpoint__period_s=0.1)
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    rig.peer.wait(path.exists, 'a checkpoint')
    rig.send(recording, range(600, 800))
    assert rig.peer.end(rig.process, signal.SIGKILL)[0] == -signal.SIGKILL
    kept = held_by(path)
    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.signals()
    assert rig.estimates() == kept


@pytest.mark.parametrize('damage', ['cut', 'other motor'])
def test_a_checkpoint_that_cannot_be_used_is_kept_aside_and_the_node_lives(
    rig, record, tmp_path, damage
):
    path = tmp_path / 'c.safetensors'
    recording = record(EXCITATION, 8.0)
    core = Observer(Configuration.from_flat({'predictor': False, 'motor.torque_constant': 0.02}))
    for k in range(100):
        core.voltage('motor', int(recording.stamp_ns[k]), float(recording.voltage_v[0, k]))
        core.torque('motor', int(recording.stamp_ns[k]), float(recording.torque_nm[0, k]))
    save(core, path)
    if damage == 'cut':
        path.write_bytes(path.read_bytes()[:1000])
    bad = path.read_bytes()
    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.send(recording, range(400))
    rig.wait_for(samples_used=400)
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    reason = 'was cut short' if damage == 'cut' else 'learnt with other known constants'
    (line,) = [line for line in said.splitlines() if 'starting from the initial values' in line]
    assert 'starting from the initial values: ' in line
    assert reason in line
    assert (tmp_path / 'c.safetensors.refused').read_bytes() == bad
    assert held_by(path)


def test_deactivating_keeps_what_was_learnt_and_configuring_resumes_it(rig, record, tmp_path):
    path = tmp_path / 'c.safetensors'
    recording = record(EXCITATION, 8.0)
    rig.start(checkpoint__path=path, checkpoint__resume='true', checkpoint__period_s=0.0)
    rig.send(recording, range(500))
    rig.wait_for(samples_used=500)
    learnt = rig.estimates()
    assert not path.exists()
    assert rig.change(Transition.TRANSITION_DEACTIVATE)
    rig.wait_until_deaf()
    rig.peer.wait(path.exists, 'the checkpoint')
    assert held_by(path) == learnt
    assert rig.change(Transition.TRANSITION_CLEANUP)
    assert rig.change(Transition.TRANSITION_CONFIGURE)
    assert rig.change(Transition.TRANSITION_ACTIVATE)
    assert rig.estimates() == learnt


def test_what_is_reset_does_not_come_back_with_the_next_start(rig, record, tmp_path):
    path = tmp_path / 'c.safetensors'
    recording = record(EXCITATION, 8.0)
    rig.start(checkpoint__path=path, checkpoint__resume='true', checkpoint__period_s=0.1)
    rig.send(recording, range(500))
    rig.wait_for(samples_used=500)
    rig.peer.wait(path.exists, 'a checkpoint')
    assert rig.call(Trigger, 'reset').message.endswith(f'; the checkpoint is kept as {path}.reset')
    assert rig.peer.end(rig.process)[0] == 0
    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.signals()
    assert rig.estimates() == {'inductance': 1.5, 'resistance': 3.0, 'hysteresis': 1.0}


def test_a_path_set_while_it_runs_stays_in_the_folder(rig, record, tmp_path):
    folder = tmp_path / 'kept'
    recording = record(EXCITATION, 8.0)
    folder.mkdir()
    (folder / 'out').symlink_to(tmp_path)
    rig.start(checkpoint__path=folder / 'c.safetensors')
    rig.send(recording, range(200))
    rig.wait_for(samples_used=200)

    def ask(value: str) -> tuple[bool, str]:
        result = rig.call(
            SetParameters, 'set_parameters', parameters=[text('checkpoint.path', value)]
        ).results[0]
        return result.successful, result.reason

    for value, words in (
        (str(tmp_path / 'c.safetensors'), f'leads out of {folder}: give a path in there'),
        ('../c.safetensors', "must not hold '..'"),
        ('out/c.safetensors', f'leads out of {folder}'),
        ('', 'must be the name of a file'),
        ('.bashrc', "must hold no name that begins with '.'"),
        ('.ssh/authorized_keys', "must hold no name that begins with '.'"),
        ('crontab', 'must end in .safetensors'),
        ('left/wheel.safetensors', f'names a folder that is not there: make {folder}/left first'),
    ):
        successful, reason = ask(value)
        assert not successful
        assert words in reason
    assert sorted(entry.name for entry in folder.iterdir()) == ['out']
    (folder / 'left').mkdir()
    assert ask('left/wheel.safetensors') == (True, '')
    assert rig.call(Trigger, 'save').message == f'saved to {folder}/left/wheel.safetensors'
    (folder / 'left').rename(folder / 'moved')
    (folder / 'left').symlink_to(tmp_path)  # behind the back of the parameter
    answer = rig.call(Trigger, 'save')
    assert not answer.success
    assert f'leads out of {folder}' in answer.message
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ['kept']
    together = [number('checkpoint.period_s', 5.0), text('checkpoint.path', '/etc/c')]
    answer = rig.call(SetParametersAtomically, 'set_parameters_atomically', parameters=together)
    assert not answer.result.successful
    assert 'leads out of' in answer.result.reason


def test_without_a_path_the_checkpoint_goes_below_ros_home(rig, record, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, 'ROS_HOME', str(tmp_path))
    rig.start()
    rig.send(record(EXCITATION, 8.0), range(100))
    rig.wait_for(samples_used=100)
    wanted = tmp_path / 'gray_box_observer' / 'gray_box_observer.safetensors'
    assert rig.call(Trigger, 'save').message == f'saved to {wanted}'
    assert wanted.is_file()


def test_a_start_with_a_path_outside_of_its_folder_is_one_line(end_here, tmp_path):
    places = {'checkpoint__folder': tmp_path / 'a', 'checkpoint__path': '/b/c.safetensors'}
    code, _, said = end_here(MODULE, *parameter_words(predictor='false', **places))
    assert code == 2
    assert said.startswith("observer: error: checkpoint.path '/b/c.safetensors' leads out of ")
    assert said.count('\n') == 1


def test_a_disk_that_refuses_is_a_warning_in_diagnostics_and_costs_no_sample(
    rig, record, tmp_path, learnt_offline
):
    (tmp_path / 'file').write_text('no folder')
    recording = record(EXCITATION, 12.0)
    rig.start(
        checkpoint__path=tmp_path / 'file' / 'c.safetensors',
        checkpoint__resume='true',
        checkpoint__period_s=0.1,
    )
    said = []
    for first in range(0, 600, 100):
        rig.send(recording, range(first, first + 100))
        rig.wait_for(samples_used=first + 100)
        said += [status.message for array in rig.diagnostics for status in array.status]
        rig.diagnostics.clear()
    assert any('the checkpoint was not written: cannot write' in message for message in said)
    assert rig.estimates() == learnt_offline(recording, range(600))
    code, _, log = rig.peer.end(rig.process)
    assert code == 0
    assert 'cannot write' in log


@pytest.mark.parametrize('kind', ['pipe', 'sparse file'])
def test_what_is_no_checkpoint_keeps_no_node_from_starting_nor_from_ending(
    rig, record, tmp_path, kind
):
    path = tmp_path / 'c.safetensors'
    if kind == 'pipe':
        os.mkfifo(path)
    else:
        with path.open('wb') as file:
            file.truncate(1 << 42)
    rig.start(checkpoint__path=path, checkpoint__resume='true', checkpoint__period_s=0.1)
    recording = record(EXCITATION, 8.0)
    said = []
    for first in range(0, 400, 100):
        rig.send(recording, range(first, first + 100))
        rig.wait_for(samples_used=first + 100)
        said += [status.message for array in rig.diagnostics for status in array.status]
        rig.diagnostics.clear()
    assert any(
        'what stands there is no checkpoint of this package; move it away' in message
        for message in said
    )
    answer = rig.call(Trigger, 'load')
    assert not answer.success
    assert f'cannot read {path}' in answer.message
    code, _, log = rig.peer.end(rig.process)
    assert code == 0
    (line,) = [line for line in log.splitlines() if 'starting from the initial values: ' in line]
    assert f'it is kept as {path}' in line
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_absurd_content_under_a_right_checksum_is_set_aside_and_learning_begins_anew(
    rig, record, tmp_path
):
    path = tmp_path / 'c.safetensors'
    recording = record(EXCITATION, 8.0)
    core = Observer(Configuration.from_flat({'predictor': False}))
    for k in range(100):
        core.voltage('motor', int(recording.stamp_ns[k]), float(recording.voltage_v[0, k]))
        core.torque('motor', int(recording.stamp_ns[k]), float(recording.torque_nm[0, k]))
    plain, arrays = decode_of(core)
    plain['motors']['motor']['context_nodes']['next_fit'] = 10**30
    path.write_bytes(encode(plain, arrays))
    rig.start(checkpoint__path=path, checkpoint__resume='true')
    rig.send(recording, range(400))
    rig.wait_for(samples_used=400)
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    (line,) = [line for line in said.splitlines() if 'starting from the initial values' in line]
    assert 'next_fit is 10' in line
    assert (tmp_path / 'c.safetensors.refused').is_file()
    assert held_by(path)


def decode_of(core: Observer) -> tuple[dict, dict]:
    """What a checkpoint of a core would hold."""
    snapshot = capture(core)
    return json.loads(snapshot.content), dict(snapshot.arrays)


def test_the_last_checkpoint_is_written_before_the_page_is_waited_for():
    """Who ends a node may not wait for a page that does not end."""
    node = Mock()
    node._keeper.close.return_value = None
    ObserverNode.close(node)
    calls = [call[0] for call in node.mock_calls]
    assert calls.index('_inputs.close') < calls.index('_keeper.close')
    assert calls.index('_keeper.close') < calls.index('_dashboard.close')
