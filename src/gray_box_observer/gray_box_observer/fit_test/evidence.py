"""What the tests of one motor have told together of amounts that one test tells badly.

An estimate rests on every sample, a test on the newest ones. What a test does not show may be large
beside the deviation of such an estimate. So the amounts that the tests find are pooled, each by its
variance (inverse-variance weighting), until the motor is found changed. Those of which a window can
say that they are others begin anew (`least_squares.py`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gray_box_observer.fit_test.projection import UNKNOWN, Amount

WINDOW = 4096
"""Newest samples, at most, that a test looks at."""

MOST = 1e12
"""Size up to which an amount is taken for one, and the inverse of its least deviation. Amounts are
shares of an interval, logarithms and squares of volts."""

CONTRADICTION_STDS = 4.0
"""Standard deviations between a window and all before it from which what was known of an amount is
not true of this window."""


@dataclass(frozen=True)
class Evidence:
    """Amounts that tests have found, by name.

    Attributes:
        amounts: of which something is known.
        samples: how many they rest on, at most: what begins anew rests on fewer.
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

    def without(self, names: Collection[str]) -> Evidence:
        """Return it without some amounts."""
        rest = {name: one for name, one in self.amounts.items() if name not in names}
        return replace(self, amounts=rest)

    def with_amounts(self, amounts: Mapping[str, Amount]) -> Evidence:
        """Return it with some amounts in place of what was known of them."""
        return replace(self, amounts={**self.amounts, **_known(amounts)})

    def contradicts(self, window: Mapping[str, Amount], allowances: Mapping[str, float]) -> bool:
        """Tell whether a window finds an amount that is clearly another.

        Args:
            window: those that are compared, by name.
            allowances: by how much they may differ beside their deviations, by name; 0 of others.
        """
        return any(
            abs(one.mean - self.amounts[name].mean)
            > allowances.get(name, 0.0)
            + CONTRADICTION_STDS * math.hypot(one.std, self.amounts[name].std)
            for name, one in window.items()
            if name in self.amounts
        )

    def with_window(self, window: Mapping[str, Amount], samples: int, new: int) -> Evidence:
        """Return it with what the newest window has found.

        Args:
            window: amounts by name.
            samples: of the window.
            new: how many of these came after the window before.
        """
        share = min(max(new / samples, 0.0), 1.0)
        if share * samples + self.samples <= samples:  # it holds all the others
            return replace(self.with_amounts(window), samples=samples)
        if share == 0.0:
            return self
        shares = {
            name: Amount(one.mean, one.std / math.sqrt(share)) for name, one in window.items()
        }
        sums = {name: _pooled(self.amount(name), one) for name, one in _known(shares).items()}
        return replace(self.with_amounts(sums), samples=self.samples + share * samples)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        amounts = {name: [one.mean, one.std] for name, one in self.amounts.items()}
        return {'samples': self.samples, 'amounts': amounts}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Evidence:
        """Take back what :meth:`to_dict` gave, once it was checked."""
        amounts = {name: Amount(*pair) for name, pair in plain['amounts'].items()}
        return cls(amounts, plain['samples'])


NO_EVIDENCE = Evidence()


def _known(amounts: Mapping[str, Amount]) -> dict[str, Amount]:
    """Return those that say anything, in numbers that can be pooled."""
    return {
        name: one
        for name, one in amounts.items()
        if abs(one.mean) < MOST and 1.0 / MOST < one.std < MOST
    }


def _pooled(one: Amount, other: Amount) -> Amount:
    """Return the mean of two amounts, each weighted by the inverse of its variance."""
    if not one.std < math.inf:
        return other
    ratio = one.std / other.std
    share = ratio * ratio / (1.0 + ratio * ratio)  # of the other one
    mean = one.mean + share * (other.mean - one.mean)
    return Amount(mean, one.std / math.sqrt(1.0 + ratio * ratio))
