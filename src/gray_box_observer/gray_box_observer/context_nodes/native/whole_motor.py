"""Loads the compiled trajectory of a motor with a rotor, `whole_motor.c`."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.white_box import forms

_COUNT = ctypes.c_int64
_NUMBER = ctypes.c_double
_POINTER = ctypes.c_void_p


@cache
def library() -> ctypes.CDLL | None:
    """Load the compiled code; None where there is none, or where it is of another motor."""
    handle = compiled.load()
    if handle is None or not hasattr(handle, 'whole_motor_residual'):
        return None
    fingerprint = handle.whole_motor_fingerprint
    run = handle.whole_motor_follow
    fingerprint.restype = run.restype = _COUNT
    run.argtypes = (
        *(_POINTER, _NUMBER, _POINTER, _COUNT, _POINTER, _POINTER, _POINTER, _POINTER),
        *(_NUMBER, _COUNT, _COUNT, _POINTER, _POINTER, _POINTER, _POINTER),
    )
    residual = handle.whole_motor_residual
    residual.restype = _COUNT
    residual.argtypes = (
        *(_POINTER, _NUMBER, _COUNT, _POINTER, _POINTER, _POINTER, _POINTER, _NUMBER, _COUNT),
        *(_COUNT, _COUNT, _NUMBER, _POINTER),
    )
    by_knot = handle.whole_motor_by_knot
    by_knot.restype = None
    by_knot.argtypes = (_COUNT, _COUNT, _POINTER, _POINTER, _POINTER, _POINTER)
    respond = handle.whole_motor_respond
    respond.restype = None
    respond.argtypes = (_COUNT, _COUNT, _POINTER, _POINTER, _POINTER, _POINTER)
    return handle if fingerprint() == forms.WHOLE_MOTOR_FINGERPRINT else None


def pointer(array: NDArray[Any]) -> int:
    """Return the address of an array of doubles without gaps."""
    assert array.dtype == np.float64
    return compiled.address(array)
