"""Residual analysis of a free run: what its residual leaves open, and what missing effects explain.

Tests after Davidson and MacKinnon (2004, chapter 6): a score test of every effect. The covariance
of the scores holds for correlated residuals too (Newey and West 1987).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.normal_equations import (
    difference_noise,
)
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.rotor.voltage_noise import SURE
from gray_box_observer.fit_test.current_lag import lag_doubts, shifts_behind_lag
from gray_box_observer.fit_test.effects import (
    LATE,
    Effect,
    Scene,
    Shapes,
    interval_means,
    possible_effects,
    scene_along,
)
from gray_box_observer.fit_test.evidence import NO_EVIDENCE, Evidence
from gray_box_observer.fit_test.fitted_residual import fitted_residual_in_pieces
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.friction_doubts import friction_doubts
from gray_box_observer.fit_test.hidden_rotor import hidden_rotor_doubts
from gray_box_observer.fit_test.input_noise import (
    BY_NEIGHBOURS,
    BY_THE_ONE_BEFORE,
    input_noise_scores,
    voltage_variances,
)
from gray_box_observer.fit_test.input_noise_bias import InputNoiseBias
from gray_box_observer.fit_test.late_speed import late_speed_doubts
from gray_box_observer.fit_test.least_squares import (
    allowances_of_stamps,
    least_squares_of,
    pooled_evidence,
    shown_steps,
    steady_least_squares,
)
from gray_box_observer.fit_test.loss_doubt import loss_shifts, loss_told
from gray_box_observer.fit_test.projection import (
    DISTINCT,
    Projection,
    long_run_covariance,
)
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.fit_test.rounding import rounding_errors
from gray_box_observer.fit_test.smoothed_current import shows_colour, smoothing_doubts
from gray_box_observer.fit_test.speed_difference import shown_by_speed, speed_amounts, without_speed
from gray_box_observer.fit_test.stamp_errors import (
    DELAY,
    INSTANT,
    StampErrors,
    beside_measured_speed,
    stamp_amounts,
    stamp_errors,
    stamp_responses,
)
from gray_box_observer.fit_test.twin_effects import swap_shifts
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median, usual_interval
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box.flow import to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

RESPONSES = 8
"""Responses to effects, or effects, that are dealt with in one piece."""

LIKELY = 10.0
"""Score, by white residuals, from which an effect is worth the robust test."""

COLOURED_ROTOR = 25.0
"""Whiteness from which a rotor's delays and lags are asked for in every shape that they have: its
fit leaves out, as outliers, the samples behind a step that would show them."""

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
        stamps: what comes of a voltage that acts later or earlier than it is stamped.
        intervals: sample intervals in an electrical time constant L/R.
        jitter: standard deviation of the stamps in sample intervals; 0 where the residual is as
            large in steep parts of the current as in flat ones.
        moving_noise_a: standard deviation of white noise in A, where no reading repeats the one
            before.
        open_shifts: shape (question, parameter): by how much the logarithms of the parameters may
            be off, each by what the residual does not show: rounding, which of two twins it is,
            noise of measured voltage and speed, least squares elsewhere, a friction that is not
            quite that of the white box, a measured speed that is not that of the whole motor, one
            that comes late, a lag that is not quite as found, and a rotor that may turn.
        smoothing_shifts: likewise, where the lag of the winding may be a driver's.
        has_noisy_voltage: whether a rotor's current leaves a part of the voltage unanswered.
        has_colour: whether, beside such noise, the residual remembers more than that makes it, or
            a filter of the current may pass for the winding.
        remembers_speed: whether noise of a measured speed gives the residual a memory.
        evidence: what this window and earlier ones tell of stamps, noise and least squares.
        persistence: share of the next sample's autocorrelation that is left a part of a mechanical
            time constant later; 0 without a rotor.
    """

    samples: int
    floor_a: float
    ratio: float
    whiteness: float
    scores: tuple[EffectScore, ...]
    robust_std: Array
    stamps: StampErrors
    intervals: float
    jitter: float
    moving_noise_a: float
    open_shifts: Array
    smoothing_shifts: Array
    persistence: float
    has_noisy_voltage: bool
    evidence: Evidence
    has_colour: bool = False
    remembers_speed: bool = False

    @property
    def best_score(self) -> float:
        """The largest score of an effect; 0 where there is none."""
        return self.scores[0].score if self.scores else 0.0


def _moving_noise(residual: Array, readings: Array) -> float:
    """Noise of the samples whose reading differs from both neighbours; 0 if too few."""
    changes = readings[1:] != readings[:-1]
    is_moving = changes[1:] & changes[:-1]
    return (
        difference_noise(residual, is_moving)
        if np.count_nonzero(is_moving) >= FEWEST_STEEP
        else 0.0
    )


