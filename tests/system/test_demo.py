"""The demo: the whole system as a user runs it, and what it does when something goes wrong."""

from __future__ import annotations

import ast
import importlib
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import psutil
import pytest

from dc_motor_sim.excitation import parse_excitation
from dc_motor_sim.voltage_source import VoltageSource
from gray_box_observer.bag.joint_state import TYPE_NAME as JOINT_STATE
from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.bag.writer import BagWriter

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'ros_ws' / 'demo.py'
LAUNCH = ROOT / 'src' / 'gray_box_observer' / 'launch' / 'demo.launch.py'
SOON_S = 3.5
"""By then the voltage has moved, and who looks at the demo sees it do so."""


@pytest.fixture
def result(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / 'ros_ws'))
    import demo_result

    return demo_result


@pytest.fixture
def account(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / 'ros_ws'))
    import demo_account

    return demo_account


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(ROOT / 'ros_ws'))
    import demo_processes

    before = signal.getsignal(signal.SIGINT)
    yield demo_processes
    signal.signal(signal.SIGINT, before)


def default_of_launch(name: str) -> str:
    """What `demo.launch.py` passes on unless the user says otherwise; `launch` is not needed."""
    tree = ast.parse(LAUNCH.read_text(encoding='utf-8'))
    (arguments,) = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'ARGUMENTS'
    ]
    return arguments[name][0]


def start_demo(*arguments: str | Path) -> subprocess.Popen[str]:
    environment = {k: v for k, v in os.environ.items() if k != 'ROS_DOMAIN_ID'}
    command = [sys.executable, DEMO, *arguments]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_an_estimate_stands_beside_its_truth_and_its_error(result: ModuleType):
    motors = result.result_of(
        {'motor': {'resistance': 1.1}}, {'motor': {'resistance': 0.2}}, {'motor': {'resistance': 1}}
    )
    assert motors['motor']['resistance'] == pytest.approx(
        {'value': 1.1, 'std': 0.2, 'truth': 1.0, 'error_percent': 10.0}
    )


@pytest.mark.parametrize(
    'stds', [{}, {'motor': {'resistance': math.nan}}, {'motor': {'resistance': math.inf}}]
)
def test_an_unknown_std_is_null_in_json(result: ModuleType, stds: dict):
    motors = result.result_of({'motor': {'resistance': 1.1}}, stds, {})
    assert json.loads(json.dumps(motors, allow_nan=False)) == {
        'motor': {'resistance': {'value': 1.1, 'std': None}}
    }


def test_the_truth_of_a_changing_parameter_is_its_last_value(result: ModuleType, tmp_path: Path):
    path = tmp_path / 'truth.yaml'
    path.write_text('motors: {left: {resistance: [[0, 1.0], [60, 1.3]], inductance: 0.5}}')
    assert result.load_truth(path) == {'left': {'resistance': 1.3, 'inductance': 0.5}}


def test_a_file_that_is_no_truth_is_refused_by_name(result: ModuleType, tmp_path: Path):
    path = tmp_path / 'truth.yaml'
    path.write_text('resistance: 1.0')
    with pytest.raises(result.DemoError, match=r'truth\.yaml is no truth file'):
        result.load_truth(path)


