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
    return _step_for(state)(derivative, state, step_s)


def integrate(derivative: Derivative, state: State, duration_s: float, substeps: int) -> State:
    """Advance by `duration_s` in `substeps` equal steps; see `bogacki_shampine_step`."""
    step_s = duration_s / substeps
    advance = _step_for(state)
    for _ in range(substeps):
        state = advance(derivative, state, step_s)
    return state


def _step_for(state: State) -> Callable[[Derivative, State, float], State]:
    """Return the step for as many variables: of one or two, written out, it is twice as fast."""
    return {1: _step_of_one, 2: _step_of_two}.get(len(state), _step_of_many)


def _step_of_one(derivative: Derivative, state: State, step_s: float) -> State:
    (x,) = state
    (k1,) = derivative(x)
    (k2,) = derivative(x + 0.5 * step_s * k1)
    (k3,) = derivative(x + 0.75 * step_s * k2)
    return (x + step_s / 9.0 * (2.0 * k1 + 3.0 * k2 + 4.0 * k3),)


def _step_of_two(derivative: Derivative, state: State, step_s: float) -> State:
    half_s = 0.5 * step_s
    three_quarters_s = 0.75 * step_s
    ninth_s = step_s / 9.0
    x, y = state
    k1, q1 = derivative(x, y)
    k2, q2 = derivative(x + half_s * k1, y + half_s * q1)
    k3, q3 = derivative(x + three_quarters_s * k2, y + three_quarters_s * q2)
    return (
        x + ninth_s * (2.0 * k1 + 3.0 * k2 + 4.0 * k3),
        y + ninth_s * (2.0 * q1 + 3.0 * q2 + 4.0 * q3),
    )


def _step_of_many(derivative: Derivative, state: State, step_s: float) -> State:
    half_s = 0.5 * step_s
    three_quarters_s = 0.75 * step_s
    ninth_s = step_s / 9.0
    k1 = derivative(*state)
    k2 = derivative(*[x + half_s * k for x, k in zip(state, k1, strict=True)])
    k3 = derivative(*[x + three_quarters_s * k for x, k in zip(state, k2, strict=True)])
    stages = zip(state, k1, k2, k3, strict=True)
    return tuple([x + ninth_s * (2.0 * a + 3.0 * b + 4.0 * c) for x, a, b, c in stages])
