"""Every executable refuses bad input in one line, with exit code 2, and waits for nothing."""

from __future__ import annotations

import importlib
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.ended_starts import EndHere

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
EXECUTABLES = {
    'identify': 'gray_box_observer',
    'observer': 'gray_box_observer',
    'recorder': 'gray_box_observer',
    'player': 'gray_box_observer',
    'watch': 'gray_box_observer',
    'dashboard': 'gray_box_observer',
    'motor_sim': 'dc_motor_sim',
}
BAG = str(ROOT / 'bags' / 'moderate')
HEAD = '/**:\n  ros__parameters:\n    '
TIMEOUT_S = 120.0

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path) -> Refused:
    """Run an executable that must end with code 2; returns its one line of error."""

    def run(name: str, *arguments: str | bytes) -> str:
        executable = (
            ROOT / 'ros_ws' / 'install' / EXECUTABLES[name] / 'lib' / EXECUTABLES[name] / name
        )
        done = subprocess.run(
            [str(executable), *arguments],
            capture_output=True,
            cwd=tmp_path,
            timeout=TIMEOUT_S,
            stdin=subprocess.DEVNULL,
        )
        return one_line(name, done.returncode, done.stderr.decode('utf-8'))

    return run


@pytest.fixture
def refused_here(end_here: EndHere, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Refused:
    """Call an executable in the process of the test, whose memory is left as it is."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('gray_box_observer.executables.settle_memory', lambda: None)

    def run(name: str, *arguments: str) -> str:
        executable = getattr(importlib.import_module(f'{EXECUTABLES[name]}.executables'), name)
        code, _, said = end_here(executable, *arguments)
        return one_line(name, code, said)

    return run


def one_line(name: str, code: int, said: str) -> str:
    """Return the line with which an executable has refused its input."""
    assert code == 2, said
    errors = [line for line in said.splitlines() if line.startswith(f'{name}: error: ')]
    assert len(errors) == 1, said
    assert 'Traceback' not in said
    assert '[ERROR]' not in said, 'said a second time'
    return errors[0].removeprefix(f'{name}: error: ')


def with_file(name: str, path: Path) -> list[str]:
    """Arguments that name a parameter file."""
    if name in ('identify', 'watch'):
        return [BAG, '--params', str(path)]
    if name == 'dashboard':
        return ['--params', str(path)]
    return [*([BAG] if name == 'player' else []), '--ros-args', '--params-file', str(path)]


@pytest.mark.parametrize('name', EXECUTABLES)
def test_a_pipe_as_parameter_file_is_refused_and_not_waited_for(
    refused: Refused, tmp_path: Path, name: str
) -> None:
    path = tmp_path / 'pipe.yaml'
    os.mkfifo(path)
    line = refused(name, *with_file(name, path))
    assert f'{path}: cannot be read: ' in line
    assert 'expected a regular file' in line


@pytest.mark.parametrize('name', EXECUTABLES)
def test_an_argument_that_is_no_utf_8_is_refused_by_its_bytes(refused: Refused, name: str) -> None:
    assert refused(name, b'bag_\xff') == r'the argument bag_\xff is no UTF-8: rename the file'


@pytest.mark.parametrize('name', [name for name in EXECUTABLES if name != 'identify'])
def test_an_argument_that_ros_does_not_know_is_refused_in_its_words(
    refused_here: Refused, name: str
) -> None:
    words = ('--ros-args', '--nosuchflag')
    assert refused_here(name, *words) == "unknown ROS arguments: ['--nosuchflag']"


@pytest.mark.parametrize('name', [name for name in EXECUTABLES if name != 'identify'])
def test_an_option_for_a_parameter_without_one_is_refused(refused_here: Refused, name: str) -> None:
    message = (
        '-p: this node has no parameters; --help lists its options'
        if name in ('watch', 'dashboard')
        else "Failed to parse ROS arguments: Couldn't parse trailing -p flag. No parameter "
        'override rule found.'
    )
    assert refused_here(name, '--ros-args', '-p') == message


@pytest.mark.parametrize(
    ('name', 'text', 'message'),
    [
        ('observer', f'{HEAD}gap_s: 1.0\n    gap_s: 2.0\n', 'line 4: the key gap_s stands twice'),
        ('player', f'{HEAD}rate: 1e400\n', 'line 3: the number 1e400 is too large'),
        ('recorder', f'{HEAD}topics: &a [*a]\n', 'line 3: an anchor (a); write the values out'),
        (
            'observer',
            f'{HEAD}motors: ["m[1..60000]", "k[1..60000]"]\n',
            'stands for 120000 motors, expected 10000 at',
        ),
        (
            'motor_sim',
            f'{HEAD}motors: ["m[1..6000]", "k[1..6000]"]\n',
            'motors stands for 12000 motors; expected 10000',
        ),
        (
            'motor_sim',
            f'{HEAD}sample_rate_hz: .nan\n',
            'sample_rate_hz must be a finite number; got nan',
        ),
        (
            'identify',
            f'{HEAD}gap_s: {"[" * 9000}\n',
            'line 3: more than 32 levels within each other',
        ),
    ],
)
def test_a_parameter_file_that_cannot_be_meant_is_refused_by_line_or_name(
    refused_here: Refused, tmp_path: Path, name: str, text: str, message: str
) -> None:
    path = tmp_path / 'p.yaml'
    path.write_text(text)
    assert message in refused_here(name, *with_file(name, path))


@pytest.mark.parametrize('place', ['/dev/zero', 'pipe'])
@pytest.mark.parametrize('name', ['identify', 'player', 'watch'])
def test_a_device_or_a_pipe_is_no_bag(
    refused: Refused, tmp_path: Path, name: str, place: str
) -> None:
    os.mkfifo(tmp_path / 'pipe')
    assert refused(name, place) == f'{place} is neither a folder nor a regular file'
