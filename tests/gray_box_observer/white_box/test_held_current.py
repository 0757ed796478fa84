"""A current that brushes may hold, beside a measured speed, against small steps of a sharp sign."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import flow, to_coordinates
from gray_box_observer.white_box.motion import Linear

NODES = ('inductance', 'resistance', 'hysteresis', 'brush_drop')
INDUCTANCE, RESISTANCE, HYSTERESIS, DROP_V = THETA = (2e-3, 1.5, 2e-3, 0.8)
BACK_EMF = 0.02
BOX = MotorWhiteBox(NODES, 0.02, {'back_emf_constant': BACK_EMF}, True)
P = to_coordinates(np.array([THETA]))
INTERVAL_S = 2e-3
STEPS = 20_000

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

CASES = {
    'far from zero': (3.0, 6.0, 40.0, 44.0),
    'comes to zero and stays': (0.4, 0.5, 10.0, 12.0),
    'comes to zero from below and stays': (-0.3, 0.2, 20.0, 22.0),
    'passes zero': (0.5, -6.0, 30.0, 26.0),
    'passes zero upwards': (-0.5, 6.0, -30.0, -26.0),
    'rests': (0.0, 0.6, 10.0, 12.0),
    'leaves zero at once': (0.0, 3.0, 20.0, 20.0),
    'leaves zero on the way': (0.0, 1.4, 50.0, 10.0),
    'leaves zero downwards': (0.0, -3.0, 20.0, 22.0),
}
"""Current at the start in A, voltage, and speeds at start and end in rad/s."""


def _moved(start_a: float, voltage_v: float, begin: float, end: float, p: Floats = P) -> Linear:
    signals = (np.array([[x]]) for x in (voltage_v, begin, end, INTERVAL_S))
    return flow(BOX, p, [np.array([[start_a]])], *signals)


def _end(*case: float, p: Floats = P) -> float:
    return float(_moved(*case, p=p).value[State.CURRENT][0, 0])


def _in_small_steps(start_a: float, voltage_v: float, begin: float, end: float) -> float:
    """Euler's method; a drop takes at most what there is of a current."""
    step_s = INTERVAL_S / STEPS
    current_a = start_a
    for step in range(STEPS):
        speed = begin + (step + 0.5) / STEPS * (end - begin)
        resistance = RESISTANCE + HYSTERESIS * abs(speed)
        rest_v = voltage_v - resistance * current_a - BACK_EMF * speed
        current_a += step_s * rest_v / INDUCTANCE
        taken_a = step_s * DROP_V / INDUCTANCE
        current_a = float(np.copysign(max(abs(current_a) - taken_a, 0.0), current_a))
    return current_a


@pytest.mark.parametrize('case', CASES.values(), ids=CASES)
def test_a_current_ends_where_small_steps_end(case: tuple[float, ...]) -> None:
    assert _end(*case) == pytest.approx(_in_small_steps(*case), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize('name', ['comes to zero and stays', 'rests'])
def test_a_current_that_is_held_is_zero_and_answers_nothing(name: str) -> None:
    value, by_state, by_coordinate = _moved(*CASES[name]).of_state(State.CURRENT)
    assert value[0, 0] == 0.0
    assert by_state[0, 0] == 0.0
    assert not by_coordinate.any()


@pytest.mark.parametrize(
    'name', ['far from zero', 'passes zero', 'passes zero upwards', 'leaves zero at once']
)
def test_derivatives_are_finite_differences(name: str) -> None:
    start_a, *signals = CASES[name]
    _, by_state, by_coordinate = _moved(start_a, *signals).of_state(State.CURRENT)
    bump_a = 1e-6
    if start_a:
        change_a = _end(start_a + bump_a, *signals) - _end(start_a - bump_a, *signals)
        assert by_state[0, 0] == pytest.approx(change_a / (2.0 * bump_a), rel=1e-5)
    for place in range(P.shape[1]):
        bump = np.zeros_like(P)
        bump[0, place] = 1e-6 * P[0, place]
        change_a = _end(start_a, *signals, p=P + bump) - _end(start_a, *signals, p=P - bump)
        expected = change_a / (2.0 * bump[0, place])
        assert by_coordinate[place, 0, 0] == pytest.approx(expected, rel=1e-4, abs=1e-9)
