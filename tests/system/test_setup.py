"""The set-up script finds ROS and Python, or names what is missing; the workspace runs."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SETUP = ROOT / 'ros_ws' / 'setup.sh'
RUN = ROOT / 'ros_ws' / 'run.sh'
TOOLS = ('bash', 'cat', 'dirname', 'env', 'grep', 'id', 'sed', 'stat', 'uname')
NOBODY = 65534

FAKE_PYTHON = """#!/bin/sh
case "$*" in
    *'sys.version_info'*) echo {version} ;;
    *_base_executable*) echo "$0" ;;
    *'import venv'*) exit {venv} ;;
    *rclpy*) exit {rclpy} ;;
esac
"""


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    """A folder that holds the few tools the script needs, and no Python."""
    folder = tmp_path / 'bin'
    folder.mkdir()
    for name in TOOLS:
        (folder / name).symlink_to(shutil.which(name))
    return folder


def add_python(
    folder: Path, *, version: str = '3.12', venv: bool = True, rclpy: bool = False
) -> Path:
    python = folder / 'python3'
    python.write_text(FAKE_PYTHON.format(version=version, venv=int(not venv), rclpy=int(not rclpy)))
    python.chmod(0o755)
    return python


def check(
    tools: Path,
    *,
    prefix: Path | None = None,
    checkout: str = 'checkout',
    user: int | None = None,
    **variables: str,
) -> subprocess.CompletedProcess[str]:
    """Ask a copy of the script, which knows nothing of this checkout's environment."""
    copy = tools.parent / checkout / 'ros_ws' / 'setup.sh'
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(SETUP, copy)
    environment = {'PATH': str(tools), 'ROS_PREFIX': str(prefix or tools / 'no_ros'), **variables}
    return subprocess.run(
        ['bash', str(copy), '--check'],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        user=user,
    )


def fake_distribution(tmp_path: Path) -> Path:
    prefix = tmp_path / 'jazzy'
    prefix.mkdir()
    (prefix / 'setup.bash').write_text('export ROS_DISTRO=jazzy\n: "$AN_UNSET_VARIABLE"\n')
    return prefix


def test_without_a_distribution_the_wheels_are_chosen(tools: Path):
    add_python(tools)
    done = check(tools)
    assert done.returncode == 0, done.stderr
    assert 'from wheels' in done.stdout


def test_a_distribution_is_chosen_where_there_is_one(tools: Path, tmp_path: Path):
    python = add_python(tools, rclpy=True)
    done = check(tools, prefix=fake_distribution(tmp_path), PYTHON=str(python))
    assert done.returncode == 0, done.stderr
    assert 'of the distribution' in done.stdout


def test_wheels_can_be_asked_for_beside_a_distribution(tools: Path, tmp_path: Path):
    add_python(tools, rclpy=True)
    done = check(tools, prefix=fake_distribution(tmp_path), ROS='wheels')
    assert done.returncode == 0, done.stderr
    assert 'from wheels' in done.stdout


def test_a_sourced_jazzy_of_another_place_is_used(tools: Path):
    add_python(tools, rclpy=True)
    done = check(tools, ROS_DISTRO='jazzy')
    assert done.returncode == 0, done.stderr
    assert 'of the distribution' in done.stdout


@pytest.mark.parametrize('elsewhere', [False, True])
def test_what_was_chosen_holds_unless_the_checkout_was_moved(
    tools: Path, tmp_path: Path, elsewhere: bool
):
    python = add_python(tools, rclpy=True)
    venv = tmp_path / 'checkout' / '.venv'
    venv.mkdir(parents=True)
    root = tmp_path / 'elsewhere' if elsewhere else venv.parent
    (venv / '.setup_stamp').write_text(f'root {root}\nros wheels\nexecutable {python}\n')
    done = check(
        tools, prefix=fake_distribution(tmp_path), **({'PYTHON': str(python)} if elsewhere else {})
    )
    assert done.returncode == 0, done.stderr
    assert ('of the distribution' in done.stdout) == elsewhere


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = done.stderr.splitlines()
    assert done.returncode == 1
    assert len(lines) == 1 and lines[0].startswith('setup: error: ')
    return lines[0]


@pytest.mark.parametrize('folder', ['a folder', 'path:list', 'dollar$'])
def test_a_folder_that_no_script_of_ros_can_stand_in_is_refused(tools: Path, folder: str):
    add_python(tools)
    line = one_line(check(tools, checkout=folder))
    assert 'move the clone to another folder' in line
    assert folder in line


