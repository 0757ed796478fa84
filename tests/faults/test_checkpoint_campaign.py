"""A small, fixed share of `checkpoint_campaign`, which runs whole as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

CASES = 60
SAMPLES = 300


def test_checkpoints_of_absurd_content_end_in_a_clear_line_or_in_an_observer_that_goes_on() -> None:
    campaign = str(Path(__file__).with_name('checkpoint_campaign.py'))
    kinds = ['recursive', 'gradient', 'thesis', 'group']
    command = [
        sys.executable,
        campaign,
        '--cases',
        str(CASES),
        '--samples',
        str(SAMPLES),
        '--kinds',
        *kinds,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert all(figure['met'] is not False for figure in result['figures'])
    assert result['outcomes']['refused'] > result['outcomes']['accepted'] > 0
