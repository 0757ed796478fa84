"""A share of the campaign of `small_bags`: the quickly read bags, with real processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

NAMES = (
    'one_chunk_of_empty_messages',
    'overlapping_chunks',
    'claims',
    'sparse_message',
    'sparse_chunks',
    'sparse_summary',
    'statistics_of_many',
    'long_definitions',
    'a_fixed_array_of_byte_arrays',
    'a_tree_of_byte_arrays',
    'a_sequence_of_chains',
)


@pytest.mark.timeout(660)
def test_bags_of_a_megabyte_are_read_in_half_a_gigabyte_or_refused_in_one_line() -> None:
    command = [sys.executable, str(Path(__file__).with_name('small_bags.py')), '--only', *NAMES]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout.splitlines()[-1])['figures']
    assert [figure['met'] for figure in figures] == [True, True, True, None]
