from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import advance

flow_module = pytest.importorskip('gray_box_observer.white_box.flow')

ALL = ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'brush_drop')
THETA = np.array([[0.5, 1.0, 10.0, 0.4, 0.3], [0.2, 2.0, 3.0, 0.1, 0.5]])
START = np.array([[1.0, -4.0, 9.0], [2.0, 0.5, -7.0]])
VOLTAGE = np.array([[12.0, 3.0, -5.0], [8.0, -9.0, 1.0]])
SPEED = np.array([[2.0, 3.0, -1.0], [4.0, 0.5, 1.0]])
NEXT_SPEED = SPEED + 0.1
INTERVAL_S = 0.001


def case(measured: bool) -> tuple[MotorWhiteBox, np.ndarray]:
    if measured:
        return MotorWhiteBox(ALL, np.array([0.3, 0.1]), {}, True), THETA
    return MotorWhiteBox(ALL[:3], np.array([0.3, 0.1]), {'back_emf_constant': 0.2, 'brush_drop': 0.3}), THETA[:, :3]


def run(box: MotorWhiteBox, p: np.ndarray, start: np.ndarray) -> object:
    return flow_module.flow(box, p, start, VOLTAGE, SPEED, NEXT_SPEED, np.full_like(START, INTERVAL_S))


@pytest.mark.parametrize('measured', [True, False])
def test_an_interval_ends_where_advancing_ends(measured: bool) -> None:
    box, theta = case(measured)
    ends = run(box, flow_module.to_coordinates(theta), START).end
    for k in range(START.shape[1]):
        signals = (START[:, k], VOLTAGE[:, k], SPEED[:, k], NEXT_SPEED[:, k])
        np.testing.assert_allclose(ends[:, k], advance(box, theta, *signals, np.full(2, INTERVAL_S)), rtol=1e-6)


@pytest.mark.parametrize('measured', [True, False])
def test_sensitivities_are_finite_differences(measured: bool) -> None:
    box, theta = case(measured)
    p = flow_module.to_coordinates(theta)
    found = run(box, p, START)
    h = 1e-6
    by_state = (run(box, p, START + h).end - run(box, p, START - h).end) / (2 * h)
    np.testing.assert_allclose(found.by_state, by_state, rtol=1e-6)
    for j in range(p.shape[1]):
        bump = np.zeros_like(p)
        bump[:, j] = h * p[:, j]
        slope = (run(box, p + bump, START).end - run(box, p - bump, START).end) / (2 * bump[:, j : j + 1])
        np.testing.assert_allclose(found.by_coordinate[j], slope, rtol=1e-5, atol=1e-9)


def test_coordinates_turn_into_parameters_and_back() -> None:
    np.testing.assert_allclose(flow_module.to_parameters(flow_module.to_coordinates(THETA)), THETA, rtol=1e-15)


def test_the_covariance_of_the_parameters_follows_from_finite_differences() -> None:
    p, random = flow_module.to_coordinates(THETA), np.random.default_rng(0)
    root = random.normal(size=(*p.shape, p.shape[1]))
    relative = root @ root.swapaxes(1, 2)
    jacobian = np.empty_like(relative)
    for j in range(p.shape[1]):
        bump = np.ones_like(p)
        bump[:, j] += 1e-6
        jacobian[:, :, j] = (flow_module.to_parameters(p * bump) - flow_module.to_parameters(p / bump)) / 2e-6
    expected = jacobian @ relative @ jacobian.swapaxes(1, 2)
    np.testing.assert_allclose(flow_module.parameter_covariance(THETA, relative), expected, rtol=1e-5)
