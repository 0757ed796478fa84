"""A small, fixed share of the campaign of `absence_campaign`, which runs whole as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path


def test_signals_missing_for_a_while_neither_break_the_core_nor_vanish_from_the_books() -> None:
    command = [sys.executable, str(Path(__file__).with_name('absence_campaign.py'))]
    arguments = [
        '--runs',
        '2',
        '--outages',
        '1',
        '--motors',
        '1',
        '9',
        '--longest',
        '1021',
        '--seed',
        '1',
    ]
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    figures = {figure['name']: figure for figure in result['figures']}
    assert all(figure['met'] is not False for figure in figures.values())
    assert figures['outages']['value'] == 2
    assert figures['messages']['value'] > 1_200
