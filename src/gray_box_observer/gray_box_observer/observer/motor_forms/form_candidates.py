"""Which other forms a trial compares, where the form in force does not explain the data.

What the fit test suspects comes first. A trial adds by itself what a rotor needs beside
(:mod:`effect_search`), for fits of a rotor cost most (docs/METHOD.md, Which effects).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import CHANGE, COLOURED_NOISE, LOAD
from gray_box_observer.fit_test.speed_basis import leaves_much
from gray_box_observer.fit_test.twin_effects import LOST_VOLTAGE, TWINS
from gray_box_observer.observer.motor_forms.load_search import SHAFT_EFFECTS
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR, FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.standstill import StandstillLine
from gray_box_observer.observer.motor_forms.suspected_effects import NODES
from gray_box_observer.observer.motor_forms.trial_start import FEW_CANDIDATES
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    VARYING_LOAD,
)

MUCH = 5.0
"""Residual over the noise from which a load may be left out first of all: arms leave 7 and more."""

SURE_SUSPECT = 50.0
"""Log-likelihood from which the likeliest suspect counts there."""


def is_uneasy(kind: FormKind, fit: FitAssessment) -> bool:
    """Tell whether a fit warns, or leaves so much beside a hidden speed that nothing counts.

    Args:
        kind: of the form.
        fit: what is known of its fit.
    """
    is_hidden = kind.source == ROTOR and fit.verdict is FitVerdict.OK
    return fit.verdict is FitVerdict.WARNING or (is_hidden and leaves_much(fit))


@dataclass(frozen=True, slots=True)
class FormCandidates:
    """The forms that may be tried next.

    Attributes:
        kind: of the form in force.
        open_forms: which forms data may lead to.
        standstill: what pauses of the motor have told; None: nothing.
    """

    kind: FormKind
    open_forms: OpenForms
    standstill: StandstillLine | None = None

    def instead(
        self, fit: FitAssessment, *, is_doubted: bool, has_no_speed: bool = False
    ) -> tuple[FormKind, ...]:
        """Return the forms to try, that of the likeliest suspect first.

        A trial adds to a rotor what it needs beside. So it is tried as it is: the one in force, and
        one without what was added to it. At most one of them has a load that varies.

        Args:
            fit: what is known of that of the form in force.
            is_doubted: whether that form is doubted; else the order of its lag alone is asked for.
            has_no_speed: whether the measured speed stands still, so that it may be none.
        """
        lag = self.kind.lag
        if lag is not None and not is_doubted:
            return (replace(self.kind, lag=lag.without_rivals),)
        plain = self.kind.with_other_source
        if self.kind.source == MEASURED and not has_no_speed:
            plain = None
        kinds = [] if lag is None else [replace(self.kind, lag=None)]  # another one than was found
        if self.kind.source == ROTOR:
            kinds += self._beside_rotor(fit, plain)
        else:
            kinds += self._beside_speed(fit, plain)
        kinds = [kind for kind in kinds if VARYING_LOAD not in kind.effects]
        different = [*dict.fromkeys(kind for kind in kinds if self._is_open(kind))]
        rotors = [] if plain is None else self._with_rotor(plain, fit)
        others = [kind for kind in rotors if kind not in different and self._is_open(kind)]
        usual_kinds = [*different, *others][:FEW_CANDIDATES]
        loads = [kind for kind in self._with_varying_load(plain) if self._is_open(kind)]
        place = len(usual_kinds)
        if self.standstill is not None:
            place = 0
        elif self._may_be_loaded(fit) and self.kind in usual_kinds:
            place = usual_kinds.index(self.kind) + 1
        return (*usual_kinds[:place], *loads, *usual_kinds[place:])

    def _is_open(self, kind: FormKind) -> bool:
        return self.open_forms.contains(kind)

    def _beside_rotor(self, fit: FitAssessment, plain: FormKind | None) -> list[FormKind]:
        """Return forms beside a rotor; coasting takes the place of no other effect.

        Args:
            fit: what is known of that of the form in force.
            plain: the form with the other source of the speed, whose fit costs least; None: it is
                not tried.
        """
        kind = self.kind
        kinds = []
        if any(suspect.effect == COASTING for suspect in fit.suspects):
            kinds.append(kind.with_effect(COASTING))
        suspects = [suspect.effect for suspect in fit.suspects if suspect.effect != COASTING]
        is_vague = not suspects or suspects[0] == COLOURED_NOISE
        if is_vague and is_uneasy(kind, fit):
            kinds.append(kind.with_effect(CURRENT_LAG))  # what is left over tells nothing
        kinds += [] if plain is None else [plain]
        node = NODES.get(suspects[0], '') if suspects else ''
        twins = TWINS.get(node, ())
        if node not in kind.effects and any(twin in kind.effects for twin in twins):
            kinds.append(kind.without(*twins).with_effect(node))
        if kind.lag is None:
            kinds.append(kind)
        kinds += kind.rivals
        if kind.effects:
            kinds.append(FormKind(ROTOR))
        if is_vague:  # a filter colours what is left over
            kinds.append(kind.with_effect(CURRENT_LAG))
        return kinds

    def _beside_speed(self, fit: FitAssessment, plain: FormKind | None) -> list[FormKind]:
        """Return forms beside a speed that is not that of a rotor.

        Args:
            fit: what is known of that of the form in force.
            plain: the form with the other source of the speed; None: it is not tried.
        """
        kinds: list[FormKind] = []
        if self.kind.source == MEASURED and plain is not None:
            kinds += self._with_rotor(plain, fit)
        for suspect in fit.suspects:
            node = NODES.get(suspect.effect)
            if node is not None and node not in self.kind.effects:
                twin = self.kind.without(*TWINS.get(node, ())).with_effect(node)
                kinds += [twin, *twin.rivals, self.kind.with_effect(node)]
            elif suspect.effect == ROTOR and plain is not None:
                kinds += self._with_rotor(plain, fit)
        return kinds

    def _may_be_loaded(self, fit: FitAssessment) -> bool:
        """Tell whether what a rotor leaves looks like a load first of all, or like nothing known.

        Args:
            fit: what is known of that of the form in force.
        """
        if self.kind.source != ROTOR or VARYING_LOAD in self.kind.effects:
            return False
        if not fit.ratio >= MUCH:
            return False
        likeliest = fit.suspects[0] if fit.suspects else None
        if likeliest is None or likeliest.evidence < SURE_SUSPECT:
            return True
        return likeliest.effect in (LOAD, CHANGE)

    def _with_varying_load(self, plain: FormKind | None) -> list[FormKind]:
        """Return a rotor with a load that varies, instead of other effects on the shaft.

        Args:
            plain: the form with the other source of the speed.
        """
        if self.kind.source == ROTOR:
            kind = self.kind.without(*SHAFT_EFFECTS).with_effects((VARYING_LOAD,))
        elif plain is not None and plain.source == ROTOR:
            kind = plain.with_effect(VARYING_LOAD)
        else:
            return []
        if self.standstill is not None and LOST_VOLTAGE in self.open_forms.effects:
            loss = (LOST_VOLTAGE,) if self.standstill.has_drop else ()
            kind = FormKind(ROTOR, (VARYING_LOAD, *loss))  # few samples may have told others
        return [kind]

    @staticmethod
    def _with_rotor(plain: FormKind, fit: FitAssessment) -> list[FormKind]:
        """Return a rotor; first behind a driver that coasts where that is suspected.

        What a speed of Kt i suspects beside a rotor tells little of the rotor.
        """
        if plain.source == ROTOR and fit.suspects and fit.suspects[0].effect == COASTING:
            return [plain.with_effect(COASTING), plain]
        return [plain]