def analyse(
    white_box: WhiteBox,
    p: Array,
    stretch: SampleWindow,
    is_drifting: bool = False,
    earlier: Evidence = NO_EVIDENCE,
    new: int | None = None,
    lag: CurrentLag | None = None,
    measured_rad_s: Array | None = None,
    late_instant: LateInstant | None = None,
    *,
    knows_voltage_noise: bool = False,
) -> ResidualAnalysis:
    """Analyse the free run of one motor, at once; see :func:`analysis_in_pieces`."""
    return completed(
        analysis_in_pieces(
            white_box,
            p,
            stretch,
            is_drifting,
            earlier,
            new,
            lag,
            measured_rad_s,
            late_instant,
            knows_voltage_noise=knows_voltage_noise,
        )
    )


def analysis_in_pieces(
    white_box: WhiteBox,
    p: Array,
    stretch: SampleWindow,
    is_drifting: bool,
    earlier: Evidence,
    new: int | None,
    lag: CurrentLag | None,
    measured_rad_s: Array | None,
    late_instant: LateInstant | None = None,
    *,
    speed_is_guess: bool = False,
    knows_voltage_noise: bool = False,
    may_be_filtered: bool = False,
) -> Pieces[ResidualAnalysis]:
    """Analyse the free run of one motor.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): published values as coordinates.
        stretch: the newest samples, with a motor axis of one.
        is_drifting: whether what heats is known to drift, which is no misfit then.
        earlier: what earlier windows have told.
        new: how many samples came after the last of these; None: all of the stretch.
        lag: of the current sensor, as it was found; None: none was.
        measured_rad_s: shape (k + 1,): readings of the speed, where the stretch holds that of the
            whole motor; else None.
        late_instant: beside a measured speed, what the fit of the whole motor tells of a voltage
            that acts late; None: nothing.
        speed_is_guess: whether a rotor may turn though the speed is taken for Kt i.
        knows_voltage_noise: whether the fit has taken off what noise of the voltage does.
        may_be_filtered: whether the winding, with a delay that is estimated, may be a filter that
            nobody has looked for.
    """
    work = stretch.state.size
    run_residual = yield from fitted_residual_in_pieces(
        white_box,
        p,
        stretch,
        is_drifting=is_drifting,
        knows_voltage_noise=knows_voltage_noise,
        noise_memory=0.0 if lag is None else lag.memory,
    )
    run = run_residual.run
    speed_noise = run_residual.speed_noise
    projection = run_residual.projection
    residual = run_residual.residual_a
    whiteness = run_residual.whiteness
    is_white = run_residual.is_white
    least_a = run_residual.least_a
    theta = to_parameters(p)[0]
    bias = None
    if run.has_input_noise:
        assert isinstance(white_box, MotorWhiteBox)
        bias = InputNoiseBias.of_run(white_box, theta, run, projection, speed_noise)
    late_remainder = None
    if white_box.has_rotor and whiteness > COLOURED_ROTOR:
        late_remainder = projection.without(projection.with_weight(run.residual_a))
    noise_a = max(run_residual.size_a, run_residual.floor_a)
    robust_std = np.full(p.shape[1], np.nan) if is_white else projection.robust_std()
    yield work
    responses_a = stamp_responses(run)
    window = {
        **stamp_amounts(run, projection, responses_a, noise_a, bias, is_white=is_white),
        **voltage_variances(run),
        **(loss_told(run) if white_box.has_rotor else {}),
    }
    if measured_rad_s is None:
        earlier = without_speed(earlier)
    else:
        window |= speed_amounts(white_box, theta, run, projection, measured_rad_s)
    yield 0
    count = residual.size
    new_count = count if new is None else new
    input_evidence = earlier.with_window(window, count, new_count)
    stamps = stamp_errors(projection, responses_a, input_evidence)
    if white_box.speed_measured:
        stamps = beside_measured_speed(stamps, late_instant)
    variances = {name: input_evidence.amount(name) for name in (BY_NEIGHBOURS, BY_THE_ONE_BEFORE)}
    least_squares = {}
    if not white_box.has_rotor:
        least_squares = least_squares_of(white_box, theta, projection, noise_a, robust_std)
    if is_drifting:
        steady_ones = steady_least_squares(least_squares)
        earlier = earlier.without([name for name in least_squares if name not in steady_ones])
        least_squares = steady_ones
    allowances = allowances_of_stamps(white_box, (stamps.delay, stamps.lead))
    evidence = pooled_evidence(earlier, window, least_squares, allowances, count, new_count)
    yield work
    intervals = _intervals(white_box, p, stretch)
    rounding_a = rounding_errors(run, run_residual.step_a, run_residual.size_a)
    rounding_a = projection.with_weight(run.beyond_memory(rounding_a))
    noise_scores = input_noise_scores(white_box, p, run, variances, speed_noise)
    open_shifts = [
        *(projection.shift(error_a)[None] for error_a in rounding_a),
        swap_shifts(white_box, run, theta, noise_a),
        shifts_behind_lag(white_box, run, theta, lag),
        projection.shift_of_scores(noise_scores)[None],
        shown_steps(white_box, theta, evidence),
        shown_by_speed(white_box, evidence),
        loss_shifts(white_box, run, projection, input_evidence),
        *(
            projection.open_shift(doubt, noise_a, is_white=is_white)
            for doubt in (
                *friction_doubts(white_box, run, theta),
                *late_speed_doubts(white_box, run, theta),
                *lag_doubts(run, lag),
                *(
                    hidden_rotor_doubts(white_box, run, theta, projection.white_std(noise_a)[0])
                    if speed_is_guess
                    else ()
                ),
            )
        ),
    ]
    yield work
    has_colour = white_box.has_rotor and (may_be_filtered or shows_colour(run))
    free_projection = projection
    if may_be_filtered:  # the delay, which is estimated, may be a part of what a filter does
        free_projection = projection.beside(np.stack([responses_a[DELAY], responses_a[INSTANT]]))
    smoothing_shifts = [
        free_projection.open_shift(doubt, noise_a, is_white=is_white)
        for doubt in smoothing_doubts(white_box, run, theta, intervals, has_colour=has_colour)
    ]
    yield work
    scores = yield from _scores(
        white_box, run, projection, least_a, late_remainder, rounding_a, bias
    )
    yield 0
    return ResidualAnalysis(
        samples=residual.size,
        floor_a=run_residual.floor_a,
        ratio=run_residual.ratio,
        whiteness=whiteness,
        scores=scores,
        robust_std=robust_std,
        stamps=stamps,
        intervals=intervals,
        jitter=_jitter(run, projection.remainder, run_residual.floor_a),
        moving_noise_a=_moving_noise(run.residual_a, run.stretch.state[0]),
        open_shifts=np.concatenate(open_shifts),
        smoothing_shifts=np.concatenate([np.empty((0, theta.size)), *smoothing_shifts]),
        persistence=_persistence(residual, _mechanical_intervals(white_box, p, stretch)),
        has_noisy_voltage=white_box.has_rotor and variances[BY_NEIGHBOURS].exceeds(SURE),
        evidence=evidence,
        has_colour=has_colour,
        remembers_speed=run.speed_memory is not None and not is_white,
    )


