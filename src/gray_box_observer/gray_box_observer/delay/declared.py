"""A delay that is not searched: what was found of driver, sensor or load stands beside it."""

from __future__ import annotations

from typing import Any

from gray_box_observer.delay.watch import DelayWatch


class DeclaredDelay(DelayWatch):
    """Keeps the delay that was declared; the fit test asks whether it holds."""

    def update(self, *_arguments: Any, **_options: Any) -> float | None:
        """Do nothing, and leave the delay as it is."""
        return None
