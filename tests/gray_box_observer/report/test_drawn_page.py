"""A real browser draws every figure of the page, and its buttons work."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from headless_browser import BROWSER, OFFLINE

from gray_box_observer.report import (
    ArchiveHistory,
    MotorTrend,
    ParameterTrend,
    render,
    render_trends,
)
from gray_box_observer.report.run.parameter_figure import parameter_figure
from gray_box_observer.report.run.rejection_figure import rejection_figure
from gray_box_observer.report.run.signal_figure import signal_figure

pytest.importorskip('plotly', reason='the report needs plotly')

# Runs after the page's own script: presses every button once the figures stand, then counts what is
# drawn.
PROBE = """
<script>
addEventListener('error', (event) => { document.documentElement.dataset.failed = event.message; });
const probe = setInterval(() => {
  if (document.documentElement.dataset.figures !== 'drawn') { return; }
  clearInterval(probe);
  const pressed = [...document.querySelectorAll('.views button')];
  const log = document.querySelector('#motor-0-parameter-0');
  const others = pressed.filter((button) => button.textContent !== 'Last tenth');
  for (const button of others) { button.click(); }
  log.dataset.type = log.layout.yaxis.type;
  pressed.find((button) => button.textContent === 'Last tenth').click();
  setTimeout(() => {
    for (const plot of document.querySelectorAll('.drawing')) {
      plot.dataset.svg = plot.querySelectorAll('svg.main-svg').length;
      const traces = plot.querySelectorAll('.scatterlayer > .trace, .barlayer > .trace');
      plot.dataset.traces = traces.length;
      plot.dataset.range = plot.layout.xaxis.range.map((end) => end.toFixed(3)).join(' ');
      plot.dataset.ink = plot.data.at(-1).marker?.color ?? '';
    }
    document.documentElement.dataset.probe = 'done';
  }, 500);
}, 50);
</script>
</body>
"""


def drawn_by_browser(page: Path, profile: Path) -> str:
    command = [BROWSER, *OFFLINE, f'--user-data-dir={profile}', '--window-size=1400,3000']
    command += ['--virtual-time-budget=30000', '--dump-dom', page.as_uri()]
    done = subprocess.run(command, capture_output=True, timeout=100, check=False)
    return re.sub(r'<script.*?</script>', '', done.stdout.decode('utf-8'), flags=re.S)


@pytest.mark.skipif(BROWSER is None, reason='neither chromium nor google-chrome is on PATH')
def test_a_browser_draws_every_figure_with_all_its_traces_and_answers_the_buttons(
    tmp_path, whole_run
):
    motor = whole_run.motors[0]
    span_s = motor.span_s()
    expected = {
        f'motor-0-parameter-{k}': parameter_figure(p, span_s)
        for k, p in enumerate(motor.parameters)
    }
    expected['motor-0-signals'] = signal_figure(motor)
    expected['motor-0-rejected'] = rejection_figure(motor)
    path = tmp_path / 'report.html'
    path.write_text(render(whole_run).replace('</body>', PROBE), encoding='utf-8')

    document = drawn_by_browser(path, tmp_path / 'profile')

    root = re.search(r'<html[^>]*>', document).group(0)
    assert 'data-probe="done"' in root, root
    assert 'data-failed' not in root, root
    plots = {
        re.search(r' id="([^"]*)"', tag).group(1): dict(re.findall(r'data-(\w+)="([^"]*)"', tag))
        for tag in re.findall(r'<div class="drawing[ "][^>]*>', document)
    }
    assert plots.keys() == expected.keys()
    for key, figure in expected.items():
        assert int(plots[key]['svg']) >= 1, key
        assert int(plots[key]['traces']) == len(figure.data), key
        assert plots[key]['range'] == '54.000 60.000', 'the time axes of a motor are not linked'
        assert '@' not in plots[key]['ink'], key
    assert plots['motor-0-parameter-0']['type'] == 'log'


TREND_PROBE = """
<script>
addEventListener('error', (event) => { document.documentElement.dataset.failed = event.message; });
const probe = setInterval(() => {
  if (document.documentElement.dataset.figures !== 'drawn') { return; }
  clearInterval(probe);
  for (const button of document.querySelectorAll('.views button')) { button.click(); }
  setTimeout(() => {
    for (const plot of document.querySelectorAll('.drawing')) {
      plot.dataset.traces = plot.querySelectorAll('.scatterlayer > .trace').length;
      plot.dataset.bars = plot.querySelectorAll('.errorbar').length;
      plot.dataset.axis = plot.layout.xaxis.type;
    }
    document.documentElement.dataset.probe = 'done';
  }, 500);
}, 50);
</script>
</body>
"""


@pytest.mark.skipif(BROWSER is None, reason='neither chromium nor google-chrome is on PATH')
def test_a_browser_draws_every_bag_of_a_trend_with_its_error_bar_over_dates(tmp_path):
    start_ns = 1_777_593_600 * 10**9 + 86_400 * 10**9 * np.arange(6, dtype=np.int64)
    value = np.array([1.0, 1.1, 1.2, 1.3, 7.0, 1.4])
    verdict = ['identified'] * 4 + ['converging', 'identified']
    trend = ParameterTrend(
        'resistance', 'ohm', start_ns, value, 0.01 * value, verdict, [f'/bag/{k}' for k in range(6)]
    )
    motors = (MotorTrend('left', (trend,)), MotorTrend('right', (trend,)))
    page = render_trends(ArchiveHistory('Trends', ('/bags',), '2026-11-21T09:00:00+00:00', motors))
    path = tmp_path / 'trend.html'
    path.write_text(page.replace('</body>', TREND_PROBE), encoding='utf-8')

    document = drawn_by_browser(path, tmp_path / 'profile')

    root = re.search(r'<html[^>]*>', document).group(0)
    assert 'data-probe="done"' in root, root
    assert 'data-failed' not in root, root
    for tag in re.findall(r'<div class="drawing[ "][^>]*>', document):
        found = dict(re.findall(r'data-(\w+)="([^"]*)"', tag))
        assert found == {'traces': '3', 'bars': '6', 'axis': 'date'}
    assert document.count('data-axis="date"') == 2
