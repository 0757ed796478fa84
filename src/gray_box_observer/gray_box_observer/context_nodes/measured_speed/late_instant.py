"""What a voltage that acts later within its interval does to a fit of current and speed.

To first order a pulse of voltage is missing at the start of the interval. Current and speed answer
that by the motion of the whole motor, and the readings of both tell how much of it there is. Beside
a voltage that is read with noise the answer holds that noise, as the residual does. What both have
in common by it is found by laying such noise over the readings once more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.rotor.noise_filter import DRAWS, SEED
from gray_box_observer.context_nodes.rotor.rotor_trajectory import Run, state_response
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array

DISTINCT = 1e-6
"""Share of the answer that unknowns must not explain: of less nothing can be told."""

SIZE_ERROR = 0.1
"""Error of the noise's power, as a share of it."""

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
        slopes, answer, residual, noise = _columns(fit)
        scale = np.linalg.norm(slopes, axis=0) + 1e-300
        columns = np.column_stack([answer, residual, noise])
        amounts = np.linalg.lstsq(slopes / scale, columns, rcond=1e-9)[0] / scale[:, None]
        shift = -amounts[:, 0]
        own, remainder, *left = (columns - slopes @ amounts).T
        power = float(own @ own)
        product = float(own @ remainder)
        variance = fit.fit.noise_a**2 * power
        if noise.size:  # what noise of the voltage brings to both is taken off
            draws = list(zip(left[:DRAWS], left[DRAWS:], strict=True))
            products = [float(one @ other) for one, other in draws]
            bias = float(np.mean(products))
            product -= bias
            variance += float(np.var(products, ddof=1)) / DRAWS + (SIZE_ERROR * bias) ** 2
            power -= float(np.mean([one @ one for one, _ in draws]))
        if not power > DISTINCT * float(answer @ answer):
            return cls(shift, 0.0, math.inf)
        return cls(shift, product / power, math.sqrt(variance) / power)


def _columns(fit: OutputFit) -> tuple[Array, Array, Array, Array]:
    """Return slopes by the parameters, answer, residual and noise, first states taken off.

    The noise is drawn as large as that of the voltage: first what it brings to the answer, then
    what it brings to the residual.

    Returns:
        Shape (reading, parameter), (reading,), (reading,) and (reading, 2 draw); no draws without
        noise.
    """
    runs = fit.fit.runs
    unknowns = fit.fit.starts.shape[1]
    inductance = float(fit.fit.theta[0])
    rng = np.random.default_rng(SEED)
    lefts: list[Array] = []
    begin = 0
    parts = zip(runs.window.histories, runs.runs, runs.derivatives, strict=True)
    for row, (history, path, by_unknown) in enumerate(parts):
        draws_v = np.empty((history.voltage_v.size, 0))
        if runs.noise is not None:
            std_v = np.sqrt(runs.noise.variances_v2(history.interval_s))
            draws_v = std_v[:, None] * rng.normal(size=(std_v.size, DRAWS))
        voltages_v = np.column_stack([history.voltage_v, draws_v])
        states = [*_answers(history.interval_s, voltages_v, path, inductance)]
        if runs.noise is not None:
            states += [*-runs.response(draws_v, row).swapaxes(0, 1)]
        rows = np.column_stack([runs.readings_of(one, row) for one in states])
        answer, *noise = runs.without_noise(rows, row).T
        residual = runs.residual_a[begin : begin + answer.size]
        begin += answer.size
        both = np.column_stack([by_unknown[:, unknowns:], answer, residual, *noise])
        lefts.append(runs.beyond_starts(both, row))
    left = np.concatenate(lefts)
    count = runs.by_logarithm.shape[1]
    return left[:, :count], left[:, count], left[:, count + 1], left[:, count + 2 :]


def _answers(interval_s: Array, voltages_v: Array, path: Run, inductance: float) -> Array:
    """Return how the states answer the missing pulses of one interval, (voltage, k + 1, state).

    Args:
        interval_s: shape (k,).
        voltages_v: shape (k, voltage).
        path: run.
        inductance: L in H.
    """
    late_v = -np.diff(voltages_v, prepend=voltages_v[:1], axis=0)
    gains = path.transitions[:, :, State.CURRENT] / inductance
    return state_response(path.transitions, gains, late_v * interval_s[:, None]).swapaxes(0, 1)