def scene_of(white_box: WhiteBox, run: FreeRun) -> Scene:
    """Return what effects are made of, along a free run."""
    speed = run.stretch.speed_rad_s[0] if white_box.speed_measured else None
    turning_rad_s = run.speed_rad_s if isinstance(run, RotorFreeRun) else speed
    return scene_along(
        white_box, run.stretch.voltage_v[0], interval_means(run.current_a), speed, turning_rad_s
    )


def _jitter(run: FreeRun, remainder: Array, floor_a: float) -> float:
    """Return the scatter of stamps in sample intervals: such errors show where currents rise."""
    slope = np.abs(np.gradient(run.current_a))
    count = max(FEWEST_STEEP, int(STEEPEST * slope.size))
    if 4 * count >= slope.size:  # there is no rest to compare with
        return 0.0
    order = np.argpartition(slope, (slope.size - 4 * count, slope.size - count))
    steep = order[-count:]
    rest = order[: -4 * count]
    size = np.abs(remainder)
    steep_a = MAD_TO_STD * float(median(size[steep]))
    rest_a = max(MAD_TO_STD * float(median(size[rest])), floor_a)
    steepness = math.sqrt(float(np.mean(slope[steep] ** 2)))
    if steep_a <= SCATTERED * rest_a or not steepness > 0.0:  # a run that stands tells no instant
        return 0.0
    return math.sqrt(steep_a**2 - rest_a**2) / steepness