def test_predictions_score_from_the_first_identified_sample_on(result: ModuleType, tmp_path: Path):
    """The way in, with an error of 100 %, is no score; afterwards the error is a tenth."""
    truth = [1.0 if k % 2 else -1.0 for k in range(200)]
    predicted = [0.0 if k < 100 else 0.9 * truth[k] for k in range(200)]
    with BagWriter(tmp_path / 'bag') as writer:
        for topic in ('/motor/torque', '/gray_box_observer/predicted_torque'):
            writer.add_topic(topic, JOINT_STATE, '')
        writer.add_topic('/gray_box_observer/motor/identified', 'std_msgs/msg/Bool', '')
        for k in range(200):
            at_ns = (k + 1) * 10_000_000
            for topic, value, later_ns in (
                ('/gray_box_observer/predicted_torque', predicted[k], 0),
                ('/motor/torque', truth[k], 1),
            ):
                data = encode_joint_state(at_ns, ('motor',), effort=(value,))
                writer.write(topic, data, at_ns + later_ns, at_ns + later_ns)
            said = bytes([0, 1, 0, 0, int(k >= 99)])
            writer.write('/gray_box_observer/motor/identified', said, at_ns + 2, at_ns + 2)
    scores = result.prediction_scores(tmp_path / 'bag')
    score = scores['motor']
    assert (score['samples'], score['since_s']) == (100, 0.99)
    assert score['nmae'] == pytest.approx(0.1)
    assert score['skill_vs_persistence'] == pytest.approx(0.95)
    assert 'an error of 10 % of its spread, 95 % better' in result.scores_text(scores)


def test_without_an_identified_sample_there_is_no_score(result: ModuleType):
    score = {'samples': 0, 'since_s': None, 'nmae': None, 'skill_vs_persistence': None}
    assert result.scores_text({'m': score}) == 'm: not every parameter was identified'
    assert 'no torque was predicted' in result.scores_text({'m': {**score, 'since_s': 2.0}})


FACTS = {
    'samples used': '90',
    'samples waiting for voltage': '1',
    'torque messages refused': 'absurd: 2, duplicate: 3',
    'torque topic: messages': '97',
    'torque topic: unreadable': '1',
}


def test_samples_that_were_lost_and_that_were_refused_are_told_apart(account: ModuleType):
    words = account.TorqueAccount.of_diagnostics([FACTS, {'node': 'x'}]).words(100)
    assert words == (
        '100 torque samples recorded, 90 used, 3 lost on the way to the observer, 6 refused by it '
        '(absurd: 2, duplicate: 3, unreadable: 1), 1 still waiting for their voltage'
    )
    assert account.TorqueAccount.of_diagnostics([{'node': 'x'}]) is None


def test_where_nothing_was_lost_nothing_else_is_said(account: ModuleType):
    assert account.TorqueAccount(100, 100).words(100) == '100 torque samples recorded, 100 used'
    assert account.TorqueAccount(100, 100).words(None) == '100 used'


def test_messages_that_motors_share_are_lost_once(account: ModuleType):
    facts = {**FACTS, 'torque messages refused': 'none', 'torque topic: unreadable': '0'}
    shared = account.TorqueAccount.of_diagnostics([facts, facts])
    assert (shared.arrived, shared.used, shared.refused.total()) == (97, 180, 0)


def test_live_values_have_units_and_stand_in_columns(result: ModuleType):
    estimates = {'m': {'resistance': 0.99889, 'hysteresis': 10.0}}
    assert result.estimates_text(estimates) == 'hysteresis 10 V s/(rad A)  resistance 0.99889 ohm'
    stds = {'m': {'resistance': 1e-3, 'hysteresis': math.nan}}
    motors = result.result_of(estimates, stds, {'m': {'resistance': 1.0}})
    assert result.summary(motors).splitlines() == [
        'm:',
        '  resistance  0.99889  +- 0.001      ohm          truth 1 ohm, -0.111 % off',
        '  hysteresis       10  +- not known  V s/(rad A)',
    ]


def test_a_process_that_dies_is_reported_with_its_last_lines(processes: ModuleType, tmp_path: Path):
    with processes.Children(tmp_path) as children:
        child = children.start(
            'worker', [sys.executable, '-c', 'raise SystemExit("no such motor")']
        )
        child.process.wait(30)
        with pytest.raises(
            processes.DemoError, match=r'(?s)worker ended early with exit code 1.*no such motor'
        ):
            children.require_alive('worker')


def test_a_program_that_is_missing_is_reported(processes: ModuleType, tmp_path: Path):
    with (
        processes.Children(tmp_path) as children,
        pytest.raises(processes.DemoError, match='cannot start the worker'),
    ):
        children.start('worker', [tmp_path / 'missing'])


