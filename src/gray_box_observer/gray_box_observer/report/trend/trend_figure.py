"""One parameter of one motor over many bags: marks with error bars, and a straight line."""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone

import numpy as np
import numpy.typing as npt

from gray_box_observer.report.figure_parts import (
    Figure,
    Trace,
    axis,
    base_layout,
    line,
    numbers,
    padded,
    plain,
)
from gray_box_observer.report.run.history import FloatArray
from gray_box_observer.report.run.verdict_words import look_of
from gray_box_observer.report.trend.trend import Drift, ParameterTrend
from gray_box_observer.report.units import SIGMA, Scale, scale_for

_HEIGHT = 360
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_SIGNS = {'identified': 'circle', 'implausible': 'x', 'unexcited': 'circle-open'}


def trend_scale(trend: ParameterTrend) -> Scale:
    """Return the unit of a parameter for the whole page: that of its typical estimate."""
    values = trend.value[trend.identified] if trend.identified.any() else trend.value
    finite = values[np.isfinite(values)]
    return scale_for(float(np.median(finite)) if finite.size else math.nan, trend.unit)


def date_of(time_ns: int) -> str:
    """Write ns since 1970 as a date and time in UTC, to the second."""
    return _moment(time_ns).strftime('%Y-%m-%d %H:%M:%S')


def trend_figure(trend: ParameterTrend) -> Figure:
    """Draw each estimate with one-sigma bar, by verdict, and the line through identified ones."""
    scale = trend_scale(trend)
    data = [
        _marks(trend, verdict, scale)
        for verdict in sorted(set(trend.verdict), key=_first_identified)
    ]
    drift = trend.drift()
    if drift is not None:
        data.append(_drift_line(trend, drift, scale))
    layout = base_layout(_HEIGHT, hovermode='closest')
    layout['xaxis'] = axis('start of the bag (UTC)', type='date', range=_date_range(trend.start_ns))
    unit = f' ({plain(scale.label)})' if scale.label else ''
    full = _value_range(trend, np.isfinite(trend.value), scale)
    settled_range = _value_range(trend, trend.identified, scale) if trend.identified.any() else full
    layout['yaxis'] = axis(f'value{unit}', type='linear', range=settled_range)
    views = [
        {'label': 'Identified', 'layout': {'yaxis.range': settled_range}},
        {'label': 'Full', 'layout': {'yaxis.range': full}},
    ]
    return Figure(
        data, layout, [views], f'Error bars: ± 1 {SIGMA}, as stated at the end of each bag.'
    )


def _first_identified(verdict: str) -> tuple[bool, str]:
    return verdict != 'identified', verdict


def _marks(trend: ParameterTrend, verdict: str, scale: Scale) -> Trace:
    """Return the estimates of one verdict; their colour and sign tell it."""
    places = [k for k, word in enumerate(trend.verdict) if word == verdict]
    color = f'@{look_of(verdict).style}'
    std = np.where(np.isfinite(trend.std), trend.std, 0.0)[places] * scale.factor
    return {
        'type': 'scatter',
        'mode': 'markers',
        'x': [_moment(int(trend.start_ns[k])).isoformat(' ', 'milliseconds')[:-6] for k in places],
        'y': numbers(trend.value[places] * scale.factor),
        'error_y': {
            'type': 'data',
            'array': numbers(std, 4),
            'color': color,
            'thickness': 1,
            'width': 2,
        },
        'name': plain(verdict),
        'marker': {'color': color, 'size': 6, 'symbol': _SIGNS.get(verdict, 'circle')},
        'customdata': [
            [plain(trend.bags[k]), deviation]
            for k, deviation in zip(places, numbers(std, 3), strict=True)
        ],
        'hovertemplate': f'%{{y:.6~g}} ± %{{customdata[1]}} '
        f'{plain(scale.label)}<br>%{{x}}<br>%{{customdata[0]}}',
    }


def _drift_line(trend: ParameterTrend, drift: Drift, scale: Scale) -> Trace:
    times = trend.start_ns[trend.identified][[0, -1]]
    return line(
        [date_of(int(time_ns)) for time_ns in times],
        numbers(drift.at(times) * scale.factor),
        'straight line',
        '@truth',
        line={'width': 1.4, 'dash': 'dash'},
        hoverinfo='skip',
    )


def _date_range(start_ns: npt.NDArray[np.int64]) -> list[str]:
    if not len(start_ns):
        return ['1970-01-01', '1970-01-02']
    room_ns = max(0.03 * float(start_ns[-1] - start_ns[0]), 60e9)
    return [date_of(int(start_ns[0] - room_ns)), date_of(int(start_ns[-1] + room_ns))]


def _value_range(trend: ParameterTrend, mask: npt.NDArray[np.bool_], scale: Scale) -> list[float]:
    value: FloatArray = trend.value[mask] * scale.factor
    std = np.where(np.isfinite(trend.std), trend.std, 0.0)[mask] * scale.factor
    if not value.size:
        return padded(math.nan, math.nan)
    return padded(float(np.min(value - std)), float(np.max(value + std)), 0.12)


def _moment(time_ns: int) -> datetime:
    """Turn a stamp into a date; 64 bits of ns end in 2262, long before dates do."""
    return _EPOCH + timedelta(microseconds=time_ns // 1000)
