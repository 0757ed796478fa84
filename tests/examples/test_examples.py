"""Every example runs, explains itself, and answers a user's mistake in one line."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / 'examples').glob('*.py'))

WITHOUT_ROS = """
import re, runpy, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.partition('.')[0]
        of_ros = r'rclpy|launch(_ros)?|(ament|ros|rosidl|rcl)_.*|.*_(msgs|srvs|interfaces)'
        if re.fullmatch(of_ros, top):
            raise ImportError(f'{name} is blocked')

sys.meta_path.insert(0, NoRos())
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name='__main__')
"""


def run(*command: object) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, *map(str, command)]
    return subprocess.run(words, capture_output=True, text=True, timeout=100)


@pytest.mark.parametrize('path', EXAMPLES, ids=lambda path: path.stem)
def test_an_example_explains_itself_and_is_named_where_readers_look(path: Path):
    done = run(path, '--help')
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f'usage: {path.stem} ')
    pages = [ROOT / 'README.md', *(ROOT / 'docs').glob('*.md')]
    assert any(f'examples/{path.name}' in page.read_text(encoding='utf-8') for page in pages)
    guide = (ROOT / 'examples' / 'README.md').read_text(encoding='utf-8')
    assert f'## `{path.name}`' in guide
    assert re.search(rf'^    ros_ws/run.sh python examples/{path.name}', guide, re.MULTILINE)


@pytest.mark.parametrize(
    ('name', 'arguments'),
    [
        ('wait_for_identified', ['--bandwidth-hz', '0']),
        ('wait_for_identified', ['--motor', 'left wheel']),
        ('wait_for_identified', ['--observer', 'observer']),
        ('wait_for_identified', ['--ros-args', '--no-such-argument']),
        ('cores_without_ros', ['--duration', 'nan']),
        ('simulated_log', ['--rate', '0', 'log.csv']),
        ('simulated_log', ['no/such/folder/log.csv', '--duration', '0.1']),
    ],
)
def test_a_mistake_is_answered_in_one_line(name: str, arguments: list[str], tmp_path: Path):
    script = ROOT / 'examples' / f'{name}.py'
    words = [sys.executable, str(script), *arguments]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2
    assert done.stdout == ''
    assert re.fullmatch(rf'{name}: error: .+\n', done.stderr)
    assert list(tmp_path.iterdir()) == []


def test_the_cores_identify_a_motor_without_ros(tmp_path: Path):
    page = tmp_path / 'estimates.html'
    script = ROOT / 'examples' / 'cores_without_ros.py'
    done = run('-c', WITHOUT_ROS, script, '--plot', page)
    assert done.returncode == 0, done.stderr
    rows = re.findall(r'^(\w+) +(\S+) +(\S+) +(\S+)  .*  (\w+)$', done.stdout, re.MULTILINE)
    assert [name for name, *_ in rows[1:]] == ['inductance', 'resistance', 'hysteresis']
    for name, value, std, truth, verdict in rows[1:]:
        assert verdict == 'identified', name
        assert abs(float(value) - float(truth)) < 4.0 * float(std) < 0.04 * float(truth), name
    assert 'The white box explains the data' in done.stdout
    drawn = page.read_text(encoding='utf-8')
    assert 'resistance [ohm]' in drawn


def test_the_block_really_blocks_ros():
    done = run('-c', WITHOUT_ROS, ROOT / 'examples' / 'wait_for_identified.py', '--help')
    assert 'rclpy is blocked' in done.stderr
