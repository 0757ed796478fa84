"""What a voltage that acts later within its interval does to a fit of current and speed.

To first order a pulse of voltage is missing at the start of the interval. Current and speed answer
that by the motion of the whole motor, and the readings of both tell how much of it there is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.rotor.rotor_trajectory import STATES, Run
from gray_box_observer.context_nodes.rotor.window import History
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array

DISTINCT = 1e-6
"""Share of the answer that unknowns must not explain: of less nothing can be told."""

STDS = 3.0
"""Standard deviations from which readings are not those of a punctual voltage."""


@dataclass(frozen=True, eq=False)
class LateInstant:
    """A voltage that acts later than its stamp, by a part of a sample interval.

    Attributes:
        shift: shape (parameter,): by how much the logarithms of the parameters would move by one
            interval.
        mean, std: how much of it the readings tell, in sample intervals; an infinite deviation:
            nothing.
    """

    shift: Array
    mean: float
    std: float

    def supports(self, delay: float) -> bool:
        """Tell whether the readings show a voltage that is late, or early, as a delay has it.

        Args:
            delay: in sample intervals; one that is longer than one shows as one.
        """
        return self.mean * delay > 0.0 and abs(self.mean) > STDS * self.std

    @classmethod
    def from_fit(cls, fit: OutputFit) -> LateInstant:
        """Ask a fit of both outputs."""
        runs = fit.fit.runs
        unknowns = fit.fit.starts.shape[1]
        inductance = float(fit.fit.theta[0])
        slopes: list[Array] = []
        answers: list[Array] = []
        residuals: list[Array] = []
        begin = 0
        parts = zip(fit.window.histories, runs.runs, runs.derivatives, strict=True)
        for row, (history, path, by_unknown) in enumerate(parts):
            states = _answer(history, path, inductance)
            answer = runs.readings_of(states, row)
            residual = runs.residual_a[begin : begin + answer.size]
            begin += answer.size
            both = np.column_stack([by_unknown[:, unknowns:], answer, residual])
            starts = by_unknown[:, :unknowns]
            left = both - starts @ np.linalg.lstsq(starts, both, rcond=1e-9)[0]
            slopes.append(left[:, :-2])
            answers.append(left[:, -2])
            residuals.append(left[:, -1])
        return cls._projected_on(
            np.concatenate(slopes),
            np.concatenate(answers),
            np.concatenate(residuals),
            fit.fit.noise_a,
        )

    @classmethod
    def _projected_on(
        cls, slopes: Array, answer: Array, residual: Array, noise_a: float
    ) -> LateInstant:
        """Project an answer on the slopes by the parameters, and the residual on what is left."""
        scale = np.linalg.norm(slopes, axis=0) + 1e-300
        both = np.column_stack([answer, residual])
        amounts = np.linalg.lstsq(slopes / scale, both, rcond=1e-9)[0] / scale[:, None]
        own, remainder = (both - slopes @ amounts).T
        power = float(own @ own)
        if not power > DISTINCT * float(answer @ answer):
            return cls(-amounts[:, 0], 0.0, math.inf)
        return cls(-amounts[:, 0], float(own @ remainder) / power, noise_a / math.sqrt(power))


def _answer(history: History, path: Run, inductance: float) -> Array:
    """Return how the states answer the missing pulses of one interval, shape (k + 1, state)."""
    late_v = -np.diff(history.voltage_v, prepend=history.voltage_v[:1])
    gains = path.transitions[:, :, State.CURRENT] / inductance
    pushes = gains * (late_v * history.interval_s)[:, None]
    states = np.zeros((pushes.shape[0] + 1, STATES))
    for k, (transition, push) in enumerate(zip(path.transitions, pushes, strict=True)):
        states[k + 1] = transition @ states[k] + push
    return states
