"""The solver against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.solver import bogacki_shampine_step, integrate


def logistic(*state):
    return tuple(x * (1.0 - x) for x in state)


def logistic_closed_form(start, time_s):
    return 1.0 / (1.0 + (1.0 / start - 1.0) * np.exp(-time_s))


def test_the_error_falls_with_the_third_power_of_the_step():
    start = np.array([0.1, 0.4])  # shape: (motor,)
    truth = logistic_closed_form(start, 2.0)
    errors = [np.abs(integrate(logistic, (start,), 2.0, n)[0] - truth).max() for n in (20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(3.0, abs=0.15)


def test_a_step_of_a_linear_system_is_the_exponential_series_up_to_third_order():
    z = -0.3
    (after,) = bogacki_shampine_step(lambda x: (z * x,), (2.0,), 1.0)
    assert after == pytest.approx(2.0 * (1 + z + z**2 / 2 + z**3 / 6), rel=1e-14)


def test_a_step_leaves_the_given_state_as_it_was():
    state = np.array([0.1, 0.2])
    bogacki_shampine_step(logistic, (state,), 0.5)
    assert state.tolist() == [0.1, 0.2]


def test_numbers_and_arrays_go_the_same_way():
    both = integrate(logistic, (np.array([0.1, 0.4]), np.array([0.2, 0.3])), 2.0, 20)
    first, second = (integrate(logistic, start, 2.0, 20) for start in ((0.1, 0.2), (0.4, 0.3)))
    assert np.array(both).tolist() == np.array([first, second]).T.tolist()
