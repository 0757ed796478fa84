"""Tests whether a white box explains one motor's newest samples, and names what it leaves out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.estimate import Estimate, Verdict
from gray_box_observer.context_nodes.pieces import Pieces, completed, without_warnings
from gray_box_observer.context_nodes.recursive.constant_voltage import FROM_REST, RISEN
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.assessment import MILD, FitAssessment, FitVerdict, Suspect
from gray_box_observer.fit_test.coasting import seems_to_coast
from gray_box_observer.fit_test.current_lag import lag_shifts
from gray_box_observer.fit_test.data_doubts import (
    doubt_of_range,
    doubts,
    doubts_of_stamps,
    may_be_duty,
)
from gray_box_observer.fit_test.data_sheet import doubt_of_data_sheet
from gray_box_observer.fit_test.effects import (
    CHANGE,
    COLOURED_NOISE,
    EFFECTS,
    ESTIMATED_REMEDIES,
    LOAD,
    LOADS,
    REMEDIES,
    ROTOR_REMEDIES,
    load_remedy,
)
from gray_box_observer.fit_test.evidence import WINDOW
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.fit_schedule import wait_after
from gray_box_observer.fit_test.fitted_residual import fitted_residual_in_pieces
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest
from gray_box_observer.fit_test.policy import (
    NOTICEABLE,
    RATIO_MISFIT,
    SCORE_DOUBT,
    WHITENESS_DOUBT,
    Judgement,
    is_dubious,
    judge,
    leaves_little,
    shows_change,
    with_shift,
    with_shifts,
)
from gray_box_observer.fit_test.residual_analysis import ResidualAnalysis, analysis_in_pieces
from gray_box_observer.fit_test.saved_test import LONGEST_WAIT, MOST_SUSPECTS
from gray_box_observer.fit_test.speed_curve import inductance_shift
from gray_box_observer.fit_test.speed_error import likely_shifts
from gray_box_observer.fit_test.still_speed import stands_still
from gray_box_observer.fit_test.suspects import (
    Explanation,
    explanations_in_pieces,
    root_mean_square,
    scored_explanations,
    select_explanations,
    with_delay,
)
from gray_box_observer.fit_test.twin_effects import OFFSET
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import INTERVAL, TORQUE, VOLTAGE
from gray_box_observer.samples.voltage_level import is_held
from gray_box_observer.settings.motor_configuration import (
    BACK_EMF,
    COASTING,
    MotorConfiguration,
)
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array

RECENT = 512
"""Newest samples by which a motor with a rotor is tested between its fits, which come ever rarer:
one that has changed is none that may be believed."""

FEWEST = 64
"""Samples of which a test tells something: a rotor whose speed nobody measures takes so long to
show."""

FEWEST_WITH_SPEED = 32
"""The same where the speed is measured."""

MOST_LOADED = 2048
"""Samples of which a test is made where a load varies: the work grows with its knots, too."""

CLEARLY, VERY_CLEARLY = 30.0, 300.0
"""Log-likelihood by which the voltage balance itself tells what is left out, of a large and of a
small residual; else the free run is asked."""

PERSISTENT = 0.8
"""Share of a residual's correlation, a third of a mechanical time constant later, from which it is
that of a load: 0.85 and more of loads, up to 0.79 of all else."""


@dataclass(frozen=True)
class _Finding:
    """What a look at some newest samples has found.

    Attributes:
        analysis: of the residual.
        judgement: what follows for the estimate.
        suspects: doubts about the data themselves.
        delay_suspect: where the delay is not what it was taken for; None: nothing is wrong there.
        noise_a: standard deviation in A of the current's noise.
    """

    analysis: ResidualAnalysis
    judgement: Judgement
    suspects: list[Suspect]
    delay_suspect: Suspect | None
    noise_a: float


@dataclass(frozen=True)
class WindowTest:
    """Tests the newest samples of one motor.

    Attributes:
        configuration: what is known of the motor beforehand.
        white_box: its physics.
        quantity: what the torque signal is taken for: ``torque`` or ``current``.
    """

    configuration: MotorConfiguration
    white_box: MotorWhiteBox
    quantity: str

    @property
    def fewest(self) -> int:
        """Samples of which a test tells something."""
        return FEWEST_WITH_SPEED if self.white_box.speed_measured else FEWEST

    @property
    def most(self) -> int:
        """Samples of which a test is made at most."""
        return MOST_LOADED if self.white_box.load_varies else WINDOW

    @property
    def _knows_speed(self) -> bool:
        return self.white_box.speed_measured or self.white_box.has_rotor

    @property
    def _speed_is_guess(self) -> bool:
        is_stated = self.configuration.values['speed_source'] == 'torque_constant'
        return not (self._knows_speed or is_stated)

    def _doubts_speed(self, motor: MotorUnderTest) -> bool:
        """Tell whether an error of a measured speed would show in the parameters alone.

        Where Kb is free, other tests ask what it does.
        """
        has_speed = self.white_box.speed_measured and BACK_EMF in self.white_box.known
        return has_speed and motor.speed_is_exact

    def can_tell(self, motor: MotorUnderTest, count: int) -> bool:
        """Tell whether so many newest samples tell something: the voltage moves among them.

        A first test may do without, where it can be passed. Of a rotor that has settled, and nobody
        measures, the resistance tells nothing: only a transient counts. After a current has risen
        from rest it goes on telling, as long as it is held: before a rotor it would fall. That may
        refute what has passed. A misfit it cannot overrule.
        """
        samples = motor.newest(count)[:, 0]
        if not is_held(samples[VOLTAGE]):
            return True
        hopeful = Verdict.IDENTIFIED in motor.estimate.verdicts[0]
        if motor.before is None:
            return hopeful and (self._knows_speed or _knows_inductance(motor.estimate))
        has_passed = motor.before.assessment.verdict is not FitVerdict.MISFIT
        is_told = has_passed and self._speed_is_guess and _rises_and_stays(samples[TORQUE])
        return hopeful and is_told

    def without_test(self, motor: MotorUnderTest, count: int) -> Judgement:
        """Return what follows for an estimate by so many newest samples that tell nothing."""
        theta = motor.estimate.value[0]
        open_fit = Judgement(
            FitVerdict.UNTESTED, np.ones(theta.size), np.zeros((theta.size, theta.size))
        )
        return self._without_seen_rotor(open_fit, theta, motor.newest(count)[:, 0])

    def test(self, motor: MotorUnderTest, count: int) -> FitResult:
        """Test so many newest samples, at once."""
        return completed(self.pieces(motor, count))

    def pieces(self, motor: MotorUnderTest, count: int) -> Pieces[FitResult]:
        """Test so many newest samples."""
        finding = yield from self._look(motor, count)
        result = yield from self._conclude(motor, count, finding)
        return result

    def test_change(self, motor: MotorUnderTest, count: int) -> FitResult | None:
        """Test so many newest samples of a motor that has passed; None where it still does.

        What else may be left out is asked where the residual is no noise alone.
        """
        if self._is_explained(motor, count):
            return None
        finding = completed(self._look(motor, count))
        before = motor.before
        verdict = finding.judgement.verdict
        was_ok = before is not None and before.assessment.verdict is FitVerdict.OK
        if verdict is not FitVerdict.MISFIT and not (was_ok and shows_change(finding.analysis)):
            return None
        remedies = ROTOR_REMEDIES if self.white_box.has_rotor else REMEDIES
        remedy = remedies[CHANGE].format(motor=self.configuration.name)
        change = Suspect(CHANGE, finding.analysis.whiteness, remedy)
        finding = replace(
            finding,
            judgement=replace(finding.judgement, verdict=FitVerdict.MISFIT),
            suspects=[*finding.suspects, change],
        )
        return completed(self._conclude(motor, count, finding))

    def _is_explained(self, motor: MotorUnderTest, count: int) -> bool:
        """Tell whether so many newest samples leave no more than noise, by its size and colour."""
        pieces = fitted_residual_in_pieces(
            self.white_box,
            to_coordinates(motor.estimate.value),
            SampleWindow.of_content(self.white_box, np.ascontiguousarray(motor.newest(count))),
            is_drifting=motor.is_drifting,
            knows_voltage_noise=motor.knows_voltage_noise,
            noise_memory=self.configuration.noise_memory,
        )
        return not is_dubious(completed(without_warnings(pieces)))

    def _look(self, motor: MotorUnderTest, count: int) -> Pieces[_Finding]:
        """Analyse so many newest samples, and ask whether the data themselves are in doubt."""
        white_box = self.white_box
        before = motor.before
        estimate = motor.estimate
        theta = estimate.value
        content = np.ascontiguousarray(motor.newest(count))
        samples = content[:, 0]
        window = SampleWindow.of_content(white_box, content)
        is_drifting = motor.is_drifting
        lag = self.configuration.current_lag
        # samples may be absurd; what is not finite is a misfit
        analysis = yield from without_warnings(
            analysis_in_pieces(
                white_box,
                to_coordinates(theta),
                window,
                is_drifting,
                motor.evidence,
                motor.new_samples,
                lag,
                motor.newest_measured(count),
                motor.late_instant,
                speed_is_guess=self._speed_is_guess,
                knows_voltage_noise=motor.knows_voltage_noise,
                may_be_filtered=self.configuration.estimates_delay,
            )
        )
        yield count
        delay_std = 0.0
        if white_box.has_rotor:  # others resolve L/R by many samples
            delay_std = motor.delay.applied_std_s / usual_interval(samples[INTERVAL])
        judgement = judge(
            analysis,
            estimate.std[0] / theta[0],
            motor.place - motor.begin,
            speed_measured=self._knows_speed,
            stamps_exact=bool(self.configuration.values['stamps_exact']),
            speed_is_hidden=self.white_box.has_rotor,
            is_doubted=before is not None and before.is_lasting_misfit,
            is_drifting=is_drifting,
            delay_std=delay_std,
        )
        shift = inductance_shift(white_box, samples, theta[0])
        judgement = with_shift(judgement, white_box.context_nodes.index('inductance'), shift)
        judgement = self._without_seen_rotor(judgement, theta[0], samples)
        is_stated = self.configuration.values['speed_source'] == 'measured'
        if white_box.speed_measured and not is_stated and stands_still(white_box, theta, content):
            every = np.ones((1, theta.shape[1]))
            judgement = with_shifts(judgement, every)  # it may be no speed at all
        if self._doubts_speed(motor):
            with np.errstate(all='ignore'):
                shifts = likely_shifts(white_box, theta, content)
            yield count
            judgement = with_shifts(judgement, np.where(np.isfinite(shifts), shifts, 1.0))
        interval_s = usual_interval(samples[INTERVAL])
        if lag is not None and interval_s < math.inf:
            stamps_exact = bool(self.configuration.values['stamps_exact'])
            shifts = lag_shifts(white_box, theta[0], lag, interval_s, stamps_exact=stamps_exact)
            judgement = with_shifts(judgement, shifts)
        yield 0
        content = motor.content
        data_doubts = doubts(white_box, samples, theta[0], self.configuration)
        suspects = list(data_doubts.suspects)
        sheet = doubt_of_data_sheet(
            self.configuration,
            estimate,
            self.quantity,
            data_doubts.balance,
            is_duty=may_be_duty(content[VOLTAGE, 0]),
        )
        if sheet is not None and not suspects:
            suspects.append(sheet)
        yield 0
        noise_a = analysis.moving_noise_a or (0.0 if before is None else before.noise_a)
        range_suspect = doubt_of_range(white_box.state(content[TORQUE, 0]), noise_a)
        if range_suspect is not None:
            suspects.append(range_suspect)
        delay_suspect = None if motor.is_lagging else self._delay_suspect(motor.delay)
        if suspects or delay_suspect is not None:
            judgement = replace(judgement, verdict=FitVerdict.MISFIT)
        return _Finding(analysis, judgement, suspects, delay_suspect, noise_a)

    def _conclude(self, motor: MotorUnderTest, count: int, finding: _Finding) -> Pieces[FitResult]:
        """Name what is likely left out, and say what the test leaves."""
        analysis = finding.analysis
        judgement = finding.judgement
        before = motor.before
        samples = motor.newest(count)[:, 0]
        suspects = finding.suspects
        if judgement.verdict is not FitVerdict.OK or is_dubious(analysis):
            has_rotor = self.white_box.has_rotor
            candidates = {}
            if not has_rotor:  # its balance has a speed that nobody measures
                yield count
                window = SampleWindow.of_content(self.white_box, motor.content)
                yield count
                knows_decay = self.white_box.speed_measured and analysis.ratio < RATIO_MISFIT
                candidates = yield from explanations_in_pieces(
                    self.white_box,
                    window,
                    analysis.intervals if knows_decay else math.inf,
                    analysis.floor_a,
                )
            clearest = _clearest(candidates)
            is_added = bool(self.configuration.added_effects)
            is_warned = judgement.verdict is FitVerdict.WARNING
            is_slight = (
                self.white_box.speed_measured and clearest < CLEARLY and leaves_little(analysis)
            )
            if clearest > VERY_CLEARLY or (is_added and is_warned and not is_slight):
                judgement = replace(judgement, verdict=FitVerdict.MISFIT)
            if judgement.verdict is not FitVerdict.OK:
                if has_rotor:
                    candidates = scored_explanations(
                        self.white_box,
                        motor.estimate.value[0],
                        analysis.scores,
                        root_mean_square(samples[VOLTAGE]),
                    )
                current_a = np.asarray(self.white_box.state(samples[TORQUE]), dtype=float)
                stamp_suspects = doubts_of_stamps(samples[INTERVAL], current_a, analysis)
                suspects = suspects + stamp_suspects + self._suspects(analysis, candidates)
            if judgement.verdict is FitVerdict.MISFIT and not finding.suspects:
                suspects = self._offsets(motor, analysis) + suspects
            is_poor = judgement.verdict is not FitVerdict.OK
            if is_poor and seems_to_coast(self.white_box, motor.content[:, 0]):
                suspects = [self._of_coasting(analysis), *suspects]
        delay = finding.delay_suspect
        if delay is not None:
            suspects = with_delay(suspects, delay)
        range_v = float(np.ptp(samples[VOLTAGE]))
        is_misfit = judgement.verdict is FitVerdict.MISFIT
        is_ok = judgement.verdict is FitVerdict.OK and not is_held(samples[VOLTAGE])
        speed_is_fitted = motor.measured_rad_s is not None
        is_outweighed = before is not None and before.outweighs(
            count, range_v, speed_is_fitted=speed_is_fitted
        )
        if before is not None and not is_misfit and is_outweighed:
            wait = min(2 * before.wait, LONGEST_WAIT)
            return replace(
                before,
                place=motor.place,
                begin=motor.begin,
                wait=wait,
                evidence=analysis.evidence,
                delay_s=motor.delay.applied_s,
                present_since=motor.present_since,
            )
        assessment = FitAssessment(
            judgement.verdict, analysis.ratio, analysis.whiteness, _first_of_each(suspects),
            analysis.samples,
        )  # fmt: skip
        earlier_misfits = 0 if before is None else before.misfits
        return FitResult(
            assessment,
            judgement,
            motor.estimate.value[0].copy(),
            motor.place,
            motor.begin,
            wait_after(before, judgement.verdict, count),
            range_v,
            1 + earlier_misfits if is_misfit else 0,
            finding.noise_a,
            is_ok or (before is not None and before.has_fitted),
            motor.evidence if is_misfit else analysis.evidence,
            motor.delay.applied_s,
            motor.present_since,
            speed_is_fitted,
            self._doubts_speed(motor),
        )

    def _without_seen_rotor(self, judgement: Judgement, theta: Array, samples: Array) -> Judgement:
        """Leave the resistance open by Kb Kt where a speed of Kt i is nothing but a guess.

        A rotor that is blocked has no back-EMF, and leaves as white a residual. Under a voltage
        that is held all of R may be back-EMF, and L/R the time in which a rotor comes to its speed,
        unless the current rises from rest and stays.
        """
        white_box = self.white_box
        nodes = white_box.context_nodes
        if not self._speed_is_guess or 'resistance' not in nodes:
            return judgement
        place = nodes.index('resistance')
        if is_held(samples[VOLTAGE]) and not _rises_and_stays(samples[TORQUE]):
            if is_held(samples[TORQUE]):
                return with_shift(judgement, place, 1.0)
            return with_shifts(judgement, np.ones((1, theta.size)))
        back_emf_ohm = float(white_box.known.get(BACK_EMF, 0.0)) * float(white_box.torque_constant)
        share = back_emf_ohm / float(theta[place])
        return with_shift(judgement, place, share if share > NOTICEABLE else 0.0)

    def _delay_suspect(self, delay: DelayEstimate) -> Suspect | None:
        name = self.configuration.name
        if delay.complaint(name) is None:
            return None
        evidence = 0.5 * (delay.value_s / max(delay.std_s, 1e-12)) ** 2
        return Suspect('delay', evidence, f'{name}.delay: {delay.value_s:.3g}')

    def _offsets(self, motor: MotorUnderTest, analysis: ResidualAnalysis) -> list[Suspect]:
        """Name an offset of the current where one of the voltage was added and does not suffice."""
        if OFFSET not in self.configuration.added_effects:
            return []
        theta = motor.estimate.value[0]
        values = self.white_box.values(theta)
        amount_v = values[OFFSET]
        explanation = Explanation(
            EFFECTS['current_offset'],
            analysis.whiteness,
            amount_v,
            amount_v,
            values.get('resistance', math.nan),
        )
        return [explanation.suspect(self.configuration.name, float(self.white_box.torque_constant))]

    def _suspects(
        self, analysis: ResidualAnalysis, candidates: Mapping[str, Explanation]
    ) -> list[Suspect]:
        """Name the likely missing effect: by voltage balance if much is wrong, else by free run."""
        scores = {score.effect.name: 0.5 * score.score for score in analysis.scores}
        clearest = _clearest(candidates)
        is_coloured = analysis.whiteness > WHITENESS_DOUBT and analysis.ratio < RATIO_MISFIT
        best_score = max(scores.values(), default=0.0)
        if is_coloured and clearest < CLEARLY and best_score < 0.5 * SCORE_DOUBT:
            return [self._of_colour(analysis)]
        mild = analysis.ratio < MILD and clearest < VERY_CLEARLY
        if scores and (clearest < CLEARLY or mild):
            candidates = {
                effect: replace(candidates[effect], evidence=evidence)
                for effect, evidence in scores.items()
                if effect in candidates
            }
        suspects = [
            self._suspect_of(one) for one in select_explanations(candidates.values(), scores)
        ]
        is_of_load = analysis.whiteness > WHITENESS_DOUBT and analysis.persistence > PERSISTENT
        return suspects if suspects or not is_of_load else [self._of_colour(analysis)]

    def _suspect_of(self, explanation: Explanation) -> Suspect:
        """Name an effect, with a remedy that this form of the motor takes."""
        effect = explanation.effect.name
        name = self.configuration.name
        if self.white_box.has_rotor and effect == 'current_offset':
            return self._of_load(explanation.evidence)
        suspect = explanation.suspect(
            name,
            float(self.white_box.torque_constant),
            float(self.white_box.known.get(BACK_EMF, 0.0)),
        )
        remedies: Mapping[str, str] = {}
        if self.white_box.has_rotor:
            remedies = ROTOR_REMEDIES
        elif self.configuration.estimates_delay:
            remedies = ESTIMATED_REMEDIES
        if effect not in remedies:
            return suspect
        return replace(suspect, remedy=remedies[effect].format(motor=name))

    def _of_colour(self, analysis: ResidualAnalysis) -> Suspect:
        """Name what leaves a residual of one colour: a load on the shaft lasts as a speed does."""
        if analysis.persistence > PERSISTENT:
            return self._of_load(analysis.whiteness)
        return Suspect(COLOURED_NOISE, analysis.whiteness, REMEDIES[COLOURED_NOISE])

    def _of_coasting(self, analysis: ResidualAnalysis) -> Suspect:
        """Name a driver that opens the winding at a command of 0."""
        remedy = REMEDIES[COASTING].format(motor=self.configuration.name)
        return Suspect(COASTING, analysis.whiteness, remedy)

    def _of_load(self, evidence: float) -> Suspect:
        """Name a load on the shaft, as which an offset of the current of a rotor shows, too."""
        remedy = load_remedy(*filter(self.configuration.has_value, LOADS))
        return Suspect(LOAD, evidence, remedy.format(motor=self.configuration.name))


def _clearest(candidates: Mapping[str, Explanation]) -> float:
    """Return the log-likelihood of the best explanation that can be."""
    return max((one.evidence for one in candidates.values() if one.is_credible), default=0.0)


def _knows_inductance(estimate: Estimate) -> bool:
    """Tell whether a motor's inductance is identified: its current was seen to rise or fall."""
    verdicts = zip(estimate.parameters, estimate.verdicts[0], strict=True)
    return any(
        parameter.name == 'inductance' and verdict is Verdict.IDENTIFIED
        for parameter, verdict in verdicts
    )


def _first_of_each(suspects: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return the first few suspects, each effect once."""
    first: dict[str, Suspect] = {}
    for suspect in suspects:
        first.setdefault(suspect.effect, suspect)
    return tuple(first.values())[:MOST_SUSPECTS]


def _rises_and_stays(torque_nm: Array) -> bool:
    """Tell whether a current rises from rest, and no rotor pulls it down again, shape (n,)."""
    size = np.abs(torque_nm)
    largest = float(size.max())
    return bool(size[0] < FROM_REST * largest and size[-1] > RISEN * largest)
