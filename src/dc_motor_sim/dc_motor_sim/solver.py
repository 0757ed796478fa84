"""Fixed-step Bogacki-Shampine, the `ode3` solver of the thesis (4.1), over numbers or arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

State = tuple[Any, ...]
"""State variables, each a number or an array of one shape."""

Derivative = Callable[..., State]
"""Time derivatives of the state variables, which are its arguments."""


def bogacki_shampine_step(derivative: Derivative, state: State, step_s: float) -> State:
    """Advance an autonomous system by one step of third order; the given state is left as it is.

    The input of the system must not change within the step. For a voltage held between samples this
    costs no accuracy, because a step never straddles a sample.

    Args:
        derivative: Time derivatives of the state variables.
        state: State variables: numbers, or arrays of one shape.
        step_s: Step length in s.

    Returns:
        The state after the step.

    Source: P. Bogacki and L. F. Shampine, "A 3(2) pair of Runge-Kutta formulas", Applied
    Mathematics Letters 2 (1989) 321-325, without the embedded error estimate.
    """
    half_s = 0.5 * step_s
    three_quarters_s = 0.75 * step_s
    ninth_s = step_s / 9.0
    k1 = derivative(*state)
    k2 = derivative(*[x + half_s * k for x, k in zip(state, k1, strict=True)])
    k3 = derivative(*[x + three_quarters_s * k for x, k in zip(state, k2, strict=True)])
    stages = zip(state, k1, k2, k3, strict=True)
    return tuple([x + ninth_s * (2.0 * a + 3.0 * b + 4.0 * c) for x, a, b, c in stages])


def integrate(derivative: Derivative, state: State, duration_s: float, substeps: int) -> State:
    """Advance by `duration_s` in `substeps` equal steps; see `bogacki_shampine_step`."""
    step_s = duration_s / substeps
    for _ in range(substeps):
        state = bogacki_shampine_step(derivative, state, step_s)
    return state
