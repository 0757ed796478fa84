"""A small archive: five bags of two motors over four months, one broken, and its command."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.identify.command import main

MONTH_NS = 30 * 86_400 * 10**9
MAY_NS = 1_777_593_600 * 10**9
"""2026-05-01, 0:00 UTC."""


@pytest.fixture
def identify(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run the command in this process; returns exit code, standard output and standard error."""

    def call(*args: Any) -> tuple[int, str, str]:
        code = main(['identify', *(str(a) for a in args)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture(scope='session')
def archive(
    tmp_path_factory: pytest.TempPathFactory,
    record: Callable[..., Recording],
    messages_of: Callable[..., Any],
    write_bag: Callable[..., Path],
) -> Path:
    """Bags at two depths, a bare file, and a text posing as a bag; `right` has 1.5 ohm."""
    folder = tmp_path_factory.mktemp('archive')
    for month in range(4):
        recording = record(
            'R[5,15]D[0.2,2]', 10.0, month + 1, ('left', 'right'), torque_noise_relative=0.01
        )
        start_ns = MAY_NS + month * MONTH_NS
        write_bag(
            folder / f'2026-{5 + month:02}' / 'bag', messages_of(recording, start_ns=start_ns)
        )
    whole = next((folder / '2026-08' / 'bag').glob('*.mcap')).read_bytes()
    (folder / 'bare.mcap').write_bytes(whole[: int(0.6 * len(whole))])
    (folder / 'no_bag.mcap').write_text('time,voltage\n0,1\n')
    (folder / 'notes.txt').write_text('not for machines')
    return folder


@pytest.fixture(scope='session')
def params(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The parameter file for the motors of the archive."""
    path = tmp_path_factory.mktemp('params') / 'params.yaml'
    path.write_text('/**:\n  ros__parameters:\n    motors: [left, right]\n')
    return path
