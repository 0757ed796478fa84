from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from gray_box_observer.predictor.elementwise import Floats
from gray_box_observer.predictor.steady_state import (
    Course,
    after,
    chord,
    course,
    exponent,
    flow,
    flow_each,
    gap_v,
    relaxation,
    slope_ohm,
)
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.dynamics import rate
from gray_box_observer.white_box.flow import rate as flow_rate
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.torch_ops import TorchOps

CASES = [(12.0, 0.0), (-7.0, 3.0), (0.0, 5.0), (0.3, -2.0), (24.0, 23.0)]
"""Held voltage and the current at the start."""

SPEED = 4.0


def lead(box: MotorWhiteBox, theta: list[float], voltage_v: float) -> Course:
    return course(Floats, box, theta, voltage_v, SPEED, 0.0)


def integrated(
    box: MotorWhiteBox, theta: list[float], voltage_v: float, start_a: float, interval_s: float
) -> float:
    """The same equation solved by scipy, from the white box's own rate."""

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        value: np.ndarray = rate(
            box, np.array([theta]), np.array([voltage_v]), state, np.array([SPEED])
        )
        return value

    solved = solve_ivp(slope, (0.0, interval_s), [start_a], method='LSODA', rtol=1e-10, atol=1e-12)
    return float(solved.y[0, -1])


def gap(box: MotorWhiteBox, theta: list[float], voltage_v: Any, state: Any) -> Any:
    balance = box.balances(state)[State.CURRENT]
    return gap_v(balance, theta, balance.signals([state], SPEED, voltage_v))


def test_gap_and_slope_are_those_of_the_white_box(box: MotorWhiteBox, theta: list[float]) -> None:
    for voltage, state in CASES:
        arrays = np.array([theta]), np.array([voltage]), np.array([state]), np.array([SPEED])
        assert gap(box, theta, voltage, state) == pytest.approx(
            rate(box, *arrays)[0] * theta[0], abs=1e-7
        )
        p = dict(enumerate(to_coordinates(arrays[0]).T[..., None]))
        slope = flow_rate(np, box, p, [arrays[2][None]], arrays[1][None], arrays[3][None]).by_state
        expected = -slope[State.CURRENT][State.CURRENT].item() * theta[0]
        balance = box.balances(state)[State.CURRENT]
        signals = balance.signals([state], SPEED, voltage)
        assert slope_ohm(balance, theta, signals) == pytest.approx(expected, abs=1e-8)


def test_the_steady_state_is_where_bisection_finds_it(
    box: MotorWhiteBox, theta: list[float]
) -> None:
    for voltage, _ in CASES:
        expected = brentq(lambda i, v=voltage: gap(box, theta, v, i), -1e12, 1e12, xtol=1e-14)
        assert lead(box, theta, voltage).steady_a == pytest.approx(expected, rel=1e-9, abs=1e-8)


@pytest.mark.parametrize('guess', [0.0, 1e-3, -50.0, 1e6, -1e12])
@pytest.mark.parametrize('voltage', [0.39, -0.41, 5.0, 1e-9])
def test_brushes_do_not_trap_newton(guess: float, voltage: float) -> None:
    box = MotorWhiteBox(('inductance', 'resistance', 'brush_drop'), 0.01)
    theta = [0.5, 0.01, 0.4]
    way = course(Floats, box, theta, voltage, 0.0, guess)
    assert abs(gap(box, theta, voltage, way.steady_a)) < 1e-9 * abs(voltage)


def test_the_chord_becomes_the_slope_where_it_ends(box: MotorWhiteBox, theta: list[float]) -> None:
    for voltage, state in CASES:
        way = lead(box, theta, voltage)
        far = gap(box, theta, voltage, state) / theta[0] / (way.steady_a - state)
        assert chord(Floats, box, way, state) == pytest.approx(max(far, 1e-12), rel=1e-9)
        near = way.steady_a * (1.0 + 1e-5) + 1e-9
        assert chord(Floats, box, way, near) == pytest.approx(way.decay_rate, rel=1e-2, abs=1e-8)
        assert chord(Floats, box, way, way.steady_a) == max(way.decay_rate, 1e-12)


