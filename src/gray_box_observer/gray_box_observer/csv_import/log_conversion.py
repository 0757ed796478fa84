"""Turns a measurement log (CSV, columns between blanks, MAT) into a bag for the observer."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.bag.embedded_parameters import to_custom_data
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import JOINT_STATE_HASH, built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter
from gray_box_observer.csv_import.column_expressions import Expression
from gray_box_observer.csv_import.column_mapping import CsvMapping, MotorColumns
from gray_box_observer.csv_import.log_doubts import (
    finite_doubt,
    interval_doubt,
    order_doubt,
    rounding_doubt,
    step_doubt,
    time_remedy,
    unit_doubts,
)
from gray_box_observer.csv_import.log_table import TableShape, look_at, read_columns
from gray_box_observer.errors import BagError

__all__ = ['CsvMapping', 'CsvSummary', 'MotorColumns', 'csv_to_bag']

_FOREVER = {'sec': 9223372036, 'nsec': 854775807}
SIGNAL_QOS = {
    'history': 'keep_last',
    'depth': 1000,
    'reliability': 'reliable',
    'durability': 'volatile',
    'deadline': _FOREVER,
    'lifespan': _FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': _FOREVER,
    'avoid_ros_namespace_conventions': False,
}

_BEYOND_NS = 2.0**31 * 1e9
"""The first stamp that no message can tell; an integer of 64 bits can."""


@dataclass(frozen=True)
class CsvSummary:
    """What became of a log.

    Attributes:
        rows: Rows of numbers in the log.
        filtered_rows: Rows that did not fulfil the condition.
        unordered_rows: Rows left out because their time was not later than that of the row before.
        non_finite_rows: Rows kept although a value in them is not finite; the observer will reject
            these samples.
        messages: Messages in the bag.
        duration_s: From the first stamp to the last.
        interval_s: From one row kept to the next, as a median; NaN of a single row.
        warnings: What looks as if it meant something else, each one line that names the log, the
            line and the column.
    """

    rows: int
    filtered_rows: int
    unordered_rows: int
    non_finite_rows: int
    messages: int
    duration_s: float
    interval_s: float = math.nan
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        left_out = (
            f'{self.filtered_rows} filtered, {self.unordered_rows} not later than the row before'
        )
        return (
            f'{self.rows} rows ({left_out}, {self.non_finite_rows} with non-finite values) became '
            f'{self.messages} messages over {self.duration_s:.6g} s'
        )


@dataclass(frozen=True, eq=False)
class _Motor:
    """One motor's signals.  shape of each: (row,)."""

    name: str
    voltage_v: NDArray[np.float64]
    torque_nm: NDArray[np.float64]
    speed_rad_s: NDArray[np.float64] | None

    def signals(self) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yield the name and the values of each signal."""
        yield 'voltage', self.voltage_v
        yield 'torque', self.torque_nm
        if self.speed_rad_s is not None:
            yield 'speed', self.speed_rad_s

    def is_finite(self) -> NDArray[np.bool_]:
        """Which rows have finite values of all signals."""
        finite = np.isfinite(self.voltage_v) & np.isfinite(self.torque_nm)
        return finite if self.speed_rad_s is None else finite & np.isfinite(self.speed_rad_s)


def csv_to_bag(
    csv_path: str | Path, folder: str | Path, mapping: CsvMapping, options: BagOptions | None = None
) -> CsvSummary:
    """Make a rosbag2 folder of a log: a voltage and a torque JointState per row and motor.

    Stamps count from the first row, which is put at ``mapping.first_stamp_ns``. Rows whose time
    does not increase are left out and counted.

    Args:
        csv_path: The log; see `gray_box_observer.csv_import.log_table` for what is understood.
        folder: The folder to make; must not exist.
        mapping: What the columns mean.
        options: How the bag is written; None for the defaults. The bag carries what the mapping
            tells of the observer's parameters (`gray_box_observer.bag.embedded_parameters`).

    Raises:
        BagError: The log or the mapping cannot be used, the disk refuses, or the folder exists.
            Then nothing is made, or is removed again.
    """
    path = Path(csv_path)
    shape = look_at(path)
    expressions = _Expressions(mapping, shape)
    columns = read_columns(path, shape, expressions.columns)
    table = columns.values
    row_count = columns.lines.size
    if expressions.time is not None:
        time_s = np.array(expressions.time(table))
    else:
        time_s = np.arange(row_count, dtype=np.float64) * (mapping.sample_period_s or 0.0)
    passes = np.ones(row_count, dtype=bool)
    if expressions.where is not None:
        passes = expressions.where(table) != 0
    in_time = passes.copy() if mapping.where_drops == 'row' else np.ones(row_count, dtype=bool)
    filtered_count = int(row_count - passes.sum())
    in_time_count = int(in_time.sum())
    rows = np.flatnonzero(in_time)
    in_order = _increasing(time_s[rows])
    doubts = [*unit_doubts(mapping, shape.names)]
    doubts += order_doubt(
        time_s[rows], in_order, columns.lines[rows], mapping.time or 'sample_period_s'
    )
    in_time[rows] = in_order
    kept_rows = np.flatnonzero(in_time)
    if not kept_rows.size or not passes[kept_rows].any():
        raise BagError(f'{path}: none of {row_count} rows can be used ({filtered_count} filtered)')
    stamps_ns = _stamps(path, mapping, time_s[kept_rows], columns.lines[kept_rows])
    motors = [expressions.signals(name, table, time_s) for name in mapping.motors]
    if expressions.looks_back:  # the first row has none before it
        passes[0] = False
    finite = np.logical_and.reduce([motor.is_finite() for motor in motors])
    interval_s = float(np.median(np.diff(time_s[kept_rows]))) if kept_rows.size > 1 else math.nan
    doubts += [doubt for doubt in (interval_doubt(interval_s, mapping.time),) if doubt is not None]
    if expressions.time is not None:
        with np.errstate(all='ignore'):  # times of rows that are left out may be anything
            intervals_s = np.diff(time_s)
        doubts += rounding_doubt(intervals_s)
    for motor in motors:
        for signal, values in motor.signals():
            rows_told = kept_rows[1:] if expressions.looks_back else kept_rows
            doubts += finite_doubt(
                f'{signal} of {motor.name}', values[rows_told], columns.lines[rows_told]
            )
        for position in expressions.positions(motor.name, table):
            if motor.speed_rad_s is not None:
                rates = motor.speed_rad_s[kept_rows]
                doubts += step_doubt(motor.name, position[kept_rows], rates, interval_s)
    messages = _write(folder, options, mapping, motors, kept_rows, stamps_ns, passes)
    return CsvSummary(
        rows=row_count,
        filtered_rows=filtered_count,
        unordered_rows=in_time_count - int(kept_rows.size),
        non_finite_rows=int(np.count_nonzero(~finite[kept_rows])),
        messages=messages,
        duration_s=float(stamps_ns[-1] - stamps_ns[0]) * 1e-9,
        interval_s=interval_s,
        warnings=(*columns.warnings, *(f'{path}: {doubt}' for doubt in doubts)),
    )


class _Expressions:
    """The mapping's expressions, compiled for one table."""

    def __init__(self, mapping: CsvMapping, shape: TableShape) -> None:
        self._shape = shape
        self._mapping = mapping
        self._all: list[Expression] = []
        self.time = self._make('time', mapping.time)
        self.where = self._make('', mapping.where)
        self._motors = {
            name: (
                self._make('voltage', motor.voltage),
                self._make('torque' if motor.torque else 'current', motor.torque or motor.current),
                self._make('speed', motor.speed),
            )
            for name, motor in mapping.motors.items()
        }

    @property
    def columns(self) -> set[int]:
        return set().union(*(expression.columns for expression in self._all))

    @property
    def looks_back(self) -> bool:
        """Whether any of them asks for the row before."""
        return any(expression.looks_back for expression in self._all)

    def positions(
        self, name: str, table: dict[int, NDArray[np.float64]]
    ) -> list[NDArray[np.float64]]:
        """Return the positions whose rate is the speed of a motor."""
        speed = self._motors[name][2]
        return [] if speed is None else speed.positions(table)

    def signals(
        self, name: str, table: dict[int, NDArray[np.float64]], time_s: NDArray[np.float64]
    ) -> _Motor:
        voltage, torque, speed = self._motors[name]
        scale = (
            self._mapping.motors[name].torque_constant
            if self._mapping.motors[name].current
            else None
        )
        if voltage is None or torque is None:
            raise BagError(f'motor {name} has no voltage or no torque')
        with np.errstate(all='ignore'):  # what is not finite is warned of where it stands
            torque_nm = torque(table, time_s) * (1.0 if scale is None else scale)
            speed_rad_s = None if speed is None else speed(table, time_s)
            voltage_v = voltage(table, time_s)
        return _Motor(name, voltage_v, torque_nm, speed_rad_s)

    def _make(self, kind: str, text: str) -> Expression | None:
        """Compile the expression of a kind of quantity; of none, the condition of a row."""
        if not text:
            return None
        shape = self._shape
        expression = Expression(text, shape.names, shape.column_count, is_condition=not kind)
        if kind and not expression.columns:
            hint = f': write {kind}=${text} for the column' if text.isdecimal() else ''
            raise BagError(f'{kind}={text} names no column{hint}')
        if kind and expression.kind not in ('', kind):
            raise BagError(f'{kind}={text} has the unit of a {expression.kind}')
        self._all.append(expression)
        return expression


