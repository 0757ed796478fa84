"""What follows from a residual analysis: the verdict, and how much less may be believed.

Low: a warning, and standard deviations as wide as what was found makes them. High: a misfit, of
which nothing is identified. Thresholds were chosen on one half of the scenarios of
``benchmarks/trust.py`` and are reported on the other (docs/METHOD.md, Residual analysis).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gray_box_observer.context_nodes.recursive.negligible import SIGMAS
from gray_box_observer.context_nodes.rotor.window_learner import REACH_OF_INDUCTANCE
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.fitted_residual import FittedResidual
from gray_box_observer.fit_test.projection import bandwidth
from gray_box_observer.fit_test.residual_analysis import ResidualAnalysis
from gray_box_observer.fit_test.smoothed_current import SMOOTHEST
from gray_box_observer.fit_test.stamp_errors import StampError
from gray_box_observer.white_box.interface import Array

RATIO_MISFIT = 4.5
"""Residual over noise floor from which the white box does not explain the data, whatever the
residual looks like."""

RATIO_WARNING = 1.3
"""The same from which there is a warning: a speed that the fit of the whole motor gives is believed
up to there (:mod:`~gray_box_observer.context_nodes.measured_speed.output_fit`)."""

RATIO_SPREAD = 7.2
"""How far beyond 1 the ratio comes by chance, times the root of the samples. Its standard deviation
is 1.3 over that root: the noise floor is itself an estimate. White noise passes it in less than
one of 20,000 tests of 256 samples. It is skew: of 64 samples one in 10,000 passes, of 32 seven."""

RATIO_DOUBT = 2.5
"""The same where an effect that is left out explains a part of it: right motors reach 1.9, wrong
ones begin at 2.9."""

WHITENESS_ASKS = 3.0
"""Whiteness from which the voltage balance is asked what is left out. White noise passes it 7 times
in a million tests."""

WHITENESS_WARNING = 5.0
"""Whiteness that is a warning by itself: white noise passes it once in 1e12 tests. A speed that the
fit of the whole motor gives is believed up to a whiteness of 4."""

WHITENESS_WIDENS = 10.0
"""Whiteness from which the residual's correlation counts into standard deviations."""

WHITENESS_DOUBT = 25.0
"""Whiteness from which the residual's correlation counts with an effect as a misfit."""

SCORE_DOUBT = 25.0
"""Chi-square of one degree of freedom from which an effect explains a part of a residual that is
not white."""

SCORE_UNMEASURED = 16.0
"""The same, by itself a misfit, where speed is not measured: a hidden rotor takes R along before it
shows otherwise."""

SCORE_MEASURED = 100.0
"""The same where speed is measured: real motors are not so exact that less would be a fault."""

SCORE_IN_NOISE = 16.0
"""The same beside noise of a measured voltage, from which the deviations contain what the effect
does: what 100 would show without noise, hides in it."""

STANDING = 0.5
"""Share of these scores that lets a misfit stand."""

MATERIAL = 0.02
"""Change of a parameter, relative to it, by which an effect that is left out makes it useless."""

NOTICEABLE = 0.003
"""The same below which an effect is none, however clearly it stands out."""

UNIFORM_STD = 1.0 / math.sqrt(12.0)
"""Standard deviation of an unknown fraction of a sample interval."""

FEWEST_SMOOTH = 256
"""Samples from which a voltage that tells no delay counts as smooth: the next move may tell it."""

HALF_INTERVAL = 0.5
"""Delay, in sample intervals, of a voltage that was sampled and not held."""

UNIFORM_MEAN = math.sqrt(3.0)
"""Mean of a delay that is anything from none to its largest, in standard deviations of it."""

SHORTEST = (0.6, 0.8)
"""Sample intervals in a time constant L/R: from the second down the instant of a step counts, below
the first fully."""

SHORT = (0.8, 1.0)
"""The same of a rotor whose speed nobody measures, as far as the inductance goes: a current that is
the mean of its interval, or smoothed, looks like one of a larger inductance. Half an interval
contains it."""

SMOOTHED = (1.0, SMOOTHEST)
"""The same as which a current that a driver averages may look."""

FEWEST_TOLD = 512
"""Samples of a test that tell a delay of the voltage from an inductance."""

UNTOLD_INTERVALS = 0.4
"""Sample intervals of L/R that may be a delay before that: it looks like as much inductance, and of
few moves nothing else shows."""

UNTOLD_DELAY = 0.05
"""Standard deviation of a delay, in sample intervals, from which the data need not show half an
interval. A voltage that was sampled and not held acts so much later than it is taken to act. Steps
tell the instant well; smooth voltages do not."""

