from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gray_box_observer.white_box import MotorWhiteBox, dynamics
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import (
    Linear,
    flow,
    is_stiff,
    parameter_covariance,
    rate,
    to_coordinates,
    to_parameters,
)

ALL = ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'brush_drop')
THETA = np.array([[0.5, 1.0, 10.0, 0.4, 0.3], [0.2, 2.0, 3.0, 0.1, 0.5]])
START = np.array([[1.0, -4.0, 9.0], [2.0, 0.5, -7.0]])
VOLTAGE = np.array([[12.0, 3.0, -5.0], [8.0, -9.0, 1.0]])
SPEED = np.array([[2.0, 3.0, -1.0], [4.0, 0.5, 1.0]])
NEXT_SPEED = SPEED + 0.1
INTERVAL_S = 0.001
THESIS = np.array([[0.5, 1.0, 10.0]])


def case(measured: bool) -> tuple[MotorWhiteBox, np.ndarray]:
    if measured:
        return MotorWhiteBox(ALL, np.array([0.3, 0.1]), {}, True), THETA
    return MotorWhiteBox(
        ALL[:3], np.array([0.3, 0.1]), {'back_emf_constant': 0.2, 'brush_drop': 0.3}
    ), THETA[:, :3]


def run(
    box: MotorWhiteBox, p: np.ndarray, start: np.ndarray, interval_s: float = INTERVAL_S
) -> Linear:
    return flow(box, p, [start], VOLTAGE, SPEED, NEXT_SPEED, np.full_like(START, interval_s))


def held(
    box: MotorWhiteBox, theta: np.ndarray, start_a: float, voltage_v: float, *intervals_s: float
) -> float:
    """Current of one motor without measured speed at the end of intervals, one after the other."""
    state = np.array([[start_a]])
    none = np.full((1, 1), np.nan)
    for interval_s in intervals_s:
        moved = flow(
            box,
            to_coordinates(theta),
            [state],
            np.array([[voltage_v]]),
            none,
            none,
            np.array([[interval_s]]),
        )
        state = moved.value[State.CURRENT]
    return float(state[0, 0])


@pytest.mark.parametrize(
    ('interval_s', 'error'), [(0.001, 1e-6), (0.02, 3e-3)]
)  # a brush drop is nearly a step
@pytest.mark.parametrize('measured', [True, False])
def test_an_interval_ends_where_scipy_ends(measured: bool, interval_s: float, error: float) -> None:
    box, theta = case(measured)
    ends = run(box, to_coordinates(theta), START, interval_s).value[State.CURRENT]
    for m, k in np.ndindex(START.shape):
        begin = SPEED[m, k]
        change = (NEXT_SPEED - SPEED)[m, k] / interval_s

        def slope(
            time_s: float, state: np.ndarray, m=m, k=k, begin=begin, change=change
        ) -> np.ndarray:  # type: ignore[no-untyped-def]
            own = box.of_motors([m]), theta[m : m + 1], VOLTAGE[m, k : k + 1]
            value: np.ndarray = dynamics.rate(*own, state, np.array([begin + change * time_s]))
            return value

        solved = solve_ivp(
            slope, (0.0, interval_s), [START[m, k]], method='LSODA', rtol=1e-10, atol=1e-12
        )
        assert ends[m, k] == pytest.approx(solved.y[0, -1], rel=error, abs=error)


