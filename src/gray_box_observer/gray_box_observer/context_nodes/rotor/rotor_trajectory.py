"""The free run of one motor with a rotor, sample after sample, with its derivatives.

Compiled code (`native/whole_motor.c`) and Python give the same to rounding; both are made of
:mod:`gray_box_observer.white_box.flow`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.native import whole_motor as native
from gray_box_observer.context_nodes.rotor.coordinates import COORDINATES, WholeMotor
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.flow import (
    Interval,
    Linear,
    _exponential_step,
    joined,
    rate,
    runge_kutta_step,
)
from gray_box_observer.white_box.interface import Array

STATES = len(State)

LOAD = tuple(TERMS).index('load_torque')
"""Place of the load's acceleration among the coordinates."""

LARGEST_STEP = 0.5
"""Largest product of step and fastest rate: a Runge-Kutta step is then right to 3e-4 of a decay."""

MOST_STEPS = 256
"""Steps in an interval; where more were needed, as many exponential ones are taken."""

PATIENCE, LEAST_PATIENCE = 128, 16384
"""Steps an interval, on average, and steps in all, beyond which a run is given up: such a motor is
too fast for its samples, and a search that tries it would hold everybody up."""


@dataclass(frozen=True, slots=True)
class Run:
    """Where k intervals lead.

    Attributes:
        states: shape (k + 1, state): current in A and speed in rad/s.
        slopes: shape (k + 1, state, state + coordinate): derivatives by the first states and by the
            coordinates of :mod:`~gray_box_observer.context_nodes.rotor.coordinates`.
        transitions: shape (k, state, state): derivatives of every interval's end by its start.
        is_bounded: whether it stayed within its limits to the end; nothing of it is valid else.
        steps: how many were taken.
    """

    states: Array
    slopes: Array
    transitions: Array
    is_bounded: bool
    steps: int


def run(
    torque_constant: float,
    p: Array,
    start: Array,
    voltage_v: Array,
    interval_s: Array,
    limits: Array,
    load_rad_s2: Array | None = None,
    *,
    compiled: bool = True,
) -> Run:
    """Follow a motor from given states.

    Args:
        torque_constant: Kt in N m/A.
        p: shape (coordinate,).
        start: shape (state,): first current in A and speed in rad/s.
        voltage_v: shape (k,): voltage held over every interval.
        interval_s: shape (k,): how long each lasts.
        limits: shape (state,): absolute values at which the run is given up; it is too where it
            takes too many steps.
        load_rad_s2: shape (k,): what a load takes of the acceleration over every interval, beside
            that of the coordinates; None: nothing.
        compiled: whether compiled code is used where there is any.
    """
    count = voltage_v.size
    states = np.empty((count + 1, STATES))
    derivatives = np.empty((count + 1, STATES, STATES + COORDINATES))
    transitions = np.empty((count, STATES, STATES))
    library = native.library() if compiled else None
    if library is None:
        loads = np.zeros(count) if load_rad_s2 is None else load_rad_s2
        path, steps = _run(
            torque_constant, p, start, (voltage_v, interval_s, loads), limits,
            (states, derivatives, transitions),
        )  # fmt: skip
        return Run(states, derivatives, transitions, path == count, steps)
    arguments = [
        np.ascontiguousarray(array, dtype=float)
        for array in (p, start, voltage_v, interval_s, limits)
    ]
    to_p, to_start, to_voltage, to_interval, to_limits = map(native.pointer, arguments)
    load = None if load_rad_s2 is None else np.ascontiguousarray(load_rad_s2, dtype=float)
    taken = np.zeros(1, dtype=np.int64)
    path = library.whole_motor_follow(
        to_p,
        torque_constant,
        to_start,
        count,
        to_voltage,
        to_interval,
        None if load is None else native.pointer(load),
        to_limits,
        LARGEST_STEP,
        MOST_STEPS,
        max(PATIENCE * count, LEAST_PATIENCE),
        *map(native.pointer, (states, derivatives, transitions)),
        taken.ctypes.data,
    )
    return Run(states, derivatives, transitions, path == count, int(taken[0]))


