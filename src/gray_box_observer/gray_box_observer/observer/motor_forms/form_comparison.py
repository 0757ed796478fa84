"""Says whether a form that was fitted explains the data clearly better than the one in force."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.context_nodes.rotor.load_walk import knot_count
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.twin_effects import TOLD_APART
from gray_box_observer.observer.motor_forms.form_fit import FormFit, log_likelihood, settled_count
from gray_box_observer.observer.motor_forms.lag_search import LagSearch
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, FormKind, MotorForm
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.trial_start import TrialStart
from gray_box_observer.settings.motor_configuration import CURRENT_LAG, DEAD_ZONE, VARYING_LOAD
from gray_box_observer.settings.sensor_lag import CurrentLag, FilterKind

EVIDENCE = 50.0
"""Log-likelihood that the other form must bring. Drawn rotors bring 180 and more, and a rotor
brings nothing where there is none."""

HALF = 0.5
"""Share of the residual that the other form may leave where its own test warns."""

LATE, LATE_WORK = 384, 131072
"""Newest samples that are asked whether a noisy or late speed explains them as well, before an
effect is added beside a measured speed, and the work of that, at most."""

DOES_NOT = 'does not either'
"""Why a form is not adopted that does not explain the samples."""

_RESISTANCE = 'resistance'
_DECISIVE: tuple[str, ...] = (_RESISTANCE, 'inertia')

_KIND_IN_WORDS = {
    FilterKind.FIRST_ORDER: '',
    FilterKind.MOVING_AVERAGE: ', that of a moving average',
    FilterKind.INTERVAL_MEAN: ', for readings are means of their intervals',
}


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


class FormComparison:
    """Compares forms of one motor with the one in force.

    Args:
        start: what the trial begins with.
        open_forms: that the motor may take.
        lags: finds the lag that a form needs.

    Attributes:
        leaves_much: whether the form in force does, where it was fitted to the samples anew.
    """

    def __init__(self, start: TrialStart, open_forms: OpenForms, lags: LagSearch) -> None:
        self._start = start
        self._open = open_forms
        self._lags = lags
        self.leaves_much = False

    def judged(self, fit: FormFit) -> Pieces[TrialOutcome]:
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
            if (yield from self._lags.is_delay(fit, content)):
                return TrialOutcome(None, 'explains them no better than a delay of the voltage')
            fit = yield from self._lags.weighed(fit, content)
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

    def _compare_lag(self, fit: FormFit) -> Pieces[TrialOutcome]:
        """Return a form with another lag where its order is told, or it explains clearly more.

        Args:
            fit: of the form in force, with a lag that was found anew.
        """
        start = self._start
        content = start.content
        same = self._open.make(start.kind)
        yield from same.learn_remembered(content, start.stamp_ns)
        fit = yield from self._lags.weighed(fit, content)
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

    def doubt(self, outcome: TrialOutcome) -> float:
        """Return by how much an outcome is the worse one of two that are rivals."""
        is_rare = outcome.kind is not None and DEAD_ZONE in outcome.kind.effects
        log_likelihood = -float(self._start.sample_count) * math.log(max(outcome.left_a, 1e-300))
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
        if VARYING_LOAD in fit.kind.effects and not self.leaves_much:
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


def _explains(fit: FitAssessment, left_a: float, before_a: float) -> bool:
    """Tell whether a form explains the data: its test is passed, or nearly and by far better."""
    if fit.verdict is FitVerdict.WARNING:
        return left_a < HALF * before_a
    return fit.verdict is FitVerdict.OK


def _is_told(fit: FormFit) -> bool:
    """Tell whether the data tell what a form stands on: beside a load that varies R alone."""
    decisive = _DECISIVE
    if VARYING_LOAD in fit.kind.effects and _RESISTANCE in fit.form.white_box.context_nodes:
        decisive = (_RESISTANCE,)
    return all(map(fit.tells, decisive))


def _on_lag(lag: CurrentLag | None) -> str:
    """Say how long a lag of the current is, and whether it may be the winding's."""
    if lag is None:
        return ''
    order_text = ''
    if lag.other_order:
        order_text = f' and L/R {1e3 * lag.winding_s:.3g} ms, or the other way round'
    kind_text = '' if lag.other_kind else _KIND_IN_WORDS[lag.filter_kind]
    return f'; the lag is {1e3 * lag.lag_s:.3g} ms{kind_text}{order_text}'