def _intervals(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> float:
    names = [parameter.name for parameter in white_box.parameters]
    interval_s = usual_interval(stretch.interval_s)
    if 'resistance' not in names or interval_s == math.inf:
        return math.inf
    return 1.0 / (float(p[0, names.index('resistance')]) * interval_s)


def _mechanical_intervals(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> float:
    """Return the sample intervals in a mechanical time constant ``R J / (Kb Kt)``."""
    if not white_box.has_rotor:
        return math.nan
    assert isinstance(white_box, MotorWhiteBox)
    values = white_box.values(to_parameters(p)[0])
    stiffness = values['back_emf_constant'] * float(white_box.torque_constant)
    time_s = values['resistance'] * values['inertia'] / stiffness
    return time_s / usual_interval(stretch.interval_s)


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


def _scores(
    white_box: WhiteBox,
    run: FreeRun,
    projection: Projection,
    least_a: float,
    late_remainder: Array | None,
    rounding_a: Array,
    bias: InputNoiseBias | None,
) -> Pieces[tuple[EffectScore, ...]]:
    """Test every effect but those that white residuals rule out at ``least_a`` or more.

    Args:
        white_box: of the motor.
        run: the free run.
        projection: of its residual on the parameters.
        least_a: noise in A that is there at least.
        late_remainder: shape (sample,): what the parameters leave of a residual with its outliers,
            on which delays and lags are tested too, in all their shapes; None: they are not.
        rounding_a: shape (place, sample): what rounding does, with weight.
        bias: what noise of voltage or speed does to products with the residual; None: there is
            none.
    """
    asks_late = late_remainder is not None
    candidates = _candidates(scene_of(white_box, run), asks_late=asks_late)
    yield 0
    voltages = _voltages_of(candidates)
    work = voltages.shape[-1]
    yield work
    parts = []
    for begin in range(0, len(voltages), RESPONSES):
        parts.append(projection.with_weight(run.response(voltages[begin : begin + RESPONSES])))
        yield 0
    response = np.concatenate(parts)
    yield work
    distinct = projection.without(response)
    yield 0
    biases = np.zeros(len(voltages))
    bias_variances = biases
    if bias is not None:
        biases, bias_variances = bias.of_responses(
            response,
            lambda noisy_run: noisy_run.response(
                _voltages_of(_candidates(scene_of(white_box, noisy_run), asks_late=asks_late))
            ),
        )
        yield len(bias.noisy_runs) * work
    gram = distinct @ distinct.T
    own = np.diagonal(gram) > DISTINCT * np.einsum('ij,ij->i', response, response)
    remainders = [projection.remainder] + ([] if late_remainder is None else [late_remainder])
    residual_parts = [(part, distinct @ part - biases, float(part @ part)) for part in remainders]
    best: dict[str, EffectScore] = {}
    first = 0
    for number, (effect, shapes) in enumerate(candidates):
        if number % RESPONSES == 0:
            yield 0
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
            of_rounding = distinct[columns] @ rounding_a.T
            least = 0.5 * noise * own_gram + of_rounding @ of_rounding.T
            least += np.diag(bias_variances[columns])
            yield work
            score = _score(distinct[columns], remainder, amount, own_products, least)
            if effect.name not in best or score > best[effect.name].score:
                shift = -projection.shift(amount @ response[columns])
                amounts = np.zeros(len(shapes))
                amounts[is_own] = amount
                best[effect.name] = EffectScore(effect, score, shift, amounts)
    return tuple(sorted(best.values(), key=lambda entry: -entry.score))


def _candidates(scene: Scene, *, asks_late: bool) -> list[tuple[Effect, Shapes]]:
    """Return all effects with every shape that they may have.

    Args:
        scene: what they are made of.
        asks_late: whether delays and lags are asked for in all their shapes.
    """
    fine = replace(scene, fine=True)
    return [
        (effect, shapes)
        for effect, alternatives in possible_effects(scene)
        for shapes in (
            effect.alternatives(fine) if asks_late and effect.name in LATE else alternatives
        )
    ]


def _voltages_of(candidates: Sequence[tuple[Effect, Shapes]]) -> Array:
    """Return the voltages of all shapes, shape (shape, k)."""
    return np.stack([shape for _, shapes in candidates for shape in shapes])


def _least_squares(matrix: Array, right: Array) -> Array:
    """Solve normal equations, whose columns may depend on each other."""
    if right.size == 1:
        return np.asarray(right / matrix[0], dtype=float)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-10)[0], dtype=float)


def _score(
    distinct: Array, remainder: Array, amount: Array, products: Array, least: Array
) -> float:
    """Return the robust score of one alternative.

    Args:
        distinct: shape (column, sample): what it alone explains.
        remainder: shape (sample,): what is left of the residual.
        amount: shape (column,): its size.
        products: shape (column,): ``distinct`` times ``remainder``.
        least: shape (column, column): covariance that the products have at least.
    """
    rest = remainder - amount @ distinct
    covariance = long_run_covariance((distinct * rest).T) + least
    return float(products @ _least_squares(covariance, products)) / products.size
