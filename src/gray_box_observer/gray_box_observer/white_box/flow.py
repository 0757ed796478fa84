"""Motion of the states over one interval with derivatives, in linear-rate coordinates.

The rate of a white box that is linear in its parameters is linear too in ``p = (1, theta_1, ...) /
theta_0``, for a motor ``(1/L, R/L, K_HS/L, ...)``: ``dx/dt = p_0 drive - sum_j p_j phi_j``
(docs/METHOD.md, The form). Sensitivities follow the variational equation, integrated together with
the states.

:func:`rate` and :func:`runge_kutta_step` are written here alone, and
:func:`~gray_box_observer.white_box.motion.joined` there: ``ros_ws/make_forms.py`` makes the
compiled ones of them. A sequence over the states has an entry
for every balance of the white box, in that order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from itertools import chain
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.balance import deducted
from gray_box_observer.white_box.held_current import held_current_motion
from gray_box_observer.white_box.interface import Array, WhiteBox, bounds
from gray_box_observer.white_box.motion import Interval, Linear, RateAt, joined, product

LARGEST_STEP = 0.35
"""Largest product of step and decay rate; the Runge-Kutta step is then right to 5e-5 of a decay."""

MAX_STEPS = 16
"""Where more Runge-Kutta steps were needed, exponential ones are taken: they settle where
Runge-Kutta would burst."""

FIRST_STEPS = 10
"""Exponential steps that are taken for the first one."""

STIFF = MAX_STEPS + 1
"""Number of steps that stands for MAX_STEPS exponential ones."""


def to_coordinates(theta: Array) -> Array:
    """Turn parameters, shape (motor, parameter), into the coordinates of the rate."""
    storage = theta[:, :1]
    coordinates = np.empty_like(theta)
    np.divide(1.0, storage, out=coordinates[:, :1])
    np.divide(theta[:, 1:], storage, out=coordinates[:, 1:])
    return coordinates


def to_parameters(p: Array) -> Array:
    """Turn coordinates back into parameters; the map is its own inverse."""
    return to_coordinates(p)


def within_bounds(white_box: WhiteBox, p: Array) -> Array:
    """Move coordinates so that every parameter lies inside its bounds."""
    return to_coordinates(to_parameters(p).clip(*bounds(white_box.parameters)))


def swapped_logarithms(slopes: Array) -> Array:
    """Turn derivatives by the coordinates' logarithms into those by the parameters', or back.

    Args:
        slopes: shape (reading, coordinate) or (reading, parameter).
    """
    return np.column_stack([-slopes.sum(axis=1), slopes[:, 1:]])


def parameter_covariance(theta: Array, relative: Array) -> Array:
    """Turn a covariance of the coordinates' logarithms into that of the parameters.

    With ``log theta_0 = -log p_0`` and ``log theta_j = log p_j - log p_0``.

    Args:
        theta: shape (motor, parameter).
        relative: shape (motor, coordinate, coordinate).
    """
    log_covariance = np.empty_like(relative)
    np.negative(relative[:, :1], out=log_covariance[:, :1])
    np.subtract(relative[:, 1:], relative[:, :1], out=log_covariance[:, 1:])
    log_covariance[:, :, 1:] -= log_covariance[:, :, :1]
    np.negative(log_covariance[:, :, :1], out=log_covariance[:, :, :1])
    return log_covariance * theta[:, :, None] * theta[:, None, :]


def flow(
    white_box: WhiteBox,
    p: Array,
    start: Sequence[Array],
    voltage_v: Array,
    speed_rad_s: Array,
    end_speed: Array,
    interval_s: Array,
    ops: Any = np,
) -> Linear:
    """Move many intervals on at once, each from its own start, by classical Runge-Kutta steps.

    As many steps as each motor's fastest decay asks for; beyond MAX_STEPS, exponential steps, which
    are stable however stiff. The first of these is taken in FIRST_STEPS, each twice as long as the
    one before. Beside a measured speed brushes may hold the current: see
    :func:`~gray_box_observer.white_box.held_current.held_current_motion`.

    Args:
        white_box: the physics.
        p: shape (motor, coordinate).
        start: of every state, shape (motor, k): the state at the start of every interval.
        voltage_v: shape (motor, k): voltage held over it.
        speed_rad_s: shape (motor, k): measured speed at its start.
        end_speed: shape (motor, k): measured speed at its end, in rad/s.
        interval_s: shape (motor, k).
        ops: numpy, or :class:`~gray_box_observer.white_box.torch_ops.TorchOps` where everything is
            a tensor.
    """
    interval = Interval(voltage_v, speed_rad_s, end_speed, interval_s)
    rate_at = _rate_at(ops, white_box, p, voltage_v)
    if white_box.holds_current:
        return held_current_motion(ops, rate_at, start[0], interval)
    here = rate_at(start, speed_rad_s)
    stiffness = _stiffness(ops, here, interval_s)
    if ops.all(stiffness <= LARGEST_STEP):
        return runge_kutta_step(rate_at, start, here, interval)
    steps = ops.where(
        stiffness <= MAX_STEPS * LARGEST_STEP, ops.ceil(stiffness / LARGEST_STEP), STIFF
    )
    counts = ops.unique(steps).tolist()
    if len(counts) == 1:
        return _in_steps(ops, rate_at, start, here, interval, int(counts.pop()))
    whole = here.mapped(ops.empty_like)
    for count in counts:  # no motor moves otherwise than it would alone
        selection = ops.flatnonzero(steps == count)
        own = interval.select(selection)
        rate_of = _rate_at(ops, white_box.of_motors(selection), p[selection], own.voltage_v)
        begin = [state[selection] for state in start]
        rate = here.mapped(lambda entry, selection=selection: entry[..., selection, :])
        group_motion = _in_steps(ops, rate_of, begin, rate, own, int(count))
        for entry, part in zip(whole.entries, group_motion.entries, strict=True):
            entry[..., selection, :] = part
    return whole


def is_stiff(
    white_box: WhiteBox, p: Array, start: Sequence[Array], voltage_v: Array, speed_rad_s: Array,
    interval_s: Array, ops: Any = np,
) -> NDArray[np.bool_]:  # fmt: skip
    """Tell for whom :func:`flow` takes exponential steps, shape (motor,); arguments as there."""
    here = _rate_at(ops, white_box, p, voltage_v)(start, speed_rad_s)
    stiff: NDArray[np.bool_] = ~(_stiffness(ops, here, interval_s) <= MAX_STEPS * LARGEST_STEP)
    return stiff


def _stiffness(ops: Any, here: Linear, interval_s: Array) -> Any:
    """Largest product of interval and decay rate (or its bound for several states), (motor,)."""
    rates = []
    for state, slopes in enumerate(here.by_state):
        coupling_rates = (
            abs(slope * here.by_state[by][state]) ** 0.5
            for by, slope in enumerate(slopes)
            if by != state
        )
        rates.append(reduce(add, coupling_rates, abs(slopes[state])))
    return ops.max(reduce(ops.maximum, rates) * interval_s, axis=1, initial=0.0)


def _in_steps(
    ops: Any, rate_at: RateAt, start: Sequence[Array], here: Linear, interval: Interval, count: int
) -> Linear:  # fmt: skip
    """Move intervals on in steps; ``here`` is the rate at the start.

    Exponential ones begin short: where a softened sign makes the start stiff, they soon leave it.
    """
    step: Any = runge_kutta_step
    parts = interval.parts(max(1, min(count, MAX_STEPS)))
    if count > MAX_STEPS:
        step = partial(_exponential_step, ops)
        parts = chain(next(parts).growing_parts(FIRST_STEPS), parts)
    whole: Linear = step(rate_at, start, here, next(parts))
    for part in parts:
        whole = joined(
            whole, step(rate_at, whole.value, rate_at(whole.value, part.speed_rad_s), part)
        )
    return whole


def runge_kutta_step(
    rate_at: RateAt, start: Sequence[Any], here: Linear, interval: Interval
) -> Linear:
    """One classical Runge-Kutta step with its derivatives; ``here`` is the rate at the start.

    How the end answers a push of the rate of a stage follows from how it answers one of the next
    stage (the discrete adjoint). Every derivative of the end is then one sum over the stages.
    """
    step_s = interval.length_s
    end_speed = interval.end_speed_rad_s
    half = 0.5 * step_s
    middle = 0.5 * (interval.speed_rad_s + end_speed)
    second = rate_at(_ahead(start, here, half), middle)
    third = rate_at(_ahead(start, second, half), middle)
    fourth = rate_at(_ahead(start, third, step_s), end_speed)
    sixth = step_s / 6.0
    states = range(len(start))
    twice = 2.0 * sixth
    last = [[sixth if s == by else None for by in states] for s in states]
    behind_third = _answers(last, fourth, twice, step_s)
    behind_second = _answers(behind_third, third, twice, half)
    first = _answers(behind_second, second, sixth, half)
    stages = (first, here), (behind_second, second), (behind_third, third), (last, fourth)

    def summed(state: int, pushes: Callable[[Linear], Sequence[Any]]) -> Any:
        return reduce(add, (product(own[state], pushes(rate)) for own, rate in stages))

    def by_state(state: int, by: int) -> Any:
        slope = summed(state, lambda rate: [row[by] for row in rate.by_state])
        return 1.0 + slope if state == by else slope

    slopes = [
        k1 + 2.0 * (k2 + k3) + k4
        for k1, k2, k3, k4 in zip(*(rate.value for _, rate in stages), strict=True)
    ]
    return Linear(
        [x + sixth * slope for x, slope in zip(start, slopes, strict=True)],
        [[by_state(s, by) for by in states] for s in states],
        [summed(s, lambda rate: rate.by_coordinate) for s in states],
    )


def _ahead(start: Sequence[Any], rate: Linear, ahead_s: Any) -> list[Any]:
    """Where a constant rate leads."""
    return [x + ahead_s * slope for x, slope in zip(start, rate.value, strict=True)]


def _answers(
    later: Sequence[Sequence[Any]], rate: Linear, own: Any, ahead_s: Any
) -> list[list[Any]]:
    """Return how the end of a step answers pushes of the rates of a stage, (state, balance).

    Args:
        later: the same of the next stage.
        rate: that of the next stage.
        own: how the end answers them by the stage itself.
        ahead_s: how far the next stage lies ahead along the rates of this one.
    """
    columns = [*zip(*rate.by_state, strict=True)]
    return [
        [
            own + ahead_s * product(row, column) if s == by else ahead_s * product(row, column)
            for by, column in enumerate(columns)
        ]
        for s, row in enumerate(later)
    ]


def _exponential_step(
    ops: Any, rate_at: RateAt, start: Sequence[Array], here: Linear, interval: Interval
) -> Linear:
    """One Rosenbrock-Euler step: exact for the rate linearised at the start, and L-stable.

    Of several states each decays by itself.
    """
    decays = [ops.minimum(slopes[state], -1e-12) for state, slopes in enumerate(here.by_state)]
    decay_factors = [ops.exp(decay * interval.length_s) for decay in decays]
    reach = [(rest - 1.0) / decay for rest, decay in zip(decay_factors, decays, strict=True)]
    states = range(len(start))
    return Linear(
        [start[s] + reach[s] * here.value[s] for s in states],
        [
            [decay_factors[s] if s == r else reach[s] * here.by_state[s][r] for r in states]
            for s in states
        ],
        [reach[s] * here.by_coordinate[s] for s in states],
    )


def _rate_at(ops: Any, white_box: WhiteBox, p: Array, voltage_v: Array) -> RateAt:
    coefficients = {place: p[:, place : place + 1] for place in range(p.shape[1])}

    def rate_at(states: Sequence[Any], speed_rad_s: Any) -> Linear:
        return rate(ops, white_box, coefficients, states, voltage_v, speed_rad_s)

    return rate_at


def rate(
    ops: Any,
    white_box: WhiteBox,
    coefficients: Mapping[int, Any],
    states: Sequence[Any],
    voltage_v: Any,
    speed_rad_s: Any,
) -> Linear:
    """Work out the rates and their derivatives.

    Args:
        ops: whose functions.
        white_box: the physics.
        coefficients: coordinates by their places, each lined up with the states.
        states: as many as the white box has.
        voltage_v: voltage.
        speed_rad_s: measured speed.
    """
    value = []
    by_state = []
    by_coordinate = []
    for balance in white_box.balances(states[0]):
        signals = balance.signals(states, speed_rad_s, voltage_v)
        inverse_storage = coefficients[balance.storage]
        others = [coefficients[place] for place in balance.places]
        drive = balance.drive(signals)
        basis = balance.basis(signals)
        value.append(deducted(inverse_storage * drive, others, basis))
        slopes = [
            deducted(
                inverse_storage * balance.drive_slope(s, signals),
                others,
                balance.basis_slope(s, signals),
            )
            for s in range(len(states))
        ]
        by_state.append(slopes)
        slope_by_place = {balance.storage: drive}
        for place, phi in zip(balance.places, basis, strict=True):
            slope_by_place[place] = -phi
        by_coordinate.append(
            ops.stack(
                [slope_by_place[p] if p in slope_by_place else 0.0 * drive for p in coefficients]
            )
        )
    return Linear(value, by_state, by_coordinate)
