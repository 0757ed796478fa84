"""One parameter finding its value: value on top, its rate of change below (thesis, figure 4.5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gray_box_observer.report.figure_parts import (
    TIME_DIGITS,
    Figure,
    Trace,
    axis,
    base_layout,
    change_marks,
    line,
    numbers,
    padded,
    plain,
    quantiles,
    settled_part,
    thinning_note,
    time_axis,
)
from gray_box_observer.report.run.history import FloatArray, ParameterHistory
from gray_box_observer.report.run.verdict_words import look_of
from gray_box_observer.report.thinning import segments, thinned
from gray_box_observer.report.units import SIGMA, Scale, scale_for

_HEIGHT = 430
_RATE_STEPS = 1_000
_MOST_SEGMENTS = 2_000


def parameter_scale(parameter: ParameterHistory) -> Scale:
    """Return the unit of a parameter for the whole page: that of its last estimate."""
    finite = parameter.value[np.isfinite(parameter.value)]
    return scale_for(float(finite[-1]) if finite.size else math.nan, parameter.unit)


def rate_of_change(
    time_s: FloatArray, value: FloatArray, steps: int = _RATE_STEPS
) -> tuple[FloatArray, FloatArray]:
    """Difference the estimates over steps of at least the run's length over `steps`.

    The step keeps the rounding of a fast sample rate out of the picture; every sample counts in a
    short run.

    Returns:
        Times in s (the end of each step) and rates per second.
    """
    if len(time_s) < 2:
        return np.empty(0), np.empty(0)
    step_s = float(time_s[-1] - time_s[0]) / steps
    cell = (
        np.floor((time_s - time_s[0]) / step_s * (1.0 + 1e-12))
        if step_s > 0.0
        else np.zeros(len(time_s))
    )
    places = np.flatnonzero(np.concatenate(([True], np.diff(cell) > 0.0)))
    finite = np.where(np.isfinite(value), value, np.nan)[places]
    return time_s[places][1:], np.diff(finite) / np.diff(time_s[places])


def parameter_figure(
    parameter: ParameterHistory, span_s: tuple[float, float], changes_s: Sequence[float] = ()
) -> Figure:
    """Draw estimate, one-sigma band and truth, the verdicts as a strip, the rate of change.

    Args:
        parameter: what to draw.
        span_s: first and last time of the motor's run, so that its figures share their time axis.
        changes_s: when the motor was found changed.
    """
    scale = parameter_scale(parameter)
    data, counts = _value_traces(parameter, scale)
    truth = _truth_trace(parameter, scale, span_s)
    data.extend([truth] if truth else [])
    rate_time_s, rate = rate_of_change(parameter.time_s, parameter.value)
    rate_scaled = rate * scale.factor
    data.append(
        line(
            numbers(rate_time_s, TIME_DIGITS),
            numbers(rate_scaled),
            'rate of change',
            '@rate',
            line={'width': 1.2},
            yaxis='y3',
            showlegend=False,
            hovertemplate=f'%{{y:.3~g}} {_per_second(scale)}',
        )
    )
    strip, strip_note = _verdict_strip(parameter)
    data.append(strip)

    value_range = [bound * scale.factor for bound in _settled_range(parameter, span_s)]
    late = settled_part(rate_time_s, span_s)
    rate_limit = quantiles(np.abs(rate_scaled[late]), 0.0, 0.99)[1]
    rate_limit = rate_limit if math.isfinite(rate_limit) and rate_limit > 0.0 else 1.0
    rate_range = padded(-rate_limit, rate_limit, 0.2)
    layout = _layout(scale, span_s, value_range, rate_range)
    layout['shapes'] = change_marks(changes_s)
    views = [_views(data, parameter, scale, value_range, rate_range)]
    return Figure(data, layout, views, ' '.join(filter(None, [thinning_note(counts), strip_note])))


def _value_traces(
    parameter: ParameterHistory, scale: Scale
) -> tuple[list[Trace], dict[str, tuple[int, int]]]:
    places = thinned(parameter.time_s, parameter.value)
    value, std = parameter.value[places] * scale.factor, parameter.std[places] * scale.factor
    times = numbers(parameter.time_s[places], TIME_DIGITS)
    is_finite = np.isfinite(value) & np.isfinite(std)
    std = np.where(is_finite, std, 0.0)
    low, high = value - std, value + std
    shown_std = numbers(np.where(is_finite, std, np.nan), 3)
    edge = {'line': {'width': 0}, 'hoverinfo': 'skip'}
    about = [
        [deviation, plain(parameter.verdict[k])]
        for deviation, k in zip(shown_std, places, strict=True)
    ]
    traces = [
        line(times, numbers(low), 'lower edge', '@band', showlegend=False, **edge),
        line(
            times, numbers(high), f'± 1 {SIGMA}', '@band', fill='tonexty', fillcolor='@band', **edge
        ),
        line(
            times,
            numbers(value),
            'estimate',
            '@estimate',
            line={'width': 2},
            customdata=about,
            hovertemplate=f'%{{y:.6~g}} ± %{{customdata[0]}} {plain(scale.label)}, '
            f'%{{customdata[1]}}',
        ),
    ]
    return traces, {'estimate': (len(places), len(parameter.value))}


def _truth_trace(
    parameter: ParameterHistory, scale: Scale, span_s: tuple[float, float]
) -> Trace | None:
    if parameter.truth is None:
        return None
    if isinstance(parameter.truth, tuple):
        times, values = parameter.truth
        if not len(times):
            return None
        times = np.append(times, max(span_s[1], times[-1]))
        values = np.append(values, values[-1])
    else:
        times = np.array(span_s)
        values = np.full(2, parameter.truth)
    return line(
        numbers(times, TIME_DIGITS),
        numbers(values * scale.factor),
        'truth',
        '@truth',
        line={'width': 1.4, 'dash': 'dash', 'shape': 'hv'},
        hovertemplate=f'%{{y:.6~g}} {plain(scale.label)}',
    )


def _verdict_strip(parameter: ParameterHistory) -> tuple[Trace, str]:
    parts = segments(parameter.time_s, parameter.verdict)
    note = ''
    if len(parts) > _MOST_SEGMENTS:
        changes = f'The verdict changed {len(parts) - 1:,} times'
        note = f'{changes}; its strip shows the longest {_MOST_SEGMENTS:,} stretches.'
        parts = sorted(parts, key=lambda part: part.start_s - part.end_s)[:_MOST_SEGMENTS]
        parts.sort(key=lambda part: part.start_s)
    strip = {
        'type': 'bar',
        'orientation': 'h',
        'name': 'verdict',
        'base': numbers([part.start_s for part in parts], TIME_DIGITS),
        'x': numbers([part.end_s - part.start_s for part in parts], TIME_DIGITS),
        'y': [0.0] * len(parts),
        'width': 1.0,
        'yaxis': 'y2',
        'marker': {
            'color': [f'@{look_of(part.verdict).style}' for part in parts],
            'line': {'width': 0},
        },
        'showlegend': False,
        'hoverinfo': 'skip',
    }
    return strip, note


def _settled_range(parameter: ParameterHistory, span_s: tuple[float, float]) -> list[float]:
    """Choose a range for what came after the wild start: estimate, band and truth."""
    late = settled_part(parameter.time_s, span_s)
    value, std = parameter.value[late], parameter.std[late]
    low, high = quantiles(value, 0.01, 0.99)
    if not math.isfinite(low):
        return [0.0, 1.0]
    room = quantiles(std, 0.5, 0.9)[1]
    room = 2.5 * min(room, 0.5 * abs(high)) if math.isfinite(room) else 0.0
    low, high = low - room, high + room
    truth = parameter.truth
    for bound in np.atleast_1d(
        truth[1] if isinstance(truth, tuple) else truth if truth is not None else []
    ):
        low, high = min(low, float(bound)), max(high, float(bound))
    floor = 1e-4 * max(abs(low), abs(high))
    if high - low < floor:
        low, high = low - floor, high + floor
    return padded(low, high, 0.15)


def _layout(
    scale: Scale, span_s: tuple[float, float], value_range: list[float], rate_range: list[float]
) -> dict[str, Any]:
    layout = base_layout(_HEIGHT, bargap=0, barmode='overlay')
    unit = f' ({plain(scale.label)})' if scale.label else ''
    layout['xaxis'] = time_axis(span_s, anchor='y3')
    layout['yaxis'] = axis(f'value{unit}', domain=[0.42, 1.0], range=value_range, type='linear')
    bare: dict[str, Any] = {'showticklabels': False, 'ticks': '', 'showgrid': False}
    layout['yaxis2'] = axis(domain=[0.365, 0.395], range=[-0.5, 0.5], fixedrange=True, **bare)
    layout['yaxis3'] = axis(
        f'rate ({_per_second(scale)})',
        domain=[0.0, 0.33],
        range=rate_range,
        type='linear',
        zeroline=True,
        zerolinecolor='@rule',
    )
    return layout


def _per_second(scale: Scale) -> str:
    return f'{plain(scale.label) or 1}/s'


def _views(
    data: list[Trace],
    parameter: ParameterHistory,
    scale: Scale,
    value_range: list[float],
    rate_range: list[float],
) -> list[dict[str, Any]]:
    linear = {'yaxis.type': 'linear', 'yaxis3.type': 'linear'}
    views: list[dict[str, Any]] = [
        {
            'label': 'Settled',
            'layout': {**linear, 'yaxis.range': value_range, 'yaxis3.range': rate_range},
        },
        {'label': 'Full', 'layout': {**linear, 'yaxis.range': None, 'yaxis3.range': None}},
    ]
    finite = parameter.value[np.isfinite(parameter.value)]
    if finite.size and finite.min() > 0.0:
        low, high = math.log10(finite.min() * scale.factor), math.log10(finite.max() * scale.factor)
        names = [trace['name'] for trace in data]
        views.append(
            {
                'label': 'Log',
                'layout': {
                    'yaxis.type': 'log',
                    'yaxis3.type': 'log',
                    'yaxis.range': padded(low, high, 0.1)
                    if high - low > 0.02
                    else [low - 0.05, high + 0.05],
                    'yaxis3.range': None,
                    'yaxis3.title.text': f'|rate| ({_per_second(scale)})',
                },
                'absolute': [names.index('rate of change')],
                'floor': {
                    str(names.index('lower edge')): float(finite.min() * scale.factor) * 1e-3
                },
            }
        )
    return views
