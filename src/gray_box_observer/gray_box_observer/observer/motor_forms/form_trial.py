"""The trial of other forms of the physics, beside the one in force and on remembered samples.

It is done piece by piece. Nothing is read but what is saved with it, so that a restored trial comes
to the same end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
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
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.observer.motor_forms.effect_search import EffectSearch
from gray_box_observer.observer.motor_forms.form_comparison import (
    DOES_NOT,
    FormComparison,
    TrialOutcome,
)
from gray_box_observer.observer.motor_forms.form_fit import FormFit, FormFitter
from gray_box_observer.observer.motor_forms.lag_search import LagSearch
from gray_box_observer.observer.motor_forms.load_search import LOOKS, LoadSearch, look_counts
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, FormKind, MotorForm
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.suspected_effects import USUAL
from gray_box_observer.observer.motor_forms.trial_start import NEWEST, TrialStart
from gray_box_observer.safe_io.saved_state import whole
from gray_box_observer.samples.replay_buffer import INTERVAL, check_signals, with_moves
from gray_box_observer.settings.motor_configuration import COASTING, VARYING_LOAD
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

SHORT_S = 1.0
"""Time over which samples come, from which a load that varies is asked for."""

LONG_S = 2.0
"""The same from which it is adopted: within less it explains most, whatever that is."""

SHORT_SEARCH_WORK, FEW_SEARCH_WORK, SEARCH_WORK = 384, 1536, 2048
"""Work of the search for what a rotor may need, for each sample, at most.

