"""What is known of a current sensor that lags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from gray_box_observer.safe_io.saved_state import ArrayRule, number, numbers

SHORTEST_S = 1e-9
"""Shortest time constant that is credible."""

LONGEST_S = 100.0
"""Longest one."""

LARGEST_CHANGE = 1e3
"""Largest change of a parameter that is credible, relative to it."""


class CurrentLag(NamedTuple):
    """First-order lag of a current sensor.

    Attributes:
        lag_s: its time constant in s.
        winding_s: time constant L/R of the winding in s, by which the voltage is taken to lag.
        other_order: by how much the parameters change, relative to them, where the winding is taken
            for the sensor, and the other way round; empty where the data tell which is which.
    """

    lag_s: float
    winding_s: float
    other_order: tuple[float, ...] = ()

    def state(self) -> dict[str, Any]:
        """Return it as plain values, for a checkpoint."""
        return {**self._asdict(), 'other_order': list(self.other_order)}

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
        )

    @property
    def is_possible(self) -> bool:
        """Whether both times lie within bounds."""
        return all(SHORTEST_S <= time_s <= LONGEST_S for time_s in (self.lag_s, self.winding_s))

    @property
    def turned(self) -> CurrentLag:
        """The same with the winding taken for the sensor, and the other way round."""
        return CurrentLag(self.winding_s, self.lag_s)