@pytest.mark.parametrize('voltage_v', [10.0, 1.0, 0.3])
@pytest.mark.parametrize('start_a', [0.0, 0.003, -0.004])
def test_a_current_soon_leaves_zero_where_its_sign_is_soft(
    start_a: float, voltage_v: float
) -> None:
    """Sixteen exponential steps of the same length left it up to 2.5 % too small."""
    box = MotorWhiteBox(('inductance', 'resistance', 'brush_drop'), 0.02)
    theta = np.array([[2e-3, 1.0, 0.6]])
    begin = [np.array([[start_a]])]
    volts = np.array([[voltage_v]])
    none = np.zeros((1, 1))
    length_s = np.array([[1e-3]])
    assert is_stiff(box, to_coordinates(theta), begin, volts, none, length_s).all()
    end = flow(box, to_coordinates(theta), begin, volts, none, none, length_s)
    solved = solve_ivp(
        lambda _, state: dynamics.rate(box, theta, volts[0], state, none[0]),
        (0.0, 1e-3), [start_a], method='LSODA', rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    value = float(end.value[State.CURRENT][0, 0])
    assert value == pytest.approx(solved.y[0, -1], rel=5e-3, abs=1e-6)


@pytest.mark.parametrize('interval_s', [0.001, 0.02])
@pytest.mark.parametrize('measured', [True, False])
def test_sensitivities_are_finite_differences(measured: bool, interval_s: float) -> None:
    box, theta = case(measured)
    p = to_coordinates(theta)
    end, by_state, by_coordinate = run(box, p, START, interval_s).of_state(State.CURRENT)
    assert end.shape == START.shape
    h = 1e-6
    up, down = (run(box, p, START + d, interval_s).value[State.CURRENT] for d in (h, -h))
    np.testing.assert_allclose(by_state, (up - down) / (2 * h), rtol=1e-5, atol=1e-9)
    for j in range(p.shape[1]):
        bump = np.zeros_like(p)
        bump[:, j] = h * p[:, j]
        up, down = (run(box, p + d, START, interval_s).value[State.CURRENT] for d in (bump, -bump))
        np.testing.assert_allclose(
            by_coordinate[j], (up - down) / (2 * bump[:, j : j + 1]), rtol=1e-4, atol=1e-8
        )


@pytest.mark.parametrize(
    ('names', 'known', 'measured'),
    [
        (ALL, {}, True),
        (ALL[:3], {'back_emf_constant': 0.4, 'brush_drop': 0.3}, True),
        (ALL[:3], {'back_emf_constant': 0.4, 'brush_drop': 0.3}, False),
        (('inductance', 'hysteresis'), {'resistance': 1.0}, False),
    ],
)
def test_the_slope_of_the_rate_is_its_finite_difference(
    names: tuple[str, ...], known: dict[str, float], measured: bool
) -> None:
    box = MotorWhiteBox(names, 0.3, known, measured)
    theta = THETA[:1, [ALL.index(name) for name in names]]
    coefficients = dict(enumerate(to_coordinates(theta).T[..., None]))
    voltage = np.array([[5.0]])
    speed = np.array([[2.5]])
    h = 1e-6
    for current in (-3.0, -0.1, 0.05, 8.0):
        states = [np.array([[current + d]]) for d in (0.0, h, -h)]
        middle, up, down = (
            rate(np, box, coefficients, [state], voltage, speed) for state in states
        )
        slope = (up.value[State.CURRENT] - down.value[State.CURRENT]) / (2 * h)
        np.testing.assert_allclose(middle.by_state[State.CURRENT][State.CURRENT], slope, rtol=1e-6)
        direct = dynamics.rate(box, theta, voltage[0], voltage[0] * 0 + current, speed[0])
        np.testing.assert_allclose(middle.value[State.CURRENT][0], direct, rtol=1e-12)


def test_without_hysteresis_the_current_rises_like_that_of_an_rl_circuit() -> None:
    box = MotorWhiteBox(('inductance', 'resistance'), 0.01)
    lengths = (0.001, 0.3, 0.02, 0.7, 0.1)
    for count in range(1, len(lengths) + 1):
        expected = 12.0 * (1.0 - np.exp(-sum(lengths[:count]) / 0.5))
        assert held(box, THESIS[:, :2], 0.0, 12.0, *lengths[:count]) == pytest.approx(
            expected, rel=1e-4
        )


def test_the_motion_is_the_closed_form_of_the_thesis_motor(thesis_box: MotorWhiteBox) -> None:
    # L di/dt = V - r i - k i^2 from rest: i = 2 V tanh(x) / (s + r tanh(x))
    r = 1.0 + 1e-4
    k = 0.1
    voltage = 10.0
    s = np.sqrt(r * r + 4.0 * k * voltage)
    for count in (1, 10, 100):
        x = np.tanh(s * 0.01 * count / (2.0 * 0.5))
        moved = held(thesis_box, THESIS, 0.0, voltage, *count * [0.01])
        assert moved == pytest.approx(2.0 * voltage * x / (s + r * x), rel=1e-8)


def test_a_step_is_of_fourth_order(thesis_box: MotorWhiteBox) -> None:
    exact = held(thesis_box, THESIS, 2.0, 12.0, *1024 * [0.32 / 1024])
    eight, sixteen, more = (
        abs(held(thesis_box, THESIS, 2.0, 12.0, *n * [0.32 / n]) - exact) for n in (8, 16, 32)
    )
    assert eight / sixteen == pytest.approx(16.0, rel=0.15)
    assert sixteen / more == pytest.approx(16.0, rel=0.15)


@pytest.mark.parametrize('interval_s', [0.5, 20.0, 1e6])
def test_a_long_held_voltage_leads_to_the_root_of_the_quadratic(
    thesis_box: MotorWhiteBox, interval_s: float
) -> None:
    r = 1.0 + 1e-4
    k = 0.1
    voltage = 12.0
    root = (np.sqrt(r * r + 4.0 * k * voltage) - r) / (2.0 * k)
    assert held(thesis_box, THESIS, 0.0, voltage, *20 * [interval_s]) == pytest.approx(
        root, rel=1e-6
    )


def test_every_motor_moves_as_it_would_alone_in_whatever_steps() -> None:
    motors = np.array([0.01, 0.01, 0.01, 0.01])
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), motors, {'back_emf_constant': 2 * motors}
    )
    p = to_coordinates(
        np.array([[0.5, 1.0, 10.0], [0.02, 1.0, 10.0], [1e-4, 1.0, 10.0], [0.015, 2.0, 1.0]])
    )
    start = np.array([[1.0, 4.0], [2.0, 0.0], [-3.0, 1.0], [0.5, 0.1]])
    voltage = np.full((4, 2), 9.0)
    none = np.full((4, 2), np.nan)
    interval = np.full((4, 2), 0.01)
    together = flow(box, p, [start], voltage, none, none, interval)
    stiff = is_stiff(box, p, [start], voltage, none, interval)
    assert stiff.tolist() == [False, False, True, False]
    for m in range(4):
        one = slice(m, m + 1)
        alone = flow(
            box.of_motors(one),
            p[one],
            [start[one]],
            voltage[one],
            none[one],
            none[one],
            interval[one],
        )
        for ours, whole in zip(
            alone.of_state(State.CURRENT), together.of_state(State.CURRENT), strict=True
        ):
            np.testing.assert_array_equal(ours, whole[..., one, :])


def test_coordinates_turn_into_parameters_and_back() -> None:
    np.testing.assert_allclose(to_parameters(to_coordinates(THETA)), THETA, rtol=1e-15)


def test_the_covariance_of_the_parameters_follows_from_finite_differences() -> None:
    p = to_coordinates(THETA)
    random = np.random.default_rng(0)
    root = random.normal(size=(*p.shape, p.shape[1]))
    relative = root @ root.swapaxes(1, 2)
    jacobian = np.empty_like(relative)
    for j in range(p.shape[1]):
        bump = np.ones_like(p)
        bump[:, j] += 1e-6
        jacobian[:, :, j] = (to_parameters(p * bump) - to_parameters(p / bump)) / 2e-6
    expected = jacobian @ relative @ jacobian.swapaxes(1, 2)
    np.testing.assert_allclose(parameter_covariance(THETA, relative), expected, rtol=1e-5)