FAR_UNTOLD_DELAY = 0.165
"""The same from which few samples are enough where the speed is measured, because the first test
comes early there: moves of the voltage have come, and have not told."""

INSTANT_SAFETY = 3.0
"""Factor on what the data tell of the instant at which a voltage acts within its interval. The
samples behind a move tell it, and a fit leaves out as outliers those of them that a late voltage
moves far: half an interval was told as a quarter."""

SAFETY = 1.25
"""Factor on standard deviations under correlated residuals, whose memory is known but roughly."""

FEW_PERIODS = 2.5
"""Factor on a deviation, less 1, by bandwidth over samples: a covariance that is itself estimated
from few periods of the correlation is often too small (Kiefer and Vogelsang 2005). With it three
deviations hold what three of a known normal distribution do, within 3 % from 64 to 2048 samples."""

OPEN = 0.04
"""Standard deviation of the inductance, relative to it, by what the data leave of such an error.
From here on it counts though they tell none."""

INDUCTANCE = 0
"""Its place among the parameters: the first."""

LARGEST_SHIFT = 1e6
"""Change of a logarithm at which shifts are cut before they are squared. It is so large because a
friction of nearly zero may be many times what it is taken for."""

LARGEST_FACTOR = 1e3


@dataclass(frozen=True, eq=False)
class Judgement:
    """What follows from a residual analysis for one motor.

    Attributes:
        verdict: of the white box.
        factor: shape (parameter,): by which standard deviations grow.
        spread: shape (parameter, parameter): covariance of the parameters' logarithms that comes on
            top.
    """

    verdict: FitVerdict
    factor: Array
    spread: Array

    @cached_property
    def widens(self) -> bool:
        """Whether an estimate knows less than its rule says."""
        return bool((self.factor > 1.0).any() or self.spread.any())

    @property
    def shifts_noticeably(self) -> bool:
        """Whether what comes on top may keep a parameter from being identified."""
        return bool((np.diagonal(self.spread) > NOTICEABLE**2).any())

    @cached_property
    def factors(self) -> Array:
        """By which covariances grow, shape (parameter, parameter)."""
        factors: Array = np.multiply.outer(self.factor, self.factor)
        return factors

    @cached_property
    def _factors_and_spread(self) -> tuple[list[list[float]], list[list[float]]]:
        return self.factors.tolist(), self.spread.tolist()

    @cached_property
    def furthest(self) -> Array:
        """Times its value that a parameter may be, by the spread alone; shape (parameter,)."""
        furthest: Array = 1.0 + SIGMAS * np.sqrt(np.diagonal(self.spread))
        return furthest

    def widened(self, values: list[float], covariance: list[list[float]]) -> list[list[float]]:
        """Return the covariance that it leaves of one motor's, in plain numbers: these are few.

        Args:
            values: of the parameters.
            covariance: shape (parameter, parameter).
        """
        rows = zip(values, covariance, *self._factors_and_spread, strict=True)
        return [
            [
                variance * factor + spread * (value * other)
                for variance, factor, spread, other in zip(*row, values, strict=True)
            ]
            for value, *row in rows
        ]

    def largest_shares(
        self, values: list[float], share: list[float], reach: list[float]
    ) -> list[float]:
        """Return what every parameter of a motor takes of the voltage at most.

        Args:
            values: of the parameters.
            share: of the voltage, that one unit of each takes; 0 where that is not known.
            reach: likewise, what may come on top by the deviation of the estimate.
        """
        factors = self.factor.tolist()
        columns = zip(self.furthest.tolist(), values, share, reach, factors, strict=True)
        return [
            furthest * value * unit + beyond * factor if unit > 0.0 else math.inf
            for furthest, value, unit, beyond, factor in columns
        ]


