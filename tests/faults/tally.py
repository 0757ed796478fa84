"""What became of the cases of a fault campaign."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class Tally:
    """Counts how cases ended; a campaign adds what else it measures.

    Attributes:
        outcomes: how often each kind of end came.
        failures: number, damage and complaint of every case that ended otherwise.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: list[tuple[int, str, str]] = field(default_factory=list)

    @property
    def hangs(self) -> int:
        """How many of the failures took longer than any case may."""
        return sum(complaint.startswith('Hang') for *_, complaint in self.failures)
