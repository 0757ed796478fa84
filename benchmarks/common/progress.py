"""How far long work is, also where no terminal shows a bar."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from tqdm import tqdm

QUIET_S = 60.0
"""Between two lines in a log, and before the first: short work needs none."""


def progress_bar(*arguments: Any, **options: Any) -> Any:
    """Return a bar of tqdm; where nobody looks on, one that tells once a minute."""
    make = tqdm
    if not sys.stderr.isatty():
        make = partial(tqdm, mininterval=QUIET_S, maxinterval=QUIET_S, delay=QUIET_S)
    return make(*arguments, **options)
