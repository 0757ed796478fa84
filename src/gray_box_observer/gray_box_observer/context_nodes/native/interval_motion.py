"""The motion over many intervals at once: compiled, `interval_motion.c`, with numpy behind it.

Batch fits and the search for a delay linearise every interval of a window. Numpy's
:func:`~gray_box_observer.white_box.flow.flow` does it for every white box; this does it for the
motors whose terms compiled code knows.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.native.compiled import address
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import COMPILED
from gray_box_observer.white_box.flow import LARGEST_STEP, MAX_STEPS, flow
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motion import Linear
from gray_box_observer.white_box.motor import MotorWhiteBox

MOST_COORDINATES, MOST_KNOWN = 5, 8
"""Room in `white_box/physics.h`."""

_COUNT = ctypes.c_int64
_NUMBER = ctypes.c_double
_POINTER = ctypes.c_void_p

_INPUTS = ('p', 'known', 'torque_constant', 'start', 'voltage', 'speed', 'end_speed', 'length')
_OUTPUTS = ('outputs', 'left_out')


class _Motions(ctypes.Structure):
    """``Motions`` of `interval_motion.c`."""

    _fields_ = (
        *(
            (name, _COUNT)
            for name in ('motors', 'intervals', 'coordinates', 'known_terms', 'speed_measured')
        ),
        ('codes', _COUNT * (MOST_COORDINATES + MOST_KNOWN)),
        *((name, _NUMBER) for name in ('largest_step', 'most_steps')),
        *((name, _POINTER) for name in (*_INPUTS, *_OUTPUTS)),
    )


@cache
def library() -> ctypes.CDLL | None:
    """Load the compiled code; None without it, or where it was built of other forms."""
    handle = compiled.library('motions_size', _Motions)
    if handle is None:
        return None
    handle.move_intervals.argtypes = (ctypes.POINTER(_Motions),)
    handle.move_intervals.restype = None
    handle.recurrences.argtypes = (*3 * (_COUNT,), *4 * (_POINTER,))
    handle.recurrences.restype = None
    variance_types = (_COUNT, _COUNT, _POINTER, _POINTER, _NUMBER, _NUMBER, _COUNT, _POINTER)
    handle.restart_variances.argtypes = variance_types
    handle.restart_variances.restype = None
    handle.forms_fingerprint.restype = _COUNT
    handle.term_values.argtypes = (_COUNT, _COUNT, *4 * (_NUMBER,), ctypes.POINTER(_NUMBER))
    handle.term_values.restype = _COUNT
    return handle if handle.forms_fingerprint() == forms.FINGERPRINT else None


def move(
    white_box: WhiteBox,
    p: Array,
    start: Array,
    voltage_v: Array,
    speed_rad_s: Array,
    end_speed: Array,
    interval_s: Array,
) -> Linear:
    """Move the current over many intervals, as :func:`~gray_box_observer.white_box.flow.flow` does.

    Args:
        white_box: the physics; of one state.
        p: shape (motor, coordinate).
        start: shape (motor, k): the current in A at the start of every interval.
        voltage_v: shape (motor, k): voltage held over it.
        speed_rad_s: shape (motor, k): measured speed at its start.
        end_speed: shape (motor, k): measured speed at its end, in rad/s.
        interval_s: shape (motor, k).
    """
    handle = library()
    if handle is None or not isinstance(white_box, MotorWhiteBox) or not _has_room(white_box):
        return flow(white_box, p, [start], voltage_v, speed_rad_s, end_speed, interval_s)
    motors, intervals = start.shape
    inputs = [
        np.ascontiguousarray(array, dtype=float)
        for array in (
            p,
            _of_motors([white_box.known[name] for name in white_box.given], motors),
            _of_motors([white_box.torque_constant], motors),
            *(start, voltage_v, speed_rad_s, end_speed, interval_s),
        )
    ]
    outputs = np.empty((2 + p.shape[1], motors, intervals))
    value = outputs[0]
    by_state = outputs[1]
    by_coordinate = outputs[2:]
    left_out = np.empty(motors, dtype=bool)
    motions = _Motions(
        motors,
        intervals,
        p.shape[1],
        len(white_box.given),
        int(white_box.speed_measured),
        white_box.codes,
        LARGEST_STEP,
        MAX_STEPS,
        *map(address, (*inputs, outputs, left_out)),
    )
    handle.move_intervals(motions)
    if left_out.any():
        index = np.flatnonzero(left_out)
        motion = flow(
            white_box.of_motors(index),
            p[index],
            [start[index]],
            *(array[index] for array in (voltage_v, speed_rad_s, end_speed, interval_s)),
        )
        value[index] = motion.value[0]
        by_state[index] = motion.by_state[0][0]
        by_coordinate[:, index] = motion.by_coordinate[0]
    return Linear([value], [[by_state]], [by_coordinate])


def _of_motors(constants: Sequence[Any], motors: int) -> Array:
    """Return constants, scalars or of shape (motor,), as shape (constant, motor)."""
    values = np.empty((len(constants), motors))
    for row, constant in zip(values, constants, strict=True):
        row[:] = constant
    return values


def recurrence(factor: Array, inputs: Array, start: Array) -> Array | None:
    """Work out ``x[j + 1] = factor[j] x[j] + inputs[j]``; None without compiled code.

    Args:
        factor: shape (motor, k).
        inputs: shape (row, motor, k): right-hand sides that share the factors.
        start: shape (row, motor).

    Returns:
        Shape (row, motor, k + 1), beginning with the start.
    """
    handle = library()
    if handle is None:
        return None
    rows, motors, k = inputs.shape
    result = np.empty((rows, motors, k + 1))
    arrays = [np.ascontiguousarray(array, dtype=float) for array in (factor, inputs, start)]
    handle.recurrences(rows, motors, k, *map(address, (*arrays, result)))
    return result


def restart_variance(
    decay: Array, restart: NDArray[np.bool_], unknown: float, negligible: float, most_samples: int
) -> Array | None:
    """Work out what restarts leave of the state's variance; None without compiled code.

    Args:
        decay: shape (motor, k): what every interval leaves of a deviation.
        restart: shape (motor, k).
        unknown: variance at a restart, in units of the noise's.
        negligible: variance that needs no remembering.
        most_samples: samples for which it is remembered at most.

    Returns:
        Shape (motor, k + 1).
    """
    handle = library()
    if handle is None:
        return None
    motors, k = restart.shape
    variance = np.empty((motors, k + 1))
    decays = np.ascontiguousarray(decay, dtype=float)
    restarts = np.ascontiguousarray(restart, dtype=np.uint8)
    handle.restart_variances(
        *(motors, k, address(decays), address(restarts)),
        *(unknown, negligible, most_samples, address(variance)),
    )
    return variance


@cache
def _known_code(code: int) -> bool:
    handle = library()
    values = (_NUMBER * 2)()
    return handle is not None and bool(handle.term_values(code, 0, *4 * (0.0,), values))


def _has_room(white_box: MotorWhiteBox) -> bool:
    """Tell whether compiled code has room for a motor and knows its terms."""
    return (
        white_box.states == COMPILED
        and len(white_box.parameters) <= MOST_COORDINATES
        and len(white_box.given) <= MOST_KNOWN
        and all(map(_known_code, white_box.codes))
    )