The first is that before a load that varies is asked for, the second that behind it where more
samples are to come. The third is that of all others.
"""

LOSS_WORK = 6144
"""The same of a loss of voltage beside a load that varies."""

ORDER = 3
"""Of the comparisons: a trial that was saved with another one cannot go on."""

CATCH_UP, WORK_A_CATCH = 64, 3072
"""Samples that a form takes over in one piece of work, once it is adopted, and what that costs."""

LONGEST_BACKLOG = 4096
"""Newest samples that have come during a trial, of which the form that is adopted learns."""

_BACKLOG = 'backlog'


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
        self._fitter = FormFitter(open_forms, start.stamp_ns, start.standstill)
        lags = LagSearch(self._fitter, open_forms)
        self._comparison = FormComparison(start, open_forms, lags)
        self._search = EffectSearch(self._fitter, lags, open_forms, start.kind)
        self._loads = LoadSearch(
            self._fitter,
            self._search,
            open_forms,
            start.kind,
            start.content,
            knows_resistance=start.standstill is not None,
        )
        self._misfits: dict[FormKind, FormFit] = {}  # of candidates
        self._fewest_misfit = start.content.shape[2]  # samples that a rotor did not explain
        self._load_fit: FormFit | None = None  # the newest one with a load that varies
        self._load_outcome: TrialOutcome | None = None  # of one without a loss of voltage
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
    def _has_most(self) -> bool:
        """Whether there are as many as a trial rests on at most."""
        return self._start.sample_count >= NEWEST

    @property
    def _span_s(self) -> float:
        """Time over which they come; as many as a trial rests on at most are always enough."""
        return math.inf if self._has_most else float(self._start.content[INTERVAL, 0].sum())

    def _first_better(self) -> Pieces[TrialOutcome]:
        """Compare one form after another, and return the first that is better.

        Of two that are rivals a dead zone has to be clearly better: it is the rarer one. Beside a
        rotor, whose fit costs most, the first counts: what it does not explain tells it later.
        """
        reasons = {}
        for kind, comparison in self._comparisons():
            outcome = yield from comparison
            if outcome.form is not None:
                return (yield from self._best_rival(outcome, kind))
            reasons[kind.in_words] = outcome.reason
        number = self._start.number
        times = f'{number} trials' if number > 1 else 'one trial'
        here = self._start.kind.in_words
        others = ', '.join(f'{words} {reason}' for words, reason in reasons.items())
        because = f'{here} does not explain the data; after {times} {others}'
        return TrialOutcome(None, because)

    def _comparisons(self) -> Iterator[tuple[FormKind, Pieces[TrialOutcome]]]:
        """Yield what is compared next: the candidates, then what rotors that fail may need.

        A rotor that has failed is asked for all that it may need, unless a load that varies
        explains the samples: it explains what acts on the shaft, and nothing that takes voltage.
        """
        candidates = self._start.candidates
        loads = [kind for kind in candidates if VARYING_LOAD in kind.effects]
        is_long = self._span_s >= SHORT_S
        for kind in candidates:
            if VARYING_LOAD not in kind.effects:
                yield kind, self._compare(kind)
            elif kind is not candidates[-1] and is_long and self._leaves_much:
                yield kind, self._compare_load(kind)  # the last one behind short searches
        searches = {kind: self._searched(kind) for kind in self._failures}
        if self._fewest_misfit > LOOKS[0] and not self._has_load:
            for kind in self._failures:
                yield kind, self._compare_searched(searches, kind, SHORT_SEARCH_WORK)
        for kind in loads if is_long and self._leaves_much else ():
            yield kind, self._compare_load(kind)
            yield kind, self._compare_load_beside_loss(kind)
        most_work = SEARCH_WORK if self._has_most else FEW_SEARCH_WORK
        for kind in [*searches] if not self._has_load else ():
            yield kind, self._compare_searched(searches, kind, most_work)

    def _best_rival(self, outcome: TrialOutcome, kind: FormKind) -> Pieces[TrialOutcome]:
        """Return the better one of a form's outcome and those of its rivals, which come behind."""
        candidates = self._start.candidates
        for rival in candidates[candidates.index(kind) + 1 :]:
            if rival in kind.rivals and kind.source != ROTOR:
                other = yield from self._compare(rival)
                outcome = min(outcome, other, key=self._comparison.doubt)
        return outcome

    def _compare_load(self, kind: FormKind) -> Pieces[TrialOutcome]:
        """Compare a rotor with a load that varies, or with what may stand for it; not twice."""
        if self._load_outcome is None:
            self._load_fit = yield from self._loads.alone(kind, self._fewest_misfit)
            self._load_outcome = yield from self._judged_load()
        return self._load_outcome

    def _compare_load_beside_loss(self, kind: FormKind) -> Pieces[TrialOutcome]:
        """Compare the same with a loss of voltage beside; few samples do not tell these apart."""
        fit = self._load_fit
        assert self._load_outcome is not None
        if self._span_s < LONG_S or not (fit is None or fit.is_misfit):
            return self._load_outcome
        work = self._loads.beside_loss(kind, fit, self._fewest_misfit)
        most_work = LOSS_WORK * self._start.sample_count
        self._load_fit = yield from bounded(work, most_work)
        return (yield from self._judged_load())

    def _judged_load(self) -> Pieces[TrialOutcome]:
        """Return what comes of the newest fit with a load that varies."""
        fit = self._load_fit
        if fit is None:
            return TrialOutcome(None, DOES_NOT)
        outcome = yield from self._comparison.judged(fit)
        is_early = VARYING_LOAD in fit.kind.effects and self._span_s < LONG_S
        if outcome.form is not None and is_early:
            return TrialOutcome(None, 'needs more samples')
        return outcome

    @property
    def _failures(self) -> list[FormKind]:
        """Rotors that do not explain the samples."""
        return [kind for kind in self._misfits if kind.source == ROTOR]

    @property
    def _leaves_much(self) -> bool:
        """Whether a rotor, or the form in force, leaves what something else has to explain."""
        return (
            bool(self._failures)
            or self._comparison.leaves_much
            or self._start.standstill is not None
        )

    @property
    def _has_load(self) -> bool:
        """Whether it is likely that a load was left out."""
        return self._load_fit is not None and self._load_fit.explains

    def _compare(self, kind: FormKind) -> Pieces[TrialOutcome]:
        """Fit another form; return it where it explains the data clearly better."""
        fit = yield from self._fitted(kind)
        if fit.is_misfit:
            self._misfits[kind] = fit
        if kind.is_like(self._start.kind):
            self._comparison.leaves_much = fit.leaves_much
        return (yield from self._comparison.judged(fit))

    def _compare_searched(
        self, searches: dict[FormKind, Pieces[FormFit]], kind: FormKind, most_work: int
    ) -> Pieces[TrialOutcome]:
        """Compare a rotor that has failed with whatever it may need beside.

        Args:
            searches: for that, under way; one that ends is taken off.
            kind: of the form that has failed.
            most_work: for each sample.
        """
        fit = yield from bounded(searches[kind], most_work * self._start.sample_count)
        if fit is None:
            return TrialOutcome(None, DOES_NOT)
        del searches[kind]
        return (yield from self._comparison.judged(fit))

    def _searched(self, kind: FormKind) -> Pieces[FormFit]:
        """Fit a rotor to all samples at once, with whatever it may need beside.

        Of forms that stand beside the one in force, and have an effect, only suspects are followed.
        """
        content = self._start.content
        is_base = not kind.effects or kind.is_like(self._start.kind)
        begin = self._misfits[kind]
        if self._fewest_misfit < self._start.sample_count:
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

    def state(self, pieces: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays.

        Args:
            pieces: of the work, done so far.
        """
        plain, arrays = self._start.state()
        plain['pieces'] = pieces
        plain['order'] = ORDER
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
        start = TrialStart.restored(plain, arrays, white_box, kind, number, open_forms)
        pieces = whole(plain, 'pieces', 0, MOST_PIECES)
        backlog: Sequence[Array] = ()
        if _BACKLOG in arrays:
            check_signals(_BACKLOG, arrays[_BACKLOG], longest=2 * LONGEST_BACKLOG)
            backlog = [*with_moves(arrays[_BACKLOG])[:, 0].T.copy()]
        trial = cls(start, open_forms, backlog)
        budget.repeat(trial.work, pieces)
        return trial


def _content(backlog: Sequence[Array]) -> Array:
    """Put samples side by side, shape (signal, 1, n)."""
    return np.stack(backlog, axis=1)[:, None]


def _has_settled(fit: FormFit) -> bool:
    """Tell whether few samples have told anything: what they leave open more of them may tell."""
    return any(verdict is not Verdict.UNEXCITED for verdict in fit.estimate.verdicts[0])