def _stamps(
    path: Path, mapping: CsvMapping, time_s: NDArray[np.float64], lines: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the stamps of rows in ns.

    Args:
        path: of the log, for the message.
        mapping: what the columns mean.
        time_s: of the rows, rising and finite.  shape: (row,)
        lines: where they stand in the log.  shape: (row,)

    Raises:
        BagError: a row lies so long after the first that no message can tell it.
    """
    with np.errstate(over='ignore'):  # infinitely late is too late
        passed_ns = np.rint((time_s - time_s[0]) * 1e9)
        interval_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else math.nan
    late_rows = np.flatnonzero(passed_ns >= _BEYOND_NS - mapping.first_stamp_ns)
    if late_rows.size:
        first = int(late_rows[0])
        remedy = time_remedy(interval_s, mapping.time)
        raise BagError(
            f'{path}, line {lines[first]}, time ({mapping.time or "sample_period_s"}) is '
            f'{time_s[first]:.9g} s, and {time_s[0]:.9g} s in the first row; a stamp of so much '
            'later does not fit into a message' + (remedy and f'; {remedy}')
        )
    stamps_ns: NDArray[np.int64] = mapping.first_stamp_ns + passed_ns.astype(np.int64)
    return stamps_ns


def _increasing(time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which times are later than all times kept before; one that is not finite never is."""
    finite = np.where(np.isfinite(time_s), time_s, -np.inf)
    latest = np.maximum.accumulate(np.concatenate(([-np.inf], finite)))[:-1]
    return finite > latest


def _write(
    folder: str | Path,
    options: BagOptions | None,
    mapping: CsvMapping,
    motors: list[_Motor],
    kept_rows: NDArray[np.intp],
    stamps_ns: NDArray[np.int64],
    passes: NDArray[np.bool_],
) -> int:
    text = schema_text(TYPE_NAME, built_in_lookup)
    # The voltage that holds from this row on stands in the next row if it applies to the interval
    # before.
    ahead = 1 if mapping.voltage_applies == 'preceding' else 0
    options = options or BagOptions()
    custom_data = {**options.custom_data, **to_custom_data(mapping.parameters())}
    writer = BagWriter(folder, replace(options, custom_data=custom_data))
    try:
        with writer:
            for topic in (mapping.voltage_topic, mapping.torque_topic):
                writer.add_topic(topic, TYPE_NAME, text, [SIGNAL_QOS], JOINT_STATE_HASH)
            for index, (row, stamp) in enumerate(
                zip(kept_rows.tolist(), stamps_ns.tolist(), strict=True)
            ):
                for motor in motors:
                    if index + ahead < kept_rows.size:
                        volts = float(motor.voltage_v[kept_rows[index + ahead]])
                        data = encode_joint_state(stamp, [motor.name], effort=[volts])
                        writer.write(mapping.voltage_topic, data, stamp, stamp)
                    if passes[row]:
                        speed = motor.speed_rad_s
                        velocity = [float(speed[row])] if speed is not None else []
                        torque = [float(motor.torque_nm[row])]
                        data = encode_joint_state(
                            stamp, [motor.name], velocity=velocity, effort=torque
                        )
                        writer.write(mapping.torque_topic, data, stamp, stamp)
    except BaseException:
        shutil.rmtree(writer.folder, ignore_errors=True)
        raise
    return writer.message_count
