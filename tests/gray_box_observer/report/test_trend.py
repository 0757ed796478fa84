from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

from gray_box_observer.report import (
    ArchiveHistory,
    MotorTrend,
    ParameterTrend,
    ReportError,
    render_trends,
)
from gray_box_observer.report.trend.trend import MONTH_S
from gray_box_observer.report.trend.trend_figure import date_of, trend_figure
from gray_box_observer.report.trend.trend_page import drift_words

MONTH_NS = round(MONTH_S) * 10**9
MAY_NS = 1_777_593_600 * 10**9
"""2026-05-01, 0:00 UTC."""


def trend(
    months: list[float], value: list[float], std: list[float], verdict: list[str] | None = None
) -> ParameterTrend:
    return ParameterTrend(
        'resistance',
        'ohm',
        np.array([MAY_NS + round(month * MONTH_NS) for month in months], dtype=np.int64),
        np.array(value),
        np.array(std),
        verdict or ['identified'] * len(value),
        [f'/archive/{k}' for k in range(len(value))],
    )


def figures_of(page: str) -> dict[str, dict[str, list[dict[str, object]]]]:
    text = re.search(r'<script type="application/json" id="figures">(.*?)</script>', page, re.S)
    assert text is not None
    return json.loads(text.group(1))


def archive(*motors: MotorTrend, **given: object) -> ArchiveHistory:
    return replace(
        ArchiveHistory('Trends', ('/archive',), '2026-11-21T09:00:00+00:00', motors), **given
    )


def test_the_drift_is_the_weighted_straight_line_that_scipy_fits() -> None:
    random = np.random.default_rng(5)
    months = np.sort(random.uniform(0.0, 12.0, 40))
    std = random.uniform(0.01, 0.05, 40)
    value = 4.2 + 0.03 * months + std * random.normal(size=40)
    found = trend(months.tolist(), value.tolist(), std.tolist()).drift()
    assert found is not None
    fit, covariance = curve_fit(
        lambda t, a, b: a + b * t, months, value, sigma=std, absolute_sigma=True
    )
    chi2 = float(np.sum(((value - fit[0] - fit[1] * months) / std) ** 2))
    assert found.per_s * MONTH_S == pytest.approx(fit[1], rel=1e-6)
    growth = max(1.0, chi2 / 38.0) ** 0.5
    assert found.per_s_std * MONTH_S == pytest.approx(growth * covariance[1, 1] ** 0.5, rel=1e-4)


def test_the_standard_deviation_of_the_drift_covers_what_the_stated_ones_leave_out() -> None:
    """Estimates that scatter with the temperature, ten times as far as each says."""
    random = np.random.default_rng(6)
    errors = []
    months = np.arange(24.0)
    for _ in range(200):
        value = 1.0 + 0.01 * months + 0.05 * random.normal(size=24)
        found = trend(months.tolist(), value.tolist(), [0.005] * 24).drift()
        assert found is not None
        errors.append((found.per_s * MONTH_S - 0.01) / (found.per_s_std * MONTH_S))
    assert 0.8 < float(np.std(errors)) < 1.3


def test_an_exact_line_is_found_exactly_and_drawn_through_its_points() -> None:
    found = trend([0.0, 1.0, 3.0], [1.0, 1.1, 1.3], [0.01] * 3)
    drift = found.drift()
    assert drift is not None
    assert drift.at(found.start_ns) == pytest.approx(found.value, rel=1e-9)
    assert drift_words(drift).startswith('+8.8\N{NO-BREAK SPACE}% ± ')
    assert drift_words(drift).endswith('in 30 days')


@pytest.mark.parametrize(
    ('months', 'verdicts'),
    [
        ([0.0, 1.0], ['identified'] * 2),
        ([1.0, 1.0, 1.0], ['identified'] * 3),
        ([0.0, 1.0, 2.0, 3.0], ['identified', 'converging', 'unexcited', 'identified']),
    ],
)
def test_too_few_identified_estimates_or_one_time_tell_no_drift(
    months: list[float], verdicts: list[str]
) -> None:
    count = len(months)
    found = trend(months, [1.0 + 0.1 * k for k in range(count)], [0.01] * count, verdicts).drift()
    assert found is None
    assert drift_words(found) == 'not known'


def test_the_figure_has_every_estimate_with_its_error_bar_and_bag() -> None:
    found = trend(
        [0.0, 1.0, 2.0],
        [1.0, 1.2, 7.0],
        [0.01, 0.02, 3.0],
        ['identified', 'identified', 'converging'],
    )
    figure = trend_figure(found)
    by_name = {trace['name']: trace for trace in figure.data}
    assert set(by_name) == {'identified', 'converging'}
    assert by_name['identified']['y'] == [1.0, 1.2]
    assert by_name['identified']['error_y']['array'] == [0.01, 0.02]
    assert by_name['identified']['x'] == ['2026-05-01 00:00:00.000', '2026-05-31 00:00:00.000']
    assert by_name['converging']['customdata'] == [['/archive/2', 3.0]]
    low, high = figure.layout['yaxis']['range']
    assert low < 0.99 and 1.22 < high < 2.0
    full = figure.views[0][1]['layout']['yaxis.range']
    assert full[0] < 4.0 and full[1] > 10.0


def test_the_page_tells_the_latest_identified_estimate_and_how_many_there_are() -> None:
    found = trend(
        [0.0, 1.0, 2.0],
        [1.0, 1.25, 7.0],
        [0.01, 0.02, 3.0],
        ['identified', 'identified', 'converging'],
    )
    page = render_trends(
        archive(
            MotorTrend('left', (found,)), failures={'/archive/<x>': 'no message'}, digest='9f' * 32
        )
    )
    for text in (
        '1.250',
        '± 0.020',
        '2 of 3 bags',
        date_of(MAY_NS + MONTH_NS),
        '/archive/&lt;x&gt;',
        '9f' * 32,
    ):
        assert text in page
    assert '/archive/<x>' not in page
    assert list(figures_of(page)) == ['motor-0-parameter-0']


def test_an_archive_without_any_result_still_has_a_page() -> None:
    page = render_trends(archive(failures={f'/archive/{k}': 'no message' for k in range(300)}))
    assert 'No bag of this archive gave an estimate.' in page
    assert 'And 100 more' in page


def test_a_clock_that_was_set_absurdly_far_is_drawn_all_the_same() -> None:
    far = replace(trend([0.0], [1.0], [0.1]), start_ns=np.array([2**63 - 1], dtype=np.int64))
    assert trend_figure(far).data[0]['x'][0].startswith('2262-04-11')


def test_series_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ReportError, match='expected one length'):
        replace(trend([0.0, 1.0], [1.0, 2.0], [0.1, 0.1]), bags=['one'])
    with pytest.raises(ReportError, match='runs backwards'):
        trend([1.0, 0.0], [1.0, 2.0], [0.1, 0.1])
