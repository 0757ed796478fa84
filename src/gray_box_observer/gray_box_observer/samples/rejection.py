"""Why something that came in was not used."""

from __future__ import annotations

from enum import Enum


class Rejection(str, Enum):
    """Why something that came in was not used."""

    NON_FINITE = 'non_finite'
    DUPLICATE = 'duplicate'
    OUT_OF_ORDER = 'out_of_order'
    NO_VOLTAGE = 'no_voltage'
    NO_SPEED = 'no_speed'
    ABSURD = 'absurd'
    MALFORMED = 'malformed'
    OVERSIZED = 'oversized'
    STALE_INPUT = 'stale_input'
    STOPPED = 'stopped'
