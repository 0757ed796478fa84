"""The white box run freely over a whole record, and its fit, for reports and validation."""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow, follow, linearise
from gray_box_observer.context_nodes.rotor.free_runs import rotor_current
from gray_box_observer.context_nodes.rotor.loaded_fit import loaded_current
from gray_box_observer.samples.spread import spread
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

CHUNK = 20_000
"""Samples that are run at a time: the linearised intervals of so many fit into memory beside all
else."""

PASSES = 6
"""Linearisations at most, each about the run of the one before."""

SETTLED = 1e-9
"""Change of the run, relative to the largest reading, from one to the next that ends them."""

CREDIBLE = 20.0
"""Times the largest reading: nothing is linearised about a state beyond."""

LAGS = 60
"""Lags of the residual's autocorrelation."""

NEWEST = 4000
"""Samples that it is worked out from, at most."""

BAND = 2.576
"""Standard deviations of a normal variable that 99 % of its values lie within."""


def white_box_torque(
    white_box: MotorWhiteBox,
    theta: Array,
    interval_s: Array,
    voltage_v: Array,
    torque_nm: Array,
    speed_rad_s: Array,
) -> Array:
    """Run the white box freely; only the start of a history takes the measured torque.

    A load that varies is taken as it explains the measured torque best.

    Args:
        white_box: of one motor.
        theta: shape (parameter,).
        interval_s: shape (n,): time since the sample before; 0 where a history begins.
        voltage_v: shape (n,): mean voltage of that interval.
        torque_nm: shape (n,): measured.
        speed_rad_s: shape (n,): measured; not looked at where the white box has its own.

    Returns:
        Shape (n,): torque in N m; NaN where the values cannot be run.
    """
    if torque_nm.size < 2 or not np.isfinite(theta).all():
        return np.full(torque_nm.shape, math.nan)
    if white_box.has_rotor:
        samples = np.stack([interval_s, voltage_v, torque_nm])
        current = loaded_current if white_box.load_varies else rotor_current
        return white_box.output(current(white_box, theta, samples))
    state = white_box.state(torque_nm)
    speed = speed_rad_s if white_box.speed_measured else np.zeros_like(torque_nm)
    coordinates = to_coordinates(theta[None])
    run = np.empty_like(state)
    run[0] = state[0]
    for begin in range(0, state.size - 1, CHUNK):
        end = min(begin + CHUNK, state.size - 1)
        restart = interval_s[begin + 1 : end + 1] <= 0.0
        stretch = SampleWindow(
            state[None, begin : end + 1],
            np.where(restart, 0.0, voltage_v[begin + 1 : end + 1])[None],
            interval_s[None, begin + 1 : end + 1],
            speed[None, begin : end + 1],
            restart[None],
        )
        run[begin : end + 1] = _run(white_box, coordinates, stretch, run[begin])
    return white_box.output(run)


def _run(
    white_box: MotorWhiteBox, coordinates: Array, stretch: SampleWindow, start: float
) -> Array:
    """Run one chunk from where the one before ended."""
    largest = float(np.max(np.abs(stretch.state))) + 1e-9
    about = stretch.state
    with np.errstate(all='ignore'):
        for _ in range(PASSES):
            maps = linearise(
                white_box,
                coordinates,
                stretch,
                np.clip(about, -CREDIBLE * largest, CREDIBLE * largest),
            )
            path = follow(maps, stretch, np.array([start]), np.zeros_like(stretch.state)).state
            change = float(np.max(np.abs(path - about)))
            about = path
            if not change > SETTLED * largest:
                break
    run: Array = about[0]
    return run


def fit_percent(measured_values: Array, predicted_values: Array) -> float | None:
    """Return the explained variation in per cent, ``100 (1 - |y - yhat| / |y - mean y|)``.

    This is the fit by normalised root mean square error (NRMSE).

    100 is perfect, 0 no better than the mean, and there is no lower limit. None where nothing
    varies or is predicted.
    """
    both = np.isfinite(measured_values) & np.isfinite(predicted_values)
    if np.count_nonzero(both) < 2:
        return None
    if spread(measured_values[both]) is None:
        return None
    variation = float(np.linalg.norm(measured_values[both] - np.mean(measured_values[both])))
    error = float(np.linalg.norm(measured_values[both] - predicted_values[both]))
    return 100.0 * (1.0 - error / variation)


def autocorrelation(residual: Array) -> tuple[Array, float] | None:
    """Return the residual's autocorrelation at lags 1 to LAGS, and its 99 % white-noise band.

    Args:
        residual: shape (n,), in order; its newest NEWEST samples count, those that are not finite
            left out.
    """
    newest = residual[np.isfinite(residual)][-NEWEST:]
    newest = newest - np.mean(newest) if newest.size else newest
    power = float(newest @ newest)
    if newest.size <= 2 * LAGS or not power > 0.0:
        return None
    correlations = np.array(
        [float(newest[lag:] @ newest[:-lag]) / power for lag in range(1, LAGS + 1)]
    )
    return correlations, BAND / math.sqrt(newest.size)
