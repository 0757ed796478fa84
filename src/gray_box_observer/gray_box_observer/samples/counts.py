"""What became of one motor's messages: nothing may be lost without a trace."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from gray_box_observer.samples.rejection import Rejection

RefusalCounts = dict[str, Counter[Rejection]]
"""What could not be used, by signal and reason."""


@dataclass(frozen=True, slots=True)
class PairingCounts:
    """What became of one motor's messages.

    Of torque, ``received = used + refused + waiting``; of voltage, ``received = taken + refused``,
    each a count.

    Attributes:
        refusal_counts: what could not be used.
        received_torque: torques that came.
        received_voltage: voltages that came.
        taken_voltage: voltages that have come into force, or will.
        used_count: torques that have become samples.
        waiting_count: torques that wait for their voltage.
        restarts: how often the clock was set back.
        held_count: samples, of the group, completed by patience running out.
        delay_ns: by how much voltage is taken to act later than it is stamped.
    """

    refusal_counts: RefusalCounts
    received_torque: int
    received_voltage: int
    taken_voltage: int
    used_count: int
    waiting_count: int
    restarts: int
    held_count: int
    delay_ns: int

    @property
    def rejected(self) -> Counter[Rejection]:
        """What could not be used, by reason, whatever signal it was of."""
        return sum(self.refusal_counts.values(), Counter())
