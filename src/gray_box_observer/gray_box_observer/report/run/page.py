"""The report: one HTML file that needs nothing else, no network and no server.

The page carries plotly.js, its own style and script, and the figures as JSON; a content security
policy in its head forbids the browser to load anything from elsewhere.
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Mapping
from html import escape
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from gray_box_observer.report.figure_parts import Figure
from gray_box_observer.report.report_errors import ReportError
from gray_box_observer.report.run import sections
from gray_box_observer.report.run.history import MotorHistory, RunHistory
from gray_box_observer.report.run.parameter_figure import parameter_figure
from gray_box_observer.report.run.rejection_figure import rejection_figure
from gray_box_observer.report.run.residual_figure import residual_figure
from gray_box_observer.report.run.signal_figure import signal_figure
from gray_box_observer.report.trend.trend import ArchiveHistory
from gray_box_observer.safe_io.atomic_write import atomic_write

_PLOTLY_MISSING = (
    'the HTML report needs plotly, which is not installed: pip install plotly, or leave out '
    '--report'
)


def require_plotly() -> None:
    """Say before a run, not after it, that its report could not be drawn; loads nothing.

    Raises:
        ReportError: plotly is not installed.
    """
    if find_spec('plotly') is None:
        raise ReportError(_PLOTLY_MISSING)


def write_report(history: RunHistory, path: Path) -> None:
    """Write the report of a run to `path`, whole or not at all: a reader never sees half.

    Args:
        history: what to report.
        path: an `.html` file; missing folders are made, an older report is replaced.

    Raises:
        ReportError: plotly is not installed, or the file cannot be written.
    """
    write_page(render(history), Path(path))


def write_page(text: str, path: Path) -> None:
    """Write a page as a whole or not at all.

    Raises:
        ReportError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(text.encode(errors='backslashreplace'))
    except OSError as error:
        reason = error.strerror or str(error)
        raise ReportError(
            f'cannot write the report {path}: {reason}; choose another file'
        ) from error


def render(history: RunHistory) -> str:
    """Return the report of a run as the text of one self-contained HTML page.

    The same history and the same versions of the libraries give the same text.

    Raises:
        ReportError: plotly is not installed.
    """
    figures: dict[str, Figure] = {}
    motors = ''.join(_motor(index, motor, figures) for index, motor in enumerate(history.motors))
    return assembled(history, sections.headline(history), motors, figures)


def assembled(
    history: RunHistory | ArchiveHistory, headline: str, content: str, figures: Mapping[str, Figure]
) -> str:
    """Return a page from what all reports share and what is this report's own.

    Args:
        history: what the page is about.
        headline: HTML of the cards on top.
        content: HTML of the motors' sections.
        figures: by the id of the element that each is drawn in.

    Raises:
        ReportError: plotly is not installed.
    """
    plotly_js, versions = _plotly()
    return Template(_resource('page.html')).substitute(
        title=escape(history.title),
        source=', '.join(escape(name) for name in history.source) or 'not named',
        created=escape(history.creation_time),
        facts=sections.facts(history.summary),
        contents=sections.contents([motor.name for motor in history.motors]),
        headline=headline,
        motors=content,
        footer=sections.footer(history, versions),
        style=_resource('page.css'),
        figures=embedded({key: figure.as_json() for key, figure in figures.items()}),
        plotly=plotly_js.replace('</script', '<\\/script'),
        script=_resource('page.js'),
    )


def embedded(content: Mapping[str, Any]) -> str:
    """Return JSON that may stand inside a script element whatever strings it holds.

    Raises:
        ValueError: a number is not finite; figures write None for those.
    """
    text = json.dumps(content, allow_nan=False, separators=(',', ':'))
    return text.replace('&', '\\u0026').replace('<', '\\u003c').replace('>', '\\u003e')


def _motor(index: int, motor: MotorHistory, figures: dict[str, Figure]) -> str:
    """Return the section of one motor and add its figures to `figures`."""
    span_s = motor.span_s()

    def figure(key: str, drawing: Figure, title: str) -> str:
        figures[f'motor-{index}-{key}'] = drawing
        return framed(f'motor-{index}-{key}', drawing, title, motor.name)

    parts = [f'<section class="motor" id="motor-{index}"><h2>{escape(motor.name)}</h2>']
    parts.append('<h3>Parameters</h3>' + sections.verdict_key(motor) + '<div class="grid">')
    for number, parameter in enumerate(motor.parameters):
        drawing = parameter_figure(parameter, span_s, motor.changes_s)
        parts.append(figure(f'parameter-{number}', drawing, sections.words(parameter.name)))
    parts.append('</div><h3>Signals and prediction</h3>')
    if len(motor.time_s):
        parts.append(
            figure('signals', signal_figure(motor), 'voltage, torque and prediction error')
        )
    else:
        parts.append('<p class="empty">No sample was used.</p>')
    residual = residual_figure(motor.fit)
    if residual is not None:
        figures[f'motor-{index}-residual'] = residual
        frame = framed(
            f'motor-{index}-residual',
            residual,
            'residual of the free run',
            motor.name,
            has_time_axis=False,
        )
        parts.append('<h3>Does the white box explain the data?</h3>' + frame)
    parts.append(sections.validation_table(motor.validation))
    parts.append(
        '<h3>Predictor</h3><div class="scroll">' + sections.scores_table(motor.scores) + '</div>'
    )
    parts.append('<h3>Rejected samples</h3>')
    rejections = rejection_figure(motor)
    if rejections is None:
        checks = ', '.join(sections.words(reason) for reason in motor.rejection_counts)
        checks_note = f' Checked: {checks}.' if checks else ''
        parts.append(f'<p class="empty">No sample was rejected.{checks_note}</p>')
    else:
        parts.append(figure('rejected', rejections, 'by reason, and when'))
    parts.append(sections.derived_table(motor.derived_figures))
    parts.append(sections.sensitivity_table(motor.sensitivity) + sections.notes_list(motor.notes))
    return ''.join(parts) + '</section>'


def framed(key: str, drawing: Figure, title: str, motor: str, *, has_time_axis: bool = True) -> str:
    """Return the frame for a motor's figure, drawn by script; `title` is HTML, `motor` is not.

    A figure that is not `has_time_axis` does not share the motor's time axis.
    """
    note = f'<p class="caption">{escape(drawing.caption)}</p>' if drawing.caption else ''
    label = f'{title} of {escape(motor)}'
    style = 'drawing' if has_time_axis else 'drawing apart'
    return (
        f'<figure><figcaption><h4>{title}</h4><div class="views" '
        f'data-for="{key}"></div></figcaption>'
        f'<div class="{style}" id="{key}" role="img" aria-label="{label}"></div>{note}</figure>'
    )


def _resource(name: str) -> str:
    return (resources.files('gray_box_observer.report.run') / name).read_text(encoding='utf-8')


def _plotly() -> tuple[str, dict[str, str]]:
    """Return the text of plotly.js and the versions that made the page."""
    try:
        import plotly
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ReportError(_PLOTLY_MISSING) from error
    text = str(get_plotlyjs())
    match = re.search(r'plotly\.js v(\d[\w.-]*)', text[:2000])
    versions = {
        'Python': platform.python_version(),
        'NumPy': np.__version__,
        'plotly': str(plotly.__version__),
        'plotly.js': match.group(1) if match else 'of unknown version',
    }
    return text, versions
