"""A value within limits: of a supply, or of what may change in a sample interval."""

from __future__ import annotations


def limited(value: float, most: float) -> float:
    """Return the value nearest to one whose size is at most so much."""
    return max(-most, min(most, value))
