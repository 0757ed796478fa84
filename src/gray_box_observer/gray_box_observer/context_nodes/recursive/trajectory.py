"""A stretch of samples as a linear function of where it starts and of the coordinates.

The trajectory is that of the output error (a free run from voltages) where the gain is zero, and
that of the innovations form where it is not: then a part of every error is taken for a disturbance
of the state, which keeps unmodelled kicks, such as wrong voltage samples, from being taken for
parameters.

Every interval's flow is linearised about a state near the true one (a measurement, or the
trajectory found before), so that the whole stretch follows from one linear recurrence, worked out
for all motors and many samples at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import interval_motion
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import FEWEST_SIGNALS, ReplayBuffer, moves_of
from gray_box_observer.white_box.declaration import COMPILED, State
from gray_box_observer.white_box.interface import Array, WhiteBox

STATES = len(COMPILED)
"""How many states are learnt; they stand before the coordinates among the unknowns."""

CURRENT = int(State.CURRENT)
"""Place of the current among the states, and so among the unknowns."""

COORDINATES = slice(STATES, None)
"""Places of the coordinates among the unknowns."""

STATE_ROW = 0
"""Row of a trajectory that holds the state."""

START_ROW = 1
"""Row that holds its derivative by the first state."""

COORDINATE_ROWS = slice(2, None)
"""Rows that hold those by the coordinates."""

KICK = 9.0
"""Standard deviations of the measured state from which a jump of it is met by a restart."""

MOVE = 0.1
"""Change of the voltage between two intervals that is a move, as a share of its range."""

MAX_KICKED_MOVES = 0.5
"""Share of the moves at which the state may jump before the jumps are the model's fault."""

FAR = 1e3
"""Times the largest measured state: no trajectory goes further."""

ABSURD = 1e100
"""No sensitivity is larger; products of a few of them must still be numbers."""

SETTLING = 100
"""Samples after a restart for which it is remembered how badly its state was known."""

UNKNOWN = 1e12
"""Variance of a state of which nothing is known, in units of the noise's."""

NEGLIGIBLE = 1e-3
"""Variance of a state, in units of the noise's, that needs no remembering."""

LONG = 48
"""Recurrences longer than this are split into parts that run side by side."""


FORGOTTEN = 1e-300
"""Share of a deviation that an interval leaves of it at least, of many time constants."""

LEAST = 1e-12
"""Share of a deviation that an interval leaves of it at least, and takes from it at least."""


