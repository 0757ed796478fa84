"""The trial of other forms of the physics, beside the one in force and on remembered samples.

It is done piece by piece. Nothing is read but what is saved with it, so that a restored trial comes
to the same end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.estimate import Verdict
from gray_box_observer.context_nodes.pieces import (
    FINISHED,
    MOST_PIECES,
    Pieces,
    WorkBudget,
    bounded,
)
from gray_box_observer.context_nodes.rotor.breakaway_start import begins_held
from gray_box_observer.context_nodes.rotor.load_walk import knot_count
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_learner import FEWEST_MOVES
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.twin_effects import TOLD_APART
from gray_box_observer.observer.effect_search import EffectSearch
from gray_box_observer.observer.form_fit import FormFit, FormFitter, log_likelihood, settled_count
from gray_box_observer.observer.load_search import LOOKS, LoadSearch, look_counts
from gray_box_observer.observer.motor_form import MEASURED, ROTOR, FormKind, MotorForm
from gray_box_observer.observer.open_forms import OpenForms
from gray_box_observer.observer.suspected_effects import USUAL
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    LATEST_NS,
    entry,
    number_or_none,
    whole,
)
from gray_box_observer.samples.replay_buffer import INTERVAL, check_signals, with_moves
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    DEAD_ZONE,
    VARYING_LOAD,
)
from gray_box_observer.settings.sensor_lag import LONGEST_MEMORY, CurrentLag, FilterKind
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

NEWEST = 2048
"""Samples that a trial rests on, at most."""

SHORT_S = 1.0
"""Time over which samples come, from which a load that varies is asked for."""

LONG_S = 2.0
"""The same from which it is adopted: within less it explains most, whatever that is."""

SHORT_SEARCH_WORK, FEW_SEARCH_WORK, SEARCH_WORK = 384, 1536, 8192
"""Work of the search for what a rotor may need, for each sample, at most: before a load that varies
is asked for, behind it where more samples are to come, and else."""

FEW_CANDIDATES = 4
"""Forms that one trial compares, at most, beside one with a load that varies."""

MOST_CANDIDATES = FEW_CANDIDATES + 1

LARGEST_STD = 0.25
"""Relative standard deviation of resistance and inertia up to which they are told. Samples that
come more slowly than L/R say nothing of the inductance, and a rotor shows all the same."""

EVIDENCE = 50.0
"""Log-likelihood that the other form must bring. Drawn rotors bring 180 and more, and a rotor
brings nothing where there is none."""

HALF = 0.5
"""Share of the residual that the other form may leave where its own test warns."""

LATE, LATE_WORK = 384, 131072
"""Newest samples that are asked whether a noisy or late speed explains them as well, before an
effect is added beside a measured speed, and the work of that, at most."""

CATCH_UP, WORK_A_CATCH = 64, 3072
"""Samples that a form takes over in one piece of work, once it is adopted, and what that costs."""

LONGEST_BACKLOG = 4096
"""Newest samples that have come during a trial, of which the form that is adopted learns."""

DOES_NOT = 'does not either'
"""Why a form is not adopted that does not explain the samples."""

_RESISTANCE = 'resistance'
_DECISIVE = (_RESISTANCE, 'inertia')

_KINDS = [*FilterKind]
_KIND_IN_WORDS = {
    FilterKind.FIRST_ORDER: '',
    FilterKind.MOVING_AVERAGE: ', that of a moving average',
    FilterKind.INTERVAL_MEAN: ', for readings are means of their intervals',
}

_TRIAL = 'trial'
_BACKLOG = 'backlog'


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """What a trial has ended with.

    Attributes:
        form: that the motor goes over to; None: it keeps its own.
        reason: why.
        kind: of the form.
        left_a: root mean square in A of the residual that it leaves.
    """

    form: MotorForm | None
    reason: str
    kind: FormKind | None = None
    left_a: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class TrialStart:
    """What a trial begins with.

    Attributes:
        kind: of the form in force.
        candidates: the forms that are tried, one after another.
        parameters: how many the form in force has.
        number: of the trial, counted from 1.
        content: shape (signal, 1, n): samples that it rests on.
        stamp_ns: of the newest of them.
        before_a: root mean square in A of the residual that the form in force leaves of them.
    """

    kind: FormKind
    candidates: tuple[FormKind, ...]
    parameters: int
    number: int
    content: Array
    stamp_ns: int
    before_a: float


class FormTrial:
    """The trial under way.

    Args:
        start: what it begins with.
        open_forms: that the motor may take.
        backlog: samples that have come since, shape (signal,) each.

    Attributes:
        backlog: as above; of very many the newest.
        adopted_count: how many of them a form that was found has learnt; None: none was found yet.
        work: what is to be done.
    """

    def __init__(
        self, start: TrialStart, open_forms: OpenForms, backlog: Sequence[Array] = ()
    ) -> None:
        self._start = start
        self._open = open_forms
        self._fitter = FormFitter(open_forms, start.stamp_ns)
        self._search = EffectSearch(self._fitter, open_forms, start.kind)
        self._loads = LoadSearch(self._fitter, self._search, open_forms, start.kind, start.content)
        self._misfits: dict[FormKind, FormFit] = {}  # of candidates
        self._fewest_misfit = start.content.shape[2]  # samples that a rotor did not explain
        self._leaves_much = False  # the form in force, where it was fitted to the samples anew
        self.backlog = list(backlog)
        self.adopted_count: int | None = None
        self.work = self._steps()

    def keep(self, samples: Array) -> None:
        """Remember samples that have come, shape (signal, 1, n); of very many the newest."""
        self.backlog.extend(samples[:, 0].T.copy())
        excess_count = len(self.backlog) - LONGEST_BACKLOG
        if excess_count > 0 and self.adopted_count is None:
            del self.backlog[:excess_count]
            self.backlog[0][INTERVAL] = 0.0  # the signal history begins here

    def finish(self, budget: WorkBudget) -> TrialOutcome | None:
        """Do what is left, within bounds; None where that is too much."""
        work_count = 0
        while work_count < FINISHED:
            try:
                work_count += next(self.work)
            except StopIteration as end:
                outcome: TrialOutcome = end.value
                return outcome
            budget.pieces += 1
        return None

    def hand_over(self, form: MotorForm, stamp_ns: int) -> None:
        """Let the form that is adopted learn what is left of the backlog.

        Args:
            form: it.
            stamp_ns: of the newest sample.
        """
        rest = self.backlog[self.adopted_count or 0 :]
        if rest:
            form.catch_up(_content(rest), stamp_ns)

    def _steps(self) -> Pieces[TrialOutcome]:
        """Find a better form, which takes over what has come since."""
        outcome = yield from self._first_better()
        if outcome.form is None:
            return outcome
        form = outcome.form
        assert form is not None
        self.adopted_count = 0
        while len(self.backlog) - self.adopted_count > CATCH_UP:
            part = self.backlog[self.adopted_count : self.adopted_count + CATCH_UP]
            form.catch_up(_content(part), self._start.stamp_ns)
            self.adopted_count += CATCH_UP
            yield WORK_A_CATCH
        return outcome

    @property
    def _count(self) -> int:
        """How many samples there are."""
        return int(self._start.content.shape[2])

    @property
    def _has_most(self) -> bool:
        """Whether there are as many as a trial rests on at most."""
        return self._count >= NEWEST

    @property
    def _span_s(self) -> float:
        """Time over which they come; as many as a trial rests on at most are always enough."""
        return math.inf if self._has_most else float(self._start.content[INTERVAL, 0].sum())

    def _first_better(self) -> Pieces[TrialOutcome]:
        """Compare every candidate, and return the first that is better.

        Of two that are rivals a dead zone has to be clearly better: it is the rarer one. Beside a
        rotor, whose fit costs most, the first counts: what it does not explain tells it later. A
        rotor that has failed is asked for all that it may need, unless a load that varies explains
        the samples: it explains what acts on the shaft, and nothing that takes voltage.
        """
        reasons = {}
        candidates = self._start.candidates
        kinds = [kind for kind in candidates if VARYING_LOAD not in kind.effects]
        for place, kind in enumerate(kinds):
            outcome = yield from self._compare(kind)
            if outcome.form is not None:
                return (yield from self._best_rival(outcome, kind, kinds[place + 1 :]))
            reasons[kind.in_words] = outcome.reason
        failures = [kind for kind in kinds if kind.source == ROTOR and kind in self._misfits]
        searches = {kind: self._searched(kind) for kind in failures}
        for kind in failures if self._fewest_misfit > LOOKS[0] else ():
            outcome = yield from self._compare_searched(searches, kind, SHORT_SEARCH_WORK)
            if outcome.form is not None:
                return outcome
        has_load = False
        loads = [kind for kind in candidates if VARYING_LOAD in kind.effects]
        is_needed = bool(failures) or self._leaves_much
        for kind in loads[-1:] if is_needed and self._span_s >= SHORT_S else ():
            outcome, has_load = yield from self._compare_load(kind)
            if outcome.form is not None:
                return outcome
            reasons[kind.in_words] = outcome.reason
        most_work = SEARCH_WORK if self._has_most else FEW_SEARCH_WORK
        for kind in [*searches] if not has_load else ():
            outcome = yield from self._compare_searched(searches, kind, most_work)
            if outcome.form is not None:
                return outcome
            reasons[kind.in_words] = outcome.reason
        number = self._start.number
        times = f'{number} trials' if number > 1 else 'one trial'
        here = self._start.kind.in_words
        others = ', '.join(f'{words} {reason}' for words, reason in reasons.items())
        because = f'{here} does not explain the data; after {times} {others}'
        return TrialOutcome(None, because)

    def _best_rival(
        self, outcome: TrialOutcome, kind: FormKind, others: Sequence[FormKind]
    ) -> Pieces[TrialOutcome]:
        """Return the better one of a form's outcome and those of its rivals."""
        for rival in others:
            if rival in kind.rivals and kind.source != ROTOR:
                other = yield from self._compare(rival)
                outcome = min(outcome, other, key=self._doubt)
        return outcome

    def _compare_load(self, kind: FormKind) -> Pieces[tuple[TrialOutcome, bool]]:
        """Compare a rotor with a load that varies, and with what may stand for it or beside it.

        Few samples do not tell it from what takes voltage.

        Returns:
            The outcome, and whether it is likely that a load was left out.
        """
        fewest = self._fewest_misfit
        fit = yield from self._loads.alone(kind, fewest)
        if (fit is None or fit.is_misfit) and self._span_s >= LONG_S:
            fit = yield from self._loads.beside_loss(kind, fit, fewest)
        if fit is None:
            return TrialOutcome(None, DOES_NOT), False
        outcome = yield from self._judged(fit)
        is_early = VARYING_LOAD in fit.kind.effects and self._span_s < LONG_S
        if outcome.form is not None and is_early:
            outcome = TrialOutcome(None, 'needs more samples')
        return outcome, fit.explains

    def _compare(self, kind: FormKind) -> Pieces[TrialOutcome]:
        """Fit another form; return it where it explains the data clearly better."""
        fit = yield from self._fitted(kind)
        if fit.is_misfit:
            self._misfits[kind] = fit
        if kind.is_like(self._start.kind):
            self._leaves_much = fit.leaves_much
        return (yield from self._judged(fit))

    def _judged(self, fit: FormFit) -> Pieces[TrialOutcome]:
        """Return a form that was fitted, where it explains the data clearly better."""
        start = self._start
        content = self._start.content
        before_a = start.before_a
        kind = fit.kind
        if fit.is_misfit:
            return TrialOutcome(None, self._why_not(fit))
        if CURRENT_LAG in kind.effects and kind.lag is None:
            return TrialOutcome(None, 'cannot be told from them')
        if kind == start.kind:
            return TrialOutcome(None, self._why_not(fit))
        if kind.is_same_but_for_lag(start.kind):
            return (yield from self._compare_lag(fit))
        left_a = fit.form.residual(content, fit.settle_s)
        if self._is_better(fit, left_a, before_a):
            same = self._open.make(start.kind)  # the form in force may be in the midst of learning
            yield from same.learn_remembered(content, start.stamp_ns)
            same_a = same.residual(content, fit.settle_s)
            before_a = same_a if fit.settle_s else min(before_a, same_a)
        if self._is_better(fit, left_a, before_a):
            if (yield from self._fitter.is_delay(fit, content)):
                return TrialOutcome(None, 'explains them no better than a delay of the voltage')
            fit = yield from self._fitter.weighed(fit, content)
            left_a = fit.form.residual(content, fit.settle_s)
        kind = fit.kind
        if not self._is_better(fit, left_a, before_a):
            return TrialOutcome(None, self._why_not(fit))
        if start.kind.source == kind.source == MEASURED:
            late = self._open.make(start.kind)
            newest = content[:, :, -LATE:]
            work = late.learn_remembered(newest, start.stamp_ns, asks_speed=True)
            yield from bounded(work, LATE_WORK)
            if late.fit.assessment(0).verdict in (FitVerdict.OK, FitVerdict.WARNING):
                return TrialOutcome(None, 'is not needed: the measured speed is noisy or late')
        return self._outcome(fit, left_a, before_a)

    def _compare_searched(
        self, searches: dict[FormKind, Pieces[FormFit]], kind: FormKind, most_work: int
    ) -> Pieces[TrialOutcome]:
        """Compare a rotor that has failed with whatever it may need beside.

        Args:
            searches: for that, under way; one that ends is taken off.
            kind: of the form that has failed.
            most_work: for each sample.
        """
        fit = yield from bounded(searches[kind], most_work * self._count)
        if fit is None:
            return TrialOutcome(None, DOES_NOT)
        del searches[kind]
        return (yield from self._judged(fit))

    def _searched(self, kind: FormKind) -> Pieces[FormFit]:
        """Fit a rotor to all samples at once, with whatever it may need beside.

        Of forms that stand beside the one in force, and have an effect, only suspects are followed.
        """
        content = self._start.content
        is_base = not kind.effects or kind.is_like(self._start.kind)
        begin = self._misfits[kind]
        if self._fewest_misfit < self._count:
            begin = yield from self._fitter.first(kind, content)
        return (yield from self._search.explained(begin, content, USUAL if is_base else ()))

    def _fitted(self, kind: FormKind) -> Pieces[FormFit]:
        """Fit another form to ever more of the samples, until they are no longer explained.

        Few samples tell at a fraction of the cost what they do not explain.
        """
        content = self._start.content
        total = content.shape[2]
        form = self._open.make(kind)
        is_held = kind.source == ROTOR and begins_held(
            form.white_box, Window.from_samples(form.white_box, form.driven(content)[:, 0])
        )
        for count in look_counts(total):
            part = content[:, :, :count] if is_held else content[:, :, -count:]
            fit = yield from self._fitter.first(kind, part, form)
            fit = yield from self._search.explained(fit, part)
            kind = fit.kind
            form = fit.form
            may_settle = kind.source != ROTOR or COASTING in kind.effects
            is_open = may_settle and count < total and not _has_settled(fit)
            if fit.is_misfit and not is_open:
                if kind.source == ROTOR:
                    self._fewest_misfit = min(self._fewest_misfit, count)
                break
        return fit

    def _compare_lag(self, fit: FormFit) -> Pieces[TrialOutcome]:
        """Return a form with another lag where its order is told, or it explains clearly more.

        Args:
            fit: of the form in force, with a lag that was found anew.
        """
        start = self._start
        content = start.content
        same = self._open.make(start.kind)
        yield from same.learn_remembered(content, start.stamp_ns)
        fit = yield from self._fitter.weighed(fit, content)
        left_a = fit.form.residual(content, fit.settle_s)
        before_a = same.residual(content, fit.settle_s)
        lag = fit.kind.lag
        before = start.kind.lag
        assert lag is not None
        is_told = before is not None and len(lag.rivals) < len(before.rivals)
        gain = self._gain(fit, left_a, before_a)
        if fit.is_misfit or not gain > (-TOLD_APART if is_told else TOLD_APART):
            return TrialOutcome(None, self._why_not(fit))
        return self._outcome(fit, left_a, before_a)

    def _outcome(self, fit: FormFit, left_a: float, before_a: float) -> TrialOutcome:
        """Return a form that is adopted, with the reason.

        Args:
            fit: of the form.
            left_a: root mean square in A of the residual that it leaves.
            before_a: the same of the form in force.
        """
        kind = fit.kind
        assessment = fit.form.fit.assessment(0)
        return TrialOutcome(
            fit.form,
            f'{kind.in_words} explains the data: the residual of its free run is '
            f'{assessment.ratio:.3g} times the noise, that of {self._start.kind.in_words} '
            f'{assessment.ratio * before_a / left_a:.3g} times (log-likelihood '
            f'{self._gain(fit, left_a, before_a):.3g}){_on_lag(kind.lag)}',
            kind,
            left_a,
        )

    def _doubt(self, outcome: TrialOutcome) -> float:
        """Return by how much an outcome is the worse one of two that are rivals."""
        is_rare = outcome.kind is not None and DEAD_ZONE in outcome.kind.effects
        log_likelihood = -float(self._count) * math.log(max(outcome.left_a, 1e-300))
        return EVIDENCE * is_rare - log_likelihood

    def _is_better(self, other: FormFit, left_a: float, before_a: float) -> bool:
        """Tell whether the other form explains the data clearly better, and is told by them.

        Args:
            other: it.
            left_a: root mean square in A of the residual that it leaves.
            before_a: the same of the form in force.
        """
        return (
            _explains(other.form.fit.assessment(0), left_a, before_a)
            and _is_told(other)
            and self._gain(other, left_a, before_a) > EVIDENCE
        )

    def _gain(self, fit: FormFit, left_a: float, before_a: float) -> float:
        """Return the log-likelihood that a form brings, less what its parameters cost (BIC).

        A load that varies costs nothing beside a rotor of which nothing is believed.
        """
        count = settled_count(self._start.content, fit.settle_s)
        if not (left_a > 0.0 and np.isfinite(before_a)):
            return 0.0 if left_a > 0.0 else -math.inf
        if count == 0:
            return -math.inf
        parameters = len(fit.estimate.parameters) - self._start.parameters
        if VARYING_LOAD in fit.kind.effects and not self._leaves_much:
            samples = fit.form.driven(self._start.content)[:, 0]
            parameters += knot_count(Window.from_samples(fit.form.white_box, samples))
        cost = 0.5 * parameters * math.log(count)
        return log_likelihood(count, before_a, left_a) - cost

    @staticmethod
    def _why_not(fit: FormFit) -> str:
        """Say why another form is not adopted."""
        if fit.is_misfit:
            return DOES_NOT
        is_tested = fit.form.fit.assessment(0).verdict is not FitVerdict.UNTESTED
        if not (is_tested and _is_told(fit)):
            return 'cannot be told from them'
        return 'explains them hardly better'

    def state(self, pieces: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays.

        Args:
            pieces: of the work, done so far.
        """
        before_a = self._start.before_a
        plain = {
            'stamp_ns': self._start.stamp_ns,
            'before_a': before_a if math.isfinite(before_a) else None,
            'pieces': pieces,
            'candidates': [
                [kind.source, *kind.effects, *_numbers_of(kind)] for kind in self._start.candidates
            ],
        }
        arrays = {_TRIAL: self._start.content.copy()}
        if self.backlog:
            arrays[_BACKLOG] = _content(self.backlog)
        return plain, arrays

    @classmethod
    def restored(
        cls,
        plain: Mapping[str, Any],
        arrays: Mapping[str, Array],
        white_box: MotorWhiteBox,
        kind: FormKind,
        number: int,
        open_forms: OpenForms,
        budget: WorkBudget,
    ) -> FormTrial:
        """Return the trial that :meth:`state` gave; pieces that had been done are done again.

        Args:
            plain: of a state.
            arrays: of the same.
            white_box: the physics in force.
            kind: of that form.
            number: of the trial, counted from 1.
            open_forms: as above.
            budget: what the pieces are counted in.

        Raises:
            CheckpointError: it is no state that a trial could have been in.
        """
        check_signals(_TRIAL, arrays.get(_TRIAL), longest=NEWEST)
        if not Window.from_samples(white_box, arrays[_TRIAL][:, 0]).moves:
            raise CheckpointError(f'{_TRIAL} holds samples that no trial begins with')
        before_a = number_or_none(plain, 'before_a', 0.0, LARGEST)
        stamp_ns = whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
        pieces = whole(plain, 'pieces', 0, MOST_PIECES)
        backlog: Sequence[Array] = ()
        if _BACKLOG in arrays:
            check_signals(_BACKLOG, arrays[_BACKLOG], longest=2 * LONGEST_BACKLOG)
            backlog = [*with_moves(arrays[_BACKLOG])[:, 0].T.copy()]
        start = TrialStart(
            kind,
            _saved_candidates(plain, kind, open_forms),
            len(white_box.parameters),
            number,
            with_moves(arrays[_TRIAL]),
            stamp_ns,
            math.inf if before_a is None else before_a,
        )
        trial = cls(start, open_forms, backlog)
        budget.repeat(trial.work, pieces)
        return trial


def _saved_candidates(
    plain: Mapping[str, Any], kind: FormKind, open_forms: OpenForms
) -> tuple[FormKind, ...]:
    """Return the candidates of a saved trial.

    Raises:
        CheckpointError: they are none that could be tried.
    """
    if 'candidates' in plain:
        entries = entry(plain, 'candidates')
    else:  # of a release that tried the source of the speed alone
        other = kind.with_other_source
        entries = [] if other is None else [[other.source]]
    if isinstance(entries, list) and 0 < len(entries) <= MOST_CANDIDATES:
        kinds = tuple(_kind_of(one) for one in entries if isinstance(one, list) and one)
        if (
            len(kinds) == len(entries)
            and (kind not in kinds or kind.source == ROTOR)
            and all(map(open_forms.contains, kinds))
        ):
            return kinds
    raise CheckpointError('speed.trial.candidates are no forms that could be tried')


def _on_lag(lag: CurrentLag | None) -> str:
    """Say how long a lag of the current is, and whether it may be the winding's."""
    if lag is None:
        return ''
    order_text = ''
    if lag.other_order:
        order_text = f' and L/R {1e3 * lag.winding_s:.3g} ms, or the other way round'
    kind_text = '' if lag.other_kind else _KIND_IN_WORDS[lag.filter_kind]
    return f'; the lag is {1e3 * lag.lag_s:.3g} ms{kind_text}{order_text}'


def _numbers_of(kind: FormKind) -> list[float]:
    """Return what is saved of a form behind the names of its effects."""
    if kind.lag is not None:
        lag = kind.lag
        place = float(_KINDS.index(lag.filter_kind))
        return [kind.dead_zone_v, lag.lag_s, lag.winding_s, lag.memory, place]
    return [kind.dead_zone_v] if kind.dead_zone_v else []


def _kind_of(entries: list[Any]) -> FormKind:
    """Return the form that was saved, whatever it is."""
    names = [one for one in entries if not isinstance(one, float)]
    zone_v, *numbers = [one for one in entries if isinstance(one, float)] or [0.0]
    lag = None
    if numbers:
        if len(numbers) not in (2, 4):
            return FormKind('')
        lag_s, winding_s, memory, place = [*numbers, 0.0, 0.0][:4]  # early releases: two
        if place not in range(len(_KINDS)) or not abs(memory) <= LONGEST_MEMORY:
            return FormKind('')
        lag = CurrentLag(lag_s, winding_s, (), memory, _KINDS[int(place)])
    return FormKind(names[0] if names else '', tuple(names[1:]), zone_v, lag)


def _content(backlog: Sequence[Array]) -> Array:
    """Put samples side by side, shape (signal, 1, n)."""
    return np.stack(backlog, axis=1)[:, None]


def can_tell(white_box: MotorWhiteBox, content: Array, largest_v: float) -> bool:
    """Tell whether the voltage has moved often enough to tell a rotor, or an effect.

    Args:
        white_box: of the motor.
        content: shape (signal, 1, n): samples.
        largest_v: voltage that has driven the motor before.
    """
    window = Window.from_samples(white_box, content[:, 0])
    return replace(window, voltage_elsewhere_v=largest_v).moves >= FEWEST_MOVES


def _explains(fit: FitAssessment, left_a: float, before_a: float) -> bool:
    """Tell whether a form explains the data: its test is passed, or nearly and by far better."""
    if fit.verdict is FitVerdict.WARNING:
        return left_a < HALF * before_a
    return fit.verdict is FitVerdict.OK


def _has_settled(fit: FormFit) -> bool:
    """Tell whether few samples have told anything: what they leave open more of them may tell."""
    return any(verdict is not Verdict.UNEXCITED for verdict in fit.estimate.verdicts[0])


def _is_told(fit: FormFit) -> bool:
    """Tell whether the data tell what a form stands on: beside a load that varies R alone."""
    estimate = fit.estimate
    decisive: tuple[str, ...] = _DECISIVE
    if VARYING_LOAD in fit.kind.effects and fit.form.white_box.context_nodes.count(_RESISTANCE):
        decisive = (_RESISTANCE,)
    return all(
        estimate.std[0, j] < LARGEST_STD * estimate.value[0, j]
        for j, parameter in enumerate(estimate.parameters)
        if parameter.name in decisive
    )