@pytest.mark.parametrize('interval_s', [1e-4, 0.01, 0.3, 2.0, 40.0])
def test_the_flow_is_what_scipy_integrates(
    box: MotorWhiteBox, theta: list[float], interval_s: float
) -> None:
    for voltage, start in CASES:
        expected = integrated(box, theta, voltage, start, interval_s)
        way = lead(box, theta, voltage)
        size = abs(start) + min(abs(way.steady_a), 100.0)  # the knee of the brushes costs the most
        assert flow(Floats, box, way, start, interval_s) == pytest.approx(expected, abs=6e-3 * size)
        assert flow(Floats, box, way, start, interval_s, 0.02) == pytest.approx(
            expected, abs=1e-4 * size
        )


def test_the_flow_follows_the_closed_form_of_the_thesis_motor(thesis_box: MotorWhiteBox) -> None:
    # L di/dt = V - r i - k i^2 from rest: i = 2 V tanh(x) / (s + r tanh(x))
    r = 1.0 + 1e-4
    k = 0.1
    voltage = 10.0
    s = math.sqrt(r * r + 4.0 * k * voltage)
    way = lead(thesis_box, [0.5, 1.0, 10.0], voltage)
    for time_s in (1e-6, 0.01, 0.1, 0.5, 3.0):
        x = math.tanh(s * time_s / (2.0 * 0.5))
        assert flow(Floats, thesis_box, way, 0.0, time_s) == pytest.approx(
            2.0 * voltage * x / (s + r * x), rel=1e-5
        )


@pytest.mark.parametrize('readout', [-1e9, -1.0, 0.0, 0.3, 1e9])
def test_whatever_the_network_says_both_limits_are_those_of_the_physics(
    box: MotorWhiteBox, theta: list[float], readout: float
) -> None:
    for voltage, start in CASES:
        way = lead(box, theta, voltage)
        distance = start - way.steady_a
        short = relaxation(Floats, box, way, start, 1e-6)
        slope = gap(box, theta, voltage, start) / theta[0]
        assert (after(Floats, short, readout) - start) / 1e-6 == pytest.approx(
            slope, rel=2e-3, abs=1e-6
        )
        if way.decay_rate > 1e-6:  # without resistance it settles nowhere, or never
            long = relaxation(Floats, box, way, start, 1e6)
            assert after(Floats, long, readout) == pytest.approx(way.steady_a, rel=1e-9, abs=1e-9)
        for interval_s in (1e-3, 0.05, 0.5, 3.0):
            end = after(Floats, relaxation(Floats, box, way, start, interval_s), readout)
            assert -1e-12 <= (end - way.steady_a) / distance <= 1.0


@pytest.mark.parametrize('readout', [-1e9, 0.0, 1e9])
def test_a_current_without_resistance_climbs_steadily_whatever_the_network_says(
    readout: float,
) -> None:
    box = MotorWhiteBox(('inductance',), 0.01)
    for voltage, start in CASES:
        way = lead(box, [0.5], voltage)
        for interval_s in (1e-3, 0.5, 3.0):
            end = after(Floats, relaxation(Floats, box, way, start, interval_s), readout)
            assert end == pytest.approx(start + voltage / 0.5 * interval_s, abs=1e-6)


@pytest.mark.parametrize('readout', [-2.0, 0.0, 2.0])
def test_a_linear_motor_is_exact_whatever_the_network_says(readout: float) -> None:
    box = MotorWhiteBox(('inductance', 'resistance'), 0.01)
    way = lead(box, [0.5, 2.0], 6.0)
    for interval_s in (1e-4, 0.1, 1.0, 5.0):
        interval = relaxation(Floats, box, way, 10.0, interval_s)
        assert after(Floats, interval, readout) == pytest.approx(
            3.0 + 7.0 * math.exp(-4.0 * interval_s), rel=1e-9
        )


def test_the_network_can_say_what_the_physics_says_but_for_the_knee_of_the_brushes(
    box: MotorWhiteBox, theta: list[float]
) -> None:
    for voltage, start in CASES:
        way = lead(box, theta, voltage)
        for interval_s in (0.01, 0.1, 0.5):
            interval = relaxation(Floats, box, way, start, interval_s)
            exact = integrated(box, theta, voltage, start, interval_s)
            lowest, highest = sorted(after(Floats, interval, readout) for readout in (-20.0, 20.0))
            tolerance = 0.016 * abs(exact - start) + 1e-7
            assert lowest - tolerance <= exact <= highest + tolerance