def by_knot(path: Run, place: Array, knots: int, *, compiled: bool = True) -> Array:
    """Differentiate a run by the knots of a load that runs straight between them.

    Args:
        path: the run.
        place: shape (k,): where every interval lies among the knots, 0 ... knots - 1.
        knots: how many there are, two at least.
        compiled: whether compiled code is used where there is any.

    Returns:
        Shape (k + 1, state, knot).
    """
    count = place.size
    result = np.zeros((count + 1, STATES, knots))
    library = native.library() if compiled else None
    if library is not None:
        arrays = [np.ascontiguousarray(array) for array in (place, path.slopes, path.transitions)]
        library.whole_motor_by_knot(count, knots, *map(native.pointer, (*arrays, result)))
        return result
    pushed = path.slopes[:, :, STATES + LOAD]
    left = np.minimum(place.astype(int), knots - 2)
    for k in range(count):
        push = pushed[k + 1] - path.transitions[k] @ pushed[k]
        share = place[k] - left[k]
        result[k + 1] = path.transitions[k] @ result[k]
        result[k + 1, :, left[k]] += (1.0 - share) * push
        result[k + 1, :, left[k] + 1] += share * push
    return result


def _run(
    torque_constant: float,
    p: Array,
    start: Array,
    signals: tuple[Array, Array, Array],
    limits: Array,
    room: tuple[Array, Array, Array],
) -> tuple[int, int]:
    """Do in Python what compiled code does; return how many intervals were followed, and steps."""
    states, derivatives, transitions = room
    states[0] = start
    derivatives[0] = np.eye(STATES, STATES + COORDINATES)
    motor: Any = WholeMotor(torque_constant)
    coefficients = dict(enumerate(p.tolist()))
    with np.errstate(all='ignore'):
        signals_at = zip(*(signal.tolist() for signal in signals), strict=True)
        patience, steps = max(PATIENCE * (states.shape[0] - 1), LEAST_PATIENCE), 0
        for k, (volt, length, load) in enumerate(signals_at):
            coefficients[LOAD] = float(p[LOAD]) + load
            motion, taken = _interval_moved(motor, coefficients, states[k].tolist(), volt, length)
            steps += taken
            if steps > patience:
                return k, steps
            if not all(abs(x) <= most for x, most in zip(motion.value, limits, strict=True)):
                return k, steps
            states[k + 1] = motion.value
            transitions[k] = motion.by_state
            derivatives[k + 1] = transitions[k] @ derivatives[k]
            derivatives[k + 1, :, STATES:] += np.array(motion.by_coordinate)
    return int(states.shape[0]) - 1, steps


def _interval_moved(
    motor: Any, coefficients: dict[int, float], start: list[float], volt: float, length: float
) -> tuple[Linear, int]:
    """Move one interval on, again in shorter steps where a state has passed zero.

    Returns:
        The motion, and how many steps were taken.
    """

    def rate_at(at: Any, speed_rad_s: Any) -> Linear:
        return rate(_FLOATS, motor, coefficients, at, volt, speed_rad_s)

    here = rate_at(start, 0.0)
    away = _fastest(here)
    interval = Interval(volt, 0.0, 0.0, length)  # type: ignore[arg-type]
    motion, taken = _in_steps(rate_at, start, here, interval, away)
    passes = [
        abs(x) <= length * abs(slope) or x * end <= 0.0
        for x, slope, end in zip(start, here.value, motion.value, strict=True)
    ]
    if not any(passes):
        return motion, taken
    at = [0.0 if passed else x for passed, x in zip(passes, start, strict=True)]
    steepest = _fastest(rate_at(at, 0.0))
    if not steepest > away:
        return motion, taken
    motion, again = _in_steps(rate_at, start, here, interval, steepest)
    return motion, taken + again


def _in_steps(
    rate_at: Any, start: list[float], here: Linear, interval: Interval, stiffness: float
) -> tuple[Linear, int]:
    """Equal steps from a start, as many as a stiffness asks for; ``here`` is the rate there.

    Returns:
        The motion, and how many steps were taken.
    """
    length: Any = interval.length_s
    share = stiffness * length / LARGEST_STEP
    step_count = math.ceil(share) if math.isfinite(share) else MOST_STEPS + 1
    count = max(1, min(step_count, MOST_STEPS))
    step: Any = runge_kutta_step
    if step_count > MOST_STEPS:
        step = partial(_exponential_step, _FLOATS)
    part = Interval(interval.voltage_v, 0.0, 0.0, length / count)  # type: ignore[arg-type]
    whole = step(rate_at, start, here, part)
    for _ in range(count - 1):
        whole = joined(whole, step(rate_at, whole.value, rate_at(whole.value, 0.0), part))
    return whole, count


def _fastest(here: Linear) -> float:
    (own, other), (back, last) = here.by_state
    coupled = math.sqrt(abs(other * back))
    return float(max(abs(own) + coupled, abs(last) + coupled))


class _Floats:
    """Of numpy's functions those that a rate and an exponential step need, for plain numbers."""

    stack = staticmethod(np.array)
    minimum = staticmethod(min)
    exp = staticmethod(math.exp)


_FLOATS = _Floats()
