"""Lets the tests of the residual analysis share their records."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