@dataclass(frozen=True, eq=False)
class SampleWindow:
    """Samples 0 ... k of a group of motors.

    Attributes:
        state: shape (motor, k + 1): measured current in A.
        voltage_v: shape (motor, k): mean voltage of the interval that ends at sample 1 ... k; 0 at
            a restart.
        interval_s: shape (motor, k): its length; 0 at a restart.
        speed_rad_s: shape (motor, k + 1).
        restart: shape (motor, k): where the signal history starts anew.
        held_v: shape (motor, k + 1): voltage in force at every sample; None: it is not told.
        moment_v: shape (motor, k + 1): first moment over the interval before it; None likewise.
    """

    state: Array
    voltage_v: Array
    interval_s: Array
    speed_rad_s: Array
    restart: NDArray[np.bool_]
    held_v: Array | None = None
    moment_v: Array | None = None

    @cached_property
    def is_regular(self) -> bool:
        """Whether no signal history starts anew in it."""
        return not self.restart.any()

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Where no signal history starts anew behind the first sample, shape (motor, k + 1)."""
        first = np.ones((self.state.shape[0], 1), dtype=bool)
        return np.concatenate([first, ~self.restart], axis=1)

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Where the voltage moves and stays, see :func:`voltage_moves`, shape (motor, k)."""
        return voltage_moves(self.voltage_v)

    @cached_property
    def far_away(self) -> Array:
        """Size that no current of these samples has, shape (motor, 1)."""
        largest: Array = np.abs(self.state).max(axis=1, keepdims=True)
        return FAR * (largest + 1e-9)

    def restarted(self, at: NDArray[np.bool_]) -> SampleWindow:
        """Return the stretch with further restarts, shape (motor, k)."""
        return replace(self, restart=self.restart | at)

    def select(self, index: NDArray[np.intp]) -> SampleWindow:
        """Return the stretch of the chosen motors."""
        voltage = self.voltage_v[index]
        interval = self.interval_s[index]
        speed = self.speed_rad_s[index]
        restart = self.restart[index]
        moves = (None if one is None else one[index] for one in (self.held_v, self.moment_v))
        return SampleWindow(self.state[index], voltage, interval, speed, restart, *moves)

    def part(self, begin: int, end: int) -> SampleWindow:
        """Return samples ``begin`` ... ``end`` as a stretch."""
        between = slice(begin, end)
        samples = slice(begin, end + 1)
        return SampleWindow(
            self.state[:, samples],
            self.voltage_v[:, between],
            self.interval_s[:, between],
            self.speed_rad_s[:, samples],
            self.restart[:, between],
            None if self.held_v is None else self.held_v[:, samples],
            None if self.moment_v is None else self.moment_v[:, samples],
        )

    @classmethod
    def newest(
        cls,
        white_box: WhiteBox,
        replay: ReplayBuffer,
        samples: int,
        selection: Any = slice(None),
        until: NDArray[np.int_] | None = None,
    ) -> SampleWindow:
        """Take samples out of a replay buffer, the first of them as where the stretch starts.

        Args:
            white_box: of the chosen motors.
            replay: where they are.
            samples: how many, at most.
            selection: index of the motors.
            until: place of the last one in each motor's stream; None: the newest.
        """
        samples = min(samples, int(replay.remembered(selection, until).min()))
        return cls.of_content(
            white_box, np.ascontiguousarray(replay.newest(samples, selection, until))
        )

    @classmethod
    def of_content(cls, white_box: WhiteBox, content: Array) -> SampleWindow:
        """Make a stretch of samples as a replay buffer gives them, shape (signal, motor, k + 1)."""
        interval, voltage, torque, speed = content[:FEWEST_SIGNALS]
        interval = interval[:, 1:]
        restart = interval <= 0.0
        return cls(
            white_box.state(torque),
            np.where(restart, 0.0, voltage[:, 1:]),
            interval,
            speed,
            restart,
            *moves_of(content),
        )


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The stretch under given coordinates, and how it would move with them.

    Attributes:
        state: shape (motor, k + 1): predicted current.
        by_start: shape (motor, k + 1): derivative by the first state.
        by_coordinate: shape (coordinate, motor, k + 1).
        factor: shape (motor, k): how much of an error every interval leaves.
    """

    state: Array
    by_start: Array
    by_coordinate: Array
    factor: Array

    def select(self, index: NDArray[np.intp]) -> Trajectory:
        """Return the trajectories of the chosen motors."""
        return Trajectory(
            self.state[index],
            self.by_start[index],
            self.by_coordinate[:, index],
            self.factor[index],
        )


@dataclass(frozen=True, eq=False)
class Linearised:
    """Every interval's flow as an affine map of the state at its start and of the coordinates.

    Attributes:
        decay: shape (motor, k): derivative of the end by the start; 0 at a restart.
        offset: shape (motor, k): end for a start of zero; the measured state at a restart.
        by_coordinate: shape (coordinate, motor, k): derivative of the end by the coordinates.
    """

    decay: Array
    offset: Array
    by_coordinate: Array

    @property
    def motion(self) -> Linearised:
        """The map of the state alone: a trajectory of it has no derivatives by coordinates."""
        return replace(self, by_coordinate=self.by_coordinate[:0])

    def select(self, index: NDArray[np.intp]) -> Linearised:
        """Return the intervals of the chosen motors."""
        return Linearised(self.decay[index], self.offset[index], self.by_coordinate[:, index])


def linearise(white_box: WhiteBox, p: Array, stretch: SampleWindow, about: Array) -> Linearised:
    """Linearise every interval of a stretch.

    Args:
        white_box: the physics.
        p: shape (motor, coordinate).
        stretch: the samples.
        about: shape (motor, k + 1): states to linearise about.
    """
    speed = stretch.speed_rad_s
    start = about[:, :-1]
    ends = speed[:, :-1], speed[:, 1:]
    motion = interval_motion.move(white_box, p, start, stretch.voltage_v, *ends, stretch.interval_s)
    end, by_state, by_coordinate = motion.of_state(CURRENT)
    limit = stretch.far_away
    if not (
        np.abs(end) <= limit
    ).all():  # absurd coordinates can be met on the way to good ones: nothing may overflow
        end = np.clip(np.nan_to_num(end), -limit, limit)
        by_state = np.nan_to_num(by_state)
        by_coordinate = np.clip(np.nan_to_num(by_coordinate), -ABSURD, ABSURD)
    decay = by_state.clip(-1.0, 1.0)
    offset = end - decay * start
    if not stretch.is_regular:
        decay = np.where(stretch.restart, 0.0, decay)
        offset = np.where(stretch.restart, stretch.state[:, 1:], offset)
        by_coordinate = np.where(stretch.restart, 0.0, by_coordinate)
    return Linearised(decay, offset, by_coordinate)


def follow(maps: Linearised, stretch: SampleWindow, start: Array, gain: Array) -> Trajectory:
    """Follow the linearised flow through a stretch.

    Args:
        maps: the linearised intervals.
        stretch: the samples.
        start: shape (motor,): state at sample 0.
        gain: shape (motor, k + 1): share of every sample's error that the state takes over; 0 for a
            free run.
    """
    gain = gain[:, :-1]
    factor = maps.decay * (1.0 - gain)
    inputs = np.empty((START_ROW + 1 + maps.by_coordinate.shape[0], *factor.shape))
    inputs[STATE_ROW] = maps.offset + maps.decay * gain * stretch.state[:, :-1]
    inputs[START_ROW] = 0.0
    inputs[COORDINATE_ROWS] = maps.by_coordinate
    first = np.zeros((inputs.shape[0], start.size))
    first[STATE_ROW], first[START_ROW] = start, 1.0
    rows = recurrence(factor, inputs, first)
    return Trajectory(rows[STATE_ROW], rows[START_ROW], rows[COORDINATE_ROWS], factor)


def input_reach(interval_s: Array, decay: Array) -> Array:
    """Return for how long an input acts in every interval, what decays of it taken off.

    Args:
        interval_s: shape (k,).
        decay: shape (k,): what every interval leaves of a deviation, 0 to 1.
    """
    reach: Array = interval_s * (1.0 - decay) / -np.log(np.clip(decay, FORGOTTEN, 1.0 - LEAST))
    return reach


def find_kicks(
    path: Trajectory, residual: Array, valid: NDArray[np.bool_], noise: Array
) -> NDArray[np.bool_]:
    """Find samples at which the state has jumped against the model: a wrong voltage sample, a bump.

    A kick shows as one large change of the error that stays, or as two where another oddity lies
    beside it; an outlier of torque as two that cancel, wrong parameters as many.

    Args:
        path: the trajectory.
        residual: shape (motor, k + 1): measured less predicted state.
        valid: shape (motor, k): where the interval is no restart.
        noise: shape (motor,): standard deviation of the measured state.

    Returns:
        Shape (motor, k): whether the state at sample 1 ... k came by a kick.
    """
    innovation = (residual[:, 1:] - path.factor * residual[:, :-1]) * valid
    limit = KICK * noise[:, None]
    change = np.abs(innovation)
    large = (change > limit).any(axis=1, keepdims=True)
    if not large.any():
        return change > limit
    earlier = _shifted(change, 2)
    before = _shifted(change, 1)
    after = _shifted(change, -1)
    one = (change > limit) & (before < 0.5 * change) & (after < 0.5 * change)
    both = np.abs(innovation + path.factor * _shifted(innovation, 1))
    two = (both > limit) & (earlier < 0.25 * both) & (after < 0.25 * both) & (before > 0.0)
    kicks: NDArray[np.bool_] = (one | two) & large
    return kicks


def voltage_moves(voltage_v: Array) -> NDArray[np.bool_]:
    """Find where the voltage moves and stays.

    One that is back after one interval has not moved: that may be a wrong reading.

    Args:
        voltage_v: shape (motor, k): mean over every interval.

    Returns:
        Shape (motor, k).
    """
    around = np.concatenate([voltage_v[:, :1], voltage_v, voltage_v[:, -1:]], axis=1)
    lasting_v = median(np.stack([around[:, :-2], voltage_v, around[:, 2:]], axis=-1))
    change_v = np.abs(np.diff(lasting_v, axis=1, prepend=lasting_v[:, :1]))
    moves: NDArray[np.bool_] = change_v > MOVE * np.ptp(lasting_v, axis=1, keepdims=True)
    return moves


def follow_moves(kicks: NDArray[np.bool_], moves: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell whose state jumps at most moves of the voltage: that is the model's fault.

    A run that begins anew behind every move would rest on the held levels alone, and these tell
    nothing of the inductance.

    Args:
        kicks: shape (motor, k): where the state has jumped.
        moves: shape (motor, k): where the voltage has moved.

    Returns:
        Shape (motor,).
    """
    near = kicks.copy()
    near[:, :-1] |= kicks[:, 1:]  # what a delayed voltage does comes an interval later
    at_moves: NDArray[np.bool_] = (moves & near).sum(axis=1) > MAX_KICKED_MOVES * moves.sum(axis=1)
    return at_moves


