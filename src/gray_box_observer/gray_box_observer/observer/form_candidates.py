"""Which other forms a trial compares, where the form in force does not explain the data.

What the fit test suspects comes first. A fit of a rotor costs most, so few forms stand beside it,
and those for which there is no room take turns (docs/METHOD.md, Which effects).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import COLOURED_NOISE, HYSTERESIS, LOAD
from gray_box_observer.fit_test.speed_basis import leaves_much
from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE, LOST_VOLTAGE, OFFSET, TWINS
from gray_box_observer.observer.form_trial import FEW_CANDIDATES
from gray_box_observer.observer.motor_form import (
    MEASURED,
    QUADRATIC_FRICTION,
    RIVALS,
    ROTOR,
    FormKind,
)
from gray_box_observer.observer.open_forms import OpenForms
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    DEAD_ZONE,
    VARYING_LOAD,
)

NODES = {
    'lost_voltage': LOST_VOLTAGE,
    'dead_zone': DEAD_ZONE,
    'current_offset': OFFSET,
    'current_lag': CURRENT_LAG,
    'delay': CURRENT_LAG,
    LOAD: LOAD_TORQUE,
    HYSTERESIS: HYSTERESIS,
    COASTING: COASTING,
}
"""Effect that a form may have for a suspected one, by the name of that. What is late by a part of
a sample interval is a lag or a delay: a form knows the lag alone."""

LOADS = (LOAD_TORQUE, QUADRATIC_FRICTION)
"""What a shaft may carry, the commoner one first."""


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
        trials: how many trials have begun before.
    """

    kind: FormKind
    open_forms: OpenForms
    trials: int

    def instead(
        self, fit: FitAssessment, *, is_doubted: bool, has_no_speed: bool = False
    ) -> tuple[FormKind, ...]:
        """Return the forms to try, that of the likeliest suspect first.

        Args:
            fit: what is known of that of the form in force.
            is_doubted: whether that form is doubted; else the order of its lag alone is asked for.
            has_no_speed: whether the measured speed stands still, so that it may be none.
        """
        kinds: list[FormKind] = []
        lag = self.kind.lag
        if lag is not None and not is_doubted:
            return (replace(self.kind, lag=lag.without_rivals),)
        if lag is not None:  # it may be another one than was found
            kinds.append(replace(self.kind, lag=None))
        plain = self.kind.with_other_source
        if self.kind.source == MEASURED and not has_no_speed:
            plain = None
        elif self.kind.source == MEASURED and plain is not None:
            kinds += self._with_rotor(plain, fit)
        suspects = fit.suspects
        if self.kind.source == ROTOR:  # the likeliest; coasting takes the place of none
            likeliest = [one for one in suspects if one.effect != COASTING][:1]
            suspects = tuple(one for one in suspects if one.effect == COASTING or one in likeliest)
        is_vague = not suspects or suspects[0].effect == COLOURED_NOISE
        if self.kind.source == ROTOR and is_uneasy(self.kind, fit) and is_vague:
            kinds.append(self.kind.with_effect(CURRENT_LAG))  # what is left over tells nothing
        for suspect in suspects:  # fits of a rotor cost most
            node = NODES.get(suspect.effect)
            if node is not None and node not in self.kind.effects:
                twin = self.kind.without(*TWINS.get(node, ())).with_effect(node)
                kinds += [twin, *twin.rivals, self.kind.with_effect(node)]
            elif suspect.effect == ROTOR and plain is not None:
                kinds += self._with_rotor(plain, fit)
        if self.kind.source == ROTOR:
            kinds += self.kind.rivals
        different = [*dict.fromkeys(kind for kind in kinds if self.open_forms.contains(kind))]
        others = []
        if plain is not None and plain not in different and self.open_forms.contains(plain):
            others.append(plain)
        room = FEW_CANDIDATES - len(different) - len(others)
        if self.kind.source == ROTOR and is_vague:  # a filter colours what is left over
            lag_kind = self.kind.with_effect(CURRENT_LAG)
            is_new = lag_kind not in different and self.open_forms.contains(lag_kind)
            others += [lag_kind] if is_new else []
        usual_kinds = (*different, *self._with_loads(different, room), *others)[:FEW_CANDIDATES]
        last = [kind for kind in self._with_varying_load(plain) if self.open_forms.contains(kind)]
        return (*usual_kinds, *last)

    def _with_varying_load(self, plain: FormKind | None) -> list[FormKind]:
        """Return a rotor with a load that varies: it explains most, and is asked last.

        Args:
            plain: the form with the other source of the speed.
        """
        if self.kind.source == ROTOR:
            kind = self.kind.without(LOAD_TORQUE)
            return [] if VARYING_LOAD in kind.effects else [kind.with_effect(VARYING_LOAD)]
        if plain is None or plain.source != ROTOR or not self.trials:
            return []
        return [plain.with_effect(VARYING_LOAD)]

    def _with_loads(self, before: Sequence[FormKind], room: int) -> list[FormKind]:
        """Return a rotor with what it may carry; where there is room for one alone, in turn.

        Args:
            before: forms that are tried anyway.
            room: for how many there is room beside.
        """
        if self.kind.source != ROTOR:
            return []
        kinds = [self.kind.with_effect(node) for node in LOADS if node not in self.kind.effects]
        kinds = [kind for kind in kinds if kind not in before and self.open_forms.contains(kind)]
        if len(kinds) <= room:
            return kinds
        turn = max(self.trials - 1, 0) % len(kinds)
        return [*kinds[turn:], *kinds[:turn]][: max(room, 0)]

    def _with_rotor(self, plain: FormKind, fit: FitAssessment) -> list[FormKind]:
        """Return a rotor, and one with an effect where that alone has failed before.

        What a speed of Kt i suspects beside a rotor tells little of the rotor: it says which of
        these is tried first. They take turns, for a fit of a rotor costs most.
        """
        if plain.source == ROTOR and fit.suspects and fit.suspects[0].effect == COASTING:
            return [plain.with_effect(COASTING), plain]
        if plain.source != ROTOR or not self.trials:
            return [plain]
        suspects = [suspect.effect for suspect in fit.suspects if suspect.effect != ROTOR]
        loss = NODES.get(suspects[0], '') if suspects else ''
        in_turn = ((loss,), LOADS) if loss in RIVALS else (LOADS, (LOST_VOLTAGE,))
        nodes = in_turn[(self.trials - 1) % len(in_turn)]
        kinds = [plain.with_effect(node) for node in nodes]
        return [plain, *kinds, *(rival for kind in kinds for rival in kind.rivals)]
