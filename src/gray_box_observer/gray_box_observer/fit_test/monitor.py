"""Follows the fit of every motor of a group, and limits its estimates by that fit.

A motor is tested when a parameter would first be called identified, then each time its data have
doubled, at last every LONGEST_WAIT samples; sooner after a misfit, for a motor that settles is soon
another one. All is decided by counts of samples, so that every door leads to the same verdicts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN, Estimate, Verdict, misfit
from gray_box_observer.context_nodes.recursive.negligible import SIGMAS
from gray_box_observer.context_nodes.recursive.normal_equations import MAD_TO_STD
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.update_rule import ContextUpdate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict, Suspect
from gray_box_observer.fit_test.data_doubts import doubt_of_range, doubts, may_be_duty
from gray_box_observer.fit_test.data_sheet import doubt_of_data_sheet
from gray_box_observer.fit_test.effects import CHANGE, COLOURED_NOISE, REMEDIES
from gray_box_observer.fit_test.policy import (
    NOTICEABLE,
    RATIO_MISFIT,
    SCORE_DOUBT,
    WHITENESS_DOUBT,
    Judgement,
    is_dubious,
    judge,
    shows_change,
    with_shift,
)
from gray_box_observer.fit_test.residual_analysis import ResidualAnalysis, analyse
from gray_box_observer.fit_test.saved_test import LONGEST_WAIT, MOST_SUSPECTS, check_saved_test
from gray_box_observer.fit_test.speed_curve import inductance_shift
from gray_box_observer.fit_test.suspects import Explanation, explanations, select_explanations
from gray_box_observer.samples.replay_buffer import TORQUE, VOLTAGE, ReplayBuffer
from gray_box_observer.settings.configuration import BACK_EMF, MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

WINDOW = 4096
"""Newest samples, at most, that a test looks at."""

FEWEST = 64
"""Samples of which a test tells something: a rotor whose speed nobody measures takes so long to
show."""

FEWEST_WITH_SPEED = 32
"""The same where the speed is measured."""

SHORTEST_WAIT = 64
"""Samples between two tests of a motor, at least."""

RECENT = 512
"""Newest samples by which a motor with a rotor is tested between its fits, which come ever rarer:
one that has changed is none that may be believed."""

RECENT_WAIT = 256
"""Samples between two such tests."""

LONGEST_SOON = 512
"""Samples between two tests, at most, of a motor that does not fit and has become another one."""

UNASKED = 256
"""Samples after which a motor is tested though nothing of it would be called identified."""

MOVED = 0.1
"""Change of a parameter's logarithm by which a motor is another one than was tested."""

HELD = 0.01
"""Range of the voltage, as a share of its largest value, in which it is held: that tells nothing of
the fit."""

HELD_NOISY = 0.05
"""The same, at most, where the voltage is measured: its own noise is no move."""

NOISE_RANGE = 10.0
"""Range of so much noise in standard deviations: that of 4096 samples is 7 to 9."""

LESS = 0.5
"""Share of the samples, and of the range of the voltage, that a misfit rests on which can overrule
it."""

PASSING = 3
"""Misfits in a row that may be those of a motor that is changing: any good test overrules them."""

CLEARLY, VERY_CLEARLY = 30.0, 300.0
"""Log-likelihood by which the voltage balance itself tells what is left out, of a large and of a
small residual; else the free run is asked."""

MILD = 1.5
"""Residual over noise floor up to which it is small."""

MANY = 1024
"""Motors of which one is tested at one sample of the group; of more, as many more."""

NEVER = np.iinfo(np.int64).max

_UNTESTED = FitAssessment()

_ALONE = np.zeros(1, dtype=np.intp)


@dataclass(frozen=True, slots=True)
class _Tested:
    """What a motor's newest test has left.

    Attributes:
        assessment: what is published.
        judgement: what follows for its estimate.
        theta: shape (parameter,): the values tested.
        place: in its stream of samples.
        begin: place before the oldest sample that counted.
        wait: samples to the next test.
        range_v: range of the voltage in the samples that a misfit rests on.
        misfits: tests in a row that found a misfit.
        noise_a: standard deviation in A of the current's noise, from the newest test that told; 0
            where none did.
    """

    assessment: FitAssessment
    judgement: Judgement
    theta: Array
    place: int
    begin: int
    wait: int
    range_v: float
    misfits: int
    noise_a: float

    def outweighs(self, count: int, range_v: float) -> bool:
        """Tell whether a misfit outweighs later samples that show none but tell less."""
        poorer = count < LESS * self.assessment.samples or range_v < LESS * self.range_v
        return self.misfits > PASSING and poorer


