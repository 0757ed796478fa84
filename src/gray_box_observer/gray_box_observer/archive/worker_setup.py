"""What Dask loads into every worker process of the cluster that ``identify`` starts."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(_worker: Any) -> None:
    """Leave Ctrl-C to the command: it ends the workers, who have nothing to say about it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
