"""The benchmark as a program: its smallest run, its misuse, and the arithmetic of its figures."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from common.figures import Figure, last_line, table

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'identification.py'


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    command = [sys.executable, str(PROGRAM), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=environment, check=False
    )


@pytest.fixture
def peers() -> None:
    for name in ('filterpy', 'padasip', 'do_mpc', 'matplotlib'):
        pytest.importorskip(name, reason='needs the peers of requirements/bench.txt')


@pytest.mark.usefixtures('peers')
def test_the_smallest_run_ends_with_one_line_of_json_that_judges_nothing() -> None:
    done = run('--quick', '--seeds', '1', '--own-seeds', '1', '--methods', 'recursive,rls')
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told['benchmark'] == 'identification'
    assert told['seeds'] == 1
    assert all(figure['met'] is None for figure in told['figures'])
    assert any(figure['value'] is not None for figure in told['figures'])
    assert 'Traceback' not in done.stderr


@pytest.mark.usefixtures('peers')
def test_an_unknown_method_is_refused_in_one_line() -> None:
    done = run('--quick', '--methods', 'kalmann')
    assert done.returncode == 2
    assert "no method 'kalmann'; there are" in done.stderr
    assert 'Traceback' not in done.stderr


def test_a_picture_of_an_unknown_kind_is_refused() -> None:
    done = run('--plot', 'error.gif')
    assert done.returncode == 2
    assert '.svg or .png' in done.stderr


@pytest.mark.usefixtures('peers')
def test_settling_is_the_first_instant_after_which_nothing_leaves_again() -> None:
    from common.settling import settled_s

    time_s = np.arange(5.0)
    assert settled_s(np.array([9.0, 0.1, 9.0, 0.1, 0.1]), time_s, 1.0) == 3.0
    assert settled_s(np.array([0.1, 0.1, 0.1, 0.1, np.nan]), time_s, 1.0) == np.inf
    assert settled_s(np.full(5, 0.1), time_s, 1.0) == 0.0


@pytest.mark.usefixtures('peers')
def test_a_failed_run_counts_as_infinitely_wrong() -> None:
    from common.summary import summarise
    from common.trace import Trace

    good = np.full((2, 3), 1e-3)
    failed = np.full((2, 3), np.nan)
    runs = [(Trace(error, 3.0), np.full((2, 3), 1e-3), np.arange(2.0)) for error in (good, failed)]
    summary = summarise(runs, 0.01)
    assert summary.diverged == 1
    assert np.all(np.isinf(summary.error))
    assert summarise(runs[:1], 0.01).overall == pytest.approx(1.0)


def test_a_figure_is_met_below_its_goal_or_inside_its_band_and_untold_without_either() -> None:
    assert Figure('error', 1.1, 1.2).met is True
    assert Figure('error', 1.3, 1.2).met is False
    assert Figure('NEES', 0.5, (0.8, 1.2)).met is False
    assert Figure('error', 1.1, 1.2, counts=False).met is None
    assert Figure('error', None, 1.2).met is None
    assert json.loads(last_line('b', 3, [Figure('error', np.inf, 1.2)]))['figures'][0] == {
        'name': 'error',
        'value': None,
        'goal': 1.2,
        'met': False,
    }


def test_a_table_lines_up_its_columns() -> None:
    assert table(['a', 'bc'], [['long', '1']]).splitlines() == ['a     bc', '----  --', 'long   1']