def test_no_process_and_no_child_of_one_is_left_behind(processes: ModuleType, tmp_path: Path):
    code = (
        'import subprocess, sys, time; '
        'child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"]); '
        'print(child.pid, flush=True); time.sleep(300)'
    )
    with processes.Children(tmp_path) as children:
        worker = children.start('worker', [sys.executable, '-c', code])
        deadline_s = time.monotonic() + 30
        while not worker.log.read_text().endswith('\n'):
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        grandchild = psutil.Process(int(worker.log.read_text()))
    assert worker.process.poll() is not None
    with_patience = psutil.wait_procs([grandchild], timeout=10)
    assert with_patience[1] == []


@pytest.mark.parametrize(
    'arguments, message',
    [
        (['--duration', '0'], 'expected a number above 0'),
        (['--bag', '\x1b[31mred'], '\\x1b[31mred does not exist'),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(arguments: list[str], message: str):
    demo = start_demo(*arguments)
    _, errors = demo.communicate(timeout=60)
    assert demo.returncode == 2
    assert message in errors.splitlines()[-1]


@pytest.mark.parametrize(
    'arguments, message',
    [
        (['--duration', 'soon'], "got 'soon'"),
        (['--duration', '1_0'], "got '1_0'"),
        (['--bag', 'missing_bag'], 'missing_bag does not exist'),
        (['--params', '/dev/null'], '/dev/null is no regular file'),
    ],
)
def test_so_is_any_other_in_the_process_of_the_test(
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
):
    monkeypatch.syspath_prepend(str(DEMO.parent))
    monkeypatch.setattr(sys, 'argv', [str(DEMO), *arguments])
    with pytest.raises(SystemExit) as end:
        importlib.import_module('demo').main()
    assert end.value.code == 2
    assert message in capfd.readouterr().err.splitlines()[-1]


def defaults_of_demo(monkeypatch: pytest.MonkeyPatch) -> tuple[float, dict[str, str]]:
    """Torque noise and excitation by motor, as `ros_ws/demo.py` has them."""
    monkeypatch.syspath_prepend(str(DEMO.parent))
    demo = importlib.import_module('demo')
    options = demo.parse_arguments([])
    assert options.excitation is None
    return options.torque_noise, {name: one.excitation for name, one in demo.MOTORS.items()}


def default_of_make(name: str) -> str:
    """What `make demo` passes on unless the user says otherwise."""
    text = (ROOT / 'Makefile').read_text(encoding='utf-8')
    return re.search(rf'^{name} \?=(.*)$', text, re.MULTILINE)[1].strip()


def test_what_one_sees_by_default_has_noise_as_on_a_robot(monkeypatch: pytest.MonkeyPatch):
    noise, _ = defaults_of_demo(monkeypatch)
    assert noise == 0.01
    assert float(default_of_make('TORQUE_NOISE')) == noise
    assert float(default_of_launch('torque_noise')) == noise


def test_what_one_sees_by_default_moves_within_seconds(monkeypatch: pytest.MonkeyPatch):
    _, excitations = defaults_of_demo(monkeypatch)
    assert default_of_make('EXCITATION') == '', 'the motor has its own'
    assert default_of_launch('excitation') == excitations['thesis']
    for name, text in excitations.items():
        for seed in range(20):
            source = VoltageSource([parse_excitation(text)], seed=seed, period_ns=10_000_000)
            levels = {float(source.step()[0]) for _ in range(round(SOON_S * 100.0))}
            assert len(levels) > 1, f'{name}, seed {seed}'


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path):
    (tmp_path / 'file').write_text('')
    demo = start_demo('--runs', tmp_path / 'file' / 'runs')
    _, errors = demo.communicate(timeout=60)
    assert demo.returncode == 1
    assert errors.startswith('demo: error: cannot make a folder for the run')


@pytest.fixture(scope='module')
def short_demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """What a demo of six seconds writes to standard output and to standard error."""
    runs = tmp_path_factory.mktemp('runs')
    demo = start_demo('--duration', '6', '--excitation', 'R[5,15]D[0.1,1]', '--runs', runs)
    output, errors = demo.communicate(timeout=240)
    assert demo.returncode == 0, errors
    return output, errors


@pytest.mark.system
def test_a_short_demo_identifies_the_motor_and_accounts_for_every_sample(
    short_demo: tuple[str, str],
):
    output, errors = short_demo
    assert len(output.splitlines()) == 1
    answer = json.loads(output)
    parameters = answer['motors']['motor']
    assert set(parameters) == {'inductance', 'resistance', 'hysteresis'}
    assert all(abs(entry['error_percent']) < 20.0 for entry in parameters.values()), parameters
    account = re.search(r'600 torque samples recorded, (\d+) used(.*)', errors)
    assert account is not None, errors
    used = int(account[1])
    rest = account[2]
    counts = re.findall(r'(\d+) (?:lost on the way|refused by it|still waiting)', rest)
    assert used + sum(map(int, counts)) == 600, account[0]
    assert used >= 540  # a busy machine may hand the first torques over before their voltages
    assert 'watch it live: http://127.0.0.1:' in errors
    assert re.search(r'^see it in another terminal: ROS_DOMAIN_ID=\d+ .*/watch$', errors, re.M)
    headings = [line for line in errors.splitlines() if re.match(r'(Offline|Live), .*:$', line)]
    assert len(headings) == 3
    assert errors.count('The white box explains the data') == 1
    assert answer['prediction']['motor']['nmae'] < 0.1
    assert Path(answer['bag'], 'metadata.yaml').is_file()
    assert '<html' in Path(answer['report']).read_text(encoding='utf-8')[:2000].lower()


@pytest.mark.system
def test_a_motor_whose_speed_nobody_measures_is_found_to_have_a_rotor(tmp_path: Path):
    demo = start_demo('--motor', 'geared', '--duration', '4', '--runs', tmp_path, '--no-dashboard')
    output, errors = demo.communicate(timeout=240)
    assert demo.returncode == 0, errors
    parameters = json.loads(output)['motors']['motor']
    assert set(parameters) == {
        *('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
    }, errors
    assert abs(parameters['resistance']['error_percent']) < 2.0
    assert 'watch it live' not in errors
    assert '2000 torque samples recorded, 2000 used\n' in errors  # however busy the machine is


@pytest.mark.system
def test_a_replayed_bag_is_identified_again_and_finds_the_truth_beside_it(
    short_demo: tuple[str, str], tmp_path: Path
):
    bag = json.loads(short_demo[0])['bag']
    again = start_demo('--bag', bag, '--rate', '2', '--runs', tmp_path, '--no-dashboard')
    output, errors = again.communicate(timeout=240)
    assert again.returncode == 0, errors
    answer = json.loads(output)
    assert answer['bag'] != bag
    assert answer['motors']['motor']['resistance']['truth'] == 1.0
    account = re.search(r'(\d+) torque samples recorded, (\d+) used', errors)
    assert account is not None, errors
    recorded_count, used_count = map(int, account.groups())
    assert 580 <= used_count <= recorded_count <= 600, errors  # a busy machine may lose some


@pytest.mark.system
def test_an_interrupt_ends_every_process(tmp_path: Path):
    demo = start_demo('--duration', '60', '--runs', tmp_path)
    watched = psutil.Process(demo.pid)
    deadline_s = time.monotonic() + 60
    while len(children := watched.children(recursive=True)) < 3:
        assert demo.poll() is None and time.monotonic() < deadline_s
        time.sleep(0.05)
    demo.send_signal(signal.SIGINT)
    _, errors = demo.communicate(timeout=60)
    assert demo.returncode == 130, errors
    assert errors.splitlines()[-1] == 'demo: stopped'
    assert psutil.wait_procs(children, timeout=5)[1] == []
