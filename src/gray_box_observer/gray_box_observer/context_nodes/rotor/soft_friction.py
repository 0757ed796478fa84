"""How far estimates are off because dry friction is softened near zero speed.

The model has ``sign(w)`` softened over a few hundredths of a rad/s, so that a rotor at rest creeps.
A motor that turns by no more than a few rad/s notices that: in simulations with sharp friction R
came out up to 3 % too small, and sure. To first order the error follows from the run. What the
friction lacks is a small load, and the parameters move by what they explain of its answer. Near
rest it takes no more than the speed that there is. The first order counts as a standard deviation:
in simulations the error was 0.2 to 2.3 times as large. Frictions are those of the softened law, but
where the inertia is pulled as well: under a slow ramp it came out half as large, and dry friction
8 % too large.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.rotor_trajectory import (
    DRY_FRICTION,
    LOAD,
    STATES,
    Run,
    state_response,
)
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array


def soft_friction_pull(runs: FreeRuns, noise_a: float) -> Array:
    """Return how softened friction pulls the logarithms of the parameters, shape (parameter,).

    That is information times shift, to first order, with all first states free.

    Args:
        runs: free runs at the values of a fit.
        noise_a: standard deviation of its readings.
    """
    unknowns = runs.starts.shape[1]
    pull = np.zeros(runs.by_logarithm.shape[1])
    for row, (path, by_unknown) in enumerate(zip(runs.runs, runs.derivatives, strict=True)):
        answer = runs.readings_of(_answer(runs, path), row)[:, None]
        answer = runs.without_noise(answer, row)
        left = runs.beyond_starts(answer, row)
        pull += by_unknown[:, unknowns:].T @ left[:, 0]
    return np.asarray(np.nan_to_num(pull / noise_a**2))


def _answer(runs: FreeRuns, path: Run) -> Array:
    """Return how the states of a run answer what its friction lacks, shape (k + 1, state)."""
    current_a, speed_rad_s = path.states.T
    at = (current_a, speed_rad_s, runs.torque_constant, np.zeros_like(speed_rad_s))
    friction = forms.EFFECTS['coulomb_friction']
    deficit = np.sign(speed_rad_s) - friction.value(*at)
    brake = friction.partial[State.SPEED](*at) * speed_rad_s
    load = np.where(np.abs(brake) < np.abs(deficit), brake, deficit)
    load *= runs.p[DRY_FRICTION]
    by_load = path.slopes[:, :, STATES + LOAD]
    gains = by_load[1:] - np.einsum('ksr,kr->ks', path.transitions, by_load[:-1])
    means = 0.5 * (load[1:] + load[:-1])
    return state_response(path.transitions, gains, means[:, None])[:, 0]
