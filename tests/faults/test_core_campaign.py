"""A small, fixed share of the campaign of `core_campaign`, which runs whole as a command."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

MESSAGES = 6000


def test_faulty_messages_neither_break_the_core_nor_vanish_nor_move_the_estimate() -> None:
    command = [sys.executable, str(Path(__file__).with_name('core_campaign.py'))]
    arguments = ['--messages', str(MESSAGES), '--restarts', '2', '--seed', '1']
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    figures = {figure['name']: figure for figure in result['figures']}
    assert result['messages'] == MESSAGES
    assert all(figure['met'] is not False for figure in figures.values())
    assert 0.2 < figures['share of messages touched']['value'] < 0.4
    assert figures['observers restored from a checkpoint, bit for bit']['value'] >= 2
    assert len(result['faults']) > 12
