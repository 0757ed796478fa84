"""The dashboard beside a running observer, by itself and started by the observer."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

MODULE = 'gray_box_observer.ros.watching.dashboard_command'
PATIENCE_S = 60.0
CHUNK = 20
ENOUGH = 100


def events(url: str) -> Any:
    """Yield what a page is told."""
    with urlopen(f'{url}events', timeout=PATIENCE_S) as answer:
        for line in answer:
            if line.startswith(b'data: '):
                yield json.loads(line.removeprefix(b'data: '))


def gathered(url: str, rig: Any, recording: Any, kind: str) -> tuple[dict[str, list], set[str]]:
    """Send a recording piece by piece until a page has heard of a signal and of estimates.

    The page reads by best effort: what is sent before reader and writer know of each other is lost.

    Returns:
        Times and values of every signal, and the names of the parameters.
    """
    signals: dict[str, list] = {}
    stream = events(url)
    for first in range(0, recording.stamp_ns.size, CHUNK):
        rig.send(recording, range(first, first + CHUNK))
        told = next(stream)
        for name, columns in told.get('signals', {}).items():
            held = signals.setdefault(name, [[], []])
            signals[name] = [one + more for one, more in zip(held, columns, strict=True)]
        names = {p['name'] for p in told.get('motor', {}).get('parameters', [])}
        if names and len(signals[kind][0]) >= ENOUGH:
            return signals, names
    raise AssertionError(f'no {kind} but {signals}')


@pytest.mark.system
def test_a_page_is_told_signals_predictions_and_estimates(
    peer: Any, rig: Any, record: Callable[..., Any]
) -> None:
    dashboard = peer.start(MODULE)
    url = dashboard.stdout.readline().removeprefix('dashboard: ').strip()
    assert url.startswith('http://127.0.0.1:')
    rig.start(predictor='true')
    signals, parameters = gathered(url, rig, record(duration_s=60.0), 'predicted')
    assert len(set(signals['voltage'][0]) & set(signals['torque'][0])) >= ENOUGH - CHUNK
    assert len(set(signals['torque'][0]) & set(signals['predicted'][0])) >= ENOUGH - CHUNK
    assert parameters == {'inductance', 'resistance', 'hysteresis'}
    code, _, err = peer.end(dashboard)
    assert (code, err) == (0, '')


@pytest.mark.system
def test_an_observer_starts_its_own_which_reads_as_it_reads_and_ends_with_it(
    peer: Any, make_rig: Callable[..., Any], record: Callable[..., Any]
) -> None:
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    rig = make_rig('/r1')
    rig.start('--ros-args', '-r', '__ns:=/r1', '-p', f'dashboard.port:={port}', '-p',
              'voltage.scale:=2.0', '-p', 'predictor:=false')  # fmt: skip
    line = ''
    while 'dashboard: ' not in line:
        line = rig.process.stderr.readline()
        assert line, 'the observer has ended'
    assert f'http://127.0.0.1:{port}/' in line
    recording = record(duration_s=60.0)
    signals, _ = gathered(f'http://127.0.0.1:{port}/', rig, recording, 'voltage')
    volts = np.array(signals['voltage'][1])
    sent = recording.voltage_v[0]
    assert np.isin(volts.round(9), (2.0 * sent).round(9)).all()
    children = rig.children()
    assert len(children) == 1
    code, _, err = peer.end(rig.process)
    assert code == 0
    assert 'has ended' not in err
    peer.wait(lambda: not children[0].is_running(), 'the end of the dashboard')


@pytest.mark.system
def test_a_port_that_is_taken_is_told_and_the_observer_goes_on(peer: Any, rig: Any) -> None:
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        rig.start(dashboard__port=port)
        line = ''
        while 'the dashboard has ended' not in line:
            line = rig.process.stderr.readline()
            assert line, 'the observer has ended'
        assert f'cannot listen on 127.0.0.1, port {port}' in line
        code, out, err = peer.end(peer.start(MODULE, '--port', str(port)), None)
        assert (code, out) == (2, '')
        assert err.startswith('dashboard: error: ') and err.count('\n') == 1
    assert rig.lifecycle_state() == 3
