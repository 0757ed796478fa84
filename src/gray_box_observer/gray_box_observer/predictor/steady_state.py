"""How a motor relaxes: where its current is going, how fast, and one step of any length towards it.

With voltage and speed held, the rate of every white box falls as the current rises, so there is one
steady state ``s``, and the current goes there without overshoot: ``di/dt = -c(i) (i - s)`` with
``c(i) = rate(i) / (s - i) > 0``, the slope of the chord from where it is to where it is going.
Hence, exactly and for every length of the interval ``h``,

    i1 = s + (i0 - s) exp(-h c_mean),    c_mean: mean of c along the way.

``c`` begins at ``c(i0)`` and ends at ``lambda_s = -d rate/di (s)``; both follow from the identified
parameters. What does not follow without integrating is the mean, and that is what the network says
(:func:`exponent`).

Every function takes plain floats (``ops`` is :class:`Floats`), arrays (numpy) or tensors
(:class:`~gray_box_observer.white_box.torch_ops.TorchOps`), the latter with a leading motor axis;
``theta`` is one entry a parameter, each a float or what broadcasts against the signals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.balance import Balance, deducted
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import WhiteBox

NEWTON_LIMIT = 80
"""More than safeguarded Newton ever needed; every third step at least halves the bracket."""

LEAK_OHM = 1e-9
"""A resistance that nobody can measure: with it a white box that has none settles far away instead
of nowhere."""

SLOWEST = 1e-12
"""Smallest decay rate in 1/s; keeps logarithms finite."""

SHORTEST = 1e-20
"""Smallest product of interval and decay rate that is told apart from nothing."""

LONGEST = 1e6
"""Largest one that is told apart from infinity."""

MOST = 6.0
"""Largest logarithm that the network is shown."""

ANSWER = 2.0
"""Largest answer of the network."""

FLOW_STEP = 0.5
"""Length of a step of :func:`flow` in ``log(1 + time * fastest rate)``; right to some 1e-5 of the
way."""

ARRIVED = 15.0
"""Time constants after which 3e-7 of the way is left: :func:`flow` ends there."""


@dataclass(frozen=True, slots=True)
class Course:
    """Where held voltage and speed lead.

    Attributes:
        theta: unknown parameters, one entry each.
        voltage_v: held voltage.
        speed_rad_s: held speed, where it is measured.
        steady_a: current at which the voltage balances, in A.
        decay_rate: how fast a deviation decays there, ``lambda_s``, in 1/s.
        near_a: distance from the steady state below which the slope there stands for the chord, in
            A.
    """

    theta: Sequence[Any]
    voltage_v: Any
    speed_rad_s: Any
    steady_a: Any
    decay_rate: Any
    near_a: Any

    def select(self, index: NDArray[np.intp]) -> Course:
        """Return the courses of the chosen motors; only of arrays."""
        return Course(
            [parameter[index] for parameter in self.theta],
            *(signal[index] for signal in self.signals),
        )

    @property
    def signals(self) -> tuple[Any, ...]:
        """Everything but theta, in the order of the attributes."""
        return self.voltage_v, self.speed_rad_s, self.steady_a, self.decay_rate, self.near_a


def gap_v(balance: Balance, theta: Sequence[Any], signals: tuple[Any, ...]) -> Any:
    """Voltage left for the inductance, ``L di/dt`` (thesis 4.17)."""
    gap = balance.drive(signals) - LEAK_OHM * signals[State.CURRENT]
    return deducted(gap, theta[1:], balance.basis(signals))


def slope_ohm(balance: Balance, theta: Sequence[Any], signals: tuple[Any, ...]) -> Any:
    """How fast that voltage falls as the current rises, ``-d gap / d state``."""
    slope = balance.drive_slope(State.CURRENT, signals) - LEAK_OHM
    return -deducted(slope, theta[1:], balance.basis_slope(State.CURRENT, signals))


def course(
    ops: Any,
    white_box: WhiteBox,
    theta: Sequence[Any],
    voltage_v: Any,
    speed_rad_s: Any,
    guess_a: Any,
) -> Course:
    """Find the steady state by Newton steps inside a shrinking bracket.

    Where Newton leaves the bracket or slows down (a brush drop is nearly a step at zero), the
    bracket is halved.

    Args:
        ops: functions of floats, arrays or tensors, as above.
        white_box: the physics.
        theta: unknown parameters.
        voltage_v: held voltage.
        speed_rad_s: held speed; ignored where the white box has its own.
        guess_a: where to begin; the last steady state is near.
    """
    state = guess_a + 0.0 * voltage_v
    low, high = 0.0 * state - math.inf, 0.0 * state + math.inf
    last = high
    slope = high
    balance = white_box.balances(state)[State.CURRENT]
    for _ in range(NEWTON_LIMIT):
        signals = balance.signals((state,), speed_rad_s, voltage_v)
        gap = gap_v(balance, theta, signals)
        slope = slope_ohm(balance, theta, signals)
        low, high = ops.where(gap > 0.0, state, low), ops.where(gap > 0.0, high, state)
        is_bracketed = high - low < math.inf
        middle = 0.5 * (ops.where(is_bracketed, low, 0.0) + ops.where(is_bracketed, high, 0.0))
        newton = state + gap / slope
        move = abs(newton - state)
        near = 1e-9 * (abs(newton) + abs(voltage_v) / slope) + 1e-300
        good = (move <= near) | ((newton >= low) & (newton <= high) & (move <= 0.5 * last))
        trial = ops.where(good, newton, ops.where(is_bracketed, middle, newton))
        last, state = abs(trial - state), trial
        if ops.all(last <= near):  # Newton is quadratic: the next step would be lost in rounding
            break
    return Course(theta, voltage_v, speed_rad_s, state, slope / theta[0], 2e-6 * abs(state) + 1e-30)


def chord(ops: Any, white_box: WhiteBox, way: Course, state: Any) -> Any:
    """How fast the current goes where it goes, ``c(i) = rate(i) / (s - i)`` in 1/s."""
    return _chord(ops, white_box.balances(state)[State.CURRENT], way, state)


def _chord(ops: Any, balance: Balance, way: Course, state: Any) -> Any:
    distance = state - way.steady_a
    far = abs(distance) > way.near_a
    signals = balance.signals((state,), way.speed_rad_s, way.voltage_v)
    gap = gap_v(balance, way.theta, signals)
    slope = gap / way.theta[0] / ops.where(far, -distance, 1.0)
    return ops.maximum(ops.where(far, slope, way.decay_rate), SLOWEST)


def flow(
    ops: Any, white_box: WhiteBox, way: Course, state: Any, interval_s: Any, step: float = FLOW_STEP
) -> Any:
    """Follow the white box over an interval of any length, however stiff.

    Integrates the logarithm of what is left of the way, ``d log|i - s| / dt = -c(i)``, by classical
    Runge-Kutta steps that grow with time as the motion dies down; for a linear motor it is exact.

    Args:
        ops: functions of floats, arrays or tensors, as above.
        white_box: the physics.
        way: where voltage and speed lead.
        state: current at the start, in A.
        interval_s: length of the interval.
        step: length of a step in ``log(1 + time * fastest rate)``.

    Returns:
        The current at the end.
    """
    begin = _begin(ops, white_box, way, state, interval_s)
    return _integrate(
        ops, white_box, way, begin, max(1, math.ceil(float(ops.max(begin.length)) / step))
    )


def flow_each(ops: Any, white_box: WhiteBox, way: Course, state: Any, interval_s: Any) -> Any:
    """As :func:`flow`, for signals of shape (motor,): each motor in its own number of steps."""
    begin = _begin(ops, white_box, way, state, interval_s)
    counts = ops.maximum(ops.ceil(begin.length / FLOW_STEP), 1.0)
    most = ops.max(counts)
    if ops.all(counts == most):
        return _integrate(ops, white_box, way, begin, int(most))
    end = ops.empty_like(state)
    for count in ops.unique(counts).tolist():
        motors = ops.flatnonzero(counts == count)
        end[motors] = _integrate(
            ops, white_box.of_motors(motors), way.select(motors), begin.select(motors), int(count)
        )
    return end


@dataclass(frozen=True, slots=True)
class _Begin:
    """Where an interval begins: the current, its rate, the fastest rate ahead, and the length.

    The length is ``log(1 + time * fastest rate)``, which :func:`flow` cuts into steps.
    """

    state: Any
    here: Any
    fastest: Any
    length: Any

    def select(self, index: NDArray[np.intp]) -> _Begin:
        """Return the chosen motors; only of arrays."""
        return _Begin(*(part[index] for part in (self.state, self.here, self.fastest, self.length)))


def _begin(ops: Any, white_box: WhiteBox, way: Course, state: Any, interval_s: Any) -> _Begin:
    here = chord(ops, white_box, way, state)
    fastest = ops.maximum(ops.maximum(here, way.decay_rate), SLOWEST)
    return _Begin(state, here, fastest, ops.log1p(fastest * interval_s))


def _integrate(ops: Any, white_box: WhiteBox, way: Course, begin: _Begin, steps: int) -> Any:
    """Current at the end of an interval cut into so many steps."""
    balance = white_box.balances(begin.state)[State.CURRENT]
    distance = begin.state - way.steady_a
    log_ratio = 0.0 * distance
    time_s = 0.0 * distance
    for k in range(steps):
        end_s = ops.expm1(begin.length * ((k + 1) / steps)) / begin.fastest
        h, time_s = end_s - time_s, end_s
        k1 = (
            begin.here
            if k == 0
            else _chord(ops, balance, way, way.steady_a + distance * ops.exp(log_ratio))
        )
        k2 = _chord(ops, balance, way, way.steady_a + distance * ops.exp(log_ratio - 0.5 * h * k1))
        k3 = _chord(ops, balance, way, way.steady_a + distance * ops.exp(log_ratio - 0.5 * h * k2))
        k4 = _chord(ops, balance, way, way.steady_a + distance * ops.exp(log_ratio - h * k3))
        log_ratio = ops.where(
            log_ratio < -ARRIVED, log_ratio, log_ratio - h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        )
        if ops.all(log_ratio < -ARRIVED):
            break
    return begin.state + distance * ops.expm1(log_ratio)


@dataclass(frozen=True, slots=True)
class Relaxation:
    """One interval of one motor in the dimensionless form that the network is shown.

    Voltage, speed and the parameters theta enter through where the current is going and how fast,
    the form in which they matter: so one network serves motors of any size, and a new theta changes
    the prediction at once.

    Attributes:
        state: current at the start, in A.
        distance: from the steady state to there, in A.
        duration: ``h c(i0)``, the interval in units of the present time constant.
        log_end_rate: ``log(lambda_s / c(i0))``: whether it will go faster (above 0) or slower at
            the end.
        halfway: ``log(c(middle) / c(i0))``, likewise in the middle of the way.
        start, goal: the start and the steady state as fractions of the sum of their magnitudes.
    """

    state: Any
    distance: Any
    duration: Any
    log_end_rate: Any
    halfway: Any
    start: Any
    goal: Any

    def inputs(self, ops: Any) -> list[Any]:
        """Columns of the network's input, each of order 1."""
        return [
            self.log_end_rate,
            self.halfway,
            ops.clip(0.5 * ops.log(self.duration), -MOST, MOST),
            self.start,
            self.goal,
        ]


