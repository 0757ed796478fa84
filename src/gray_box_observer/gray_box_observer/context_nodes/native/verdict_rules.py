"""When a parameter counts as known, as compiled code reads it: `verdict_rules.h`."""

from __future__ import annotations

import ctypes

from gray_box_observer.context_nodes.estimate import VerdictSettings
from gray_box_observer.white_box.interface import Parameter, bounds

MOST_JUDGED = 12
"""Room in `verdict_rules.h`."""

_SETTINGS = (
    'identified_relative_std',
    'excited_relative_std',
    'bound_tolerance',
    'negligible_share',
)


class VerdictRules(ctypes.Structure):
    """``VerdictRules`` of `verdict_rules.h`."""

    _fields_ = (
        *((name, ctypes.c_double * MOST_JUDGED) for name in ('lower', 'upper')),
        *((name, ctypes.c_double) for name in _SETTINGS),
    )

    @classmethod
    def between_bounds(cls, parameters: tuple[Parameter, ...]) -> VerdictRules:
        """Return rules for these parameters, at most MOST_JUDGED, whose settings are to come."""
        lower, upper = bounds(parameters)
        return cls(tuple(lower.tolist()), tuple(upper.tolist()))

    def follow(self, settings: VerdictSettings) -> None:
        """Take settings over."""
        for name in _SETTINGS:
            setattr(self, name, getattr(settings, name))