class FitMonitor:
    """Follows the fit of a group of motors.

    Args:
        motors: their configurations, in the order of the motor axis.
        white_boxes: physics of each.
        quantity: what the torque signal is taken for: ``torque`` or ``current``.
    """

    def __init__(
        self,
        motors: Sequence[MotorConfiguration],
        white_boxes: Sequence[MotorWhiteBox],
        quantity: str = 'torque',
    ) -> None:
        self._motors = motors
        self._quantity = quantity
        self._white_boxes = white_boxes
        self._results: list[_Tested | None] = [None] * len(motors)
        self._fewest = np.array(
            [FEWEST_WITH_SPEED if box.speed_measured else FEWEST for box in white_boxes]
        )
        self._due = self._fewest.copy()
        self._soon = np.full(len(motors), NEVER)
        self._begin = np.full(len(motors), NEVER)
        self._tested_at = np.zeros(len(motors), dtype=np.int64)
        self._limits = np.ones(len(motors), dtype=bool)
        self._theta = np.full((len(motors), len(white_boxes[0].parameters)), np.nan)
        self._moved: frozenset[int] = frozenset()

    def configuration(self, motor: int) -> MotorConfiguration:
        """Return the configuration of one motor."""
        return self._motors[motor]

    def assessment(self, motor: int) -> FitAssessment:
        """Return what is known of the fit of one motor."""
        result = self._results[motor]
        return _UNTESTED if result is None else result.assessment

    def is_urgent(self, motor: int) -> bool:
        """Tell whether the estimate awaits a test; untested, nothing is believed of the motor."""
        result = self._results[motor]
        tested = result is not None and result.assessment.verdict is not FitVerdict.MISFIT
        return not tested or motor in self._moved

    def is_stale(self, nodes: ContextUpdate, motor: int) -> bool:
        """Tell whether a motor with a rotor is to be tested by its newest samples.

        Args:
            nodes: the rule that has learnt it.
            motor: its place on the motor axis.
        """
        result = self._results[motor]
        if result is None or result.assessment.verdict is FitVerdict.MISFIT:
            return False
        return int(nodes.replay.received[motor]) - int(self._tested_at[motor]) >= RECENT_WAIT

    def due(self, nodes: ContextUpdate, estimate: Estimate, motors: NDArray[np.intp]) -> list[int]:
        """Return which of some motors are to be tested now.

        Args:
            nodes: the rule that has learnt them.
            estimate: theirs, in the same order.
            motors: their places on the motor axis.
        """
        replay = nodes.replay
        self._moved = frozenset()
        if len(self._motors) == 1:  # the usual case, in plain numbers
            return [0] if motors.size and self._is_due(replay, estimate) else []
        places = replay.received[motors]
        if (places < np.minimum(self._due[motors], self._soon[motors])).all():
            return []
        changed = replay.begin(motors) > self._begin[motors]
        waited = places >= np.where(changed, self._soon[motors], self._due[motors])
        moved = (places >= self._soon[motors]) & self._has_moved(estimate, motors)
        self._moved = frozenset(motors[moved].tolist())
        rows = np.flatnonzero(waited | moved)
        if not rows.size:
            return []
        rows = rows[
            np.argsort(self._due[motors[rows]], kind='stable')
        ]  # who has waited longest is first
        due_motors = (
            int(motors[row])
            for row in rows.tolist()
            if self._is_ripe(estimate, row, motors[row], places[row])
        )
        return list(islice(due_motors, max(1, len(self._motors) // MANY)))

    def _is_due(self, replay: ReplayBuffer, estimate: Estimate) -> bool:
        """Tell whether a motor that is alone is to be tested now; see :meth:`due`."""
        place, due, soon = int(replay.received[0]), int(self._due[0]), int(self._soon[0])
        if place < due and place < soon:
            return False
        has_waited = place >= (soon if replay.begin()[0] > self._begin[0] else due)
        if place >= soon and self._has_moved(estimate, _ALONE)[0]:
            self._moved = frozenset((0,))
        elif not has_waited:
            return False
        return self._is_ripe(estimate, 0, 0, place)

    def _is_ripe(self, estimate: Estimate, row: int, motor: int, place: int) -> bool:
        """Tell whether a first test is worth its time: something would be believed without it."""
        hopeful = Verdict.IDENTIFIED in estimate.verdicts[row]
        return self._results[motor] is not None or hopeful or bool(place >= UNASKED)

    def _has_moved(self, estimate: Estimate, motors: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Tell which motors are others than were tested, shape (motor,).

        What a test has found holds for the values tested. Of a motor that fits, those count that
        are believed.
        """
        far = np.abs(np.log(estimate.value / self._theta[motors])) > MOVED
        has_moved: NDArray[np.bool_] = far.any(axis=1)
        if not has_moved.any():
            return has_moved
        for row in np.flatnonzero(has_moved).tolist():
            result = self._results[motors[row]]
            if result is not None and result.assessment.verdict is not FitVerdict.MISFIT:
                verdicts = zip(estimate.verdicts[row], far[row], strict=True)
                has_moved[row] = any(
                    verdict is Verdict.IDENTIFIED and is_far for verdict, is_far in verdicts
                )
        return has_moved

    def test(
        self, nodes: ContextUpdate, estimate: Estimate, motor: int, delay: DelayEstimate,
        *, is_recent: bool = False,
    ) -> None:  # fmt: skip
        """Test one motor.

        Args:
            nodes: the rule that has learnt it.
            estimate: of this motor alone, as the rule gives it.
            motor: its place on the motor axis.
            delay: what is known of its delay.
            is_recent: whether the newest samples alone are tested; only a misfit counts then.
        """
        replay = nodes.replay
        one = slice(motor, motor + 1)
        place, begin = int(replay.received[motor]), int(replay.begin(one)[0])
        count = int(min(replay.remembered(one)[0], RECENT if is_recent else WINDOW))
        self._tested_at[motor] = place
        fewest = int(self._fewest[motor])
        if count < fewest:
            if not is_recent:
                self._put_off(motor, place + fewest - count)
            return
        before = self._results[motor]
        samples = replay.newest(count, one)
        hopeful = Verdict.IDENTIFIED in estimate.verdicts[0]
        white_box = self._white_boxes[motor]
        knows_speed = white_box.speed_measured or white_box.has_rotor
        # Of a rotor that has settled, and nobody measures, the resistance tells nothing: only a
        # transient counts.
        tells = before is None and hopeful and (knows_speed or _knows_inductance(estimate))
        if is_held(samples[VOLTAGE, 0]) and not tells:
            if not is_recent:
                self._put_off(motor, place + SHORTEST_WAIT)
            return
        theta = estimate.value
        stretch = SampleWindow.newest(white_box, replay, count, one)
        drifting = nodes.is_drifting(motor)
        with np.errstate(all='ignore'):  # absurd samples; what is not finite is a misfit
            analysis = analyse(white_box, to_coordinates(theta), stretch, drifting)
        judgement = judge(
            analysis,
            estimate.std[0] / theta[0],
            place - begin,
            speed_measured=knows_speed,
            stamps_exact=bool(self._motors[motor].values['stamps_exact']),
            is_doubted=before is not None and before.misfits > PASSING,
            is_drifting=drifting,
        )
        shift = inductance_shift(white_box, samples[:, 0], theta[0])
        judgement = with_shift(judgement, white_box.context_nodes.index('inductance'), shift)
        judgement = self._without_seen_rotor(judgement, theta[0], motor)
        doubted = doubts(white_box, samples[:, 0], theta[0], self._motors[motor])
        suspicions = list(doubted.suspects)
        content = replay.newest(min(replay.stored(motor), WINDOW), one)
        is_duty = may_be_duty(content[VOLTAGE, 0])
        sheet = doubt_of_data_sheet(
            self._motors[motor], estimate, self._quantity, doubted.balance, is_duty=is_duty
        )
        if sheet is not None and not suspicions:
            suspicions.append(sheet)
        noise_a = analysis.moving_noise_a or (0.0 if before is None else before.noise_a)
        clipped = doubt_of_range(white_box.state(content[TORQUE, 0]), noise_a)
        if clipped is not None:
            suspicions.append(clipped)
        late = self._delay_suspect(motor, delay)
        if suspicions or late:
            judgement = replace(judgement, verdict=FitVerdict.MISFIT)
        if is_recent:
            was_ok = before is not None and before.assessment.verdict is FitVerdict.OK
            if was_ok and shows_change(analysis):
                judgement = replace(judgement, verdict=FitVerdict.MISFIT)
            if judgement.verdict is not FitVerdict.MISFIT:
                return
            suspicions.append(Suspect(CHANGE, analysis.whiteness, REMEDIES[CHANGE]))
        if judgement.verdict is not FitVerdict.OK or is_dubious(analysis):
            explained = (
                {}  # its balance has a speed that nobody measures
                if white_box.has_rotor
                else explanations(white_box, SampleWindow.of_content(white_box, content))
            )
            if _clearest(explained) > VERY_CLEARLY:
                judgement = replace(judgement, verdict=FitVerdict.MISFIT)
            if judgement.verdict is not FitVerdict.OK:
                suspicions += self._suspects(analysis, explained, motor)
        suspicions = [
            late[0] if late and suspect.effect == 'delay' else suspect for suspect in suspicions
        ] + late
        assessment = FitAssessment(
            judgement.verdict,
            analysis.ratio,
            analysis.whiteness,
            _without_repetition(suspicions),
            analysis.samples,
        )
        range_v = float(np.ptp(samples[VOLTAGE, 0]))
        misfit = judgement.verdict is FitVerdict.MISFIT
        if not misfit and before is not None and before.outweighs(count, range_v):
            wait = min(2 * before.wait, LONGEST_WAIT)
            self._results[motor] = replace(before, place=place, begin=begin, wait=wait)
        else:
            misfits = 1 + (0 if before is None else before.misfits) if misfit else 0
            wait = self._wait(before, judgement.verdict, count)
            self._results[motor] = _Tested(
                assessment,
                judgement,
                theta[0].copy(),
                place,
                begin,
                wait,
                range_v,
                misfits,
                noise_a,
            )
        self._follow(motor)

    def _without_seen_rotor(self, judgement: Judgement, theta: Array, motor: int) -> Judgement:
        """Leave the resistance open by Kb Kt where a speed of Kt i is nothing but a guess.

        A rotor that is blocked has no back-EMF, and leaves as white a residual.
        """
        white_box = self._white_boxes[motor]
        nodes = white_box.context_nodes
        is_guess = self._motors[motor].values['speed_source'] != 'torque_constant'
        knows_speed = white_box.speed_measured or white_box.has_rotor
        if knows_speed or not is_guess or 'resistance' not in nodes:
            return judgement
        place = nodes.index('resistance')
        back_emf_ohm = float(white_box.known.get(BACK_EMF, 0.0)) * float(white_box.torque_constant)
        share = back_emf_ohm / float(theta[place])
        return with_shift(judgement, place, share if share > NOTICEABLE else 0.0)

    def _put_off(self, motor: int, place: int) -> None:
        """Ask again at a place where there may be more to tell by."""
        self._due[motor] = self._soon[motor] = place

    def _follow(self, motor: int) -> None:
        """Note when a motor is tested next, and whether its test limits its estimate."""
        result = self._results[motor]
        assert result is not None
        self._due[motor] = result.place + result.wait
        self._soon[motor] = result.place + _soonest(result.misfits)
        self._begin[motor] = result.begin
        self._theta[motor] = result.theta
        judgement = result.judgement
        self._limits[motor] = judgement.widens or judgement.verdict is FitVerdict.MISFIT

    @staticmethod
    def _wait(before: _Tested | None, verdict: FitVerdict, count: int) -> int:
        """Samples to the next test: as many as this one; after a misfit few, then doubling."""
        if verdict is not FitVerdict.MISFIT:
            return int(np.clip(count, SHORTEST_WAIT, LONGEST_WAIT))
        again = before is not None and before.assessment.verdict is FitVerdict.MISFIT
        return min(2 * before.wait, LONGEST_WAIT) if again and before is not None else SHORTEST_WAIT

    def _delay_suspect(self, motor: int, delay: DelayEstimate) -> list[Suspect]:
        name = self._motors[motor].name
        if delay.complaint(name) is None:
            return []
        evidence = 0.5 * (delay.value_s / max(delay.std_s, 1e-12)) ** 2
        return [Suspect('delay', evidence, f'{name}.delay: {delay.value_s:.3g}')]

    def _suspects(
        self, analysis: ResidualAnalysis, explained: Mapping[str, Explanation], motor: int
    ) -> list[Suspect]:  # fmt: skip
        """Name the likely missing effect: by voltage balance if much is wrong, else by free run."""
        name = self._motors[motor].name
        scores = {score.effect.name: 0.5 * score.score for score in analysis.scores}
        clearest = _clearest(explained)
        coloured = analysis.whiteness > WHITENESS_DOUBT and analysis.ratio < RATIO_MISFIT
        if (
            coloured
            and clearest < CLEARLY
            and max(scores.values(), default=0.0) < 0.5 * SCORE_DOUBT
        ):
            return [Suspect(COLOURED_NOISE, analysis.whiteness, REMEDIES[COLOURED_NOISE])]
        mild = analysis.ratio < MILD and clearest < VERY_CLEARLY
        if scores and (clearest < CLEARLY or mild):
            explained = {
                effect: replace(explained[effect], evidence=evidence)
                for effect, evidence in scores.items()
                if effect in explained
            }
        torque_constant = float(self._white_boxes[motor].torque_constant)
        return [
            one.suspect(name, torque_constant)
            for one in select_explanations(explained.values(), scores)
        ]

    def judged(
        self, nodes: ContextUpdate, estimate: Estimate, motors: NDArray[np.intp]
    ) -> Estimate:
        """Return an estimate as far as the fit lets it be believed.

        Args:
            nodes: the rule that has learnt them.
            estimate: as it gives it, one row for each of some motors.
            motors: their places on the motor axis.
        """
        limited = np.flatnonzero(self._limits[motors])
        if limited.size == 0:
            return estimate
        covariance = estimate.covariance
        verdicts = list(estimate.verdicts)
        for row in limited.tolist():
            motor = int(motors[row])
            result = self._results[motor]
            if result is None:
                verdicts[row] = tuple(map(_at_most_converging, verdicts[row]))
                continue
            widened = _widened(result.judgement, estimate.value[row], estimate.covariance[row])
            if widened is not None:
                covariance = covariance.copy() if covariance is estimate.covariance else covariance
                covariance[row] = widened
                std = np.sqrt(np.diagonal(widened))[None]
                frozen = Verdict.FROZEN in verdicts[row]
                value = estimate.value[row : row + 1]
                most = _largest_shares(nodes, motor, value[0], result.judgement)[None]
                verdicts[row] = nodes.verdict_rules.judge(
                    estimate.parameters, value, std, is_frozen=frozen, most=most
                )[0]
            if result.assessment.verdict is FitVerdict.MISFIT:
                verdicts[row] = tuple(map(misfit, verdicts[row]))
        return replace(estimate, covariance=covariance, verdicts=tuple(verdicts))

    def forget(self) -> None:
        """Start anew: what was tested is no more."""
        self._results = [None] * len(self._motors)
        self._due[:] = self._fewest
        self._soon[:] = self._begin[:] = NEVER
        self._tested_at[:] = 0
        self._limits[:] = True
        self._theta[:] = np.nan

    def state(self, motor: int, received_count: int) -> dict[str, Any]:
        """Everything about one motor, as plain values; places count back from the newest."""
        result = self._results[motor]
        is_asked_soon = self._soon[motor] < NEVER
        due = {
            'due': int(self._due[motor]) - received_count,
            'soon': int(self._soon[motor]) - received_count if is_asked_soon else None,
            'tested_at': int(self._tested_at[motor]) - received_count,
        }
        if result is None:
            return due
        judgement = result.judgement
        return {
            **due,
            'assessment': {**result.assessment.to_dict(), 'samples': result.assessment.samples},
            'factor': judgement.factor.tolist(),
            'spread': judgement.spread.tolist(),
            'theta': result.theta.tolist(),
            'place': result.place - received_count,
            'begin': result.begin - received_count,
            'wait': result.wait,
            'range_v': result.range_v,
            'misfits': result.misfits,
            'noise_a': result.noise_a,
        }

    def restore(self, plain: dict[str, Any], motor: int, received_count: int) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that a test could have left.
        """
        check_saved_test(plain, len(self._white_boxes[motor].parameters))
        if 'assessment' not in plain:
            self._results[motor] = None
            self._soon[motor] = self._begin[motor] = NEVER
            self._limits[motor] = True
            self._theta[motor] = np.nan
            self._restore_due(plain, motor, received_count)
            return
        assessment = FitAssessment.from_dict(plain['assessment'])
        judgement = Judgement(
            assessment.verdict, np.array(plain['factor']), np.array(plain['spread'])
        )
        self._results[motor] = _Tested(
            assessment,
            judgement,
            np.array(plain['theta']),
            plain['place'] + received_count,
            plain['begin'] + received_count,
            plain['wait'],
            plain['range_v'],
            plain['misfits'],
            plain.get('noise_a', 0.0),  # releases before kept none
        )
        self._follow(motor)
        self._restore_due(plain, motor, received_count)

    def _restore_due(self, plain: dict[str, Any], motor: int, received_count: int) -> None:
        self._due[motor] = plain['due'] + received_count
        self._tested_at[motor] = plain.get('tested_at', 0) + received_count
        if plain.get('soon') is not None:
            self._soon[motor] = plain['soon'] + received_count


def _soonest(misfits: int) -> int:
    """Samples to a test of a motor that has become another one, after so many misfits in a row.

    One that goes on changing without ever fitting is asked less and less often.
    """
    return min(SHORTEST_WAIT << min(max(misfits - PASSING, 0), 8), LONGEST_SOON)


def _largest_shares(nodes: ContextUpdate, motor: int, value: Array, judgement: Judgement) -> Array:
    """Upper bound on each parameter's share of the voltage, shape (parameter,).

    The bound is wider by the spread of the estimate.
    """
    share, reach = nodes.voltage_shares(motor)
    shift = SIGMAS * np.sqrt(np.diagonal(judgement.spread))
    wider: Array = (1.0 + shift) * value * share + reach * judgement.factor
    return np.where(share > 0.0, wider, np.inf)


def _clearest(explained: Mapping[str, Explanation]) -> float:
    """Return the log-likelihood of the best explanation that can be."""
    return max((one.evidence for one in explained.values() if one.is_credible), default=0.0)


def _knows_inductance(estimate: Estimate) -> bool:
    """Tell whether a motor's inductance is identified: its current was seen to rise or fall."""
    verdicts = zip(estimate.parameters, estimate.verdicts[0], strict=True)
    return any(
        parameter.name == 'inductance' and verdict is Verdict.IDENTIFIED
        for parameter, verdict in verdicts
    )


def is_held(voltage_v: Array) -> bool:
    """Tell whether a voltage hardly moves, shape (n,): then there is nothing to tell a fit by."""
    largest_v = float(np.max(np.abs(voltage_v)))
    noise_v = MAD_TO_STD * float(np.median(np.abs(np.diff(voltage_v)))) / math.sqrt(2.0)
    by_noise_v = min(NOISE_RANGE * noise_v, HELD_NOISY * largest_v)
    return float(np.ptp(voltage_v)) <= max(HELD * largest_v, by_noise_v)


def _widened(judgement: Judgement, value: Array, covariance: Array) -> Array | None:
    """Return the covariance that a judgement leaves; None where it is as before."""
    if not judgement.widens:
        return None
    grown = covariance * judgement.factor[:, None] * judgement.factor
    widened: Array = grown + judgement.spread * value[:, None] * value
    return widened


def _at_most_converging(verdict: Verdict) -> Verdict:
    return Verdict.CONVERGING if verdict in COUNTS_AS_KNOWN else verdict


def _without_repetition(suspicions: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return the first few suspects, each effect once."""
    first: dict[str, Suspect] = {}
    for suspect in suspicions:
        first.setdefault(suspect.effect, suspect)
    return tuple(first.values())[:MOST_SUSPECTS]
