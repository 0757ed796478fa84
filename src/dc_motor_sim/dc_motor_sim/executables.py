"""What ``ros2 run`` starts: asked to end, it does so also while its modules are being loaded."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence

from dc_motor_sim.end_signals import listened_signals


def motor_sim(args: Sequence[str] | None = None) -> int:
    """Start the simulator; the result is the exit code."""
    for number in listened_signals():
        # Nothing has begun that would have to be finished.
        signal.signal(number, lambda *_: os._exit(0))
    from dc_motor_sim.ros import motor_sim as node

    return node.main(args)
