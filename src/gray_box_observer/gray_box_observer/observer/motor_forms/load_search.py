"""Asks whether a load that varies explains what a rotor on trial leaves, and what stands for it.

A load that varies explains what acts on the shaft, and nothing that takes voltage. So it tells the
winding apart from the rest. Effects on the shaft that explain as much tell more: they stand for it.
A loss of voltage may stand beside it (docs/METHOD.md, A load that varies).
"""

from __future__ import annotations

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.observer.motor_forms.effect_search import EVIDENCE, EffectSearch
from gray_box_observer.observer.motor_forms.form_fit import FormFit, FormFitter, likelihood_gain
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.suspected_effects import BESIDE_A_LOAD, ON_THE_SHAFT
from gray_box_observer.settings.motor_configuration import VARYING_LOAD
from gray_box_observer.white_box.interface import Array

LOOKS = (512, 1024)
"""Newest samples of a trial that are tried first: what explains not even these is given up at a
fraction of the cost."""

LAST_LOOK = 1.5
"""Factor from one look with such a load to the last one at least.

For fewer samples more a rotor is not fitted again. What a load has done before says nothing of
those.
"""

SHAFT_EFFECTS = frozenset(name for nodes in ON_THE_SHAFT for name in nodes)
"""Effects that may stand for a load that varies."""

SURE = 4.0
"""Standard deviations from nothing from which a loss of voltage beside it shows."""

LOOK_WORK = 2048
"""Work of a fit to a look, for each of its samples, at most: what no load explains takes long."""

TOLD_LOAD_WORK = 512
"""Work of the search for what may stand for a load that varies, for each sample, at most."""


def look_counts(total: int, fewest: int = 0, growth: float = 1.0) -> list[int]:
    """Return how many samples the looks of a trial have, at last all of them.

    Args:
        total: how many there are.
        fewest: how many a look has at least.
        growth: factor from one look to the last one at least.
    """
    return [*(n for n in LOOKS if fewest <= n < total and n * growth <= total), total]


def newest_looks(content: Array, fewest: int = 0, growth: float = 1.0) -> list[Array]:
    """Return ever more of the newest samples, and at last all of them.

    Args:
        content: shape (signal, 1, n): the samples.
        fewest: how many they are at least.
        growth: factor from one look to the last one at least.
    """
    return [content[:, :, -count:] for count in look_counts(content.shape[2], fewest, growth)]


class LoadSearch:
    """Fits rotors of one motor with a load that varies.

    Args:
        fitter: of the forms.
        effects: adds effects to them.
        open_forms: that the motor may take.
        in_force: the form that has failed.
        content: shape (signal, 1, n): the samples.
        knows_resistance: whether pauses have told it: then the fewest samples are not asked.
    """

    def __init__(
        self,
        fitter: FormFitter,
        effects: EffectSearch,
        open_forms: OpenForms,
        in_force: FormKind,
        content: Array,
        *,
        knows_resistance: bool = False,
    ) -> None:
        self._fitter = fitter
        self._effects = effects
        self._open = open_forms
        self._content = content
        self._looks = newest_looks(content, growth=LAST_LOOK)
        if knows_resistance:
            self._looks = self._looks[-2:]
        self._knows_resistance = knows_resistance
        has_failed = in_force.source == ROTOR and not SHAFT_EFFECTS.isdisjoint(in_force.effects)
        self._may_stand = not has_failed

    def alone(self, kind: FormKind, fewest: int) -> Pieces[FormFit | None]:
        """Fit a rotor with such a load to ever more samples, as long as it explains them.

        Effects on the shaft may stand for it: beside these the deviations of the rotor are not
        opened. They begin where a look tells the winding first, or where all samples leave it.

        Args:
            kind: of the form.
            fewest: samples that the rotor did not explain without it.

        Returns:
            The fit that explains all samples, or the newest one, a misfit; None where that takes
            too much work.
        """
        form = None
        fit = None
        may_stand = self._may_stand
        for part in self._looks:
            work = self._fitter.first(kind, part, form)
            fit = yield from bounded(work, LOOK_WORK * part.shape[2])
            if fit is None or fit.is_misfit:
                break
            form = fit.form
            is_last = part.shape[2] == self._content.shape[2]
            is_told = fit.tells('resistance') and not self._knows_resistance
            if may_stand and (is_last or is_told):
                may_stand = False
                most = TOLD_LOAD_WORK * self._content.shape[2]
                other = yield from bounded(self._stand_in(fit, fewest), most)
                if other is not None:
                    return other
        return fit

    def beside_loss(
        self, kind: FormKind, fit: FormFit | None, fewest: int
    ) -> Pieces[FormFit | None]:
        """Add the one loss of voltage with which the samples are explained.

        One that the form has may have stood for the load, and is taken off first.

        Args:
            kind: of the form without it.
            fit: of that form, a misfit; None where it took too much work.
            fewest: samples that the rotor did not explain without the load.

        Returns:
            The fit with it, or without the one that the form has; None where none explains them,
            or more than one.
        """
        plain = kind.without(*(name for nodes in BESIDE_A_LOAD for name in nodes))
        if plain != kind:
            other = yield from self.alone(plain, fewest)
            if other is not None and other.explains:
                return other
        explanations = []
        for nodes in BESIDE_A_LOAD:
            other_kind = kind.with_effects(nodes)
            if other_kind != kind and self._open.contains(other_kind):
                other = yield from self.alone(other_kind, fewest)
                if other is not None and other.explains and self._shows(nodes, other, fit):
                    explanations.append(other)
        return explanations[0] if len(explanations) == 1 else None

    def _shows(self, nodes: tuple[str, ...], other: FormFit, fit: FormFit | None) -> bool:
        """Tell whether a loss that was added is no accident.

        Args:
            nodes: what was added.
            other: the fit with it, which may have something else for the load.
            fit: without it, a misfit; None: there is none.
        """
        estimate = other.estimate
        is_far = all(
            estimate.value[0, place] > SURE * estimate.std[0, place]
            for place, parameter in enumerate(estimate.parameters)
            if parameter.name in nodes
        )
        return is_far and (fit is None or likelihood_gain(other, fit, self._content) > EVIDENCE)

    def _stand_in(self, fit: FormFit, fewest: int) -> Pieces[FormFit | None]:
        """Look for effects on the shaft that explain as much as a load that varies; None: none do.

        Args:
            fit: with such a load.
            fewest: samples that the rotor did not explain without it.
        """
        kind = fit.kind.without(VARYING_LOAD)
        for part in newest_looks(self._content, fewest):
            other = yield from self._fitter.again(kind, fit, part, searches_elsewhere=False)
            other = yield from self._effects.explained(
                other, part, ON_THE_SHAFT, follows_suspects=False
            )
            if other.leaves_much:
                return None
            kind = other.kind
            fit = other
        return fit
