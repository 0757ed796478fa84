"""What was left out: rejected samples by reason, and when."""

from __future__ import annotations

import numpy as np

from gray_box_observer.report.figure_parts import (
    TIME_DIGITS,
    Figure,
    axis,
    base_layout,
    numbers,
    plain,
    thinning_note,
    time_axis,
)
from gray_box_observer.report.run.history import MotorHistory
from gray_box_observer.report.thinning import thinned

_DRAWN_WHOLE = 4_000


def rejection_figure(motor: MotorHistory) -> Figure | None:
    """Draw a bar for every reason of rejection, and a mark at the time of each rejection.

    Returns:
        None where nothing was rejected.
    """
    reasons = [
        reason
        for reason in {**motor.rejection_counts, **motor.rejected_time_s}
        if _count(motor, reason)
    ]
    if not reasons:
        return None
    reasons.sort(key=lambda reason: _count(motor, reason))
    labels = [plain(reason.replace('_', ' ')) for reason in reasons]
    counts = [_count(motor, reason) for reason in reasons]
    marked_x: list[float | None] = []
    marked_y: list[str] = []
    drawn_counts: dict[str, tuple[int, int]] = {}
    for reason, label in zip(reasons, labels, strict=True):
        times = np.sort(np.asarray(motor.rejected_time_s.get(reason, ()), dtype=np.float64))
        times = times[np.isfinite(times)]
        places = thinned(times, np.zeros(len(times)), _DRAWN_WHOLE)
        drawn_counts[reason] = (len(places), len(times))
        marked_x += numbers(times[places], TIME_DIGITS)
        marked_y += [label] * len(places)
    bars = {
        'type': 'bar',
        'orientation': 'h',
        'x': counts,
        'y': labels,
        'text': [f'{count:,}' for count in counts],
        'textposition': 'auto',
        'marker': {'color': '@rejected'},
        'xaxis': 'x2',
        'hovertemplate': '%{y}: %{x}<extra></extra>',
        'name': 'rejected samples',
        'showlegend': False,
    }
    marks = {
        'type': 'scatter',
        'mode': 'markers',
        'x': marked_x,
        'y': marked_y,
        'marker': {
            'symbol': 'line-ns-open',
            'size': 14,
            'color': '@rejected',
            'line': {'width': 1.5, 'color': '@rejected'},
        },
        'hovertemplate': '%{y} at %{x:.4f} s<extra></extra>',
        'name': 'when',
        'showlegend': False,
    }
    layout = base_layout(110 + 34 * len(reasons), hovermode='closest', bargap=0.35)
    layout['margin'] = {**layout['margin'], 't': 12}
    layout['xaxis'] = time_axis(motor.span_s(), domain=[0.36, 1.0])
    layout['xaxis2'] = axis('samples', domain=[0.0, 0.3], rangemode='tozero', anchor='y', nticks=5)
    layout['yaxis'] = axis(
        type='category', categoryarray=labels, automargin=True, ticks='', anchor='x2'
    )
    untimed_count = sum(_count(motor, reason) for reason in reasons) - sum(
        every for _, every in drawn_counts.values()
    )
    caption = (
        f'{untimed_count:,} rejected samples have no time and no mark. '
        if untimed_count > 0
        else ''
    )
    return Figure([bars, marks], layout, [], (caption + thinning_note(drawn_counts)).strip())


def _count(motor: MotorHistory, reason: str) -> int:
    return max(
        int(motor.rejection_counts.get(reason, 0)), len(motor.rejected_time_s.get(reason, ()))
    )
