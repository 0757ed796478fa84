"""A small, fixed share of the campaign of `corrupt_bags`, which runs whole as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

CASES = 300


def test_damaged_bags_end_in_a_clear_line_or_in_a_partial_read_that_says_what_was_lost() -> None:
    command = [
        sys.executable,
        str(Path(__file__).with_name('corrupt_bags.py')),
        '--cases',
        str(CASES),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert all(figure['met'] for figure in result['figures'])
    outcomes = result['outcomes']
    assert sum(outcomes.values()) == CASES
    for outcome in ('clear error', 'partial read with a warning', 'everything read'):
        assert outcomes[outcome] > 5
    assert (
        sum(count for outcome, count in outcomes.items() if outcome.startswith('identify'))
        == CASES / 20
    )
