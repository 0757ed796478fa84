"""A real browser draws what the server tells, while more of it comes."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from headless_browser import BROWSER, OFFLINE
from tornado.websocket import WebSocketClientConnection, websocket_connect

from gray_box_observer.watching.dashboard.page_feed import PageSource
from gray_box_observer.watching.dashboard.page_server import PageServer
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses
from gray_box_observer.watching.observer_state import WatchedState

pytest.importorskip('plotly', reason='the dashboard needs plotly')

TIMEOUT_S = 100.0
SECOND_NS = 10**9
SAMPLES = 50
VERDICTS = {'inductance': 'identified', 'resistance': 'converging', 'hysteresis': 'negligible'}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason='neither chromium nor google-chrome is on PATH'),
]

UPDATED = """
new Promise((resolve) => {
  const look = () => {
    if (Number(document.body.dataset.updates) >= %d) { resolve(document.body.dataset.updates); }
  };
  new MutationObserver(look).observe(document.body, { attributes: true });
  look();
})
"""
"""Settles once the page has been drawn so often."""

DRAWN = """
(() => {
  const inked = (plot, path) => [...plot.querySelectorAll(path)]
    .filter((line) => /[LHVC]/.test(line.getAttribute('d') || '')).length;
  const described = (plot) => ({
    title: plot.layout.title.text,
    lines: inked(plot, '.scatterlayer .js-line'),
    fills: inked(plot, '.scatterlayer .js-fill'),
    points: plot.data.map((trace) => trace.x.length),
  });
  const signals = [...document.querySelectorAll('body > .plot')].filter((plot) => !plot.hidden);
  return {
    signals: Object.fromEntries(signals.map((plot) => [plot.id, described(plot)])),
    courses: [...document.querySelectorAll('#courses > .plot')].map(described),
    rows: [...document.querySelectorAll('#parameters tr')]
      .map((row) => [...row.cells].map((cell) => cell.textContent)),
    verdicts: [...document.querySelectorAll('#parameters td[data-verdict]')]
      .map((cell) => cell.dataset.verdict),
    advice: document.querySelector('#advice').textContent,
    connection: document.querySelector('#connection').textContent,
  };
})()
"""
"""What stands on the page; a line of a plot counts where its path leads somewhere."""


class Tab:
    """One tab of the browser, by its debugging protocol.

    Attributes:
        complaints: errors of scripts, those that they write to the console too.
    """

    def __init__(self, connection: WebSocketClientConnection, session: str = '') -> None:
        self._connection = connection
        self._session = session
        self._numbers = count(1)
        self._events: list[str] = []
        self.complaints: list[str] = []

    async def open(self, url: str) -> None:
        """Open a page, and wait until it is loaded."""
        target = await self.call('Target.createTarget', url='about:blank')
        attached = await self.call(
            'Target.attachToTarget', targetId=target['targetId'], flatten=True
        )
        self._session = attached['sessionId']
        for domain in ('Runtime', 'Page'):
            await self.call(f'{domain}.enable')
        await self.call('Page.navigate', url=url)
        while 'Page.loadEventFired' not in self._events:
            await self._hear()

    async def evaluate(self, script: str) -> Any:
        """Return the value of an expression, or what its promise settles with."""
        answer = await self.call(
            'Runtime.evaluate', expression=script, awaitPromise=True, returnByValue=True
        )
        assert 'exceptionDetails' not in answer, answer
        return answer['result'].get('value')

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; return its result."""
        number = next(self._numbers)
        request = {'id': number, 'method': method, 'params': parameters}
        if self._session:
            request['sessionId'] = self._session
        await self._connection.write_message(json.dumps(request))
        while (message := await self._hear()).get('id') != number:
            pass
        assert 'error' not in message, message
        result: dict[str, Any] = message['result']
        return result

    async def _hear(self) -> dict[str, Any]:
        """Return the next message, and keep what is wrong with the page."""
        text = await self._connection.read_message()
        assert text is not None, 'the browser has ended'
        message: dict[str, Any] = json.loads(text)
        method = message.get('method', '')
        self._events.append(method)
        kind = message.get('params', {}).get('type')
        is_written = method == 'Runtime.consoleAPICalled' and kind in ('error', 'assert')
        if is_written or method == 'Runtime.exceptionThrown':
            self.complaints.append(json.dumps(message['params']))
        return message