INPUTS = 5
"""Number of columns of :meth:`Relaxation.inputs`."""


def relaxation(
    ops: Any, white_box: WhiteBox, way: Course, state: Any, interval_s: Any
) -> Relaxation:
    """Describe an interval; finite whatever theta, voltage and interval are."""
    balance = white_box.balances(state)[State.CURRENT]
    here = _chord(ops, balance, way, state)
    middle = _chord(ops, balance, way, 0.5 * (state + way.steady_a))
    magnitude = abs(state) + abs(way.steady_a) + 1e-30
    return Relaxation(
        state,
        state - way.steady_a,
        ops.clip(here * interval_s, SHORTEST, LONGEST),
        ops.clip(ops.log(ops.maximum(way.decay_rate, SLOWEST) / here), -MOST, MOST),
        ops.clip(ops.log(middle / here), -MOST, MOST),
        state / magnitude,
        way.steady_a / magnitude,
    )


def exponent(ops: Any, interval: Relaxation, readout: Any) -> Any:
    """Mean decay rate times length of the interval, ``h c_mean``; numpy, floats or torch.

    ``log(c_mean / c(i0)) = g (log_end_rate + d n)``: ``g`` is how far the mean has moved from its
    start towards its end if the approach were a plain exponential, ``n`` the network's answer,
    ``d`` how much the rate varies at all. So, whatever the weights: the slope is that of the white
    box where the interval is short, the end is its steady state where it is long, and a linear
    motor is exact. A fresh network says 0.

    Args:
        ops: whose functions.
        interval: its dimensionless form.
        readout: output of the network; bounded here.
    """
    mean_share = 1.0 + ops.expm1(-interval.duration) / interval.duration
    varies = abs(interval.log_end_rate) + abs(interval.halfway)
    answer = ANSWER * ops.tanh(readout / ANSWER)
    return interval.duration * ops.exp(mean_share * (interval.log_end_rate + varies * answer))


def after(ops: Any, interval: Relaxation, readout: Any) -> Any:
    """Current at the end of the interval, in A: never beyond where it was and where it is going."""
    return interval.state + interval.distance * ops.expm1(-exponent(ops, interval, readout))