def judge(
    analysis: ResidualAnalysis,
    relative_std: Array,
    samples: int,
    *,
    speed_measured: bool,
    stamps_exact: bool,
    speed_is_hidden: bool = False,
    is_doubted: bool = False,
    is_drifting: bool = False,
    delay_std: float = 0.0,
) -> Judgement:
    """Judge one motor.

    Args:
        analysis: of its residual.
        relative_std: shape (parameter,): what its estimate says now.
        samples: how many its estimate rests on.
        speed_measured: whether its speed is a signal, or a state of its own.
        stamps_exact: whether the voltage acts at the very instant of its stamp.
        speed_is_hidden: whether it is that of a rotor which nobody measures.
        is_doubted: whether it did not fit so far: less is enough then to go on doubting.
        is_drifting: whether it is followed as a winding that heats, which leaves a white residual.
        delay_std: standard deviation of an estimated delay of the voltage, in sample intervals.
    """
    limit = SCORE_MEASURED if speed_measured else SCORE_UNMEASURED
    is_coloured = analysis.whiteness > WHITENESS_DOUBT
    if is_coloured and not speed_measured:
        limit = SCORE_DOUBT
    if is_doubted:
        limit *= STANDING
    spread = np.zeros((relative_std.size, relative_std.size))
    strong = [
        score
        for score in analysis.scores
        if score.score > limit and np.max(np.abs(score.shift)) > NOTICEABLE
    ]
    material = any(np.max(np.abs(score.shift)) > MATERIAL for score in strong)
    doubtful = analysis.best_score > SCORE_DOUBT and (is_coloured or analysis.ratio > RATIO_DOUBT)
    doubtful |= is_drifting and is_coloured
    if analysis.ratio > RATIO_MISFIT or doubtful or (strong and (material or not speed_measured)):
        verdict = FitVerdict.MISFIT
    elif strong or _is_large(analysis) or analysis.whiteness > WHITENESS_WARNING:
        verdict = FitVerdict.WARNING
    else:
        verdict = FitVerdict.OK
    if analysis.has_noisy_voltage and not strong:
        strong = [score for score in analysis.scores if score.score > SCORE_IN_NOISE]
    for score in strong[:1]:
        shift = np.clip(score.shift, -LARGEST_SHIFT, LARGEST_SHIFT)
        spread += np.outer(shift, shift)
    factor = np.ones(relative_std.size)
    if analysis.whiteness > WHITENESS_WIDENS or analysis.remembers_speed:
        few = 1.0 + FEW_PERIODS * bandwidth(analysis.samples) / analysis.samples
        fewer = math.sqrt(analysis.samples / max(samples, analysis.samples))
        robust = SAFETY * few * fewer * analysis.robust_std
        factor = np.clip(robust / np.maximum(relative_std, 1e-12), 1.0, LARGEST_FACTOR)
    late = UNIFORM_MEAN * analysis.jitter
    unknown_shifts = [(1.0, row) for row in analysis.open_shifts]
    if not stamps_exact:
        is_smooth = _is_delay_untold(analysis, speed_measured=speed_measured)
        late += UNIFORM_STD if is_smooth else _untold_std(analysis)
        unknown_shifts += _driver_doubts(analysis, speed_is_hidden=speed_is_hidden)
    unknown_shifts += [(amount, analysis.stamps.delay.shift) for amount in (late, delay_std)]
    for amount, unknown_shift in unknown_shifts:
        shift = _within_reach(amount * np.clip(unknown_shift, -LARGEST_SHIFT, LARGEST_SHIFT))
        spread += np.outer(shift, shift)
    numbers = (analysis.ratio, analysis.whiteness, *factor, *spread.ravel())
    if not np.isfinite(numbers).all():  # what is no number says nothing, and nothing is believed
        return Judgement(FitVerdict.MISFIT, np.ones_like(factor), np.zeros_like(spread))
    return Judgement(verdict, factor, spread)


def _within_reach(shift: Array) -> Array:
    """Return a shift in which the inductance moves no further than what it does can go.

    That goes with itself, and of a winding far faster than the samples it is next to nothing.
    """
    size = abs(float(shift[INDUCTANCE]))
    return shift if not size > REACH_OF_INDUCTANCE else shift * (REACH_OF_INDUCTANCE / size)


def is_dubious(residual: FittedResidual | ResidualAnalysis) -> bool:
    """Tell whether to ask what is left out: a residual is larger or less white than most."""
    return not (residual.ratio <= RATIO_WARNING and residual.whiteness <= WHITENESS_ASKS)


def _is_large(analysis: ResidualAnalysis) -> bool:
    """Tell whether a residual is larger than the noise, and not by chance."""
    by_chance = 1.0 + RATIO_SPREAD / math.sqrt(analysis.samples)
    return analysis.ratio > max(RATIO_WARNING, by_chance)


def leaves_little(analysis: ResidualAnalysis) -> bool:
    """Tell whether a residual that warns is slight, and nothing explains it.

    Beside a measured speed noise of the readings, and motion between them, leave as much.
    """
    is_slight = analysis.ratio <= RATIO_DOUBT and analysis.whiteness <= WHITENESS_DOUBT
    return is_slight and analysis.best_score <= SCORE_DOUBT


def shows_change(analysis: ResidualAnalysis) -> bool:
    """Tell whether a motor that fitted so far has become another one by its newest samples."""
    return analysis.ratio > RATIO_DOUBT and analysis.whiteness > WHITENESS_DOUBT


def _share_below(limits: tuple[float, float], intervals: float) -> float:
    """Return how far a number of sample intervals is below the second of two limits, 0 to 1."""
    fully, from_here = limits
    return float(np.clip((from_here - intervals) / (from_here - fully), 0.0, 1.0))


