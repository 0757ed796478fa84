"""What every figure of the report shares: numbers, axes, ranges.

A figure is a plain dictionary that goes into the page as JSON: `data` and `layout` as plotly.js
takes them, and `views`, groups of buttons. A view overrides parts of the layout (`layout`, by
dotted path) and may change what is drawn: `absolute` lists traces of which the magnitude is drawn,
`floor` the least value of others. Colours are written `@name` and looked up in the style sheet, so
that a figure follows light and dark.
"""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gray_box_observer.report.run.history import FloatArray

Trace = dict[str, Any]

SIGNAL_DIGITS = 7

MOST_MARKS = 200
TIME_DIGITS = 10


@dataclass(frozen=True)
class Figure:
    """One drawing of the page.

    Attributes:
        data: traces of plotly.js.
        layout: layout of plotly.js.
        views: groups of buttons; each view is a mapping with a `label`, see the module.
        caption: what a reader must know to read it, plain text.
    """

    data: list[Trace]
    layout: dict[str, Any]
    views: list[list[dict[str, Any]]]
    caption: str = ''

    def as_json(self) -> dict[str, Any]:
        """Return what the script of the page reads."""
        return {'data': self.data, 'layout': self.layout, 'views': self.views}


def numbers(values: npt.ArrayLike, digits: int = SIGNAL_DIGITS) -> list[float | None]:
    """Return a list for JSON: rounded to significant digits, None where a value is not finite."""
    pattern = f'%.{digits}g'
    return [
        float(pattern % value) if math.isfinite(value) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]


def plain(text: str) -> str:
    """Escape a user's text for plotly.js, which reads some HTML in labels and `%{` templates."""
    return html.escape(text, quote=False).replace('%{', '%&#123;')


def axis(title: str = '', **settings: Any) -> dict[str, Any]:
    """Return an axis in the style of the page."""
    return {
        'title': {'text': title, 'standoff': 8, 'font': {'size': 11}},
        'gridcolor': '@grid',
        'zeroline': False,
        'linecolor': '@rule',
        'ticks': 'outside',
        'ticklen': 4,
        'tickcolor': '@rule',
        'exponentformat': 'power',
        **settings,
    }


def time_axis(span_s: tuple[float, float], **settings: Any) -> dict[str, Any]:
    """Return the time axis that the figures of a motor share; the page zooms them together."""
    start, end = span_s
    return axis(
        'time (s)',
        hoverformat='.3f',
        range=[start, end if end > start else start + 1.0],
        **settings,
    )


def change_marks(times_s: Sequence[float]) -> list[dict[str, Any]]:
    """Return vertical lines at the times at which the motor was found changed."""
    style = {
        'type': 'line',
        'xref': 'x',
        'yref': 'paper',
        'y0': 0,
        'y1': 1,
        'line': {'color': '@rate', 'dash': 'dot'},
    }
    return [{**style, 'x0': time_s, 'x1': time_s} for time_s in times_s[:MOST_MARKS]]


def base_layout(height: int, **settings: Any) -> dict[str, Any]:
    """Return the layout that every figure starts from."""
    return {
        'height': height,
        'margin': {'l': 72, 'r': 16, 't': 36, 'b': 46},
        'paper_bgcolor': '@surface',
        'plot_bgcolor': '@surface',
        'font': {
            'family': 'Inter, "Helvetica Neue", Arial, sans-serif',
            'size': 12,
            'color': '@ink-soft',
        },
        'hoverlabel': {
            'bgcolor': '@raised',
            'bordercolor': '@rule',
            'font': {'color': '@ink', 'size': 12},
        },
        'hovermode': 'x unified',
        'legend': {
            'orientation': 'h',
            'traceorder': 'normal',
            'x': 0,
            'xanchor': 'left',
            'y': 1.01,
            'yanchor': 'bottom',
            'bgcolor': 'rgba(0, 0, 0, 0)',
        },
        'dragmode': 'zoom',
        **settings,
    }


def line(x: list[Any], y: list[Any], name: str, color: str, **settings: Any) -> Trace:
    """Return a line trace; settings under `line` are added to its colour and width."""
    style = {'color': color, 'width': 1.5, **settings.pop('line', {})}
    return {
        'type': 'scatter',
        'mode': 'lines',
        'x': x,
        'y': y,
        'name': name,
        'line': style,
        **settings,
    }


def padded(low: float, high: float, share: float = 0.08) -> list[float]:
    """Return an axis range with some air; a sensible one where there is nothing to show."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return [0.0, 1.0]
    room = (high - low) * share or abs(high) * share or 1.0
    return [low - room, high + room]


def settled_part(
    time_s: FloatArray, span_s: tuple[float, float], share: float = 0.3
) -> npt.NDArray[np.bool_]:
    """Mark what came after the first `share` of the run; everything, if nothing did."""
    late = time_s >= span_s[0] + share * (span_s[1] - span_s[0])
    return late if late.any() else np.ones(len(time_s), dtype=bool)


def quantiles(values: FloatArray, low: float, high: float) -> tuple[float, float]:
    """Return two quantiles of the finite values, NaN where there are none."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return math.nan, math.nan
    return float(np.quantile(finite, low)), float(np.quantile(finite, high))


def largest(values: FloatArray) -> float:
    """Return the largest finite magnitude, 0 where there is none."""
    finite = values[np.isfinite(values)]
    return float(np.max(np.abs(finite))) if finite.size else 0.0


def thinning_note(counts: Mapping[str, tuple[int, int]]) -> str:
    """Say which series were thinned, from (drawn, of) by name; empty if none was."""
    thin = [
        f'{name}: {some:,} of {every:,}' for name, (some, every) in counts.items() if some < every
    ]
    if not thin:
        return ''
    return (
        'Thinned for drawing, keeping the lowest and the highest sample of every time bucket ('
        + '; '.join(thin)
        + ' points).'
    )
