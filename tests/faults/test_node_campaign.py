"""A small share of `node_campaign`: real nodes on real DDS with faults between them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

pytestmark = pytest.mark.system

MESSAGES = 3000
LONGEST_S = 240.0
"""Half a minute on an idle machine."""


def run(*arguments: object) -> tuple[int, str, str]:
    """Run the campaign; none of the nodes it has started outlives it, whatever becomes of it."""
    command = [
        sys.executable,
        str(Path(__file__).with_name('node_campaign.py')),
        *(str(a) for a in arguments),
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            out, said = process.communicate(timeout=LONGEST_S)
        finally:
            started = (
                psutil.Process(process.pid).children(recursive=True)
                if process.poll() is None
                else []
            )
            for left in started:
                left.kill()
            process.kill()
        return process.returncode, out, said


@pytest.mark.timeout(LONGEST_S + 60.0)
def test_observers_killed_amid_faults_account_for_every_message_and_find_the_motor(peer) -> None:
    code, out, said = run(
        *(
            '--messages',
            MESSAGES,
            '--restarts',
            1,
            '--seed',
            1,
            '--no-predictor',
            '--domain',
            peer.domain,
        )
    )
    assert code == 0, out[-2000:] + said[-2000:]
    result = json.loads(out.splitlines()[-1])
    figures = {figure['name']: figure for figure in result['figures']}
    assert result['messages'] == MESSAGES
    assert all(figure['met'] is not False for figure in figures.values())
    assert 0.25 < figures['share of messages touched']['value'] < 0.4
    assert len(result['faults']) > 12
    account = result['account']
    assert account['samples used'] > 6000, 'of those sent in the clean minute at least'
    for reason in ('duplicate', 'out_of_order', 'non_finite', 'absurd'):
        assert account[f'refused: {reason}'] > 10
