"""Two rounds of `kill_recorder`, which runs fifty as a command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system


def test_a_killed_recorder_leaves_bags_that_everybody_reads_without_a_gap(peer) -> None:
    command = [sys.executable, str(Path(__file__).with_name('kill_recorder.py')), '--times', '2']
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(peer.domain)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.stdout, done.stderr
    figures = {
        figure['name']: figure for figure in json.loads(done.stdout.splitlines()[-1])['figures']
    }
    assert len(figures) == 6
    # How much is lost is a time, which a busy machine stretches: the command judges it.
    assert [
        name
        for name, figure in figures.items()
        if figure['met'] is False and 'lost in s' not in name
    ] == []
