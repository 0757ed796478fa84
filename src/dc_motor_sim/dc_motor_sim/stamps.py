"""Integer nanoseconds outside, float seconds inside: the one place that converts."""

from __future__ import annotations

NANOSECONDS_PER_SECOND = 1_000_000_000


def to_seconds(time_ns: int) -> float:
    """Convert integer nanoseconds into float seconds."""
    return time_ns / NANOSECONDS_PER_SECOND


def to_nanoseconds(time_s: float) -> int:
    """Convert float seconds into the nearest integer nanosecond."""
    return round(time_s * NANOSECONDS_PER_SECOND)
