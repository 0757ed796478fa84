"""Lets tests of the context nodes share records of a motor with a rotor."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
