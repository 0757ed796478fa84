"""Rivals that fit all samples at once: output error of the rotor model, and a linear ARX model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from common.motion import FloatArray
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import bounds

STATES = 2


@dataclass(frozen=True, slots=True)
class Signals:
    """One record of a motor.

    Attributes:
        interval_s: shape (k,): between two samples.
        voltage_v: shape (k,): held over every interval.
        current_a: shape (k + 1,): measured.
    """

    interval_s: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray

    @property
    def window(self) -> Window:
        """The record as free runs take it."""
        return Window((History(self.current_a, self.voltage_v, self.interval_s),))

    @property
    def at_rest(self) -> FloatArray:
        """First states of a motor that stands still, shape (1, state)."""
        return np.array([[float(self.current_a[0]), 0.0]])


def free_run_at_rest(box: MotorWhiteBox, theta: FloatArray, record: Signals) -> FloatArray:
    """Return the current of a motor that begins at rest, shape (k + 1,); NaN: it has no run."""
    runs = free_runs(box, theta, record.window, record.at_rest)
    if not runs.is_bounded:
        return np.full(record.current_a.size, np.nan)
    states: FloatArray = runs.runs[0].states
    return states[:, 0]


def batch_fit(
    box: MotorWhiteBox, records: Sequence[Signals], starts: Sequence[FloatArray]
) -> FloatArray:
    """Fit the free run of the current to records that begin at rest.

    Least squares by the trust region of scipy, in the logarithms of the parameters, with the
    derivatives of the trajectory. The best of all starts is returned.

    Args:
        box: the rotor model.
        records: whose samples count alike.
        starts: of the parameters, shape (parameter,) each.
    """
    lower, upper = (np.log(bound) for bound in bounds(box.parameters))
    total = sum(record.current_a.size for record in records)
    far = np.full(total, 10.0 * max(float(np.abs(record.current_a).max()) for record in records))

    def residual(logarithms: FloatArray) -> FloatArray:
        runs = _runs(box, records, logarithms)
        return far if runs is None else np.concatenate([one for one, _ in runs])

    def slopes(logarithms: FloatArray) -> FloatArray:
        runs = _runs(box, records, logarithms)
        nothing = np.zeros((total, logarithms.size))
        return nothing if runs is None else -np.concatenate([slope for _, slope in runs])

    ends = [
        least_squares(
            residual, np.clip(np.log(start), lower, upper), slopes, bounds=(lower, upper),
            x_scale='jac',
        )
        for start in starts
    ]  # fmt: skip
    return np.asarray(np.exp(min(ends, key=lambda end: float(end.cost)).x))


def _runs(
    box: MotorWhiteBox, records: Sequence[Signals], logarithms: FloatArray
) -> list[tuple[FloatArray, FloatArray]] | None:
    """Return residual and derivatives by the logarithms of every record; None: one has no run."""
    runs = [free_runs(box, np.exp(logarithms), one.window, one.at_rest) for one in records]
    if not all(run.is_bounded for run in runs):
        return None
    return [(run.residual_a, run.by_parameter) for run in runs]


def arx_fit(records: Sequence[Signals], order: int) -> FloatArray:
    """Fit ``i[k] = a1 i[k-1] + ... + b1 V[k] + b2 V[k-1] ...`` by least squares.

    ``V[k]`` is held over the interval that ends with sample k.

    Args:
        records: sampled evenly.
        order: how many currents and how many voltages count.

    Returns:
        Shape (2 order,).
    """
    rows = []
    targets = []
    for record in records:
        current = record.current_a
        voltage = record.voltage_v
        places = np.arange(order, current.size)
        columns = [current[places - lag] for lag in range(1, order + 1)]
        columns += [voltage[places - 1 - lag] for lag in range(order)]
        rows.append(np.column_stack(columns))
        targets.append(current[places])
    return np.asarray(np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)[0])


def arx_run(weights: FloatArray, record: Signals) -> FloatArray:
    """Run such a model freely from its first readings, shape (k + 1,)."""
    order = weights.size // 2
    current = record.current_a[:order].tolist()
    for place in range(order, record.current_a.size):
        past = [current[place - lag] for lag in range(1, order + 1)]
        past += [float(record.voltage_v[place - 1 - lag]) for lag in range(order)]
        current.append(float(np.dot(weights, past)))
    return np.array(current)