@pytest.fixture
def debugging_url(tmp_path: Path) -> Iterator[str]:
    """Where the browser that is started here listens."""
    profile = tmp_path / 'profile'
    options = [*OFFLINE, '--remote-debugging-port=0', f'--user-data-dir={profile}']
    command = [str(BROWSER), *options, 'about:blank']
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stderr is not None
        line = ''
        while 'DevTools listening on ' not in line:
            line = process.stderr.readline()
            assert line, 'the browser has ended'
        yield line.rpartition(' ')[2].strip()
    finally:
        process.terminate()
        process.communicate(timeout=TIMEOUT_S)


@pytest.fixture
def source() -> PageSource:
    return PageSource(WatchedState(), SignalCourses(), lambda: 3.0)


def tell(source: PageSource, second: int) -> None:
    """Let an observer publish for one more second."""
    with source.lock:
        labels = ('left', ','.join(VERDICTS), 'value,std')
        numbers = [0.5, 0.1, 1.0 + 0.1 * second, 0.2, 10.0, 1.0]
        source.state.add_estimates('/o', labels, numbers, float(second))
        verdicts = {f'{name} verdict': verdict for name, verdict in VERDICTS.items()}
        source.state.add_status('/o', 'left', 0, 'drive it on', verdicts, float(second))
        for k in range(SAMPLES):
            stamp_ns = second * SECOND_NS + k * SECOND_NS // SAMPLES
            phase = 2.0 * math.pi * k / SAMPLES
            values = {'voltage': 12.0, 'torque': 0.2, 'speed': 30.0}
            for kind, value in values.items():
                source.signals.add('', kind, ['left'], [value * math.sin(phase)], stamp_ns)
            source.signals.add('/o', 'predicted', ['left'], [0.19 * math.sin(phase)], stamp_ns)


def shows_second(shown: dict[str, Any], second: int) -> bool:
    """Whether every plot has been drawn up to this second."""
    samples = (second + 1) * SAMPLES
    estimates = second + 1
    return all(set(plot['points']) == {samples} for plot in shown['signals'].values()) and all(
        set(plot['points']) == {estimates} for plot in shown['courses']
    )


async def looked_at(debugging_url: str, url: str, source: PageSource) -> tuple[dict, list[str]]:
    """Return what the page shows once it has been told more, and what went wrong with it."""
    connection = await websocket_connect(debugging_url, max_message_size=64_000_000)
    try:
        tab = Tab(connection)
        await tab.open(url)
        update_count = int(await tab.evaluate(UPDATED % 1))
        tell(source, 2)
        shown: dict[str, Any] = {}
        # Updates that were on their way when the second was told know nothing of it.
        while not (shown and shows_second(shown, 2)):
            update_count = int(await tab.evaluate(UPDATED % (update_count + 1)))
            shown = await tab.evaluate(DRAWN)
        return shown, tab.complaints
    finally:
        connection.close()


def test_a_browser_draws_every_curve_band_and_verdict_as_they_come(
    debugging_url: str, source: PageSource
) -> None:
    tell(source, 0)
    tell(source, 1)
    server = PageServer(source)
    server.start()
    try:
        shown, complaints = asyncio.run(
            asyncio.wait_for(looked_at(debugging_url, server.url, source), TIMEOUT_S)
        )
    finally:
        server.stop()

    assert complaints == []
    assert shown['connection'] == 'live'
    assert shown['advice'] == 'drive it on'
    line_counts = {name: plot['lines'] for name, plot in shown['signals'].items()}
    assert line_counts == {'voltage': 1, 'torque': 2, 'residual': 1, 'speed': 1}
    titles = [plot['title'].partition(' [')[0] for plot in shown['courses']]
    assert titles == list(VERDICTS)
    for plot in shown['courses']:
        assert len(plot['points']) == 3, plot['title']
        assert (plot['lines'], plot['fills']) == (3, 1), plot['title']
    assert [row[0] for row in shown['rows']] == list(VERDICTS)
    assert all(all(row) for row in shown['rows']), 'a cell is empty'
    assert [row[-1] for row in shown['rows']] == list(VERDICTS.values())
    assert shown['verdicts'] == list(VERDICTS.values())
