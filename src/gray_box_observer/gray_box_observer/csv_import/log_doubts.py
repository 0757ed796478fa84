"""Log values that look like another unit or clock: warnings by line and column."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.csv_import.column_mapping import CsvMapping
from gray_box_observer.errors import brief
from gray_box_observer.expressions.unit_factors import OTHER_UNITS, SI
from gray_box_observer.samples.noise_floor import quantisation_step
from gray_box_observer.samples.stamp_rounding import stamp_rounding

SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S = 2e-5, 0.1
"""Samples of a motor are seldom closer (50 kHz) or further apart (10 Hz): its current settles
within L/R, which is between a tenth of a millisecond and some tenths of a second."""

_FACTORS = {'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9, 'divided by 1000 already': 1e3}

NOTABLE_NOISE = 0.02
"""Share of the speed from which on the noise of its steps is told."""

DIGITS = 6
"""Of the moves of a position, relative to the largest: a log rounds what it writes."""

_SIGNALS = ('voltage', 'current', 'torque', 'speed')


def unit_doubts(mapping: CsvMapping, names: tuple[str, ...]) -> Iterator[str]:
    """Say which columns are taken as they are although their names end with another unit."""
    signals = [('time', 'time', mapping.time)]
    for motor, columns in mapping.motors.items():
        prefix = f'{motor}.' if len(mapping.motors) > 1 else ''
        signals += [(f'{prefix}{key}', key, getattr(columns, key)) for key in _SIGNALS]
    for key, kind, expression in signals:
        if expression not in names:
            continue
        words = re.findall(r'[^\W\d_]+', expression)
        if len(words) > 1 and words[-1] in OTHER_UNITS[kind]:
            yield (
                f'{key} is in {SI[kind]}, but column {brief(expression)} says {words[-1]}; '
                f'write such as {key}={quoted(expression)}[{words[-1]}] if it is so'
            )


def order_doubt(
    time_s: NDArray[np.float64],
    in_order: NDArray[np.bool_],
    lines: NDArray[np.int64],
    expression: str,
) -> Iterator[str]:
    """Say where the time first falls, stands still or is none.

    Args:
        time_s: of the rows that are considered.  shape: (row,)
        in_order: which of them are later than all before.  shape: (row,)
        lines: where they stand in the log.  shape: (row,)
        expression: the time's, for the message.
    """
    wrong = np.flatnonzero(~in_order)
    if not wrong.size:
        return
    first = int(wrong[0])
    if not np.isfinite(time_s[first]):
        complaint = f'is {time_s[first]}'
    else:
        latest = float(np.max(time_s[:first][in_order[:first]], initial=-np.inf))
        complaint = (
            f'{"falls" if time_s[first] < latest else "stands still"}: {time_s[first]:.9g} s after '
            f'{latest:.9g} s'
        )
    yield (
        f'line {lines[first]}, time ({brief(expression)[1:-1]}) {complaint}; '
        f'{wrong.size} rows that are not later than those before are left out'
    )


def interval_doubt(interval_s: float, expression: str) -> str | None:
    """Warn of samples too far apart or too close for a motor, and name the likely time unit."""
    if SHORTEST_INTERVAL_S <= interval_s <= LONGEST_INTERVAL_S or not np.isfinite(interval_s):
        return None
    complaint = (
        f'samples are {interval_s:.3g} s apart, where those of a motor are {SHORTEST_INTERVAL_S:g} '
        f'to {LONGEST_INTERVAL_S:g} s apart'
    )
    remedy = time_remedy(interval_s, expression)
    return f'{complaint}; {remedy}' if remedy else complaint


def rounding_doubt(interval_s: NDArray[np.float64]) -> Iterator[str]:
    """Say where the times of evenly taken rows are rounded to coarse steps.

    Args:
        interval_s: from row to row.  shape: (row - 1,)
    """
    grid = stamp_rounding(interval_s)
    if grid is not None:
        yield (
            f'the time is rounded to {1e3 * grid.step_s:.3g} ms, though rows seem to come every '
            f'{1e3 * grid.period_s:.6g} ms; write sample_period_s={grid.period_s:.6g} '
            'instead of time if it is so'
        )


def time_remedy(interval_s: float, expression: str) -> str:
    """Return the unit that a time is likely in, and how to say so; empty where none is likely.

    Args:
        interval_s: from row to row, with the time read as s.
        expression: of the time; empty where the log has none.
    """
    plausible = [
        unit
        for unit, factor in _FACTORS.items()
        if 2 * SHORTEST_INTERVAL_S <= interval_s * factor <= LONGEST_INTERVAL_S
    ]
    if not expression or not plausible:
        return ''
    unit = plausible[0]
    if unit not in OTHER_UNITS['time']:
        return f'if the time is {unit}, write time=({expression})*1000'
    return f'if the time is in {unit}, write {time_in(expression, unit)}'


def time_in(expression: str, unit: str) -> str:
    """Return what says that a time is in a unit."""
    if re.fullmatch(r'\$?\w+', expression):
        return f'time={expression}[{unit}]'
    return f'time=({expression})*{OTHER_UNITS["time"][unit]}'


def quoted(name: str) -> str:
    """Return a column's name as it stands in an expression."""
    return name if re.fullmatch(r'[^\W\d]\w*', name) else f"'{name}'"


def step_doubt(
    name: str, position: NDArray[np.float64], speed: NDArray[np.float64], interval_s: float
) -> Iterator[str]:
    """Say how noisy a speed is because its position moves in steps.

    Rounding to a step ``d`` has a standard deviation of ``d / sqrt(12)``, the difference of two
    ``d / sqrt(6)``.

    Args:
        name: of the motor.
        position: whose rate the speed is.  shape: (row,)
        speed: in rad/s.  shape: (row,)
        interval_s: from row to row.
    """
    moves = np.diff(position[np.isfinite(position)])
    largest = float(np.max(np.abs(moves), initial=0.0))
    if not largest > 0.0:
        return
    step = largest * float(quantisation_step(np.round(moves / largest, DIGITS)[None])[0])
    noise = _speed_of_rate(position, speed, interval_s) * step / (np.sqrt(6.0) * interval_s)
    if noise > NOTABLE_NOISE * float(np.sqrt(np.nanmean(speed**2))):
        yield (
            f'speed of {name} is the rate of a position with steps of {step:.3g}: its noise is '
            f'about {noise:.2g} rad/s; a longer interval or a finer encoder makes it less'
        )


def _speed_of_rate(
    position: NDArray[np.float64], speed: NDArray[np.float64], interval_s: float
) -> float:
    """Return the speed in rad/s of a position's rate of one, by least squares.

    Args:
        position: shape (row,).
        speed: in rad/s.  shape: (row,)
        interval_s: from row to row.
    """
    rate = np.diff(position) / interval_s
    is_finite = np.isfinite(rate) & np.isfinite(speed[1:])
    power = float(rate[is_finite] @ rate[is_finite])
    return abs(float(rate[is_finite] @ speed[1:][is_finite])) / power if power > 0.0 else 1.0


def finite_doubt(name: str, values: NDArray[np.float64], lines: NDArray[np.int64]) -> Iterator[str]:
    """Say where a signal first has no finite value.

    Args:
        name: of the signal, with its motor.
        values: of the rows that are kept.  shape: (row,)
        lines: where they stand in the log.  shape: (row,)
    """
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        first = int(wrong[0])
        yield (
            f'line {lines[first]}: {name} is {values[first]} there and not finite in {wrong.size} '
            'rows; '
            'the observer refuses these samples'
        )