def test_an_environment_of_another_user_is_left_alone(tools: Path, tmp_path: Path):
    add_python(tools)
    venv = tmp_path / 'checkout' / '.venv'
    venv.mkdir(parents=True)
    (venv / 'theirs').touch()
    for folder in (tmp_path, *tmp_path.parents):  # somebody else may look, but not write
        if folder.parent.is_relative_to(tempfile.gettempdir()):
            folder.chmod(0o755)
    if os.getuid() != 0:
        venv.chmod(0o555)
    line = one_line(check(tools, user=NOBODY if os.getuid() == 0 else None))
    assert 'work in a clone of your own' in line
    assert (venv / 'theirs').exists()


def test_a_missing_python_is_named(tools: Path):
    assert 'Python is missing' in one_line(check(tools))


def test_a_python_that_no_wheel_serves_is_named_with_its_version(tools: Path):
    add_python(tools, version='3.9')
    message = one_line(check(tools))
    assert 'python3 (3.9)' in message
    assert '3.11, 3.12, 3.13' in message


def test_a_missing_venv_module_is_named_with_its_package(tools: Path):
    add_python(tools, venv=False)
    assert 'apt install python3.12-venv' in one_line(check(tools))


def test_a_distribution_without_rclpy_is_named(tools: Path, tmp_path: Path):
    python = add_python(tools)
    message = one_line(check(tools, prefix=fake_distribution(tmp_path), PYTHON=str(python)))
    assert 'cannot import rclpy' in message


def test_a_distribution_that_was_asked_for_and_is_not_there_is_named(tools: Path):
    add_python(tools)
    assert 'no_ros/setup.bash' in one_line(check(tools, ROS='distribution'))


def test_an_unknown_source_of_ros_is_refused(tools: Path):
    assert 'ROS=conda' in one_line(check(tools, ROS='conda'))


def requires_built_workspace() -> None:
    if not (ROOT / 'ros_ws' / 'install' / 'setup.bash').is_file():
        pytest.skip('the workspace is not built: run make test')


def test_the_workspace_is_not_confused_by_another_environment(tmp_path: Path):
    requires_built_workspace()
    (tmp_path / 'rclpy').mkdir()
    (tmp_path / 'rclpy' / '__init__.py').write_text('raise ImportError("the wrong rclpy")')
    foreign = {
        'PYTHONPATH': str(tmp_path),
        'AMENT_PREFIX_PATH': str(tmp_path),
        'LD_LIBRARY_PATH': str(tmp_path),
        '_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1',
    }
    code = (
        'import os, rclpy; from ament_index_python import get_package_prefix as f; f("std_msgs"); '
        'from rclpy.impl.implementation_singleton import rclpy_implementation; '
        'print(os.environ["AMENT_PREFIX_PATH"])'
    )
    done = subprocess.run(
        [RUN, 'python', '-c', code],
        env=os.environ | foreign,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert str(tmp_path) not in done.stdout


@pytest.mark.parametrize('source', ['. ros_ws/install/setup.bash && ', ''])
@pytest.mark.parametrize(
    'package_and_name',
    ['dc_motor_sim/motor_sim', 'gray_box_observer/observer', 'gray_box_observer/identify'],
)
def test_an_executable_starts_without_an_activated_environment_sourced_or_not(
    package_and_name: str, source: str
):
    requires_built_workspace()
    package, name = package_and_name.split('/')
    script = f'{source}ros_ws/install/{package}/lib/{package}/{name} --help'
    done = subprocess.run(
        ['bash', '-c', script],
        cwd=ROOT,
        env={'PATH': '/usr/bin:/bin', 'HOME': os.environ.get('HOME', '/')},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert name in done.stdout


@pytest.mark.parametrize('name', ['observer', 'watch', 'identify', 'motor_sim'])
def test_an_executable_of_the_workspace_needs_no_path(name: str):
    requires_built_workspace()
    found = subprocess.check_output([RUN, 'bash', '-c', f'command -v {name}'], text=True)
    assert Path(found.strip()).parent.parent.parent.parent == ROOT / 'ros_ws' / 'install'


def test_running_without_a_build_says_what_to_do(tmp_path: Path):
    (tmp_path / 'ros_ws').mkdir()
    copy = shutil.copy(RUN, tmp_path / 'ros_ws')
    done = subprocess.run([copy, sys.executable], capture_output=True, text=True, timeout=30)
    assert done.returncode == 2
    assert done.stderr == 'run.sh: error: the workspace is not built; run make setup\n'


@pytest.mark.parametrize(('asked', 'expected'), [({}, '1'), ({'OPENBLAS_NUM_THREADS': '3'}, '3')])
def test_linear_algebra_gets_one_thread_unless_asked(asked: dict[str, str], expected: str):
    others = {name: value for name, value in os.environ.items() if 'NUM_THREADS' not in name}
    command = [RUN, 'printenv', 'OPENBLAS_NUM_THREADS']
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, env=others | asked, check=True
    )
    assert done.stdout == f'{expected}\n'
