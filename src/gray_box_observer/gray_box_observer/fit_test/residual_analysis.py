"""Residual analysis of a free run: size, whiteness, and what missing effects explain.

Tests after Ljung (1999, chapter 16) and Davidson and MacKinnon (2004, chapter 6): size against a
noise floor, the Ljung-Box statistic, and a score test of every effect with a covariance that
correlated residuals cannot fool (Newey and West 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import (
    MAD_TO_STD,
    difference_noise,
)
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.effects import LATE, Effect, Scene, interval_means, possible_effects
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.friction_doubts import FrictionDoubt, friction_doubts
from gray_box_observer.fit_test.input_noise import input_noise_shift
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run
from gray_box_observer.fit_test.twin_effects import swap_shifts
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.flow import to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

LAGS = 20
"""Autocorrelations that the Ljung-Box statistic takes in."""

CREDIBLE = 6.0
"""Standard deviations beyond which a residual counts for no more: an outlier is not a misfit."""

LIKELY = 10.0
"""Score, by white residuals, from which an effect is worth the robust test."""

COLOURED = 3.0
"""Whiteness from which correlated residuals are taken into the covariance of the parameters."""

COLOURED_ROTOR = 25.0
"""Whiteness from which a rotor's delays and lags are asked for in every shape that they have: its
fit leaves out, as outliers, the samples behind a step that would show them."""

DISTINCT = 1e-6
"""Share of an effect's response that must not be explained by the parameters: of less nothing can
be told."""

INTEGRATION = 1e-4
"""Noise floor that is believed at least, as a share of the current's spread: steps of the
integration err by less."""

STEEPEST = 0.02
"""Share of the samples, the steepest ones of the current, in which errors of the stamps would show.
"""

FEWEST_STEEP = 20
"""Samples that these are at least."""

SCATTERED = 2.0
"""Times the other residuals, by their medians, that these must be: in white noise they reach 1.6.
"""

PERSISTENT_LAG = 1.0 / 3.0
"""Mechanical time constants after which a load on the shaft still shows in the current."""

FEWEST_MECHANICAL = 20.0
"""Sample intervals in such a time constant, from which noise with a memory is none of a load."""

SMALLEST = 1e-12
"""The same in A, where no current flows."""


@dataclass(frozen=True, eq=False)
class EffectScore:
    """Robust score test of one effect.

    Attributes:
        effect: which.
        score: chi-square of one degree of freedom a shape.
        shift: shape (parameter,): by how much the logarithms of the parameters would move with it.
        amounts: shape (shape,): how much there is of each of its shapes, in the unit of the shape's
            coefficient.
    """

    effect: Effect
    score: float
    shift: Array
    amounts: Array


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """What the residual of one motor's free run says.

    Attributes:
        samples: how many it rests on.
        floor_a: noise floor of the current in A.
        ratio: root mean square of the residual over the noise floor.
        whiteness: Ljung-Box statistic over its degrees of freedom.
        scores: of effects, the largest first.
        robust_std: shape (parameter,): standard deviations of the logarithms over these samples,
            under the residual's own correlation; NaN where the residual is white or nothing can be
            said.
        delay_shift: shape (parameter,): by how much the logarithms of the parameters would move if
            the voltage acted one sample interval later than it is stamped.
        delay_std: standard deviation in sample intervals to which the data tell such a delay, all
            parameters being free; infinite where they do not.
        intervals: sample intervals in an electrical time constant L/R.
        jitter: standard deviation of the stamps in sample intervals; 0 where the residual is as
            large in steep parts of the current as in flat ones.
        moving_noise_a: standard deviation of white noise in A, where no reading repeats the one
            before.
        open_shifts: shape (question, parameter): by how much the logarithms of the parameters may
            be off, each by what the residual does not show: which of two twins it is, noise of
            measured voltage and speed, and a friction that is not quite that of the white box.
        persistence: share of the next sample's autocorrelation that is left a part of a mechanical
            time constant later; 0 without a rotor.
    """

    samples: int
    floor_a: float
    ratio: float
    whiteness: float
    scores: tuple[EffectScore, ...]
    robust_std: Array
    delay_shift: Array
    delay_std: float
    intervals: float
    jitter: float
    moving_noise_a: float
    open_shifts: Array
    persistence: float


def _moving_noise(residual: Array, readings: Array) -> float:
    """Noise of the samples whose reading differs from both neighbours; 0 if too few."""
    changes = readings[1:] != readings[:-1]
    is_moving = changes[1:] & changes[:-1]
    return (
        difference_noise(residual, is_moving)
        if np.count_nonzero(is_moving) >= FEWEST_STEEP
        else 0.0
    )


def ljung_box(residual: Array, lags: int = LAGS) -> float:
    """Return the Ljung-Box statistic over its degrees of freedom; about 1 for white noise."""
    count = residual.size
    deviation = residual - residual.mean()
    power = float(deviation @ deviation)
    if power <= 0.0:
        return 0.0
    correlations = (
        np.array([float(deviation[lag:] @ deviation[:-lag]) for lag in range(1, lags + 1)]) / power
    )
    weights = count * (count + 2.0) / (count - np.arange(1, lags + 1))
    return float(weights @ correlations**2) / lags


def analyse(
    white_box: WhiteBox,
    p: Array,
    stretch: SampleWindow,
    is_drifting: bool = False,
) -> ResidualAnalysis:
    """Analyse the free run of one motor.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): published values as coordinates.
        stretch: the newest samples, with a motor axis of one.
        is_drifting: whether what heats is known to drift, which is no misfit then.
    """
    run = (rotor_free_run if white_box.has_rotor else free_run)(white_box, p, stretch)
    step_a = float(quantisation_step(stretch.state)[0])
    least_a = max(INTEGRATION * float(np.std(stretch.state)), step_a * STEP_TO_STD, SMALLEST)
    floor_a = max(difference_noise(run.residual_a), least_a)
    limit_a = CREDIBLE * max(MAD_TO_STD * float(median(np.abs(run.residual_a))), floor_a)
    weight = np.sqrt(run.weight)
    residual = np.clip(run.residual_a, -limit_a, limit_a) * weight
    base = np.column_stack([run.jacobian, *run.further])
    if is_drifting:
        base = np.column_stack([base, *run.response(_ramps(white_box, run))])
    projection = _Projection(base * weight[:, None], residual, run.jacobian.shape[1])
    if is_drifting:
        residual = projection.remainder
    size_a = math.sqrt(float(residual @ residual) / residual.size)
    whiteness = ljung_box(residual) if size_a > least_a else 1.0
    is_coloured = white_box.has_rotor and whiteness > COLOURED_ROTOR
    robust = projection.robust_std() if whiteness > COLOURED else np.full(p.shape[1], np.nan)
    noise_a = max(size_a, floor_a)
    theta = to_parameters(p)[0]
    delay_shift, delay_std = _delay_effect(run, projection, weight, noise_a)
    return ResidualAnalysis(
        samples=residual.size,
        floor_a=floor_a,
        ratio=size_a / floor_a,
        whiteness=whiteness,
        scores=_scores(
            run,
            projection,
            scene_of(white_box, run),
            weight,
            least_a,
            projection.without(run.residual_a * weight) if is_coloured else None,
        ),
        robust_std=robust,
        delay_shift=delay_shift,
        delay_std=delay_std,
        intervals=_intervals(white_box, p, stretch),
        jitter=_jitter(run, projection.remainder, floor_a),
        moving_noise_a=_moving_noise(run.residual_a, run.stretch.state[0]),
        open_shifts=np.concatenate(
            [
                swap_shifts(white_box, run, theta, noise_a),
                input_noise_shift(white_box, run, theta),
                *(
                    projection.open_shift(doubt, weight, noise_a)
                    for doubt in friction_doubts(white_box, run, theta)
                ),
            ]
        ),
        persistence=_persistence(residual, _mechanical_intervals(white_box, p, stretch)),
    )


def scene_of(white_box: WhiteBox, run: FreeRun) -> Scene:
    """Return what effects are made of, along a free run."""
    speed = run.stretch.speed_rad_s[0] if white_box.speed_measured else None
    return Scene(
        run.stretch.voltage_v[0],
        interval_means(run.current_a),
        None if speed is None else interval_means(speed),
        has_rotor=white_box.has_rotor,
    )


def _delay_effect(
    run: FreeRun, projection: _Projection, weight: Array, noise_a: float
) -> tuple[Array, float]:
    """Return what a delay of one sample interval does to the log-parameters, and its std."""
    voltage_v = run.stretch.voltage_v[0]
    later = np.diff(voltage_v, prepend=voltage_v[:1])
    response = run.response(-later[None])[0] * weight
    distinct = projection.without(response)
    size_a = math.sqrt(float(distinct @ distinct))
    least_a = math.sqrt(DISTINCT * float(response @ response))
    std = noise_a / size_a if size_a > least_a else math.inf
    return -projection.shift(response), std


def _jitter(run: FreeRun, remainder: Array, floor_a: float) -> float:
    """Return the scatter of stamps in sample intervals: such errors show where currents rise."""
    slope = np.abs(np.gradient(run.current_a))
    count = max(FEWEST_STEEP, int(STEEPEST * slope.size))
    if 4 * count >= slope.size:  # there is no rest to compare with
        return 0.0
    order = np.argpartition(slope, (slope.size - 4 * count, slope.size - count))
    steep, rest = order[-count:], order[: -4 * count]
    size = np.abs(remainder)
    steep_a = MAD_TO_STD * float(median(size[steep]))
    rest_a = max(MAD_TO_STD * float(median(size[rest])), floor_a)
    steepness = math.sqrt(float(np.mean(slope[steep] ** 2)))
    if steep_a <= SCATTERED * rest_a or not steepness > 0.0:  # a run that stands tells no instant
        return 0.0
    return math.sqrt(steep_a**2 - rest_a**2) / steepness


def _intervals(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> float:
    names = [parameter.name for parameter in white_box.parameters]
    interval_s = _usual_interval(stretch)
    if 'resistance' not in names or math.isnan(interval_s):
        return math.inf
    return 1.0 / (float(p[0, names.index('resistance')]) * interval_s)


def _usual_interval(stretch: SampleWindow) -> float:
    """Return the median sample interval in s; NaN where there is none."""
    interval_s = stretch.interval_s[stretch.interval_s > 0.0]
    return float(median(interval_s)) if interval_s.size else math.nan


def _mechanical_intervals(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> float:
    """Return the sample intervals in a mechanical time constant ``R J / (Kb Kt)``."""
    if not white_box.has_rotor:
        return math.nan
    assert isinstance(white_box, MotorWhiteBox)
    values = white_box.values(to_parameters(p)[0])
    stiffness = values['back_emf_constant'] * float(white_box.torque_constant)
    time_s = values['resistance'] * values['inertia'] / stiffness
    return time_s / _usual_interval(stretch)


def _persistence(residual: Array, intervals: float) -> float:
    """Return how much of the residual's correlation lasts as long as a rotor's speed does.

    Args:
        residual: shape (sample,).
        intervals: sample intervals in a mechanical time constant; NaN without a rotor.
    """
    if not FEWEST_MECHANICAL < intervals < residual.size:
        return 0.0
    later = round(PERSISTENT_LAG * intervals)
    deviation = residual - residual.mean()
    soon = float(deviation[1:] @ deviation[:-1])
    return float(deviation[later:] @ deviation[:-later]) / soon if soon > 0.0 else 0.0


def _ramps(white_box: WhiteBox, run: FreeRun) -> Array:
    """Voltages of a resistance that drifts, shape (power, k)."""
    progress = np.linspace(-1.0, 1.0, run.decay.size)
    current_a = interval_means(run.current_a)
    return np.stack([-current_a * progress**power for power in (1, 2, 3)])


class _Projection:
    """Least squares of the residual on the parameters, and what is left of it.

    Args:
        base: shape (sample, column): derivatives by first state, coordinates and what else is free.
        residual: shape (sample,).
        unknowns: how many of the columns are first state and coordinates.
    """

    def __init__(self, base: Array, residual: Array, unknowns: int) -> None:
        self._scale = np.linalg.norm(base, axis=0) + 1e-300
        self._q, self._r = np.linalg.qr(base / self._scale)
        self._unknowns = unknowns
        self.remainder: Array = self.without(residual)

    def without(self, signals: Array) -> Array:
        """Return what the columns do not explain of signals, shape (..., sample)."""
        part: Array = (signals @ self._q) @ self._q.T
        return np.subtract(signals, part, out=part)

    def shift(self, signal: Array) -> Array:
        """Return the response of the log-parameters to a misread signal, shape (parameter,)."""
        shift = self._solved(self._q.T @ signal) / self._scale
        return _of_parameters(shift[1 : self._unknowns])

    def open_shift(self, doubt: FrictionDoubt, weight: Array, noise_a: float) -> Array:
        """Return by how much a doubt leaves the log-parameters open, shape (1 or 0, parameter).

        The parameters do not take over all of the response. The rest tells how much there is, with
        what is likely beforehand.

        Args:
            doubt: in the friction.
            weight: shape (sample,): roots of those of the samples.
            noise_a: standard deviation of the residual.
        """
        response = doubt.response_a * weight
        own = self.without(response) / noise_a
        precision = float(own @ own) + 1.0
        amount = float(own @ self.remainder) / noise_a / precision
        std = precision**-0.5
        if abs(amount) < doubt.least_stds * std:
            return np.empty((0, self._unknowns - 1))
        return math.hypot(amount, std) * self.shift(response)[None]

    def robust_std(self) -> Array:
        """Standard deviations of the log-parameters, shape (parameter,), for any correlation."""
        weighted_rows = self._q * self.remainder[:, None]
        spread = self._solved(long_run_covariance(weighted_rows)) / self._scale[:, None]
        spread = (self._solved(spread.T) / self._scale[:, None])[
            1 : self._unknowns, 1 : self._unknowns
        ]
        shift = _of_parameters(_of_parameters(spread).T)
        std: Array = np.sqrt(np.maximum(np.diagonal(shift), 0.0))
        return std

    def _solved(self, right: Array) -> Array:
        diagonal = np.abs(np.diagonal(self._r))
        if not (diagonal > 1e-12 * diagonal.max()).all():
            return np.asarray(np.linalg.pinv(self._r) @ right)
        return np.asarray(np.linalg.solve(self._r, right))


def _of_parameters(coordinates: Array) -> Array:
    """Turn changes of log-coordinates, shape (coordinate, ...), into those of parameters."""
    shift = coordinates - coordinates[:1]
    shift[0] = -coordinates[0]
    return shift


def bandwidth(count: int) -> int:
    """Return the lags up to which correlation counts, of so many samples."""
    return int(min(count // 8, max(8.0, 2.0 * math.sqrt(count))))


def long_run_covariance(terms: Array) -> Array:
    """Covariance of a sum of correlated terms, shape (sample, n), after Newey and West (1987)."""
    count = terms.shape[0]
    width = bandwidth(count)
    fft_length = 1 << (count + width).bit_length()
    spectrum = np.fft.rfft(terms, fft_length, axis=0)
    lags = np.arange(width + 1)
    kernel = np.zeros(fft_length)
    kernel[lags] = 1.0 - lags / (width + 1.0)
    kernel[-lags[1:]] = kernel[lags[1:]]
    weights = np.fft.rfft(kernel).real.copy()
    weights[1 : (fft_length + 1) // 2] *= 2.0
    covariance: Array = ((spectrum.conj() * weights[:, None]).T @ spectrum).real / fft_length
    return covariance


def _scores(
    run: FreeRun,
    projection: _Projection,
    scene: Scene,
    weight: Array,
    least_a: float,
    late_remainder: Array | None,
) -> tuple[EffectScore, ...]:
    """Test every effect but those that white residuals rule out at ``least_a`` or more.

    Args:
        run: the free run.
        projection: of its residual on the parameters.
        scene: what the effects are made of.
        weight: shape (sample,): of the samples.
        least_a: noise in A that is there at least.
        late_remainder: shape (sample,): what the parameters leave of a residual with its outliers,
            on which delays and lags are tested too, in all their shapes; None: they are not.
    """
    fine = replace(scene, fine=True)
    candidates = [
        (effect, shapes)
        for effect, alternatives in possible_effects(scene)
        for shapes in (
            alternatives
            if late_remainder is None or effect.name not in LATE
            else effect.alternatives(fine)
        )
    ]
    voltages = np.stack([shape for _, shapes in candidates for shape in shapes])
    response = run.response(voltages)
    response *= weight
    distinct = projection.without(response)
    gram = distinct @ distinct.T
    own = np.diagonal(gram) > DISTINCT * np.einsum('ij,ij->i', response, response)
    remainders = [projection.remainder] + ([] if late_remainder is None else [late_remainder])
    residual_parts = [(part, distinct @ part, float(part @ part)) for part in remainders]
    best: dict[str, EffectScore] = {}
    first = 0
    for effect, shapes in candidates:
        columns = np.arange(first, first + len(shapes))
        first += len(shapes)
        is_own = own[columns]
        columns = columns[is_own]
        if columns.size == 0:
            continue
        own_gram = gram[np.ix_(columns, columns)]
        for remainder, products, power in (
            residual_parts if effect.name in LATE else residual_parts[:1]
        ):
            own_products = products[columns]
            amount = _least_squares(own_gram, own_products)
            explained_power = float(own_products @ amount)
            rest_power = power - 2.0 * explained_power + float(amount @ own_gram @ amount)
            noise = max(rest_power / remainder.size, least_a**2)
            if explained_power < LIKELY * columns.size * noise:  # a white residual rules it out
                continue
            score = _score(distinct[columns], remainder, amount, own_products, noise * own_gram)
            if effect.name not in best or score > best[effect.name].score:
                shift = -projection.shift(amount @ response[columns])
                amounts = np.zeros(len(shapes))
                amounts[is_own] = amount
                best[effect.name] = EffectScore(effect, score, shift, amounts)
    return tuple(sorted(best.values(), key=lambda entry: -entry.score))


def _least_squares(matrix: Array, right: Array) -> Array:
    """Solve normal equations, whose columns may depend on each other."""
    if right.size == 1:
        return np.asarray(right / matrix[0], dtype=float)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-10)[0], dtype=float)


def _score(
    distinct: Array, remainder: Array, amount: Array, products: Array, white: Array
) -> float:
    """Return the robust score of one alternative.

    Args:
        distinct: shape (column, sample): what it alone explains.
        remainder: shape (sample,): what is left of the residual.
        amount: shape (column,): its size.
        products: shape (column,): ``distinct`` times ``remainder``.
        white: shape (column, column): covariance of the products if what is left then is white.
    """
    rest = remainder - amount @ distinct
    covariance = long_run_covariance((distinct * rest).T) + 0.5 * white
    return float(products @ _least_squares(covariance, products)) / products.size