def test_floats_and_arrays_say_the_same(box: MotorWhiteBox, theta: list[float]) -> None:
    voltages, starts = (np.array(values) for values in zip(*CASES, strict=True))
    columns = [np.full(voltages.size, value) for value in theta]
    ways = course(
        np, box, columns, voltages, np.full(voltages.size, SPEED), np.zeros(voltages.size)
    )
    interval = relaxation(np, box, ways, starts, np.full(voltages.size, 0.2))
    ends = after(np, interval, np.full(voltages.size, 0.7))
    flows = flow(np, box, ways, starts, 0.2, 0.02)
    for k, (voltage, start) in enumerate(CASES):
        way = lead(box, theta, voltage)
        alone = relaxation(Floats, box, way, start, 0.2)
        assert ends[k] == pytest.approx(after(Floats, alone, 0.7), rel=1e-9, abs=1e-9)
        assert flows[k] == pytest.approx(flow(Floats, box, way, start, 0.2, 0.02), rel=2e-3)
        np.testing.assert_allclose(
            [c[k] for c in interval.inputs(np)], alone.inputs(Floats), atol=1e-8
        )


@pytest.mark.parametrize('seed', range(5))
def test_wild_parameters_and_voltages_stay_finite_and_small_inputs(
    box: MotorWhiteBox, theta: list[float], seed: int
) -> None:
    random = np.random.default_rng(seed)
    count = 200
    wild = [np.clip(v * 10.0 ** random.uniform(-8, 8, count), 1e-8, 1e6) for v in theta]
    voltage, start = (
        random.normal(size=count) * 10.0 ** random.uniform(-12, 9, count) for _ in range(2)
    )
    voltage[:5] = start[5:10] = 0.0
    speed = random.normal(size=count) * 1e4
    with np.errstate(all='raise', under='ignore'):
        way = course(np, box, wild, voltage, speed, np.zeros(count))
        interval = relaxation(np, box, way, start, 10.0 ** random.uniform(-9, 6, count))
        inputs = np.array(interval.inputs(np))
        assert np.all(np.abs(inputs) < 12.0)
        for readout in (-1e3, 0.0, 1e3):
            assert np.all(exponent(np, interval, np.full(count, readout)) > 0.0)
            assert np.all(np.isfinite(after(np, interval, np.full(count, readout))))
    for k in range(count):
        alone = course(
            Floats, box, [float(c[k]) for c in wild], float(voltage[k]), float(speed[k]), 0.0
        )
        one = relaxation(Floats, box, alone, float(start[k]), 0.01)
        assert math.isfinite(after(Floats, one, 0.5))
        assert math.isfinite(flow(Floats, box, alone, float(start[k]), 0.01))


@pytest.mark.parametrize('ops', [np, TorchOps('cpu')], ids=['numpy', 'torch'])
@pytest.mark.parametrize('intervals_s', [(0.01, 0.01, 0.01), (1e-4, 0.3, 10.0)])
def test_every_motor_flows_as_it_would_alone(ops: Any, intervals_s: tuple[float, ...]) -> None:
    of = np.asarray if ops is np else ops.taken
    theta = np.array([[0.5, 1.0, 10.0], [0.1, 2.0, 5.0], [0.02, 0.5, 20.0]])
    starts = np.array([0.0, 3.0, -2.0])
    constant = np.full(3, 0.01)
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'),
        of(constant),
        {'back_emf_constant': of(constant)},
    )
    voltage = of(np.array([12.0, -7.0, 5.0]))
    interval_s = of(np.array(intervals_s))
    way = course(ops, box, list(of(theta).T), voltage, 0.0 * voltage, 0.0 * voltage)
    ends = flow_each(ops, box, way, of(starts), interval_s)
    for k in range(3):
        one = of(np.array([k]))
        alone = flow(ops, box.of_motors(one), way.select(one), of(starts)[one], interval_s[one])
        assert float(ends[k]) == float(alone[0])
