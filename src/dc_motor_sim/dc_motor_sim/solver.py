"""Fixed-step Bogacki-Shampine, the `ode3` solver of the thesis (4.1), over arrays of any shape."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Derivative = Callable[[FloatArray], FloatArray]


def bogacki_shampine_step(derivative: Derivative, state: FloatArray, step_s: float) -> FloatArray:
    """Advance an autonomous system by one step of third order; the given state is left as it is.

    The input of the system must not change within the step. For a voltage held between samples this
    costs no accuracy, because a step never straddles a sample.

    Args:
        derivative: Time derivative as a function of the state, same shape as the state.
        state: Shape (motor, state).
        step_s: Step length in s.

    Returns:
        The state after the step, same shape.

    Source: P. Bogacki and L. F. Shampine, "A 3(2) pair of Runge-Kutta formulas", Applied
    Mathematics Letters 2 (1989) 321-325, without the embedded error estimate.
    """
    k1 = derivative(state)
    k2 = derivative(state + (0.5 * step_s) * k1)
    k3 = derivative(state + (0.75 * step_s) * k2)
    return state + (step_s / 9.0) * (2.0 * k1 + 3.0 * k2 + 4.0 * k3)


def integrate(
    derivative: Derivative, state: FloatArray, duration_s: float, substeps: int
) -> FloatArray:
    """Advance by `duration_s` in `substeps` equal steps; see `bogacki_shampine_step`."""
    step_s = duration_s / substeps
    for _ in range(substeps):
        state = bogacki_shampine_step(derivative, state, step_s)
    return state
