"""Numbers for people and programs: one that is not finite is written as not known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def finite_or_none(value: Any) -> float | None:
    """Return a number as a plain float; None where there is none, or where it is not finite."""
    if value is None:
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def plain(tree: Any) -> Any:
    """Return plain values for JSON: arrays become lists, and what is not finite becomes None.

    Args:
        tree: mappings, sequences, arrays, numbers and text, nested in any way.
    """
    if isinstance(tree, (bool, str, int)) or tree is None:
        return tree
    if isinstance(tree, (float, np.floating)):
        return finite_or_none(tree)
    if isinstance(tree, np.generic):
        return tree.item()
    if isinstance(tree, np.ndarray):
        return plain(tree.tolist())
    if isinstance(tree, Mapping):
        return {key: plain(value) for key, value in tree.items()}
    return [plain(value) for value in tree]


def words_of(value: float | None, form: str = '.6g', placeholder: str = 'not known') -> str:
    """Return a number as text, or words where it is not known."""
    number = finite_or_none(value)
    return placeholder if number is None else format(number, form)