def _shifted(values: Array, by: int) -> Array:
    """Values (motor, k) shifted in time; 0 before the first, infinite after the last."""
    result = np.full(values.shape, np.inf if by < 0 else 0.0)
    if by < 0:
        result[:, :by] = values[:, -by:]
    else:
        result[:, by:] = values[:, : values.shape[1] - by]
    return result


def restart_variance(decay: Array, restart: NDArray[np.bool_]) -> Array:
    """Variance of the predicted state after restarts, in noise variances, (motor, k + 1).

    A restart begins at one measured sample, whose noise decays with the motion while the samples
    that follow tell the state better and better: a Kalman filter of the state alone, ``P' = decay^2
    P / (1 + P)``, from UNKNOWN at the sample that it restarts from. With its gain ``P / (1 + P)``
    innovations are white and of variance ``1 + P``, so that what comes after a gap teaches what it
    can and no more.

    Args:
        decay: shape (motor, k): what every interval leaves of a deviation; 0 at a restart.
        restart: shape (motor, k).
    """
    if not restart.any():
        return np.zeros((restart.shape[0], restart.shape[1] + 1))
    compiled_variance = interval_motion.restart_variance(
        decay, restart, UNKNOWN, NEGLIGIBLE, SETTLING
    )
    if compiled_variance is not None:
        return compiled_variance
    motors, k = restart.shape
    variance = np.zeros((motors, k + 1))
    motor, at = np.nonzero(restart)
    variance[motor, at + 1] = UNKNOWN
    remaining_variance = np.ones(motor.size)  # after the sample that it restarts from
    for ahead in range(1, SETTLING):
        onward = at + ahead < k
        onward[onward] = ~restart[motor[onward], at[onward] + ahead]
        onward &= remaining_variance > NEGLIGIBLE
        if not np.any(onward):
            break
        motor = motor[onward]
        at = at[onward]
        remaining_variance = remaining_variance[onward]
        predicted_variance = decay[motor, at + ahead] ** 2 * remaining_variance
        variance[motor, at + ahead + 1] = predicted_variance
        remaining_variance = taken_over(predicted_variance)
    return variance


