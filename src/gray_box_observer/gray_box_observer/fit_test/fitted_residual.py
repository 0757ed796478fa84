"""The residual of a free run: what the parameters leave of it, how large it is, and how white.

Tests after Ljung (1999, chapter 16): size against a noise floor, and the Ljung-Box statistic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun, free_run_in_pieces
from gray_box_observer.fit_test.input_noise import with_voltage_noise
from gray_box_observer.fit_test.projection import Projection
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run_in_pieces
from gray_box_observer.fit_test.speed_noise import SpeedNoise
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.flow import to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox

LAGS = 20
"""Autocorrelations that the Ljung-Box statistic takes in."""

CREDIBLE = 6.0
"""Standard deviations beyond which a residual counts for no more: an outlier is not a misfit."""

COLOURED = 3.0
"""Whiteness from which correlated residuals are taken into the covariance of the parameters."""

WORK_OF_COLUMNS = 1000
"""Products of numbers that are one piece of work."""

INTEGRATION = 1e-4
"""Noise floor that is believed at least, as a share of the current's spread: steps of the
integration err by less."""

SMALLEST = 1e-12
"""Noise floor in A that is believed at least, where no current flows."""


@dataclass(frozen=True, eq=False)
class FittedResidual:
    """What the parameters leave of the residual of one motor's free run.

    Attributes:
        run: the free run.
        speed_noise: of the readings of a measured speed; None: they have none.
        projection: of its residual on the parameters.
        residual_a: shape (sample,): what they leave.
        step_a: by which readings of the current step; 0: by none.
        least_a: noise in A that is there at least.
        floor_a: noise floor of the current in A.
        size_a: root mean square of the residual.
        ratio: the same over the noise floor; beside noise of voltage or speed, that of its
            innovations.
        whiteness: Ljung-Box statistic over its degrees of freedom, of the same.
        is_white: whether the residual itself is white.
    """

    run: FreeRun
    speed_noise: SpeedNoise | None
    projection: Projection
    residual_a: Array
    step_a: float
    least_a: float
    floor_a: float
    size_a: float
    ratio: float
    whiteness: float
    is_white: bool


def fitted_residual_in_pieces(
    white_box: WhiteBox,
    p: Array,
    stretch: SampleWindow,
    *,
    is_drifting: bool,
    knows_voltage_noise: bool,
    noise_memory: float,
) -> Pieces[FittedResidual]:
    """Run one motor freely, and project the residual on its parameters.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): published values as coordinates.
        stretch: the newest samples, with a motor axis of one.
        is_drifting: whether what heats is known to drift, which is no misfit then.
        knows_voltage_noise: whether the fit has taken off what noise of the voltage does.
        noise_memory: of a rotor's current.
    """
    work = stretch.state.size
    if white_box.has_rotor:
        run = yield from rotor_free_run_in_pieces(white_box, p, stretch, noise_memory)
    else:
        run = yield from free_run_in_pieces(white_box, p, stretch)
    yield work
    step_a = float(quantisation_step(stretch.state)[0])
    least_a = max(INTEGRATION * float(np.std(stretch.state)), step_a * STEP_TO_STD, SMALLEST)
    if knows_voltage_noise:
        run = with_voltage_noise(white_box, to_parameters(p)[0], run)
    speed_noise = None
    if white_box.speed_measured and not white_box.has_rotor:
        speed_noise = SpeedNoise.from_run(white_box, p, run)
        run = run if speed_noise is None else speed_noise.shown_in(run)
    floor_a = max(difference_noise(run.innovation_of(run.residual_a)), least_a)
    limit_a = CREDIBLE * max(MAD_TO_STD * float(median(np.abs(run.residual_a))), floor_a)
    residual = np.clip(run.residual_a, -limit_a, limit_a)
    base = np.column_stack([run.jacobian, *run.further])
    if is_drifting:
        base = np.column_stack([base, *run.response(_ramps(white_box, run))])
    yield 0
    projection = Projection(base, residual, run.weight, run.jacobian.shape[1])
    yield max(work, base.shape[0] * base.shape[1] ** 2 // WORK_OF_COLUMNS)
    has_load = white_box.load_varies
    residual = projection.remainder if is_drifting or has_load else projection.residual
    freedom = max(residual.size - base.shape[1], 1) if has_load else residual.size
    of_white = projection.correlations_of_white(LAGS) if has_load else 0.0
    size_a = math.sqrt(float(residual @ residual) / freedom)
    is_large = size_a > least_a
    whiteness = ljung_box(residual, of_white=of_white) if is_large else 1.0
    is_white = whiteness <= COLOURED
    innovation_size_a = size_a
    if run.has_input_noise:
        innovation = run.innovation_of(residual)
        innovation_size_a = math.sqrt(float(innovation @ innovation) / freedom)
        whiteness = ljung_box(innovation, of_white=of_white) if is_large else 1.0
    return FittedResidual(
        run=run,
        speed_noise=speed_noise,
        projection=projection,
        residual_a=residual,
        step_a=step_a,
        least_a=least_a,
        floor_a=floor_a,
        size_a=size_a,
        ratio=innovation_size_a / floor_a,
        whiteness=whiteness,
        is_white=is_white,
    )


def ljung_box(residual: Array, lags: int = LAGS, of_white: Array | float = 0.0) -> float:
    """Return the Ljung-Box statistic over its degrees of freedom; about 1 for white noise.

    Args:
        residual: shape (sample,).
        lags: up to which correlations count.
        of_white: shape (lag,): correlations that white noise would have here.
    """
    count = residual.size
    deviation = residual - residual.mean()
    power = float(deviation @ deviation)
    if power <= 0.0:
        return 0.0
    correlations = (
        np.array([float(deviation[lag:] @ deviation[:-lag]) for lag in range(1, lags + 1)]) / power
    )
    weights = count * (count + 2.0) / (count - np.arange(1, lags + 1))
    return float(weights @ (correlations - of_white) ** 2) / lags


def _ramps(white_box: WhiteBox, run: FreeRun) -> Array:
    """Voltages of a resistance that drifts, shape (power, k)."""
    progress = np.linspace(-1.0, 1.0, run.decay.size)
    current_a = interval_means(run.current_a)
    return np.stack([-current_a * progress**power for power in (1, 2, 3)])
