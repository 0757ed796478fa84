"""``watch`` beside a running observer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from gray_box_observer.watching.observer_state import SILENT_S

MODULE = 'gray_box_observer.ros.watching.watch_command'


def used(rig: Any) -> str | None:
    """Samples of the motor, by the newest diagnostics of this observer among those of several."""
    counts = [
        pair.value
        for array in rig.diagnostics
        for status in array.status
        if status.hardware_id == f'{rig.namespace}/motor'.lstrip('/')
        for pair in status.values
        if pair.key == 'samples used'
    ]
    return counts[-1] if counts else None


@pytest.mark.system
def test_it_shows_the_observers_that_run_and_ends_quietly(
    peer: Any, make_rig: Callable[..., Any], record: Callable[..., Any]
) -> None:
    rigs = [make_rig('/r1'), make_rig('/r2')]
    for rig in rigs:
        rig.start('--ros-args', '-r', f'__ns:={rig.namespace}', '-p', 'predictor:=false')
    recording = record(duration_s=4.0)
    rigs[0].send(recording, range(400))
    peer.wait(lambda: used(rigs[0]) == '400', 'the samples to be used', timeout_s=60)
    names = [f'{rig.namespace}/gray_box_observer' for rig in rigs]
    named = [word for name in names for word in ('--observer', name)]
    code, out, err = peer.end(peer.start(MODULE, '--once', '--timeout', '110', *named), None)
    assert (code, err) == (0, '')
    assert '/r1/gray_box_observer  1 motor' in out
    assert '400 samples used' in ' '.join(out.split())
    assert '/r2/gray_box_observer  ' in out
    assert 'nothing received for this motor' in out
    watching = peer.start(MODULE, '--observer', 'r1/gray_box_observer', '--period', '0.1')
    first = watching.stdout.readline() + watching.stdout.readline()
    assert '/r1/gray_box_observer' in first
    code, out, err = peer.end(watching)
    assert (code, err) == (0, '')
    assert '/r2/' not in out


@pytest.mark.system
def test_where_nothing_is_heard_it_says_what_may_be_the_reason(
    peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = peer.end(peer.start(MODULE, '--once'), None)
    assert (code, out) == (2, '')
    assert f'no observer heard on /*/estimates or /diagnostics for {SILENT_S:.0f} s' in err
    assert f'ROS_DOMAIN_ID={peer.domain}' in err
    assert err.count('\n') == 1
