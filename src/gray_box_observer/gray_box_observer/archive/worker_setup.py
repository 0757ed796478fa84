"""What Dask loads into every worker process of the cluster that ``identify`` starts."""

from __future__ import annotations

import gc
import signal
from typing import Any


def dask_setup(_worker: Any) -> None:
    """Leave Ctrl-C to the command, which ends the workers: they have nothing to say about it.

    The garbage collector leaves alone what Dask has loaded, which stays as long as the process.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.collect()
    gc.freeze()
