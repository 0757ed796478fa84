"""The dashboard beside a running observer, by itself and started by the observer."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from typing import Any
from urllib.request import urlopen

import pytest

MODULE = 'gray_box_observer.ros.watching.dashboard_command'
PATIENCE_S = 60.0


def events(url: str) -> Any:
    """Yield what a page is told."""
    with urlopen(f'{url}events', timeout=PATIENCE_S) as answer:
        for line in answer:
            if line.startswith(b'data: '):
                yield json.loads(line.removeprefix(b'data: '))


def gathered(url: str, kind: str, count: int = 1) -> tuple[dict[str, list], set[str]]:
    """Read updates until a signal has so many points and the motor has estimates.

    Returns:
        Times and values of every signal, and the names of the parameters.
    """
    signals: dict[str, list] = {}
    end_s = time.monotonic() + PATIENCE_S
    for told in events(url):
        for name, columns in told.get('signals', {}).items():
            held = signals.setdefault(name, [[], []])
            signals[name] = [one + more for one, more in zip(held, columns, strict=True)]
        names = {p['name'] for p in told.get('motor', {}).get('parameters', [])}
        if names and len(signals[kind][0]) >= count:
            return signals, names
        assert time.monotonic() < end_s, f'no {kind}: {told}'
    raise AssertionError('the stream has ended')


@pytest.mark.system
def test_a_page_is_told_signals_predictions_and_estimates(
    peer: Any, rig: Any, record: Callable[..., Any]
) -> None:
    dashboard = peer.start(MODULE)
    url = dashboard.stdout.readline().removeprefix('dashboard: ').strip()
    assert url.startswith('http://127.0.0.1:')
    rig.start(predictor='true')
    rig.signals()
    for publisher in rig.signals():
        peer.wait(lambda p=publisher: p.get_subscription_count() == 2, 'the dashboard to listen')
    predicted = '/gray_box_observer/predicted_torque'
    peer.wait(lambda: peer.node.count_subscribers(predicted) == 2, 'the dashboard to hear more')
    rig.send(record(duration_s=4.0), range(400))
    rig.wait_for(samples_used=400)
    signals, parameters = gathered(url, 'predicted', 350)
    assert signals['voltage'][0] == signals['torque'][0]
    assert len(set(signals['torque'][0]) & set(signals['predicted'][0])) > 300
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
    for publisher in rig.signals():
        peer.wait(lambda p=publisher: p.get_subscription_count() == 2, 'the dashboard to listen')
    recording = record(duration_s=1.0)
    rig.send(recording, range(100))
    signals, _ = gathered(f'http://127.0.0.1:{port}/', 'voltage', 90)
    assert signals['voltage'][1][0] == pytest.approx(2.0 * recording.voltage_v[0, 0])
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
