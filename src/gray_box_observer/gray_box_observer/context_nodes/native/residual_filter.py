"""Loads the compiled filter of noise in residuals, `residual_filter.c`."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.white_box.interface import Array

STATES = 2
"""Current and speed."""

_COUNT = ctypes.c_int64
_NUMBER = ctypes.c_double
_POINTER = ctypes.c_void_p


class _ResidualFilter(ctypes.Structure):
    """``ResidualFilter`` of `residual_filter.c`."""

    _fields_ = (
        *((name, _COUNT) for name in ('samples', 'columns', 'outputs')),
        ('jacobian', _NUMBER * 4),
        *((name, _NUMBER) for name in ('drive', 'noise', 'unit')),
        *((name, _POINTER) for name in ('length', 'voltage', 'is_held', 'is_read', 'rows')),
        *((name, _POINTER) for name in ('result', 'deviations')),
    )


@cache
def library() -> ctypes.CDLL | None:
    """Load the compiled code; None if absent."""
    handle = compiled.library('residual_filter_size', _ResidualFilter)
    if handle is None:
        return None
    handle.filter_noise.argtypes = (ctypes.POINTER(_ResidualFilter), _POINTER)
    handle.move_by_noise.argtypes = (ctypes.POINTER(_ResidualFilter), _POINTER, _POINTER)
    handle.filter_noise.restype = handle.move_by_noise.restype = None
    return handle


def filter_noise(
    jacobian: Array,
    drive: float,
    noise: float,
    unit: float,
    interval_s: Array,
    voltage_v2: Array,
    is_held: NDArray[np.bool_],
    is_read: NDArray[np.bool_],
    rows: Array,
) -> tuple[Array, Array] | None:
    """Filter rows as :mod:`~gray_box_observer.context_nodes.rotor.noise_filter` does.

    None without compiled code. Arguments and results are those of its filter in Python.
    """
    handle = library()
    if handle is None:
        return None
    outputs, samples, columns = rows.shape
    numbers = [np.ascontiguousarray(one, dtype=float) for one in (interval_s, voltage_v2)]
    flags = [np.ascontiguousarray(one, dtype=np.uint8) for one in (is_held, is_read)]
    rows = np.ascontiguousarray(rows, dtype=float)
    result = np.empty_like(rows)
    deviations = np.empty((samples, columns, STATES))
    states = np.zeros((columns, STATES))
    structure = _ResidualFilter(
        samples,
        columns,
        outputs,
        tuple(jacobian.ravel().tolist()),
        drive,
        noise,
        unit,
        *map(compiled.address, (*numbers, *flags, rows, result, deviations)),
    )
    handle.filter_noise(structure, compiled.address(states))
    return result, deviations


def move_by_noise(
    jacobian: Array,
    drive: float,
    interval_s: Array,
    is_held: NDArray[np.bool_],
    voltages_v: Array,
) -> Array | None:
    """Move states by small voltages as the filter in Python does; None without compiled code.

    Args:
        jacobian: shape (state, state): derivatives of the rates by the states.
        drive: rate of the current by the voltage.
        interval_s: shape (k,).
        is_held: shape (k,): over which intervals friction holds the rotor.
        voltages_v: shape (k, column): over every interval.

    Returns:
        Shape (k + 1, column, state).
    """
    handle = library()
    if handle is None:
        return None
    count, columns = voltages_v.shape
    lengths_s = np.ascontiguousarray(interval_s, dtype=float)
    held_flags = np.ascontiguousarray(is_held, dtype=np.uint8)
    inputs_v = np.ascontiguousarray(voltages_v, dtype=float)
    states = np.zeros((count + 1, columns, STATES))
    structure = _ResidualFilter(
        samples=count + 1,
        columns=columns,
        jacobian=tuple(jacobian.ravel().tolist()),
        drive=drive,
        length=compiled.address(lengths_s),
        is_held=compiled.address(held_flags),
    )
    handle.move_by_noise(structure, compiled.address(inputs_v), compiled.address(states))
    return states
