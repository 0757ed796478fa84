"""The signals of a motor on one time axis: voltage, torque, prediction error, current, speed."""

from __future__ import annotations

from typing import Any

import numpy as np

from gray_box_observer.report.figure_parts import (
    TIME_DIGITS,
    Figure,
    Trace,
    axis,
    base_layout,
    change_marks,
    largest,
    line,
    numbers,
    padded,
    quantiles,
    settled_part,
    thinning_note,
    time_axis,
)
from gray_box_observer.report.run.history import FloatArray, MotorHistory
from gray_box_observer.report.thinning import thinned
from gray_box_observer.report.units import MINUS, Scale, scale_for

_ROW_HEIGHT = 170
_GAP = 0.035


class _Rows:
    """Collects traces row by row and remembers what thinning left out."""

    def __init__(self, time_s: FloatArray) -> None:
        self._time_s = time_s
        self.data: list[Trace] = []
        self.drawn_counts: dict[str, tuple[int, int]] = {}

    def add(
        self, row: int, values: FloatArray, scale: Scale, name: str, color: str, **style: Any
    ) -> None:
        places = thinned(self._time_s, values)
        self.drawn_counts[name] = (len(places), len(values))
        times = numbers(self._time_s[places], TIME_DIGITS)
        trace = line(times, numbers(values[places] * scale.factor), name, color, **style)
        trace['yaxis'] = 'y' if row == 0 else f'y{row + 1}'
        trace['hovertemplate'] = f'%{{y:.5~g}} {scale.label}'
        self.data.append(trace)


def signal_figure(motor: MotorHistory) -> Figure:
    """Draw voltage, torque (measured, predicted, white box), error, then current and speed.

    A row or a line for which there is no number at all is left out, and the caption says so.
    """
    rows = _Rows(motor.time_s)
    torque_scale = scale_for(_typical(motor.torque_nm), 'N m')
    forecasts: dict[str, tuple[FloatArray, str, dict[str, Any]]] = {
        'predicted': (motor.predicted_torque_nm, '@predicted', {'width': 1.6}),
        'white box': (motor.white_box_torque_nm, '@white-box', {'width': 1.6, 'dash': 'dot'}),
    }
    free_run = motor.free_run_torque_nm
    if free_run is not None:
        forecasts['free run'] = free_run, '@free-run', {'width': 1.6, 'dash': 'dash'}
    present = {
        name: forecast for name, forecast in forecasts.items() if np.isfinite(forecast[0]).any()
    }

    rows.add(0, motor.voltage_v, Scale(1.0, 'V'), 'voltage', '@voltage', line={'shape': 'hv'})
    rows.add(1, motor.torque_nm, torque_scale, 'measured', '@measured', line={'width': 4})
    titles = ['voltage (V)', f'torque ({torque_scale.label})']
    errors = {name: values - motor.torque_nm for name, (values, _, _) in present.items()}
    error_scale = scale_for(_error_limit(motor, errors), 'N m')
    for name, (values, color, style) in present.items():
        rows.add(1, values, torque_scale, name, color, line=style)
    if errors:
        titles.append(f'error ({error_scale.label})')
    for name, values in errors.items():
        color = present[name][1]
        rows.add(
            2,
            values,
            error_scale,
            f'{name} {MINUS} measured',
            color,
            line={'width': 1},
            showlegend=False,
        )
    if motor.current_a is not None:
        scale = scale_for(_typical(motor.current_a), 'A')
        titles.append(f'current ({scale.label})')
        rows.add(len(titles) - 1, motor.current_a, scale, 'current', '@current')
    if motor.speed_rad_s is not None:
        titles.append('speed (rad/s)')
        rows.add(len(titles) - 1, motor.speed_rad_s, Scale(1.0, 'rad/s'), 'speed', '@speed')

    settled_ranges = _settled_ranges(motor, torque_scale, error_scale, errors)
    layout = _layout(motor, titles)
    for path, limits in settled_ranges.items():
        layout[path.split('.')[0]]['range'] = limits
    remarks = [f'No {name} torque in this run.' for name in forecasts if name not in present]
    if errors:
        remarks.append(
            'Error is the torque forecast before the sample was learnt, minus the measured one.'
        )
    if 'free run' in present:
        remarks.append(
            'Free run: the white box at the final values, from voltages alone (and speed where '
            'measured).'
        )
    if motor.changes_s:
        remarks.append('Vertical lines: the motor was found changed.')
    caption = ' '.join([*remarks, thinning_note(rows.drawn_counts)]).strip()
    views = [_time_views(motor.span_s())]
    if present:
        views.append(
            [
                {'label': 'Settled scale', 'layout': settled_ranges},
                {'label': 'Full scale', 'layout': dict.fromkeys(settled_ranges)},
            ]
        )
    return Figure(rows.data, layout, views, caption)


def _typical(values: FloatArray) -> float:
    return quantiles(np.abs(values), 0.0, 0.98)[1]


def _error_limit(motor: MotorHistory, errors: dict[str, FloatArray]) -> float:
    late = settled_part(motor.time_s, motor.span_s())
    return max(
        (quantiles(np.abs(values[late]), 0.0, 0.995)[1] for values in errors.values()), default=0.0
    )


def _settled_ranges(
    motor: MotorHistory, torque_scale: Scale, error_scale: Scale, errors: dict[str, FloatArray]
) -> dict[str, list[float]]:
    """Return ranges of the value axes, by path in the layout, that a wild start cannot blow up."""
    low, high = quantiles(motor.torque_nm * torque_scale.factor, 0.0, 1.0)
    ranges = {'yaxis2.range': padded(low, high)}
    if errors:
        limit = _error_limit(motor, errors) * error_scale.factor
        limit = (
            limit if limit > 0.0 else max(map(largest, errors.values())) * error_scale.factor or 1.0
        )
        ranges['yaxis3.range'] = padded(-limit, limit, 0.15)
    return ranges


def _time_views(span_s: tuple[float, float]) -> list[dict[str, Any]]:
    start, end = span_s
    tenth = (end - start) / 10.0
    return [
        {
            'label': 'Whole run',
            'layout': {'xaxis.range': [start, end if end > start else start + 1.0]},
        },
        {'label': 'First tenth', 'layout': {'xaxis.range': [start, start + (tenth or 1.0)]}},
        {'label': 'Last tenth', 'layout': {'xaxis.range': [end - (tenth or 1.0), end]}},
    ]


def _layout(motor: MotorHistory, titles: list[str]) -> dict[str, Any]:
    shares = np.array([1.35 if title.startswith('torque') else 0.8 for title in titles])
    heights = shares / shares.sum() * (1.0 - _GAP * (len(titles) - 1))
    tops = 1.0 - np.concatenate(([0.0], np.cumsum(heights + _GAP)[:-1]))
    layout = base_layout(_ROW_HEIGHT * len(titles) + 60, hoversubplots='axis')
    last = 'y' if len(titles) == 1 else f'y{len(titles)}'
    layout['xaxis'] = time_axis(motor.span_s(), anchor=last)
    for row, title in enumerate(titles):
        domain = [max(float(tops[row] - heights[row]), 0.0), float(tops[row])]
        zero = {'zeroline': True, 'zerolinecolor': '@rule'} if title.startswith('error') else {}
        layout[f'yaxis{row + 1 if row else ""}'] = axis(title, domain=domain, **zero)
    layout['shapes'] = change_marks(motor.changes_s)
    return layout