def _untold_std(analysis: ResidualAnalysis) -> float:
    """Return the deviation of a delay, in sample intervals, where the instant of a step counts.

    It does where L/R is short. A residual that is not white tells nothing of the instant.
    """
    is_white = analysis.whiteness <= WHITENESS_ASKS
    return 0.0 if is_white else _share_below(SHORTEST, analysis.intervals) * UNIFORM_STD


def _driver_doubts(
    analysis: ResidualAnalysis, *, speed_is_hidden: bool
) -> list[tuple[float, Array]]:
    """Return what a driver may do: amounts, each with how one of it moves the parameters.

    Args:
        analysis: of the residual.
        speed_is_hidden: whether the speed is that of a rotor which nobody measures.
    """
    stamps = analysis.stamps
    is_mature = analysis.evidence.is_mature
    amounts = [
        (_doubted_amount(error, is_mature=is_mature), error.shift)
        for error in (stamps.delay, stamps.lead)
    ]
    smoothed_share = 1.0 if analysis.has_colour else _share_below(SMOOTHED, analysis.intervals)
    amounts += [(smoothed_share, row) for row in analysis.smoothing_shifts]
    amounts.append(_inductance_doubt(analysis, speed_is_hidden=speed_is_hidden))
    short_share = _share_below(SHORTEST, analysis.intervals)
    likely_std = (1.0 if stamps.instant.is_shown else short_share) * UNIFORM_STD
    if likely_std > 0.0:
        size = INSTANT_SAFETY * stamps.instant.amount.likely(likely_std).size
        amounts.append((min(size, likely_std), stamps.instant.shift))
    return amounts


def _inductance_doubt(analysis: ResidualAnalysis, *, speed_is_hidden: bool) -> tuple[float, Array]:
    """Return how uncertain the instant of a move is, and how one interval of it moves L alone.

    That is at least what the delay takes of L/R: of a window in which the voltage has hardly moved,
    the shift is too small.
    """
    shift = abs(float(analysis.stamps.delay.shift[INDUCTANCE]))
    limits = SHORT
    intervals = analysis.intervals
    if not speed_is_hidden:
        limits = SHORTEST
        shift = max(shift, 1.0 / max(intervals, UNTOLD_INTERVALS))
        intervals -= UNTOLD_INTERVALS if analysis.samples < FEWEST_TOLD else 0.0
    of_inductance = np.zeros_like(analysis.stamps.delay.shift)
    of_inductance[INDUCTANCE] = shift
    return _share_below(limits, intervals) * UNIFORM_STD, of_inductance


def _doubted_amount(error: StampError, *, is_mature: bool) -> float:
    """Return the error of a driver's stamps that may be there, in sample intervals.

    At first it counts where the data tell one, or where they do not and the inductance would be
    useless.

    Args:
        error: as the data have it.
        is_mature: whether the tests rest on more than one window: then it always counts.
    """
    amount = error.likely_amount
    is_open = amount.std * abs(float(error.shift[INDUCTANCE])) > OPEN
    return amount.size if error.is_shown or is_open or is_mature else 0.0


def _is_delay_untold(analysis: ResidualAnalysis, *, speed_measured: bool) -> bool:
    """Tell whether half an interval of delay may pass unseen, and would falsify the inductance.

    A voltage that moves smoothly and acts d later looks like one that acts at once on L - R d.
    """
    moves_inductance = MATERIAL * analysis.intervals < HALF_INTERVAL
    is_smooth = (
        analysis.samples >= FEWEST_SMOOTH and analysis.stamps.delay.amount.std > UNTOLD_DELAY
    )
    is_open = speed_measured and FAR_UNTOLD_DELAY < analysis.stamps.delay.amount.std < math.inf
    return (is_smooth or is_open) and moves_inductance


def with_shifts(judgement: Judgement, shifts: Array) -> Judgement:
    """Return a judgement that leaves parameters open together.

    Args:
        judgement: as the residual has it.
        shifts: shape (question, parameter): standard deviations that come on top, relative to the
            parameters, with their signs.
    """
    if shifts.size == 0:
        return judgement
    rows = np.clip(shifts, -LARGEST_SHIFT, LARGEST_SHIFT)
    return replace(judgement, spread=judgement.spread + rows.T @ rows)


def with_shift(judgement: Judgement, place: int, share: float) -> Judgement:
    """Return a judgement that leaves one parameter open by a share of it.

    Args:
        judgement: as the residual has it.
        place: of the parameter.
        share: standard deviation that comes on top, relative to the parameter.
    """
    if share == 0.0:
        return judgement
    spread = judgement.spread.copy()
    spread[place, place] += min(share, LARGEST_SHIFT) ** 2
    return replace(judgement, spread=spread)
