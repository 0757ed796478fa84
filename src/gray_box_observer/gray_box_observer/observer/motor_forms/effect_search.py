"""Looks for the effects that a rotor on trial needs, where more than one may act.

Effects are added one by one, as the fit test suspects them, until a fit explains the samples
(forward selection). What the others make needless goes again (backward elimination; Draper and
Smith, Applied Regression Analysis, 1998, chapter 15; docs/METHOD.md, Which effects).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.fit_test.coasting import seems_to_coast
from gray_box_observer.fit_test.twin_effects import TOLD_APART
from gray_box_observer.observer.motor_forms.form_fit import FormFit, FormFitter, likelihood_gain
from gray_box_observer.observer.motor_forms.lag_search import LagSearch
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.suspected_effects import suspected_beside_rotor
from gray_box_observer.settings.motor_configuration import COASTING, CURRENT_LAG, VARYING_LOAD
from gray_box_observer.white_box.interface import Array

MOST_EFFECTS = 4
"""Effects that one motor gets at most; an offset of the current is two beside a hidden speed."""

EVIDENCE = 50.0
"""Log-likelihood by which an effect that does not yet explain the samples has to better the fit."""

SLIGHT = 0.1
"""The same for each sample: the residual is a tenth smaller then."""

WORTHWHILE = 0.25
"""The same for each sample, from which no other effect is compared: the residual is a fifth smaller
then, and what turns out to be needless goes again."""


class EffectSearch:
    """Fits forms of one motor to samples, and adds what a rotor needs.

    Args:
        fitter: of the forms.
        lags: finds the lag that they need.
        open_forms: that the motor may take.
        in_force: the form that has failed: it is no result.
    """

    def __init__(
        self, fitter: FormFitter, lags: LagSearch, open_forms: OpenForms, in_force: FormKind
    ) -> None:
        self._fitter = fitter
        self._lags = lags
        self._open = open_forms
        self._in_force = in_force

    def explained(
        self,
        fit: FormFit,
        content: Array,
        further: Sequence[tuple[str, ...]] = (),
        *,
        follows_suspects: bool = True,
    ) -> Pieces[FormFit]:
        """Settle a form, and add effects to a rotor until it explains the samples.

        Where no effects do, the form with the last one that bettered the fit is a misfit.

        Args:
            fit: of the form.
            content: shape (signal, 1, n): the samples.
            further: effects that are tried behind those that are suspected, some together.
            follows_suspects: whether any are tried that are suspected.
        """
        fit = yield from self._lags.settled(fit, content)
        plain = fit
        newest: tuple[str, ...] = ()
        while self._needs_more(fit):
            suspects = self._suspected(fit, content) if follows_suspects else []
            effects = dict.fromkeys([*suspects, *further])
            other = yield from self._with_one_more(fit, effects, content)
            if other is None:
                return fit
            newest = tuple(name for name in other.kind.effects if name not in fit.kind.effects)
            fit = other
        if fit is plain:
            return fit
        return (yield from self._without_needless(fit, newest, content))

    @staticmethod
    def _suspected(fit: FormFit, content: Array) -> list[tuple[str, ...]]:
        """Return effects that leave what a form leaves, the likeliest first."""
        suspects = suspected_beside_rotor(fit.form.fit.assessment(0))
        may_coast = seems_to_coast(fit.form.white_box, content[:, 0], fewest=1)
        return [(COASTING,), *suspects] if may_coast else suspects  # it looks like brushes, too

    def _needs_more(self, fit: FormFit) -> bool:
        """Tell whether a form is a rotor that may get another effect, and needs one.

        A filter of the current explains too much with another one beside. So does a load that
        varies, but for a loss of voltage (:mod:`load_search`).
        """
        kind = fit.kind
        is_flexible = CURRENT_LAG in kind.effects or VARYING_LOAD in kind.effects
        may_grow = not is_flexible and len(kind.effects) < MOST_EFFECTS
        return kind.source == ROTOR and may_grow and (fit.leaves_much or self._is_in_force(kind))

    def _is_in_force(self, kind: FormKind) -> bool:
        return kind.is_like(self._in_force)

    def _with_one_more(
        self, fit: FormFit, effects: Iterable[tuple[str, ...]], content: Array
    ) -> Pieces[FormFit | None]:
        """Add the first effect that explains the samples, or the one that betters the fit most.

        Args:
            fit: without it.
            effects: to choose from, some together.
            content: shape (signal, 1, n): the samples.
        """
        best = None
        count = content.shape[2]
        most = max(EVIDENCE, SLIGHT * count)
        for nodes in effects:
            kind = fit.kind.with_effects(nodes)
            is_new = kind != fit.kind and not self._is_in_force(kind)
            is_possible = len(kind.effects) <= MOST_EFFECTS and self._open.contains(kind)
            if not (is_new and is_possible):
                continue
            other = yield from self._quick_fit(kind, fit, content)
            if not other.leaves_much:
                other = yield from self._fitter.again(other.kind, other, content)
            gain = likelihood_gain(other, fit, content)
            if not other.leaves_much and (fit.leaves_much or gain > TOLD_APART):
                return other
            if gain > most:
                best = other
                most = gain
            if gain > WORTHWHILE * count:
                break
        return best

    def _quick_fit(self, kind: FormKind, before: FormFit, content: Array) -> Pieces[FormFit]:
        """Fit a rotor with other effects, from where it stands without: a quick look.

        Args:
            kind: with these effects.
            before: with those that it has.
            content: shape (signal, 1, n): the samples.
        """
        fit = yield from self._fitter.again(kind, before, content, searches_elsewhere=False)
        return (yield from self._lags.settled(fit, content))

    def _without_needless(
        self, fit: FormFit, newest: tuple[str, ...], content: Array
    ) -> Pieces[FormFit]:
        """Take off again each effect without which the samples are explained as well.

        Args:
            fit: that explains them.
            newest: effects without which they were not.
            content: shape (signal, 1, n): the samples.
        """
        for effect in fit.kind.effects:
            kind = fit.kind.without(effect)
            if newest == (effect,) or self._is_in_force(kind):
                continue
            other = yield from self._quick_fit(kind, fit, content)
            if not other.leaves_much and likelihood_gain(fit, other, content) < TOLD_APART:
                fit = yield from self._fitter.again(other.kind, other, content)
        return fit
