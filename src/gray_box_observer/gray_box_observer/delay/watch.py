"""Watches whether voltage acts on torque later than stamped, while a motor is observed.

The work is spread over samples, one small piece each, and is decided by their number alone, never
by a clock: live and replayed samples lead to the same delay at the same sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.context_nodes.rotor.window_learner import FEWEST_MOVES
from gray_box_observer.delay.coarse import Profile, profile
from gray_box_observer.delay.fine import FineSearch, evidence
from gray_box_observer.delay.hidden_rotor_delay import NEWEST, HiddenRotorSearch
from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import LARGEST, entry, number, number_or_none, whole
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.raw_history import TORQUES, RawSignals, SignalHistory
from gray_box_observer.samples.sample import nanoseconds, seconds
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

FIRST = 128
"""Samples before the question is first asked; then whenever a quarter has come on top, at last
every LONGEST_WAIT."""

FIRST_OF_ROTOR, FIRST_OF_MISFIT = 256, 1024
"""Samples from which the physics of a hidden rotor is asked: for a delay that is to be estimated,
and of another misfit, for most are soon explained without."""

LONGEST_WAIT = 1024

LONGEST_ROTOR_WAIT = 8192
"""Samples between two searches by the physics of a hidden rotor that bring nothing new, at most,
while its delay is not settled."""

LONGEST_DELAY_S = 0.5
LONGEST_LEAD_S = 0.1
"""Voltage is looked for so far after and before its stamp, and no further than a quarter and an
eighth of the data."""

FURTHEST_S = 10.0
"""No delay is larger, be it declared or found, in either direction."""

EVIDENCE = 15.0
"""Log-likelihood that a delay must bring; by chance one time in 2e7 (chi-square of 30 with one
degree of freedom)."""

COARSE_EVIDENCE = 7.5
"""What the coarse search must bring for the fine one, which brings half as much again or more, to
be worth its time."""

WORTH = 0.1
"""Sample intervals that a delay must differ from the one in force: less harms nobody."""

COARSE_WORTH = 0.05
STDS = 3.0

LateInstantSource = Callable[[], LateInstant | None]
"""Gives what the newest fit of current and speed tells of a voltage that acts late."""


class DelayVerdict(str, Enum):
    """What the data say of the delay."""

    UNKNOWN = 'not told by the data yet'
    CONFIRMED = 'confirmed by the data'
    SUSPECTED = 'suspected'
    UNDECLARED = 'undeclared'
    ESTIMATED = 'estimated'


@dataclass(frozen=True)
class DelayEstimate:
    """What is known of the delay of one motor: voltage acts that much later than it is stamped.

    Attributes:
        applied_s: the delay in force.
        is_estimated: whether it is estimated; else it was declared.
        value_s, std_s: what the data say; NaN while they do not.
        verdict: how far the two agree.
        applied_std_s: standard deviation of a delay that was found and applied; 0 of another one.
    """

    applied_s: float
    is_estimated: bool
    value_s: float = math.nan
    std_s: float = math.nan
    verdict: DelayVerdict = DelayVerdict.UNKNOWN
    applied_std_s: float = 0.0

    @property
    def words(self) -> str:
        """Which of the two is which, in one line: what the data say, and what is taken off."""
        result = 'the data do not tell'
        if math.isfinite(self.value_s):
            result = f'found in the data: {self.value_s:.6g} +- {self.std_s:.2g} s'
        origin = 'estimated' if self.is_estimated else 'declared'
        return f'{result}; applied: {self.applied_s:.6g} s, as {origin}'

    def complaint(self, motor: str) -> str | None:
        """Say what is wrong and what to do about it, in one line; None where nothing is."""
        if self.verdict is not DelayVerdict.UNDECLARED:
            return None
        who = (
            'voltage seems to lead torque' if self.value_s > 0.0 else 'torque seems to lead voltage'
        )
        instead = f', not by {1e3 * self.applied_s:.4g} ms' if self.applied_s else ''
        return (
            f'{who} by {1e3 * abs(self.value_s):.3g} ms{instead}: '
            f'set {motor}.delay to {self.value_s:.3g} or to estimate'
        )


@dataclass(frozen=True)
class _Found:
    """Outcome of one search; a NaN where it did not come that far.

    Attributes:
        delay_s: where the data are explained best.
        std_s: standard deviation of that.
        evidence: log-likelihood that it brings over the delay in force; 0 where it agrees with that
            one.
        interval_s: usual time between torques.
        inside: whether it lies within what was searched.
    """

    delay_s: float
    std_s: float
    evidence: float
    interval_s: float
    inside: bool

    def agrees_with(self, delay_s: float) -> bool:
        """Tell whether another delay is as good, as far as the data and any use of it tell."""
        return abs(self.delay_s - delay_s) < max(STDS * self.std_s, WORTH * self.interval_s)


@dataclass(slots=True)
class _Progress:
    """How far the question has come in one signal history.

    Attributes:
        restarts: number of the history.
        count: samples of it.
        ask_at: count from which it is asked next.
        refine_at: count before which no fine search follows one in vain.
        ask_rotor_at: count before which the physics of a hidden rotor is not asked again.
        is_put_off: whether the last piece of work has waited for a result to go out.
        work: the search under way.
        before: outcome of the search before, where the next one has to agree with it.
    """

    restarts: int
    count: int = 0
    ask_at: int = FIRST
    refine_at: int = 0
    ask_rotor_at: int = 0
    is_put_off: bool = False
    work: Generator[None, None, _Found | None] | None = None
    before: _Found | None = None


@dataclass(frozen=True, eq=False)
class HiddenRotor:
    """Physics of a motor whose rotor turns unseen, or may.

    Attributes:
        white_box: of the whole motor.
        initial: shape (parameter,): first guess of its parameters.
    """

    white_box: MotorWhiteBox
    initial: Array


class DelayWatch:
    """Asks for the delay of one motor.

    A motor with a hidden rotor is asked by the physics of the whole of it: where its delay is to be
    estimated, or where it is a misfit. So is one that may have such a rotor, while it is a misfit.

    Args:
        white_box: the physics.
        initial: shape (1, parameter): first guess of the parameters.
        applied_s: the delay in force.
        is_estimated: whether a delay that is found shall be applied.
        gap_s: a longer silence of torque starts the signal history anew.
        hidden_rotor: that the motor has or may have; None: it can have none.

    Attributes:
        estimate: what is known.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        initial: Array,
        applied_s: float,
        *,
        is_estimated: bool,
        gap_s: float,
        hidden_rotor: HiddenRotor | None = None,
    ) -> None:
        self._hidden_rotor = hidden_rotor
        self._is_misfit = False
        self._white_box = white_box
        self._initial = to_coordinates(np.asarray(initial, dtype=float))
        self._gap_s = gap_s
        self.estimate = DelayEstimate(applied_s, is_estimated)
        self._interval_s = math.nan  # of the signals that were searched last
        self._dropped_count = 0  # samples that were learnt and are in no history any more
        self._progress = _Progress(0)

    def update(
        self,
        history: SignalHistory,
        stamp_ns: int,
        samples: int = 1,
        *,
        is_awaited: bool = False,
        late_instant: LateInstantSource | None = None,
        is_misfit: bool = False,
    ) -> float | None:
        """Go on by one piece of work, where there is any.

        The search takes a measured speed for exact. Its noise makes the inductance large, and a
        delay that goes with it. Where a fit of current and speed explains both, what that does not
        show was not found.

        Args:
            history: raw measurements that led to the samples so far.
            stamp_ns: stamp of the newest sample.
            samples: how many have come since it was last called.
            is_awaited: whether somebody waits for what the sample has led to; the work then waits
                for the next one.
            late_instant: where the speed is measured.
            is_misfit: whether the physics does not explain the data.

        Returns:
            The delay in s that shall be applied from now on; None where all stays as it is.
        """
        if history.restarts != self._progress.restarts:  # what was found stays
            self._dropped_count += self._progress.count
            self._progress = _Progress(history.restarts)
        estimate = self.estimate
        is_undeclared = estimate.verdict is DelayVerdict.UNDECLARED
        if is_undeclared and not self._is_supported(estimate.value_s, late_instant):
            self._progress.before = None
            self.estimate = DelayEstimate(estimate.applied_s, estimate.is_estimated)
        self._is_misfit = is_misfit
        progress = self._progress
        progress.count += samples
        is_asked = is_misfit or estimate.is_estimated or not self._white_box.has_rotor
        if progress.work is None and not is_asked:
            return None
        progress.is_put_off = is_awaited and not progress.is_put_off
        if progress.is_put_off:
            return None
        if progress.work is None:
            if progress.count < progress.ask_at:
                return None
            progress.ask_at = progress.count + min(progress.count // 4, LONGEST_WAIT)
            progress.work = self._search(history, stamp_ns)
        try:
            with np.errstate(all='ignore'):  # absurd samples; results are checked
                next(progress.work)
        except StopIteration as end:
            progress.work = None
            return None if end.value is None else self._judge_possible(end.value, late_instant)
        return None

    def _judge_possible(
        self, result: _Found, late_instant: LateInstantSource | None
    ) -> float | None:
        """Judge an outcome, as far as current and speed together show it."""
        self._interval_s = result.interval_s
        is_news = math.isfinite(result.std_s) and not result.agrees_with(self.estimate.applied_s)
        if not is_news or self._is_supported(result.delay_s, late_instant):
            return self._judge(result)
        self._progress.before = None
        if self.estimate.verdict is DelayVerdict.SUSPECTED:
            self.estimate = replace(self.estimate, verdict=DelayVerdict.UNKNOWN)
        return None

    def _is_supported(self, delay_s: float, late_instant: LateInstantSource | None) -> bool:
        """Tell whether current and speed together show a delay, or are not asked."""
        instant = None if late_instant is None else late_instant()
        away = (delay_s - self.estimate.applied_s) / self._interval_s
        return instant is None or not math.isfinite(away) or instant.supports(away)

    @property
    def searching(self) -> bool:
        """Whether a search is under way."""
        return self._progress.work is not None

    def _search(
        self, history: SignalHistory, stamp_ns: int
    ) -> Generator[None, None, _Found | None]:
        """Search once, piece by piece; return the outcome, None where the data are silent."""
        applied_s = self.estimate.applied_s
        signals = history.signals(stamp_ns, round(applied_s * 1e9))
        cut = None if signals is None else self._cut(signals, applied_s)
        yield
        if cut is None:
            return None
        signals, reach_s = cut
        steps = np.diff(signals.time_s)
        restart = steps > self._gap_s
        if np.all(restart):
            return None
        interval_s = float(median(steps[~restart]))
        result = None
        if not self._white_box.has_rotor:
            result = yield from self._search_balance(signals, restart, interval_s, reach_s)
        if self._hidden_rotor is None or (result is not None and self._is_clear(result)):
            return result
        if not (self._white_box.has_rotor or self._is_misfit):
            return result
        other = yield from self._search_rotor(signals, restart, interval_s, reach_s)
        return result if other is None else other

    def _is_clear(self, result: _Found) -> bool:
        """Tell whether an outcome is sure: the delay in force, or another one."""
        return result.inside and (
            result.agrees_with(self.estimate.applied_s) or result.evidence >= EVIDENCE
        )

    def _search_balance(
        self,
        signals: RawSignals,
        restart: NDArray[np.bool_],
        interval_s: float,
        reach_s: tuple[float, float],
    ) -> Generator[None, None, _Found | None]:
        """Search by the balance of the voltage, whose speed is measured or w = Kt i."""
        applied_s = self.estimate.applied_s
        coarse = yield from profile(self._white_box, signals, restart, interval_s, reach_s)
        yield
        if coarse is None:
            return None
        start_s = coarse.best()
        if (
            coarse.evidence(start_s + interval_s) < COARSE_EVIDENCE
        ):  # flat: the voltage did not move
            return None
        if not self._worth_refining(coarse, start_s, interval_s):
            return _Found(applied_s, math.nan, 0.0, interval_s, True)
        if self._progress.count < self._progress.refine_at and not self.estimate.is_estimated:
            return None
        self._progress.refine_at = 2 * self._progress.count  # unless it brings news
        fine = FineSearch(self._white_box, signals, restart, interval_s, self._initial, reach_s)
        best = yield from fine.fit(start_s, free=True)
        if not math.isfinite(best.delay_s + best.std_s):
            return None
        inside = _is_inside(best.delay_s, interval_s, reach_s)
        result = _Found(best.delay_s, best.std_s, 0.0, interval_s, inside)
        if result.agrees_with(applied_s):  # and needs no evidence against it
            return result
        held_fit = yield from fine.fit(applied_s, free=False)
        likelihood_gain = evidence(best, held_fit)
        return replace(result, evidence=likelihood_gain) if math.isfinite(likelihood_gain) else None

    def _search_rotor(
        self,
        signals: RawSignals,
        restart: NDArray[np.bool_],
        interval_s: float,
        reach_s: tuple[float, float],
    ) -> Generator[None, None, _Found | None]:
        """Search by the physics of the whole motor, which costs most: ever more rarely in vain."""
        assert self._hidden_rotor is not None
        first = FIRST_OF_ROTOR if self.estimate.is_estimated else FIRST_OF_MISFIT
        progress = self._progress
        if progress.count < max(progress.ask_rotor_at, first) or not _moves(signals):
            return None
        is_settled = self.estimate.verdict is DelayVerdict.ESTIMATED and not self._is_misfit
        longest = progress.count if is_settled else LONGEST_ROTOR_WAIT
        progress.ask_rotor_at = progress.count + min(progress.count, longest)
        rotor = self._hidden_rotor
        search = HiddenRotorSearch(
            rotor.white_box, rotor.initial, signals, restart, interval_s, reach_s
        )
        result = yield from search.run(self.estimate.applied_s)
        if result is None or not math.isfinite(result.delay_s + result.std_s):
            return None
        inside = _is_inside(result.delay_s, interval_s, reach_s)
        return _Found(result.delay_s, result.std_s, result.evidence, interval_s, inside)

    def _worth_refining(self, coarse: Profile, delay_s: float, interval_s: float) -> bool:
        """Whether a coarse search finds news; the fine one takes twenty times as long."""
        estimate = self.estimate
        is_early = self._progress.count <= 2 * TORQUES
        if estimate.is_estimated and is_early:
            return True
        if estimate.verdict is DelayVerdict.UNDECLARED and not is_early:
            return abs(delay_s - estimate.value_s) > 0.5 * interval_s
        away = abs(delay_s - estimate.applied_s) > COARSE_WORTH * interval_s
        return away and coarse.evidence(estimate.applied_s) > COARSE_EVIDENCE

    def _cut(
        self, signals: RawSignals, applied_s: float
    ) -> tuple[RawSignals, tuple[float, float]] | None:
        """Keep the torques with known voltage at any delay, and say how far it may reach."""
        span_s = float(signals.time_s[-1] - signals.time_s[0])
        low = max(min(-LONGEST_LEAD_S, applied_s - LONGEST_LEAD_S), applied_s - span_s / 8.0)
        high = min(max(LONGEST_DELAY_S, applied_s + LONGEST_LEAD_S), applied_s + span_s / 4.0)
        keep = (signals.time_s >= signals.voltage_time_s[0] + high) & (
            signals.time_s <= low - applied_s
        )
        if self._white_box.speed_measured:
            keep &= np.isfinite(signals.speed_rad_s)
        if np.count_nonzero(keep) < FIRST // 4:
            return None
        known_signals = replace(
            signals,
            time_s=signals.time_s[keep],
            torque_nm=signals.torque_nm[keep],
            speed_rad_s=signals.speed_rad_s[keep],
        )
        return known_signals, (low, high)

    def _judge(self, result: _Found) -> float | None:
        """Compare the outcome with the delay in force; two searches must agree on another one."""
        estimate = self.estimate
        before, self._progress.before = self._progress.before, None
        if math.isnan(result.std_s):
            if estimate.verdict in (DelayVerdict.UNKNOWN, DelayVerdict.SUSPECTED):
                self.estimate = replace(estimate, verdict=DelayVerdict.CONFIRMED)
            return None
        if result.agrees_with(estimate.applied_s):
            return (
                self._agree(result) if result.inside and result.std_s < result.interval_s else None
            )
        if not result.inside or result.evidence < EVIDENCE:
            return None
        self._progress.before = result
        near_s = result.interval_s + STDS * math.hypot(
            result.std_s, 0.0 if before is None else before.std_s
        )
        if before is None or abs(result.delay_s - before.delay_s) > near_s:
            self._progress.refine_at = 0  # what is news is asked again soon
            self._progress.ask_rotor_at = 0
            if estimate.verdict is not DelayVerdict.UNDECLARED:
                self.estimate = replace(estimate, verdict=DelayVerdict.SUSPECTED)
            return None
        if not estimate.is_estimated:
            self.estimate = replace(
                estimate,
                value_s=result.delay_s,
                std_s=result.std_s,
                verdict=DelayVerdict.UNDECLARED,
            )
            return None
        self._progress.before = None
        return self._apply(result)

    def _agree(self, result: _Found) -> float | None:
        """Note that the data agree with the delay in force; sharpen an estimated one.

        Then all is learnt anew from the history: only while that forgets nothing and holds what
        restarts left out.
        """
        if not self.estimate.is_estimated:
            self.estimate = replace(
                self.estimate,
                value_s=result.delay_s,
                std_s=result.std_s,
                verdict=DelayVerdict.CONFIRMED,
            )
            return None
        sharper = (
            result.std_s < 0.5 * (self.estimate.applied_std_s or math.inf)
            and abs(result.delay_s - self.estimate.applied_s) > result.std_s
        )
        if (
            sharper
            and self.estimate.applied_s != 0.0
            and self._dropped_count <= self._progress.count <= TORQUES
        ):
            return self._apply(result)
        self.estimate = replace(
            self.estimate,
            value_s=result.delay_s,
            std_s=result.std_s,
            verdict=DelayVerdict.ESTIMATED,
        )
        return None

    def _apply(self, result: _Found) -> float:
        applied_s = seconds(nanoseconds(result.delay_s))
        self.estimate = DelayEstimate(
            applied_s, True, result.delay_s, result.std_s, DelayVerdict.ESTIMATED, result.std_s
        )
        self._dropped_count = 0
        return applied_s

    def take_over(self, other: DelayWatch) -> None:
        """Go on with the delay that another form of the motor has found and applied.

        Args:
            other: its watch. What was declared stays so, and is asked anew.
        """
        if not (self.estimate.is_estimated and other.estimate.is_estimated):
            return
        self.estimate = other.estimate
        self._dropped_count = other._dropped_count + other._progress.count
        self._progress = _Progress(other._progress.restarts)

    def estimate_of(self, motor: int) -> DelayEstimate:
        """Return what is known of a motor; there is one, at place 0."""
        return self.estimate

    def state(self, motor: int = 0) -> dict[str, Any]:
        """What was found, as plain values for a checkpoint; searches under way begin anew."""
        estimate = self.estimate
        return {
            'applied_s': estimate.applied_s,
            'value_s': None if math.isnan(estimate.value_s) else estimate.value_s,
            'std_s': None if math.isnan(estimate.std_s) else estimate.std_s,
            'verdict': estimate.verdict.name,
            'applied_std_s': estimate.applied_std_s or None,
            'learnt': self._dropped_count + self._progress.count,
            'interval_s': None if math.isnan(self._interval_s) else self._interval_s,
        }

    def restore(self, plain: dict[str, Any], motor: int = 0) -> None:
        """Restore what :meth:`state` gave; a delay that is declared differently now stays so.

        Raises:
            CheckpointError: it is no state that could have been found.
        """
        applied_s = number(plain, 'applied_s', -FURTHEST_S, FURTHEST_S)
        value_s = number_or_none(plain, 'value_s', -FURTHEST_S, FURTHEST_S)
        std_s, applied_std_s = (
            number_or_none(plain, name, 0.0, LARGEST) for name in ('std_s', 'applied_std_s')
        )
        learnt_count = whole(plain, 'learnt')
        interval_s = None
        if 'interval_s' in plain:  # not in files of early releases
            interval_s = number_or_none(plain, 'interval_s', 0.0, LARGEST)
        word = entry(plain, 'verdict')
        if not isinstance(word, str) or word not in DelayVerdict.__members__:
            raise CheckpointError(
                f'verdict is {printable(repr(word), 40)}, expected one of a delay'
            )
        if not self.estimate.is_estimated and applied_s != self.estimate.applied_s:
            return
        self._dropped_count = learnt_count
        self._interval_s = interval_s or math.nan  # 0 is no interval
        value_s, std_s = (math.nan if value is None else value for value in (value_s, std_s))
        self.estimate = DelayEstimate(
            applied_s,
            self.estimate.is_estimated,
            value_s,
            std_s,
            DelayVerdict[word],
            applied_std_s or 0.0,
        )


def _is_inside(delay_s: float, interval_s: float, reach_s: tuple[float, float]) -> bool:
    """Tell whether a delay lies within what was searched, and not at its edge."""
    margin_s = 0.5 * interval_s
    return reach_s[0] + margin_s < delay_s < reach_s[1] - margin_s


def _moves(signals: RawSignals) -> bool:
    """Tell whether the voltage has moved often enough to tell the delay of a hidden rotor."""
    begin_s = float(signals.time_s[-NEWEST:][0])
    voltage_v = signals.voltage_v[signals.voltage_time_s >= begin_s]
    return bool(np.count_nonzero(np.diff(voltage_v)) >= FEWEST_MOVES)
