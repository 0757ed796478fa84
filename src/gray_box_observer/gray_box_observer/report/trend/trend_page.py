"""The trend report: what many recordings of the same motors say, on one page."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from gray_box_observer.report.figure_parts import Figure
from gray_box_observer.report.run import sections
from gray_box_observer.report.run.page import assembled, framed, write_page
from gray_box_observer.report.run.verdict_words import look_of
from gray_box_observer.report.trend.trend import (
    DAY_S,
    MONTH_S,
    ArchiveHistory,
    Drift,
    MotorTrend,
    ParameterTrend,
)
from gray_box_observer.report.trend.trend_figure import date_of, trend_figure, trend_scale
from gray_box_observer.report.units import percent, value_and_std

_MOST_FAILED = 200


def write_trend_report(history: ArchiveHistory, path: Path) -> None:
    """Write the trend report of an archive to ``path``, as a whole or not at all.

    Raises:
        ReportError: plotly is not installed, or the file cannot be written.
    """
    write_page(render_trends(history), path)


def render_trends(history: ArchiveHistory) -> str:
    """Return the trend report as the text of one self-contained HTML page.

    Raises:
        ReportError: plotly is not installed.
    """
    figures: dict[str, Figure] = {}
    motors = ''.join(_motor(index, motor, figures) for index, motor in enumerate(history.motors))
    return assembled(history, _headline(history), motors + _failure_table(history), figures)


def drift_words(drift: Drift | None) -> str:
    """Say how fast a parameter changes, in % of its value, with one standard deviation; plain text.

    Per 30 days; the same per day for what changes by the day.
    """
    if drift is None or drift.mean == 0.0:
        return 'not known'
    share = drift.per_s / abs(drift.mean)
    std = drift.per_s_std / abs(drift.mean)
    per_s, unit = (MONTH_S, 'in 30 days') if abs(share) * DAY_S < 0.1 else (DAY_S, 'a day')
    return f'{percent(share * per_s, has_sign=True)} ± {percent(std * per_s)} {unit}'


def _headline(history: ArchiveHistory) -> str:
    return sections.card_rows(history.motors, _card, 'No bag of this archive gave an estimate.')


def _card(trend: ParameterTrend) -> str:
    """Return a parameter's latest identified estimate, else its latest, and its drift."""
    scale = trend_scale(trend)
    identified_places = np.flatnonzero(trend.identified)
    latest = int(identified_places[-1]) if identified_places.size else len(trend.value) - 1
    text, deviation = value_and_std(float(trend.value[latest]), float(trend.std[latest]), scale)
    spread = f' <span class="std">± {deviation}</span>' if deviation is not None else ''
    unit = f' <span class="unit">{escape(scale.label)}</span>' if scale.label else ''
    verdict = trend.verdict[latest]
    details = [
        ('bag of', date_of(int(trend.start_ns[latest]))),
        ('identified in', f'{identified_places.size} of {len(trend.value)} bags'),
        ('change', drift_words(trend.drift())),
    ]
    rows = ''.join(
        f'<div><dt>{label}</dt><dd>{escape(entry)}</dd></div>' for label, entry in details
    )
    return (
        '<article class="card '
        f'{look_of(verdict).style}"><header><h3>{sections.words(trend.name)}</h3>'
        f'{sections.badge(verdict)}</header><p class="value"><span '
        f'class="number">{text}</span>{spread}{unit}</p>'
        f'<dl>{rows}</dl></article>'
    )


def _motor(index: int, motor: MotorTrend, figures: dict[str, Figure]) -> str:
    """Return the section of one motor and add its figures to `figures`."""
    parts = [
        f'<section class="motor" id="motor-{index}"><h2>{escape(motor.name)}</h2>',
        '<h3>Estimates over time</h3><div class="grid">',
    ]
    for number, trend in enumerate(motor.parameters):
        key = f'motor-{index}-parameter-{number}'
        figures[key] = trend_figure(trend)
        parts.append(framed(key, figures[key], sections.words(trend.name), motor.name))
    return ''.join(parts) + '</div></section>'


def _failure_table(history: ArchiveHistory) -> str:
    """Return the bags that gave nothing, with the reason."""
    if not history.failures:
        return ''
    failures = list(history.failures.items())[:_MOST_FAILED]
    remaining_count = len(history.failures) - len(failures)
    rows = ''.join(
        f'<tr><th scope="row">{escape(bag)}</th><td>{escape(why)}</td></tr>'
        for bag, why in failures
    )
    more = (
        f'<p class="caption">And {remaining_count} more: the table has them all.</p>'
        if remaining_count
        else ''
    )
    return (
        '<section class="motor"><h2>Bags that gave nothing</h2><div '
        'class="scroll"><table><thead><tr>'
        '<th scope="col">bag</th><th scope="col">reason</th></tr></thead>'
        f'<tbody>{rows}</tbody></table></div>{more}</section>'
    )
