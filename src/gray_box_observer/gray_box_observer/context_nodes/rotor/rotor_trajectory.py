"""The free run of one motor with a rotor, sample after sample, with its derivatives.

An interval is one step where friction holds the rotor, or brushes the current (:mod:`held_state`),
and where the rate is straight in the states (:mod:`straight_motion`). Else it is halved until a
part is either, or until few Runge-Kutta steps are enough for it: near where a softened sign
changes, and everywhere for a moving motor with hysteresis. Compiled code (`native/whole_motor.c`)
and Python give the same to rounding; both are made of :mod:`gray_box_observer.white_box.flow`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.native import whole_motor as native
from gray_box_observer.context_nodes.native.compiled import address
from gray_box_observer.context_nodes.rotor.coordinates import COORDINATES, WholeMotor
from gray_box_observer.context_nodes.rotor.held_state import held_motion, may_be_held
from gray_box_observer.context_nodes.rotor.straight_motion import HALVINGS, StraightMotion
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.flow import _exponential_step, rate, runge_kutta_step
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motion import Interval, Linear, joined

STATES = len(State)

LOAD = tuple(TERMS).index('load_torque')
"""Place of the load's acceleration among the coordinates."""

DRY_FRICTION = tuple(TERMS).index('coulomb_friction')
"""The same of dry friction's."""

BRUSHES = tuple(TERMS).index('brush_drop')
"""Place of the drop of the brushes among them."""

LARGEST_STEP = 0.5
"""Largest product of step and fastest rate: a Runge-Kutta step is then right to 3e-4 of a decay."""

MOST_STEPS = 256
"""Steps in an interval; where more were needed, as many exponential ones are taken."""

PATIENCE, LEAST_PATIENCE = 128, 16384
"""Steps an interval, on average, and steps in all, beyond which a run is given up: such a motor is
too fast for its samples, and a search that tries it would hold everybody up."""


FEW_STEPS = 4
"""Runge-Kutta steps that are taken sooner than a part is halved."""

STRAIGHT_COST, HELD_COST = 2, 4
"""Steps that a straight motion counts for, and an attempt at one with the rotor held."""

FEWEST_INTERVALS = 8
"""Of a run, from which straight motions are prepared."""

MANY_STEPS = 16
"""Runge-Kutta steps from which they are prepared anew for an interval of another length."""

SAME_LENGTH = 1e-6
"""Share by which a length is another."""


