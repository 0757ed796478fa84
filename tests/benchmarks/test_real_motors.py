"""The benchmark on real measurements, where there are few of them or none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'real_motors.py'


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    command = [sys.executable, PROGRAM, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=100, env=environment, check=False
    )


@pytest.fixture
def servo_log(tmp_path: Path) -> Path:
    """A log in the form of the servo's: L = 2 mH and R = 8 ohm behind its brushes."""
    random = np.random.default_rng(1)
    current = 0.0
    period_s = 49.75e-6
    lines = ['duty_q15,vmotor_a,vmotor_b,current_raw,window_valid']
    for step in range(4000):
        if step % 40 == 0:
            duty = float(random.uniform(0.4, 1.0))
        voltage = duty * 2000 * 2.466e-3
        lines.append(
            f'{duty * 32767:.0f},2000,0,'
            f'{current / 0.8952e-3 + 108.5 + random.normal(0.0, 0.2):.3f},1'
        )
        for _ in range(20):
            drop = 0.455 * current / (abs(current) + 0.02)
            current += period_s / 20 / 0.002 * (voltage - 8.0 * current - drop)
    log = tmp_path / 'openservocore' / 'rl-probe-bench.csv'
    log.parent.mkdir()
    log.write_text('\n'.join(lines) + '\n')
    return log


def test_the_servo_alone_gives_its_figure_and_none_of_the_robots(servo_log: Path) -> None:
    done = run('--data', servo_log.parent.parent)
    assert done.returncode == 0, done.stderr
    figures = {f['name']: f for f in json.loads(done.stdout.splitlines()[-1])['figures']}
    assert figures['SG90 L/R in us']['value'] == pytest.approx(250.0, rel=0.02)
    assert figures['SG90 L/R in us']['met'] is False
    assert figures['healthy robot motors']['value'] == 0
    for name in ('healthy robot motors, lowest R in ohm', 'dead current sensors believed'):
        assert (figures[name]['value'], figures[name]['met']) == (None, None)


@pytest.mark.parametrize('folder', ['missing', '.'])
def test_a_folder_without_measurements_is_one_clear_line(tmp_path: Path, folder: str) -> None:
    done = run('--data', tmp_path / folder)
    assert done.returncode == 2
    assert done.stderr.startswith(
        f'real_motors: error: no measurements in {tmp_path / folder}: expected '
    )
    assert done.stderr.count('\n') == 1


def test_a_log_that_cannot_be_read_is_one_clear_line(servo_log: Path) -> None:
    servo_log.write_text('time,voltage\n0,1\n')
    done = run('--data', servo_log.parent.parent)
    assert done.returncode == 2
    assert done.stderr.startswith('real_motors: error: ')
    assert done.stderr.count('\n') == 1
