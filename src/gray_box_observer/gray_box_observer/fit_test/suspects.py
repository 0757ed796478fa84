"""What is likely left out where the white box does not explain the data.

The published values of a misfit may be absurd, and a free run from them tells little. The voltage
balance in weak form is linear whatever they are: multiplied by a triangle over a few samples and
integrated, it needs no derivative of the current. Every effect is tried beside the parameters by
least squares, and the likeliest comes first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.effects import (
    LATE,
    Effect,
    Shapes,
    interval_means,
    possible_effects,
    scene_along,
)
from gray_box_observer.fit_test.residual_analysis import EffectScore
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import decaying_regressors, integrated_regressors
from gray_box_observer.white_box.interface import Array

WINDOW = 8
"""Samples over which the triangle rises, and as many over which it falls."""

STRIDE = 3
"""Samples between two rows; neighbours overlap, and so many count for one."""

FEWEST_ROWS = 24

CLEAR = 5.0
"""Log-likelihood that an effect must bring to be named."""

SIGN_TOLD = 5.0
"""Standard deviations of the noise beyond which a reading tells the sign of the current."""

ALIKE = ('current_offset', 'lost_voltage', 'dead_zone')
"""What cannot be told apart while current and voltage keep their signs."""

TIED = 2.0
"""Log-likelihood by which explanations must differ to be told apart."""


@dataclass(frozen=True)
class Explanation:
    """One effect beside the parameters, fitted to the voltage balance.

    Attributes:
        effect: which.
        evidence: log-likelihood that it brings.
        amount: how much of its first shape there is, in the unit of the shape's coefficient.
        total: how much of all its shapes together.
        resistance: R in ohm beside it, or as it is given; NaN where it is not.
        share: ``total`` over the root mean square of the voltage.
    """

    effect: Effect
    evidence: float
    amount: float
    total: float
    resistance: float
    share: float = 0.0

    @property
    def is_credible(self) -> bool:
        """Whether such an effect can be as large as that, beside this resistance."""
        lowest, highest = self.effect.credible
        can_be = lowest <= self.total <= highest and self.share <= self.effect.largest_share
        return can_be and (self.resistance > 0.0 or self.effect.hides_resistance)

    @property
    def rank(self) -> tuple[bool, float]:
        """Explanations in the order of their evidence, those that cannot be before all others."""
        return self.is_credible, self.evidence

    def suspect(self, motor: str, torque_constant: float, stated_kb: float = 0.0) -> Suspect:
        """Name it, with a remedy that can be pasted.

        Args:
            motor: its name.
            torque_constant: Kt in N m/A.
            stated_kb: Kb in V s/rad, as it is known beforehand; 0: it is not.
        """
        remedy = self.effect.remedy
        if self.amount < 0.0 and self.effect.negative_remedy:
            remedy = self.effect.negative_remedy
        remedy = remedy.format(
            motor=motor,
            amount=self.amount,
            offset_nm=torque_constant * self.amount / (self.resistance or math.nan),
            kb=stated_kb + self.amount,
        )
        return Suspect(self.effect.name, self.evidence, remedy)


TOGETHER = 16
"""Alternatives that are fitted in one piece of work, each in about 0.05 ms."""


def explanations(white_box: MotorWhiteBox, stretch: SampleWindow) -> dict[str, Explanation]:
    """Explain at once; see :func:`explanations_in_pieces`."""
    return completed(explanations_in_pieces(white_box, stretch))


def explanations_in_pieces(
    white_box: MotorWhiteBox,
    stretch: SampleWindow,
    intervals: float = math.inf,
    noise_a: float = 0.0,
) -> Pieces[dict[str, Explanation]]:
    """Fit every effect beside the parameters; return its best alternative by its name.

    Args:
        white_box: of one motor.
        stretch: its samples, with a motor axis of one.
        intervals: sample intervals in a time constant L/R; infinite where that is not known.
        noise_a: of the readings of the current.
    """
    rows, names, candidates = yield from _balance_in_pieces(white_box, stretch, intervals, noise_a)
    if rows.shape[1] < FEWEST_ROWS:
        return {}
    yield rows.shape[1]
    count = rows.shape[1]
    if count > rows.shape[0]:  # sums of squares are all that is asked of them
        rows = np.asarray(np.linalg.qr(rows.T, mode='r')).T
    yield count
    regressors = list(rows[: len(names)])
    target = rows[len(names)]
    base_rest, _ = _fit(regressors, target)
    if not math.isfinite(base_rest):
        return {}
    voltage_v = root_mean_square(stretch.voltage_v)
    given_ohm = float(white_box.known.get('resistance', math.nan))
    best: dict[str, Explanation] = {}
    first = len(names) + 1
    for place, (effect, shapes) in enumerate(candidates):
        if place % TOGETHER == 0:
            yield TOGETHER * rows.shape[1]
        further = list(rows[first : first + len(shapes)])
        first += len(shapes)
        rest, weights = _fit([*regressors, *further], target)
        if not math.isfinite(rest):
            continue
        gain = 0.5 * count / STRIDE * math.log(base_rest / rest)
        evidence = gain - 0.5 * len(shapes) * math.log(count)
        resistance = (
            float(weights[names.index('resistance')]) if 'resistance' in names else given_ohm
        )
        own = weights[len(names) :]
        total = float(own.sum())
        explanation = Explanation(
            effect, evidence, float(own[0]), total, resistance, abs(total) / voltage_v
        )
        if effect.name not in best or explanation.rank > best[effect.name].rank:
            best[effect.name] = explanation
    return best


def root_mean_square(voltage_v: Array) -> float:
    """Return the root mean square of a voltage, which is never nothing."""
    return float(np.sqrt(np.mean(voltage_v**2))) + 1e-300


def scored_explanations(
    white_box: MotorWhiteBox, theta: Array, scores: Iterable[EffectScore], voltage_v: float
) -> dict[str, Explanation]:
    """Return what score tests of a free run say of every effect, by its name.

    The voltage balance of a rotor has a speed that nobody measures: only the free run tells.

    Args:
        white_box: of one motor.
        theta: shape (parameter,): values of the free run.
        scores: of its effects.
        voltage_v: root mean square of the voltage.
    """
    names = [parameter.name for parameter in white_box.parameters]
    explanations_by_name = {}
    for score in scores:
        resistance = float(white_box.known.get('resistance', math.nan))
        if 'resistance' in names:
            place = names.index('resistance')
            resistance = float(theta[place]) * math.exp(min(float(score.shift[place]), 1.0))
        highest = score.effect.credible[1]
        total = min(float(score.amounts.sum()), highest)  # one step from wrong values goes too far
        explanations_by_name[score.effect.name] = Explanation(
            score.effect,
            0.5 * score.score,
            float(score.amounts[0]),
            total,
            resistance,
            abs(total) / voltage_v,
        )
    return explanations_by_name


def select_explanations(
    candidates: Iterable[Explanation], scores: Mapping[str, float]
) -> list[Explanation]:
    """Return explanations that bring enough, the best first.

    An offset and a lost voltage are the same while the current keeps its sign; one that takes
    voltage is more often a loss, one that gives it an offset.

    Args:
        candidates: what might be.
        scores: evidence of the free run, by the effect's name.
    """
    clear = (one for one in candidates if one.evidence > CLEAR and one.is_credible)
    best_first = sorted(clear, key=lambda one: -one.evidence)
    if best_first and {one.effect.name for one in best_first[:2]} == set(LATE):
        best_first[:2] = sorted(best_first[:2], key=lambda one: -scores.get(one.effect.name, 0.0))
    ties = [
        one
        for one in best_first
        if one.effect.name in ALIKE and one.evidence > best_first[0].evidence - TIED
    ]
    if best_first and len(ties) > 1 and best_first[0] in ties:
        effect_name = 'lost_voltage' if ties[0].amount > 0.0 else 'current_offset'
        ties.sort(key=lambda one: one.effect.name != effect_name)
        best_first = ties + [one for one in best_first if one not in ties]
    return best_first


def with_delay(suspects: Sequence[Suspect], delay: Suspect) -> list[Suspect]:
    """Return suspects with a delay that was found by a search, the likelier of it and a lag first.

    A lag of the current looks like a delay. The search compares likelihoods of every sample, the
    voltage balance those of one in STRIDE.

    Args:
        suspects: the likeliest first; their delay, if any, is that of the balance.
        delay: as the search has found it.
    """
    named_suspects = [delay if one.effect == 'delay' else one for one in suspects]
    if delay not in named_suspects:
        named_suspects.append(delay)
    lag = next((one for one in named_suspects if one.effect == 'current_lag'), None)
    if lag is not None:
        pair = [delay, lag] if delay.evidence > STRIDE * lag.evidence else [lag, delay]
        places = sorted((named_suspects.index(delay), named_suspects.index(lag)))
        for place, one in zip(places, pair, strict=True):
            named_suspects[place] = one
    return named_suspects


def _balance_in_pieces(
    white_box: MotorWhiteBox, stretch: SampleWindow, intervals: float, noise_a: float
) -> Pieces[tuple[Array, list[str], list[tuple[Effect, Shapes]]]]:
    """Weak voltage balance: rows of parameters, of voltage, and of every effect's shapes."""
    current_a = stretch.state[0]
    interval_s = stretch.interval_s[0]
    whole = ~stretch.restart[0]
    if white_box.holds_current:  # readings do not tell its sign where the brushes hold it
        is_told = np.abs(current_a) > SIGN_TOLD * noise_a
        whole &= is_told[:-1] & is_told[1:]
    readings = stretch.voltage_v, stretch.state, stretch.speed_rad_s, stretch.interval_s
    if intervals < math.inf:
        columns, target = decaying_regressors(white_box, *readings, intervals)
    else:
        columns, target = integrated_regressors(white_box, *readings)
    speed = stretch.speed_rad_s[0] if white_box.speed_measured else None
    mean_a = interval_means(current_a)
    scene = scene_along(white_box, stretch.voltage_v[0], mean_a, speed, speed, fine=True)
    signals = [*columns[0].T, target[0]]
    rows = [_windowed(np.where(whole, np.stack(signals), 0.0), whole)]
    candidates = []
    for effect, alternatives in possible_effects(scene):
        yield whole.size
        for shapes in alternatives:
            candidates.append((effect, shapes))
            signals = [-shape * interval_s for shape in shapes]
            rows.append(_windowed(np.where(whole, np.stack(signals), 0.0), whole))
    yield whole.size
    return np.concatenate(rows), [one.name for one in white_box.parameters], candidates


def _windowed(signals: Array, whole: Array) -> Array:
    """Integrals over triangles of samples, shape (signal, row); none spans a restart."""
    count = signals.shape[1]
    triangle = np.concatenate([np.arange(1, WINDOW + 1), np.arange(WINDOW - 1, 0, -1)]) / WINDOW
    if count < triangle.size:
        return np.empty((signals.shape[0], 0))
    sound = sliding_window_view(whole, triangle.size)[::STRIDE].all(axis=1)
    rows: Array = sliding_window_view(signals, triangle.size, axis=1)[:, ::STRIDE] @ triangle
    return rows if sound.all() else rows[:, sound]


def _fit(regressors: list[Array], target: Array) -> tuple[float, Array]:
    """Fit a target by least squares; return the sum of squares that is left, and the weights.

    Where the numbers are too large for that, the sum is not finite.
    """
    columns = np.column_stack(regressors)
    scale = np.linalg.norm(columns, axis=0) + 1e-300
    with np.errstate(over='ignore', invalid='ignore'):  # currents next to nothing
        weights = np.linalg.lstsq(columns / scale, target, rcond=1e-9)[0] / scale
        rest = target - columns @ weights
        return float(rest @ rest) + 1e-24 * float(target @ target) + 1e-300, weights
