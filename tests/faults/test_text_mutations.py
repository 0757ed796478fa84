"""A small, fixed share of the campaign of `text_mutations`, which runs whole as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

CASES = 400


def test_damaged_parameters_truths_and_metadata_end_in_a_clear_line_or_in_finite_values() -> None:
    command = [
        sys.executable,
        str(Path(__file__).with_name('text_mutations.py')),
        '--cases',
        str(CASES),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    result = json.loads(done.stdout.splitlines()[-1])
    assert result['figures'][0]['value'] == 0, done.stderr
    outcomes = result['outcomes']
    assert sum(outcomes.values()) == CASES
    for kind in ('parameters', 'truth', 'metadata', 'log'):
        assert outcomes[f'{kind}: a clear error'] > 2
        assert outcomes[f'{kind}: used'] > 2
    assert sum(count for outcome, count in outcomes.items() if outcome.startswith('identify')) > 5
    assert sum(count for outcome, count in outcomes.items() if outcome.startswith('process')) == 2
