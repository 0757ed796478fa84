"""Asks whether a load that varies explains what a rotor on trial leaves, and what stands for it.

A load that varies explains what acts on the shaft, and nothing that takes voltage. So it tells the
winding apart from the rest. Effects on the shaft that explain as much tell more: they stand for it.
A loss of voltage may stand beside it (docs/METHOD.md, A load that varies).
"""

from __future__ import annotations

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.observer.effect_search import EffectSearch
from gray_box_observer.observer.form_fit import FormFit, FormFitter
from gray_box_observer.observer.motor_form import FormKind
from gray_box_observer.observer.open_forms import OpenForms
from gray_box_observer.observer.suspected_effects import BESIDE_A_LOAD, ON_THE_SHAFT
from gray_box_observer.settings.motor_configuration import VARYING_LOAD
from gray_box_observer.white_box.interface import Array

LOOKS = (512, 1024)
"""Newest samples of a trial that are tried first: what explains not even these is given up at a
fraction of the cost."""

TOLD_LOAD_WORK = 512
"""Work of the search for what may stand for a load that varies, for each sample, at most."""


def newest_looks(content: Array, fewest: int = 0) -> list[Array]:
    """Return ever more of the newest samples, and at last all of them.

    Args:
        content: shape (signal, 1, n): the samples.
        fewest: how many they are at least.
    """
    total = content.shape[2]
    counts = [count for count in LOOKS if fewest <= count < total]
    return [content[:, :, -count:] for count in counts] + [content]


class LoadSearch:
    """Fits rotors of one motor with a load that varies.

    Args:
        fitter: of the forms.
        effects: adds effects to them.
        open_forms: that the motor may take.
        in_force: the form that has failed.
        content: shape (signal, 1, n): the samples.
    """

    def __init__(
        self,
        fitter: FormFitter,
        effects: EffectSearch,
        open_forms: OpenForms,
        in_force: FormKind,
        content: Array,
    ) -> None:
        self._fitter = fitter
        self._effects = effects
        self._open = open_forms
        self._content = content
        on_shaft = {name for nodes in ON_THE_SHAFT for name in nodes}
        self._may_stand = on_shaft.isdisjoint(in_force.effects)  # else they have failed

    def alone(self, kind: FormKind, fewest: int) -> Pieces[FormFit]:
        """Fit a rotor with such a load to ever more samples, as long as it explains them.

        What it tells of the winding by few of them is where effects on the shaft begin, which may
        stand for it: beside these the deviations of the rotor are not opened.

        Args:
            kind: of the form.
            fewest: samples that the rotor did not explain without it.

        Returns:
            The fit that explains all samples, or the newest one, a misfit.
        """
        form = self._open.make(kind)
        looks = newest_looks(self._content)
        for place, part in enumerate(looks):
            fit = yield from self._fitter.first(kind, part, form)
            form = fit.form
            if fit.is_misfit:
                break
            if place == 0 and self._may_stand:
                most = TOLD_LOAD_WORK * self._content.shape[2]
                other = yield from bounded(self._stand_in(fit, fewest), most)
                if other is not None:
                    return other
        return fit

    def beside_loss(self, fit: FormFit, kind: FormKind, fewest: int) -> Pieces[FormFit]:
        """Add the one loss of voltage with which the samples are explained.

        Args:
            fit: without one, a misfit: it is returned where none explains them, or more than one.
            kind: of that form.
            fewest: samples that the rotor did not explain without the load.
        """
        explanations = []
        for nodes in BESIDE_A_LOAD:
            other_kind = kind.with_effects(nodes)
            if other_kind != kind and self._open.contains(other_kind):
                other = yield from self.alone(other_kind, fewest)
                if not other.leaves_much:
                    explanations.append(other)
        return explanations[0] if len(explanations) == 1 else fit

    def _stand_in(self, fit: FormFit, fewest: int) -> Pieces[FormFit | None]:
        """Look for effects on the shaft that explain as much as a load that varies; None: none do.

        Args:
            fit: with such a load.
            fewest: samples that the rotor did not explain without it.
        """
        kind = fit.kind.without(VARYING_LOAD)
        for part in newest_looks(self._content, fewest):
            other = yield from self._fitter.at(kind, fit, part)
            other = yield from self._effects.explained(
                other, part, ON_THE_SHAFT, follows_suspects=False
            )
            if other.leaves_much:
                return None
            kind = other.kind
            fit = other
        return fit
