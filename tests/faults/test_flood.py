"""A small share of `flood`: a real node under messages that are far too large."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

LONGEST_S = 240.0


@pytest.mark.timeout(LONGEST_S + 60.0)
def test_messages_far_too_large_do_not_fill_the_memory(peer) -> None:
    command = [
        sys.executable,
        str(Path(__file__).with_name('flood.py')),
        '--domain',
        str(peer.domain),
    ]
    options = ['--seconds', '8', '--kinds', 'large', '--senders', '2']
    done = subprocess.run(
        [*command, *options], capture_output=True, text=True, timeout=LONGEST_S, check=False
    )
    assert done.stdout, done.stderr[-2000:]
    result = json.loads(done.stdout.splitlines()[-1])
    figures = {figure['name']: figure for figure in result['figures']}
    assert result['large: messages sent'] > 10
    assert figures['large: memory, most [MB]']['met'], done.stdout
    assert figures['tracebacks']['met'], done.stdout
