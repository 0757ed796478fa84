from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

BAG = Path(__file__).resolve().parents[2] / 'bags' / 'moderate'

START = """
import sys

executable, *missing = sys.argv[1:]
sys.modules.update(dict.fromkeys(missing))
from gray_box_observer import executables

raise SystemExit(getattr(executables, executable)([executable, '--help']))
"""

THREADS_SEEN = """
import os, sys, types

from gray_box_observer import executables

command = types.ModuleType('command')
command.main = lambda args: print(os.environ['OMP_NUM_THREADS'], 'numpy' in sys.modules)
sys.modules['gray_box_observer.identify.command'] = command
executables.identify()
"""

LOADED = """
import contextlib, io, sys

from gray_box_observer.identify.command import main

with contextlib.redirect_stdout(io.StringIO()):
    code = main(['identify', sys.argv[1], '--skip-predictor'])
print(code, 'gray_box_observer.predictor' in sys.modules, 'numpy.random' in sys.modules)
"""


def start(*arguments: str) -> tuple[int, str, str]:
    """Start an executable in a Python without the modules; return exit code and outputs."""
    done = subprocess.run(
        [sys.executable, '-c', START, *arguments], capture_output=True, text=True, timeout=100
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ('executable', 'missing', 'remedy'),
    [
        ('recorder', 'mcap', 'pip install mcap"'),
        ('player', 'mcap_ros2', 'pip install mcap-ros2-support"'),
        ('player', 'lz4', 'pip install lz4"'),
        ('identify', 'zstandard', 'pip install zstandard"'),
        ('identify', 'yaml', 'pip install PyYAML"'),
        ('observer', 'rclpy', 'source the set-up file of ROS 2 Jazzy'),
        ('recorder', 'rcl_interfaces', 'source the set-up file of ROS 2 Jazzy'),
    ],
)
def test_a_missing_package_is_one_line_that_says_what_to_install(
    executable: str, missing: str, remedy: str
) -> None:
    code, out, said = start(executable, missing)
    assert (code, out) == (2, '')
    assert said.startswith(f'{executable}: error: this Python has no {missing}: ')
    assert remedy in said
    assert said.count('\n') == 1


@pytest.mark.parametrize(
    'executable', ['observer', 'recorder', 'player', 'identify', 'watch', 'dashboard']
)
def test_with_every_package_an_executable_is_the_command_of_its_module(
    executable: str,
) -> None:
    code, out, said = start(executable)
    assert (code, said) == (0, '')
    assert out.startswith(f'usage: {executable} ')


@pytest.mark.parametrize(('asked', 'expected'), [({}, '1'), ({'OMP_NUM_THREADS': '3'}, '3')])
def test_linear_algebra_runs_on_one_thread_unless_asked_otherwise(
    asked: dict[str, str], expected: str
) -> None:
    environment = {
        name: value for name, value in os.environ.items() if not name.endswith('_NUM_THREADS')
    } | asked
    command = [sys.executable, '-c', THREADS_SEEN]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=100, env=environment, check=True
    )
    assert done.stdout == f'{expected} False\n', (
        'settled before numpy, which reads it once, is loaded'
    )


def test_the_observer_needs_nothing_of_the_bags_or_the_training() -> None:
    assert start('observer', 'mcap', 'mcap_ros2', 'lz4', 'zstandard', 'torch', 'plotly')[0] == 0


def test_a_module_of_ours_that_is_missing_is_a_defect_and_shows_its_traceback() -> None:
    code, _, said = start('identify', 'gray_box_observer.identify.offline_run')
    assert code == 1
    assert 'Traceback' in said


@pytest.mark.parametrize(
    'asked', [['--json', 'found.json'], ['--json', '-', '--report', 'found.html']]
)
def test_a_reader_of_the_output_may_leave_early_and_files_are_written_all_the_same(
    tmp_path: Path, asked: list[str]
) -> None:
    script = 'from gray_box_observer import executables; raise SystemExit(executables.identify())'
    command = [sys.executable, '-c', script, str(BAG), '--skip-predictor', *asked]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    process.stdout.close()
    said = process.stderr.read()
    assert (process.wait(timeout=100), 'Broken' in said) == (0, False), said
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        name for name in asked if name.startswith('found')
    ]


def test_a_reader_of_errors_may_leave_early_too(tmp_path: Path) -> None:
    script = 'from gray_box_observer import executables; raise SystemExit(executables.identify())'
    strange = tmp_path / 'strange.yaml'
    strange.write_text('/**: {ros__parameters: {strange: 1}}')
    asked = [str(BAG), '--skip-predictor', '--params', str(strange), '--json', 'found.json']
    process = subprocess.Popen(
        [sys.executable, '-c', script, *asked], stderr=subprocess.PIPE, cwd=tmp_path
    )
    process.stderr.close()
    assert process.wait(timeout=100) == 0
    assert (tmp_path / 'found.json').exists()


MEMORY_LEFT = """
import sys

import psutil

from gray_box_observer import executables

if sys.argv[1] == 'settled':
    executables.settle_memory()
process, kept = psutil.Process(), []
before = process.memory_info().rss
for size in (8 << 20, 7 << 20, 6 << 20):
    large = []
    for _ in range(8):
        large.append(bytearray(size))
        kept.append(bytearray(100_000))
    del large
print(process.memory_info().rss - before - sum(map(len, kept)))
"""


def test_large_blocks_of_memory_go_back_when_they_are_freed() -> None:
    run = [sys.executable, '-c', MEMORY_LEFT]
    left = {
        how: int(subprocess.check_output([*run, how], timeout=100))
        for how in ('settled', 'as it comes')
    }
    assert left['settled'] < 4e6
    if left['as it comes'] < 4e6:
        pytest.skip('this C library gives them back by itself')


def test_python_m_identify_is_the_command_that_is_installed() -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'gray_box_observer.identify', b'\xff.mcap'],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 2
    assert 'is no UTF-8' in done.stderr


def test_without_predictor_nothing_of_it_is_loaded() -> None:
    done = subprocess.run(
        [sys.executable, '-c', LOADED, str(BAG)], capture_output=True, text=True, timeout=100
    )
    assert done.stdout.split() == ['0', 'False', 'False'], done.stderr