def taken_over(variance: Array) -> Array:
    """Share of a sample's error that a state takes over: ``P / (1 + P)``, P in noise variances.

    It is also the variance that the state is left with by the sample.
    """
    return variance / (1.0 + variance)


def recurrence(factor: Array, inputs: Array, start: Array) -> Array:
    """Work out ``x[j + 1] = factor[j] x[j] + inputs[j]``.

    Args:
        factor: shape (motor, k).
        inputs: shape (row, motor, k): right-hand sides that share the factors.
        start: shape (row, motor).

    Returns:
        Shape (row, motor, k + 1), beginning with the start.
    """
    result = interval_motion.recurrence(factor, inputs, start)
    if result is not None:
        return result
    rows, motors, k = inputs.shape
    if k > LONG:
        return _in_parts(factor, inputs, start)
    result = np.empty((rows, motors, k + 1))
    result[:, :, 0] = value = start
    for j in range(k):
        value = factor[:, j] * value + inputs[:, :, j]
        result[:, :, j + 1] = value
    return result


def _in_parts(factor: Array, inputs: Array, start: Array) -> Array:
    """The same for long windows: parts from zero side by side, then carries between them."""
    rows, motors, k = inputs.shape
    length = max(2, int(np.sqrt(k)))
    parts = -(-k // length)
    spare = parts * length - k
    factor = np.pad(factor, ((0, 0), (0, spare)), constant_values=1.0).reshape(
        motors, parts, length
    )
    inputs = np.pad(inputs, ((0, 0), (0, 0), (0, spare))).reshape(rows, motors, parts, length)
    inside = np.empty_like(inputs)
    reach = np.cumprod(factor, axis=-1)
    value = np.zeros((rows, motors, parts))
    for j in range(length):
        value = factor[..., j] * value + inputs[..., j]
        inside[..., j] = value
    carry = np.empty((rows, motors, parts))
    carry[:, :, 0] = start
    for part in range(1, parts):
        carry[:, :, part] = (
            reach[:, part - 1, -1] * carry[:, :, part - 1] + inside[:, :, part - 1, -1]
        )
    whole = (inside + reach * carry[..., None]).reshape(rows, motors, parts * length)[:, :, :k]
    return np.concatenate([start[:, :, None], whole], axis=2)
