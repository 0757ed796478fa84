"""Which forms the data may lead a motor to."""

from __future__ import annotations

from dataclasses import dataclass

from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, SOURCES_OF, FormKind, FormMaker
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    DEAD_ZONE,
    VARYING_LOAD,
)
from gray_box_observer.white_box.declaration import TERMS

LARGEST_ZONE_V = TERMS[DEAD_ZONE].parameter.upper


@dataclass(frozen=True, slots=True)
class OpenForms:
    """Which forms data may lead to.

    Attributes:
        make: makes one of them.
        sources: of the speed.
        effects: that may be added.
        effects_of_rotor: that may be added to a rotor alone: the others have them.
    """

    make: FormMaker
    sources: tuple[str, ...]
    effects: tuple[str, ...] = ()
    effects_of_rotor: tuple[str, ...] = ()

    @property
    def is_choice(self) -> bool:
        """Whether there is more than one form."""
        return len(self.sources) > 1 or bool(self.effects)

    def contains(self, kind: FormKind) -> bool:
        """Tell whether a form is one of these, and adds no effect twice or where it cannot act."""
        effects = kind.effects
        possible = self.effects + (self.effects_of_rotor if kind.source == ROTOR else ())
        if kind.source not in self.sources or not all(name in possible for name in effects):
            return False
        can_act = all(kind.source in SOURCES_OF.get(name, self.sources) for name in effects)
        zone_is_known = 0.0 <= kind.dead_zone_v <= (LARGEST_ZONE_V if DEAD_ZONE in effects else 0.0)
        lag = kind.lag
        lag_is_known = lag is None or (CURRENT_LAG in effects and lag.is_possible)
        is_once = len(set(effects)) == len(effects)
        if CURRENT_LAG in effects and (DEAD_ZONE in effects or COASTING in effects):
            return False  # what these take lags, too
        if VARYING_LOAD in effects and (LOAD_TORQUE in effects or CURRENT_LAG in effects):
            return False  # it has a constant part, too, and may look like anything that is slow
        return can_act and zone_is_known and lag_is_known and is_once
