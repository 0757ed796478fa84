"""What a report draws: the course of one run, as plain arrays.

Whoever ran the observer fills these classes; the report reads them and knows nothing else of the
observer. Times are seconds since the start of the run; values are in SI units.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.report.report_errors import ReportError

FloatArray = npt.NDArray[np.float64]

Truth = float | tuple[FloatArray, FloatArray]
"""A constant, or (times in s, values) of a piecewise-constant course; each value holds from its
time on."""


@dataclass(frozen=True, eq=False)
class ParameterHistory:
    """The course of one context node.

    Attributes:
        name: the parameter, for example `inductance`.
        unit: SI unit, for example `H`, `ohm`, `V s / (rad A)`.
        time_s: when each estimate was made. Shape `(estimate,)`, non-decreasing.
        value: the estimates in `unit`. Shape `(estimate,)`.
        std: their standard deviations in `unit`, NaN where unknown. Shape `(estimate,)`.
        verdict: the verdict with each estimate. Length `estimate`.
        truth: the true value where it is known, see `Truth`.

    Raises:
        ReportError: lengths differ, or times are not finite or run backwards.
    """

    name: str
    unit: str
    time_s: FloatArray
    value: FloatArray
    std: FloatArray
    verdict: Sequence[str]
    truth: Truth | None = None

    def __post_init__(self) -> None:
        label = f'history of parameter {self.name!r}'
        _check_times(label, self.time_s)
        _check_length(label, len(self.time_s), value=self.value, std=self.std, verdict=self.verdict)
        if isinstance(self.truth, tuple):
            times, values = self.truth
            _check_times(f'truth of parameter {self.name!r}', times)
            _check_length(f'truth of parameter {self.name!r}', len(times), values=values)

    def truth_at_end(self) -> float | None:
        """Return the true value that held when the run ended, None where it is not known."""
        if isinstance(self.truth, tuple):
            times, values = self.truth
            past_values = values[times <= self.time_s[-1]] if len(self.time_s) else values
            return float(past_values[-1]) if len(past_values) else None
        return None if self.truth is None else float(self.truth)


@dataclass(frozen=True)
class DerivedFigure:
    """A constant that follows from the parameters.

    Attributes:
        name: what it is called, for example `kV`.
        value, std: in `unit`.
        unit: SI unit.
        verdict: the one that says least, of the parameters that it is made of.
    """

    name: str
    value: float
    std: float
    unit: str
    verdict: str


@dataclass(frozen=True, eq=False)
class FitHistory:
    """Whether the white box explains the data of one motor.

    Attributes:
        verdict: `ok`, `warning`, `misfit` or `untested`.
        sentence: the same for people, with the remedy.
        percent: variation of the newest torque that its free run explains (NRMSE), in %; None where
            not known.
        autocorrelation: of the free run's residual, at lags 1, 2, ... samples; None where not
            known.
        band: magnitude that 99 % of the autocorrelations of white noise stay below.
    """

    verdict: str = 'untested'
    sentence: str = FitAssessment().sentence
    percent: float | None = None
    autocorrelation: FloatArray | None = None
    band: float = 0.0


@dataclass(frozen=True, eq=False)
class MotorHistory:
    """The course of one motor: its signals, its parameters, and what was left out.

    Attributes:
        name: the motor.
        time_s: stamps of the samples. Shape `(sample,)`, non-decreasing.
        voltage_v: armature voltage. Shape `(sample,)`.
        torque_nm: measured torque. Shape `(sample,)`.
        predicted_torque_nm: the predictor's torque, made before the sample was learnt; NaN where
            none.
        white_box_torque_nm: torque of the white box alone; NaN where none.
        parameters: one history per context node.
        speed_rad_s: measured shaft speed, None where there is none.
        rejection_counts: how many samples were rejected, by reason.
        rejected_time_s: when they were rejected, by reason, for as many as are known.
        scores: scores of the predictor by name (`nmae`, `skill_vs_persistence`,
            `skill_vs_white_box`).
        notes: warnings and remarks in plain words.
        sensitivity: for each constant taken as known, the change of each parameter in % when that
            constant is 1 % larger; None where it was not worked out.
        current_a: measured current, None where it is not drawn.
        free_run_torque_nm: torque of the white box run freely at the final values; None where there
            is none.
        changes_s: when the motor was found changed.
        derived_figures: constants that follow from the parameters at the end.
        fit: whether the white box explains the data.
        validation: figures on a bag that taught nothing, as the JSON holds them; None where there
            was none.

    Raises:
        ReportError: lengths differ, or times are not finite or run backwards.
    """

    name: str
    time_s: FloatArray
    voltage_v: FloatArray
    torque_nm: FloatArray
    predicted_torque_nm: FloatArray
    white_box_torque_nm: FloatArray
    parameters: tuple[ParameterHistory, ...]
    speed_rad_s: FloatArray | None = None
    rejection_counts: Mapping[str, int] = field(default_factory=dict)
    rejected_time_s: Mapping[str, FloatArray] = field(default_factory=dict)
    scores: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    sensitivity: Mapping[str, Mapping[str, float]] | None = None
    current_a: FloatArray | None = None
    free_run_torque_nm: FloatArray | None = None
    changes_s: tuple[float, ...] = ()
    derived_figures: tuple[DerivedFigure, ...] = ()
    fit: FitHistory = FitHistory()
    validation: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        label = f'history of motor {self.name!r}'
        _check_times(label, self.time_s)
        _check_length(
            label,
            len(self.time_s),
            voltage_v=self.voltage_v,
            torque_nm=self.torque_nm,
            predicted_torque_nm=self.predicted_torque_nm,
            white_box_torque_nm=self.white_box_torque_nm,
        )
        for name in ('speed_rad_s', 'current_a', 'free_run_torque_nm'):
            signal = getattr(self, name)
            if signal is not None:
                _check_length(label, len(self.time_s), **{name: signal})

    def span_s(self) -> tuple[float, float]:
        """Return the first and the last time of samples, estimates and rejected samples, in s."""
        times = [self.time_s, *(parameter.time_s for parameter in self.parameters)]
        times.extend(self.rejected_time_s.values())
        every = np.concatenate([np.asarray(part, dtype=np.float64) for part in times])
        every = every[np.isfinite(every)]
        return (float(every.min()), float(every.max())) if every.size else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class RunHistory:
    """One run of the observer over one or more motors.

    Attributes:
        title: headline of the report.
        source: names of the bags, or of the topics.
        creation_time: when the report was made, ISO 8601; the caller's, so that the same run gives
            the same page.
        motors: one history per motor.
        summary: facts of the run; a key's unit suffix (`duration_s`) is shown as the unit.
        command: the command that makes this report again.
        digest: hexadecimal SHA-256 over every estimate in order.
        parameters: what it was made with, by dotted names.
    """

    title: str
    source: Sequence[str]
    creation_time: str
    motors: tuple[MotorHistory, ...]
    summary: Mapping[str, str | float | int] = field(default_factory=dict)
    command: str = ''
    digest: str = ''
    parameters: Mapping[str, Any] = field(default_factory=dict)


def _check_times(label: str, time_s: FloatArray) -> None:
    times = np.asarray(time_s)
    if times.ndim != 1:
        raise ReportError(f'{label}: time_s has {times.ndim} axes, expected one')
    if not np.all(np.isfinite(times)):
        raise ReportError(f'{label}: {np.count_nonzero(~np.isfinite(times))} times are not finite')
    if np.any(np.diff(times) < 0.0):
        at = int(np.argmax(np.diff(times) < 0.0)) + 1
        raise ReportError(
            f'{label}: time_s runs backwards at index {at}; sort or split the run first'
        )


def _check_length(label: str, length: int, **arrays: Sequence[str] | FloatArray) -> None:
    for name, array in arrays.items():
        if len(array) != length:
            raise ReportError(
                f'{label}: {name} has {len(array)} entries, expected {length} as in time_s'
            )
