"""Loads the compiled filters of the speed, `filtered_speed.c`."""

from __future__ import annotations

import ctypes
from functools import cache

from gray_box_observer.context_nodes.native import compiled, whole_motor

_COUNT = ctypes.c_int64
_NUMBER = ctypes.c_double
_POINTER = ctypes.c_void_p

FILTER_SIZE = 14
"""Numbers of a filter: three states, their covariance, log-likelihood and share."""


class FilterSettings(ctypes.Structure):
    """What every filter needs to know; the order is that of `filtered_speed.c`."""

    _fields_ = (
        *((name, _NUMBER) for name in ('coarseness', 'slip', 'furthest', 'memory')),
        ('largest_step', _NUMBER),
        ('most_steps', _COUNT),
    )


@cache
def library() -> ctypes.CDLL | None:
    """Load the compiled code; None where there is none, or where it is of another motor."""
    if whole_motor.library() is None:
        return None
    handle = compiled.library('filtered_speed_settings_size', FilterSettings)
    if handle is None:
        return None
    for size in (handle.filtered_speed_size, handle.filtered_speed_ladder_size):
        size.restype = _COUNT
    if handle.filtered_speed_size() != FILTER_SIZE:
        return None
    steps = handle.filtered_speed_steps
    steps.restype = None
    steps.argtypes = (
        *(_COUNT, _POINTER, ctypes.POINTER(FilterSettings), _POINTER, _COUNT, _POINTER, _POINTER),
        *(_POINTER, _POINTER, _POINTER, _POINTER),
    )
    return handle