@dataclass(frozen=True, eq=False)
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
    patience: int = PATIENCE,
    is_compiled: bool = True,
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
        patience: steps an interval, on average, beyond which it is given up.
        is_compiled: whether compiled code is used where there is any.
    """
    count = voltage_v.size
    most_steps = max(patience * count, LEAST_PATIENCE)
    states = np.empty((count + 1, STATES))
    derivatives = np.empty((count + 1, STATES, STATES + COORDINATES))
    transitions = np.empty((count, STATES, STATES))
    library = native.library() if is_compiled else None
    if library is None:
        loads = np.zeros(count) if load_rad_s2 is None else load_rad_s2
        path, steps = _run(
            torque_constant, p, start, (voltage_v, interval_s, loads), limits,
            (states, derivatives, transitions), most_steps,
        )  # fmt: skip
        return Run(states, derivatives, transitions, path == count, steps)
    arguments = [
        np.ascontiguousarray(array, dtype=float)
        for array in (p, start, voltage_v, interval_s, limits)
    ]
    to_p, to_start, to_voltage, to_interval, to_limits = map(native.pointer, arguments)
    load = None if load_rad_s2 is None else np.ascontiguousarray(load_rad_s2, dtype=float)
    step_count = np.zeros(1, dtype=np.int64)
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
        most_steps,
        *map(native.pointer, (states, derivatives, transitions)),
        address(step_count),
    )
    return Run(states, derivatives, transitions, path == count, int(step_count[0]))


class OneInterval:
    """Follows one motor over a single interval, as :func:`run` does, and sooner.

    What compiled code reads and writes is kept from one interval to the next.

    Args:
        torque_constant: Kt in N m/A.
        p: shape (coordinate,): they do not change.
        is_compiled: whether compiled code is used where there is any.
    """

    def __init__(self, torque_constant: float, p: Array, *, is_compiled: bool = True) -> None:
        self._torque_constant = torque_constant
        self._p = np.ascontiguousarray(p, dtype=float)
        self._start = np.empty(STATES)
        self._limits = np.empty(STATES)
        self._signals = np.empty(3)  # voltage, length and load
        self._states = np.empty((2, STATES))
        self._derivatives = np.empty((2, STATES, STATES + COORDINATES))
        self._transitions = np.empty((1, STATES, STATES))
        self._step_count = np.zeros(1, dtype=np.int64)
        self._library = native.library() if is_compiled else None
        signals = native.pointer(self._signals)
        self._signal_pointers = [signals + k * self._signals.itemsize for k in range(3)]
        arrays = (self._p, self._start, self._limits)
        self._inputs = [native.pointer(array) for array in arrays]
        outputs = (self._states, self._derivatives, self._transitions)
        self._outputs = [*map(native.pointer, outputs), address(self._step_count)]

    def end(
        self,
        start: Array,
        voltage_v: float,
        length_s: float,
        limits: tuple[float, float],
        load_rad_s2: float,
    ) -> Array | None:
        """Return the states at the end of an interval; None where the run is given up.

        Args:
            start: shape (state,): current in A and speed in rad/s.
            voltage_v: held over the interval.
            length_s: how long it lasts.
            limits: absolute values of the states at which the run is given up.
            load_rad_s2: what a load takes of the acceleration, beside that of the coordinates.
        """
        self._start[:] = start
        self._signals[:] = voltage_v, length_s, load_rad_s2
        self._limits[:] = limits
        if self._library is None:
            volts, lengths, loads = self._signals[:, None]
            path = run(
                self._torque_constant, self._p, self._start, volts, lengths, self._limits, loads,
                is_compiled=False,
            )  # fmt: skip
            return path.states[1] if path.is_bounded else None
        to_p, to_start, to_limits = self._inputs
        to_voltage, to_length, to_load = self._signal_pointers
        path_count = self._library.whole_motor_follow(
            to_p, self._torque_constant, to_start, 1, to_voltage, to_length, to_load, to_limits,
            LARGEST_STEP, MOST_STEPS, LEAST_PATIENCE, *self._outputs,
        )  # fmt: skip
        return self._states[1].copy() if path_count == 1 else None


def by_knot(path: Run, place: Array, knots: int, *, is_compiled: bool = True) -> Array:
    """Differentiate a run by the knots of a load that runs straight between them.

    Args:
        path: the run.
        place: shape (k,): where every interval lies among the knots, 0 ... knots - 1.
        knots: how many there are, two at least.
        is_compiled: whether compiled code is used where there is any.

    Returns:
        Shape (k + 1, state, knot).
    """
    count = place.size
    result = np.zeros((count + 1, STATES, knots))
    library = native.library() if is_compiled else None
    if library is not None:
        arrays = [np.ascontiguousarray(array) for array in (place, path.slopes, path.transitions)]
        library.whole_motor_by_knot(count, knots, *map(native.pointer, (*arrays, result)))
        return result
    load_slopes = path.slopes[:, :, STATES + LOAD]
    left = np.minimum(place.astype(int), knots - 2)
    for k in range(count):
        push = load_slopes[k + 1] - path.transitions[k] @ load_slopes[k]
        share = place[k] - left[k]
        result[k + 1] = path.transitions[k] @ result[k]
        result[k + 1, :, left[k]] += (1.0 - share) * push
        result[k + 1, :, left[k] + 1] += share * push
    return result


def state_response(
    transitions: Array, gains: Array, inputs: Array, *, is_compiled: bool = True
) -> Array:
    """Return by how much further inputs move the states, shape (k + 1, input, state).

    Args:
        transitions: shape (k, state, state): of a run.
        gains: shape (k, state): derivatives of every interval's end by an input over it.
        inputs: shape (k, input).
        is_compiled: whether compiled code is used where there is any.
    """
    count, columns = inputs.shape
    result = np.zeros((count + 1, columns, STATES))
    library = native.library() if is_compiled else None
    if library is not None:
        arrays = [np.ascontiguousarray(array) for array in (transitions, gains, inputs)]
        library.whole_motor_respond(count, columns, *map(native.pointer, (*arrays, result)))
        return result
    state = np.zeros((STATES, columns))
    for k, (transition, gain) in enumerate(zip(transitions, gains, strict=True)):
        state = transition @ state + gain[:, None] * inputs[k]
        result[k + 1] = state.T
    return result


def _run(
    torque_constant: float,
    p: Array,
    start: Array,
    signals: tuple[Array, Array, Array],
    limits: Array,
    room: tuple[Array, Array, Array],
    patience: int,
) -> tuple[int, int]:
    """Do in Python what compiled code does; return how many intervals were followed, and steps."""
    states, derivatives, transitions = room
    states[0] = start
    derivatives[0] = np.eye(STATES, STATES + COORDINATES)
    motion = _Motion(torque_constant, p, limits)
    with np.errstate(all='ignore'):
        if signals[1].size >= FEWEST_INTERVALS:
            motion.prepare(float(signals[1][signals[1].size // 2]))
        for k, (volt, length, load) in enumerate(
            zip(*(signal.tolist() for signal in signals), strict=True)
        ):
            end = motion.over(states[k].tolist(), volt, length, float(p[LOAD]) + load)
            if motion.steps > patience:
                return k, motion.steps
            if not all(abs(x) <= most for x, most in zip(end.value, limits, strict=True)):
                return k, motion.steps
            states[k + 1] = end.value
            transitions[k] = end.by_state
            derivatives[k + 1] = transitions[k] @ derivatives[k]
            derivatives[k + 1, :, STATES:] += np.array(end.by_coordinate)
    return int(states.shape[0]) - 1, motion.steps


class _Motion:
    """Moves one motor over intervals.

    Attributes:
        steps: how many were taken.
    """

    def __init__(self, torque_constant: float, p: Array, far: Array) -> None:
        self._motor: Any = WholeMotor(torque_constant)
        self._p = p
        self._far = far
        self._coefficients = dict(enumerate(p.tolist()))
        # where both act, they bend each other's balance
        self._holding_rates = {
            State.SPEED: 0.0 if p[BRUSHES] else float(p[DRY_FRICTION]),
            State.CURRENT: 0.0 if p[DRY_FRICTION] else float(p[BRUSHES]),
        }
        self._straight: StraightMotion | None = None
        self._length_s = math.nan  # that straight motions were looked for of
        self.steps = 0

    def prepare(self, length_s: float) -> None:
        """Look for straight motions over an interval."""
        self._length_s = length_s
        self._straight = StraightMotion.of_motor(self._rate_at(0.0), self._p, self._far, length_s)

    def over(self, start: list[float], volt: float, length_s: float, load_rad_s2: float) -> Linear:
        """Move one interval on."""
        self._coefficients[LOAD] = load_rad_s2
        return self._part(start, volt, length_s, 0, self._straight_over(start, volt, length_s))

    def _straight_over(
        self, start: list[float], volt: float, length_s: float
    ) -> StraightMotion | None:
        """Return straight motions over an interval, where there are any or it is worth it."""
        if math.isnan(self._length_s):
            return None
        if abs(length_s - self._length_s) > SAME_LENGTH * self._length_s:
            if not _fastest(self._rate_at(volt)(start)) * length_s > MANY_STEPS * LARGEST_STEP:
                return None
            self.prepare(length_s)
        return self._straight

    def _rate_at(self, volt: float) -> Any:
        def rate_at(at: Any, speed_rad_s: Any = 0.0) -> Linear:
            return rate(_FLOATS, self._motor, self._coefficients, at, volt, speed_rad_s)

        return rate_at

    def _part(
        self,
        start: list[float],
        volt: float,
        length_s: float,
        level: int,
        straight: StraightMotion | None,
    ) -> Linear:
        """Move on by a part of an interval, in shorter steps where a state passes zero."""
        rate_at = self._rate_at(volt)
        here = rate_at(start)
        motion = self._held_over(State.SPEED, rate_at, start, here, length_s)
        if motion is not None:
            return motion
        motion = None if straight is None else straight.moved(rate_at, start, here, level)
        if motion is not None:
            self.steps += STRAIGHT_COST
            return motion
        if self._p[BRUSHES]:
            motion = self._held_over(State.CURRENT, rate_at, start, here, length_s)
            if motion is not None:
                return motion
        may_halve = level < HALVINGS
        few = FEW_STEPS * LARGEST_STEP
        away = _fastest(here)
        interval = Interval(volt, 0.0, 0.0, length_s)  # type: ignore[arg-type]
        if not may_halve or away * length_s <= few:
            motion, step_count = _in_steps(rate_at, start, here, interval, away)
            self.steps += step_count
            steepest = self._steepest(rate_at, start, here, motion, length_s)
            if not steepest > away:
                return motion
            away = steepest
            if not may_halve or away * length_s <= few:
                motion, step_count = _in_steps(rate_at, start, here, interval, away)
                self.steps += step_count
                return motion
        half = 0.5 * length_s
        first = self._part(start, volt, half, level + 1, straight)
        then = self._part([*first.value], volt, half, level + 1, straight)
        return joined(first, then)

    def _held_over(
        self, state: State, rate_at: Any, start: list[float], here: Linear, length_s: float
    ) -> Linear | None:
        """Move on by a part over which friction or brushes hold a state; None where they do not."""
        if not may_be_held(here, state, length_s):
            return None
        self.steps += HELD_COST
        return held_motion(rate_at, start, state, length_s, self._holding_rates[state])

    @staticmethod
    def _steepest(
        rate_at: Any, start: list[float], here: Linear, motion: Linear, length_s: float
    ) -> float:
        """Return the fastest rate where states are zero that pass it on the way; 0: none does."""
        passes = [
            abs(x) <= length_s * abs(slope) or x * end <= 0.0
            for x, slope, end in zip(start, here.value, motion.value, strict=True)
        ]
        if not any(passes):
            return 0.0
        at = [0.0 if is_passed else x for is_passed, x in zip(passes, start, strict=True)]
        return _fastest(rate_at(at))


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
    coupling = math.sqrt(abs(other * back))
    return float(max(abs(own) + coupling, abs(last) + coupling))


class _Floats:
    """Of numpy's functions those that a rate and an exponential step need, for plain numbers."""

    stack = staticmethod(np.array)
    minimum = staticmethod(min)
    exp = staticmethod(math.exp)


_FLOATS = _Floats()
