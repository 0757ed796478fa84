"""The campaigns are programs, not a package: their folder goes on the path, as it is when one of
them runs.
"""

from __future__ import annotations

import sys
from pathlib import Path

HERE = str(Path(__file__).resolve().parent)

if HERE not in sys.path:
    sys.path.insert(0, HERE)
