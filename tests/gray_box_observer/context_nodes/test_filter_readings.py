"""What a current sensor behind a filter reads of a free run: against fine steps and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gray_box_observer.context_nodes.rotor.filter_readings import FilterReadings
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns, free_runs
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    CurrentSensor,
    SpeedOutput,
    Unknowns,
)
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

NODES = (
    *('inductance', 'resistance', 'hysteresis'),
    *('inertia', 'viscous_friction', 'coulomb_friction'),
)
BOX = MotorWhiteBox(NODES, 0.05, {'back_emf_constant': 0.05})
THETA = np.array([2e-3, 1.5, 2e-4, 2e-5, 1e-5, 5e-3])
LAG_S = 3e-3
INTERVALS = 120
UNKNOWNS = Unknowns(SpeedOutput(0.01), None, CurrentSensor(5e-3))
LAG = UNKNOWNS.current_lag


def history() -> History:
    """Twenty levels of the voltage, at intervals that vary by a fifth; nothing is read yet."""
    rng = np.random.default_rng(0)
    interval_s = 5e-3 * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, INTERVALS))
    voltage_v = np.repeat(rng.uniform(-12.0, 12.0, INTERVALS // 6), 6)
    readings = np.ones(INTERVALS + 1)
    return History(readings, voltage_v, interval_s, readings)


def runs_of(
    theta: Array = THETA, lag_s: float = LAG_S, unknowns: Unknowns = UNKNOWNS, **starts: float
) -> FreeRuns:
    """Run through the history from rest."""
    start = np.zeros((1, unknowns.count))
    start[0, LAG] = lag_s
    start[0, LAG + 1] = starts.get('first_a', 0.0)
    start[0, 0] = starts.get('current_a', 0.0)
    start[0, 1] = starts.get('speed_rad_s', 0.0)
    return free_runs(BOX, theta, Window((history(),), unknowns), start)


def finely_filtered(parts: int = 200) -> Array:
    """Filter the current of the same run in steps so fine that it is straight within them."""
    coarse = history()
    fine = History(
        np.ones(parts * INTERVALS + 1),
        np.repeat(coarse.voltage_v, parts),
        np.repeat(coarse.interval_s / parts, parts),
    )
    current_a = free_runs(BOX, THETA, Window((fine,)), np.zeros((1, 2))).runs[0].states[:, 0]
    left = np.exp(-fine.interval_s / LAG_S)
    readings_a = np.zeros_like(current_a)
    for k, own in enumerate(left.tolist()):
        ramp_a = LAG_S * (current_a[k + 1] - current_a[k]) / fine.interval_s[k]
        start_a = readings_a[k] - current_a[k] + ramp_a
        readings_a[k + 1] = current_a[k + 1] - ramp_a + start_a * own
    return readings_a[::parts]


def test_the_readings_are_those_of_a_filter_in_fine_steps() -> None:
    readings_a = runs_of().read_a[0]
    off_a = np.abs(readings_a - finely_filtered())
    assert np.median(off_a) < 1e-4 * np.ptp(readings_a)
    assert off_a.max() < 5e-3 * np.ptp(readings_a)  # where friction changes its sign


def test_a_moving_average_weighs_the_current_at_the_samples() -> None:
    unknowns = replace(UNKNOWNS, current_sensor=CurrentSensor(5e-3, is_digital=True))
    runs = runs_of(unknowns=unknowns)
    weight = -np.expm1(-np.median(history().interval_s) / LAG_S)
    expected_a = 0.0
    for current_a, read_a in zip(runs.runs[0].states[1:, 0], runs.read_a[0][1:], strict=True):
        expected_a += weight * (current_a - expected_a)
        assert read_a == pytest.approx(expected_a, abs=1e-12)


@pytest.mark.parametrize('is_digital', [False, True])
@pytest.mark.parametrize('memory', [0.0, 0.4])
def test_the_derivatives_are_those_of_small_steps(memory: float, *, is_digital: bool) -> None:
    unknowns = replace(UNKNOWNS, current_sensor=CurrentSensor(5e-3, memory, is_digital))
    runs = runs_of(unknowns=unknowns)
    count = INTERVALS + 1
    slopes = runs.derivatives[0][:count]

    def slope(step: float, **changes: float | Array) -> Array:
        moved = runs_of(unknowns=unknowns, **changes)  # type: ignore[arg-type]
        return (runs.residual_a - moved.residual_a)[:count] / step

    columns = {
        0: slope(1e-5, current_a=1e-5),
        1: slope(1e-4, speed_rad_s=1e-4),
        LAG: slope(1e-8, lag_s=LAG_S + 1e-8),
        LAG + 1: slope(1e-5, first_a=1e-5),
    }
    for place in range(THETA.size):
        theta = THETA.copy()
        theta[place] *= np.exp(1e-6)
        columns[unknowns.count + place] = slope(1e-6, theta=theta)
    for column, expected in columns.items():
        off = np.abs(slopes[:, column] - expected)
        assert off.max() < 5e-3 * np.abs(expected).max(), column


@pytest.mark.parametrize('lag_s', [-1e-3, 0.0, 1e-5])
def test_next_to_no_lag_is_none(lag_s: float) -> None:
    runs = runs_of(lag_s=lag_s)
    np.testing.assert_allclose(runs.read_a[0], runs.runs[0].states[:, 0], atol=0.02)


def test_a_filter_as_slow_as_the_motor_stays_finite() -> None:
    law = np.array([[-THETA[1] / THETA[0], -0.05 / THETA[0]], [0.05 / THETA[3], -0.5]])
    for rate in -np.linalg.eigvals(law).real:
        near = [runs_of(lag_s=share / rate).read_a[0] for share in (1.0, 1.001)]
        assert np.isfinite(near).all()
        np.testing.assert_allclose(near[0], near[1], atol=0.05)


def test_a_motor_that_swings_is_filtered_too() -> None:
    """An inertia so small that current and speed swing has complex rates."""
    theta = THETA.copy()
    theta[3] *= 0.02
    start = np.zeros((1, UNKNOWNS.count))
    start[0, LAG] = LAG_S
    runs = free_runs(BOX, theta, Window((history(),), UNKNOWNS), start)
    sensor = runs._filter[0]
    assert isinstance(sensor, FilterReadings)
    assert np.isfinite(sensor.current_a).all()
    assert np.ptp(sensor.current_a) < np.ptp(runs.runs[0].states[:, 0])
