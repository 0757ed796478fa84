"""What is known of a current sensor that lags."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple

from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import ArrayRule, number, numbers

SHORTEST_S = 1e-9
"""Shortest time constant that is credible."""

LONGEST_S = 100.0
"""Longest one."""

LONGEST_MEMORY = 0.95
"""Longest memory that is believed to be that of noise."""

LARGEST_CHANGE = 1e3
"""Largest change of a parameter that is credible, relative to it."""


class FilterKind(StrEnum):
    """What makes the current of a sensor late."""

    FIRST_ORDER = 'first_order'
    """An analogue filter of first order, or a driver's in a loop far faster than it publishes."""
    MOVING_AVERAGE = 'moving_average'
    """Of the samples, in which every one weighs less than the next by the same factor."""
    INTERVAL_MEAN = 'interval_mean'
    """Readings are means over the sample interval before them."""


class CurrentLag(NamedTuple):
    """Lag of a current sensor behind a filter.

    Attributes:
        lag_s: its time constant in s; of a mean half a sample interval.
        winding_s: time constant L/R of the winding in s, by which the voltage is taken to lag.
        other_order: by how much the parameters change, relative to them, where the winding is taken
            for the sensor, and the other way round; empty where the data tell which is which.
        memory: share of the noise before that a reading's noise has, for noise passes a filter
            that comes behind it; negative where noise comes behind an average, which is undone.
        filter_kind: what it comes from.
        other_kind: by how much the parameters change where it is of another kind; empty where the
            data tell which it is.
    """

    lag_s: float
    winding_s: float
    other_order: tuple[float, ...] = ()
    memory: float = 0.0
    filter_kind: FilterKind = FilterKind.FIRST_ORDER
    other_kind: tuple[float, ...] = ()

    def state(self) -> dict[str, Any]:
        """Return it as plain values, for a checkpoint."""
        rivals = {'other_order': list(self.other_order), 'other_kind': list(self.other_kind)}
        return self._asdict() | rivals

    @classmethod
    def restored(cls, plain: Mapping[str, Any]) -> CurrentLag:
        """Return what :meth:`state` gave.

        Raises:
            CheckpointError: it is no lag that could have been found.
        """
        rule = ArrayRule((None,), -LARGEST_CHANGE, LARGEST_CHANGE)
        return cls(
            number(plain, 'lag_s', SHORTEST_S, LONGEST_S),
            number(plain, 'winding_s', SHORTEST_S, LONGEST_S),
            tuple(numbers(plain, 'other_order', rule).tolist()),
            number(plain, 'memory', -LONGEST_MEMORY, LONGEST_MEMORY) if 'memory' in plain else 0.0,
            _saved_kind(plain),
            tuple(numbers(plain, 'other_kind', rule).tolist()) if 'other_kind' in plain else (),
        )  # files of early releases know none of the last three

    @property
    def is_average(self) -> bool:
        """Whether it is that of a moving average."""
        return self.filter_kind is FilterKind.MOVING_AVERAGE

    @property
    def settles(self) -> bool:
        """Whether it leans on all that has been since a signal history began."""
        return self.filter_kind is FilterKind.FIRST_ORDER

    @property
    def is_mean(self) -> bool:
        """Whether it is that of readings which are means of their intervals."""
        return self.filter_kind is FilterKind.INTERVAL_MEAN

    @property
    def is_possible(self) -> bool:
        """Whether both times lie within bounds."""
        return all(SHORTEST_S <= time_s <= LONGEST_S for time_s in (self.lag_s, self.winding_s))

    @property
    def turned(self) -> CurrentLag:
        """The same with the winding taken for the sensor, and the other way round."""
        return self.without_rivals._replace(lag_s=self.winding_s, winding_s=self.lag_s)

    @property
    def without_rivals(self) -> CurrentLag:
        """The same without what data tell of its order and kind: that is of one form alone."""
        return self._replace(other_order=(), other_kind=())

    @property
    def rivals(self) -> list[tuple[float, ...]]:
        """By how much the parameters change in other explanations that the data leave open."""
        return [shift for shift in (self.other_order, self.other_kind) if shift]


def _saved_kind(plain: Mapping[str, Any]) -> FilterKind:
    """Return the kind of a saved filter; early releases knew those of first order alone.

    Raises:
        CheckpointError: it is none that there is.
    """
    kind = plain.get('filter_kind', FilterKind.FIRST_ORDER)
    if kind not in [*FilterKind]:
        raise CheckpointError('current_lag.filter_kind is none of those that there are')
    return FilterKind(kind)
