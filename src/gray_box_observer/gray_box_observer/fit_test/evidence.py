"""What the tests of one motor have told together of amounts that one test tells badly.

An estimate rests on every sample, a test on the newest ones. What a test does not show may be large
beside the deviation of such an estimate. So the amounts that the tests find are pooled, each by its
variance (inverse-variance weighting), until the motor is another one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gray_box_observer.fit_test.projection import UNKNOWN, Amount

WINDOW = 4096
"""Newest samples, at most, that a test looks at."""

MOST = 1e12
"""Size up to which an amount is taken for one."""


@dataclass(frozen=True)
class Evidence:
    """Amounts that tests have found, by name.

    Attributes:
        amounts: of which something is known.
        samples: how many they rest on.
    """

    amounts: Mapping[str, Amount] = field(default_factory=dict)
    samples: float = 0.0

    @property
    def is_mature(self) -> bool:
        """Whether it rests on more than one window.

        A parameter is believed within a few hundred samples, which tell little beside it. Of many
        thousands, its own deviation falls far below what an error of the stamps makes of it.
        """
        return self.samples > WINDOW

    def amount(self, name: str) -> Amount:
        """Return an amount; of an unknown name, the unknown."""
        return self.amounts.get(name, UNKNOWN)

    def of_newest(self, samples: int) -> Evidence:
        """Return what is left of it where no more than some newest samples count."""
        if self.samples <= samples:
            return self
        less = math.sqrt(self.samples / samples) if samples > 0 else math.inf
        amounts = {name: Amount(one.mean, less * one.std) for name, one in self.amounts.items()}
        return Evidence(amounts if math.isfinite(less) else {}, float(samples))

    def with_window(self, window: Mapping[str, Amount], samples: int, new: int) -> Evidence:
        """Return it with what the newest window has found.

        Args:
            window: amounts by name.
            samples: of the window.
            new: how many of these came after the window before.
        """
        if new + self.samples <= samples:  # it holds all the others
            return Evidence({name: one for name, one in window.items() if _is_amount(one)}, samples)
        share = min(1.0, max(0.0, new / samples))
        amounts = dict(self.amounts)
        for name, one in window.items():
            if share > 0.0 and _is_amount(one):
                amounts[name] = _pooled(
                    amounts.get(name, UNKNOWN), Amount(one.mean, one.std / math.sqrt(share))
                )
        return Evidence(amounts, self.samples + share * samples)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        amounts = {name: [one.mean, one.std] for name, one in self.amounts.items()}
        return {'samples': self.samples, 'amounts': amounts}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Evidence:
        """Take back what :meth:`to_dict` gave, once it was checked."""
        return cls(
            {name: Amount(*pair) for name, pair in plain['amounts'].items()}, plain['samples']
        )


NO_EVIDENCE = Evidence()


def _is_amount(amount: Amount) -> bool:
    """Tell whether it says anything, in numbers that can be pooled."""
    return abs(amount.mean) < MOST and 1.0 / MOST < amount.std < MOST


def _pooled(one: Amount, other: Amount) -> Amount:
    """Return the mean of two amounts, each weighted by the inverse of its variance."""
    if not one.std < math.inf:
        return other
    ratio = one.std / other.std
    share = ratio * ratio / (1.0 + ratio * ratio)  # of the other one
    mean = one.mean + share * (other.mean - one.mean)
    return Amount(mean, one.std / math.sqrt(1.0 + ratio * ratio))
