"""What is known of a current sensor that lags."""

from __future__ import annotations

from typing import NamedTuple

SHORTEST_S = 1e-9
"""Shortest time constant that is credible."""

LONGEST_S = 100.0
"""Longest one."""


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

    @property
    def is_possible(self) -> bool:
        """Whether both times lie within bounds."""
        return all(SHORTEST_S <= time_s <= LONGEST_S for time_s in (self.lag_s, self.winding_s))

    @property
    def turned(self) -> CurrentLag:
        """The same with the winding taken for the sensor, and the other way round."""
        return CurrentLag(self.winding_s, self.lag_s)
