"""A delay that is not searched: that of a motor with a rotor, whose voltage leads its current."""

from __future__ import annotations

from gray_box_observer.delay.watch import DelayWatch, LateInstantSource
from gray_box_observer.samples.raw_history import SignalHistory


class DeclaredDelay(DelayWatch):
    """Keeps the delay that was declared; the fit test asks whether it holds."""

    def update(
        self,
        history: SignalHistory,
        stamp_ns: int,
        samples: int = 1,
        *,
        is_awaited: bool = False,
        late_instant: LateInstantSource | None = None,
    ) -> float | None:
        """Do nothing, and leave the delay as it is."""
        return None
