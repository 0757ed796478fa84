"""The lag of a current sensor: how much of it a free run shows, and what hides behind it.

A current that lags is less by ``lag di/dt``, which passes the same filter. Beside the parameters
the residual tells by how much a lag is off, in one Gauss-Newton step. A winding and a sensor are
two first-order lags in a row, whose order the current does not show: either may be the winding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow, recurrence
from gray_box_observer.context_nodes.rotor.noise_memory import memory_of
from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun, rotor_free_run
from gray_box_observer.fit_test.stamp_errors import STAMP_STD
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median, usual_interval
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates
from gray_box_observer.white_box.interface import Array, WhiteBox

NONLINEAR = 2e-3
"""Share of every parameter that friction and hysteresis leave open, behind a lag."""

_LINEAR = ('resistance', 'back_emf_constant', 'voltage_offset')

_OF_THE_MEAN = {'inductance': -1.0, 'resistance': -1.0, 'inertia': 1.0}

LEAST = 1e-6
"""Share of a sample interval: a lag that is less is none."""


class LagStep(NamedTuple):
    """What the residual of a free run tells of the lag that was assumed.

    Attributes:
        step_s: by how much it is too short.
        std_s: standard deviation of that.
        memory: of the current's noise, as a filter of the lag that is right may leave it
            (:mod:`~gray_box_observer.context_nodes.rotor.noise_memory`); 0 without a rotor.
        correlation: the same of the residual, as any filter may have it.
    """

    step_s: float
    std_s: float
    memory: float
    correlation: float


def lag_step(
    white_box: MotorWhiteBox, theta: Array, content: Array, lag: CurrentLag | None
) -> LagStep:
    """Return by how much a lag is too short, in one Gauss-Newton step.

    Args:
        white_box: of one motor.
        theta: shape (1, parameter): values that were found with the lag.
        content: shape (signal, 1, n): samples, with the voltages that the white box takes.
        lag: that was assumed; None: none was.
    """
    stretch = SampleWindow.of_content(white_box, np.ascontiguousarray(content))
    p = to_coordinates(theta)
    if white_box.has_rotor:
        run = rotor_free_run(white_box, p, stretch, 0.0 if lag is None else lag.memory)
    else:
        run = free_run(white_box, p, stretch)
    columns = run.jacobian[:, 1:]
    _, distinct = run.explain(_by_lag(run, lag), columns)
    noise_a = MAD_TO_STD * float(median(np.abs(run.residual_a)))
    residual = run.residual_a * np.sqrt(run.weight)
    power = float(distinct @ distinct)
    memory = 0.0
    correlation = 0.0
    step_s = float(distinct @ residual) / power if power > 0.0 else 0.0
    std_s = noise_a / math.sqrt(power) if power > 0.0 else math.inf
    if isinstance(run, RotorFreeRun):
        lag_s = step_s + (0.0 if lag is None else lag.lag_s)
        is_undone = lag is not None and lag.is_average
        memory = memory_of(run.runs.misread_a, _kept_share(run, lag_s), is_undone=is_undone)
        correlation = memory_of(run.runs.misread_a)
    return LagStep(step_s, std_s, memory, correlation)


def _kept_share(run: FreeRun, lag_s: float) -> float:
    """Return what a filter leaves of a reading after the usual interval; 0: nothing."""
    return math.exp(-usual_interval(run.stretch.interval_s) / lag_s) if lag_s > 0.0 else 0.0


def _by_lag(run: FreeRun, lag: CurrentLag | None) -> Array:
    """Differentiate the current of a run by the lag, shape (k + 1,), in A/s."""
    lag_s = 0.0 if lag is None else lag.lag_s
    is_whole = run.is_whole
    if not is_whole.any():
        return np.zeros_like(run.current_a)
    if lag is not None and lag.is_average:
        return run.beyond_memory(_by_average(run, lag_s))
    interval_s = run.stretch.interval_s[0]
    least_s = LEAST * usual_interval(interval_s)
    slope = np.where(is_whole, np.diff(run.current_a) / np.where(is_whole, interval_s, 1.0), 0.0)
    remainder = np.where(is_whole, np.exp(-interval_s / max(lag_s, least_s)), 0.0)
    inputs = (1.0 - remainder) * slope
    by_lag: Array = -recurrence(remainder[None], inputs[None, None], np.zeros((1, 1)))[0, 0]
    return run.beyond_memory(by_lag)


def _by_average(run: FreeRun, lag_s: float) -> Array:
    """Differentiate a current by the time constant of a moving average that was undone, in A/s.

    Of its readings ``f_k = r f_(k-1) + (1 - r) i_k`` it is what is new in them, in the unit of the
    current. The readings are those of the run: of measured ones the noise would bend the step.

    Args:
        run: of the current that the readings are averages of.
        lag_s: the time constant in s, positive.
    """
    interval_s = run.stretch.interval_s[0]
    kept_share = np.where(run.is_whole, np.exp(-interval_s / lag_s), 0.0)
    newest_a = run.current_a[None]
    reading_a = recurrence(
        kept_share[None], ((1.0 - kept_share) * newest_a[:, 1:])[None], newest_a[:, :1]
    )[0, 0]
    by_share = (reading_a[:-1] - run.current_a[1:]) / (1.0 - kept_share)
    by_lag = by_share * kept_share * interval_s / lag_s**2
    return np.concatenate([[0.0], np.where(run.is_whole, by_lag, 0.0)])


def lag_doubts(run: FreeRun, lag: CurrentLag | None) -> list[Doubt]:
    """Return what a lag that was found not quite right does to an estimate.

    Args:
        run: the free run at the present values.
        lag: as it was found; None: none was.
    """
    return [] if lag is None else [Doubt(lag.lag_s * _by_lag(run, lag))]


def shifts_behind_lag(
    white_box: WhiteBox, run: FreeRun, theta: Array, lag: CurrentLag | None
) -> Array:
    """Return how a lag moves the logarithms of the parameters through what is not linear.

    The voltage of an effect is that of the current itself, and passes the filter as a voltage. The
    white box takes the effect of the current behind the filter. Parameters and lag take over most
    of the difference.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
        lag: as it was found; None: there is none.

    Returns:
        Shape (1, parameter), or none of them.
    """
    nothing = np.empty((0, theta.size))
    if lag is None or white_box.has_rotor or white_box.speed_measured:
        return nothing
    lag_s = lag.lag_s
    interval_s = np.where(run.is_whole, run.stretch.interval_s[0], 0.0)
    late_a = interval_means(run.current_a)
    slope = np.where(run.is_whole, np.diff(run.current_a) / np.maximum(interval_s, 1e-12), 0.0)
    early_v = _drop(white_box, run, theta, late_a + lag_s * slope)
    late_v = _drop(white_box, run, theta, late_a)
    remainder = np.where(run.is_whole, np.exp(-interval_s / lag_s), 0.0)
    inputs_v = (1.0 - remainder) * early_v
    filter_v = recurrence(remainder[None], inputs_v[None, None], early_v[None, :1])[0, 0, 1:]
    response_a = run.response(-(filter_v - late_v)[None])[0]
    columns = np.column_stack([swapped_logarithms(run.jacobian[:, 1:]), _by_lag(run, lag)])
    if not np.isfinite(response_a).all():  # of an absurd motor
        return nothing
    amounts, _ = run.explain(response_a, columns)
    return amounts[None, :-1]


def _drop(white_box: WhiteBox, run: FreeRun, theta: Array, current_a: Array) -> Array:
    """Return what effects of a current that are not linear take of the voltage, shape (k,)."""
    speed = white_box.speed(current_a, run.stretch.speed_rad_s[0, 1:])
    basis = white_box.basis(run.stretch.voltage_v[0], current_a, speed)
    drop_v = np.zeros_like(current_a)
    effects = zip(white_box.parameters[1:], theta[1:].tolist(), basis, strict=True)
    for parameter, value, phi in effects:
        if parameter.name not in _LINEAR:
            drop_v = drop_v + value * phi
    return drop_v


def lag_shifts(
    white_box: MotorWhiteBox,
    theta: Array,
    lag: CurrentLag,
    interval_s: float,
    *,
    stamps_exact: bool,
) -> Array:
    """Return how far parameters may be off beside a lag that was found, relative to them.

    * The winding may be the sensor, and the sensor the winding. The filter may be of another kind.
    * Stamps that are late by ``d`` look like another lag, and move L/R by ``d lag / (L/R - lag)``:
      so the sum of all delays stays, and that of their squares.
    * The voltage that moves the winding to the right end of an interval moves it by another mean,
      which a rotor takes over. R and L come out smaller by a twelfth of
      ``interval^2 / (L/R R J / (Kb Kt))``, J larger.
    * What is not linear does not change places with a lag.

    Args:
        white_box: of one motor.
        theta: shape (parameter,): its values.
        lag: of the current.
        interval_s: usual sample interval.
        stamps_exact: whether voltage acts at the instant of its stamp.

    Returns:
        Shape (question, parameter).
    """
    names = [parameter.name for parameter in white_box.parameters]
    values = white_box.values(theta)
    winding_s = values['inductance'] / values['resistance']
    shifts = list(np.diag(np.full(len(names), NONLINEAR)))
    shifts += [np.array(shift) for shift in lag.rivals]
    if not stamps_exact:
        apart_s = max(abs(winding_s - lag.lag_s), LEAST * lag.lag_s)
        share = STAMP_STD * interval_s * lag.lag_s / (apart_s * winding_s)
        shifts.append(np.array([share * (name == 'inductance') for name in names]))
    if white_box.has_rotor and not lag.is_average:
        stiffness = values['back_emf_constant'] * float(white_box.torque_constant)
        square_s2 = values['inductance'] * values['inertia'] / stiffness
        share = interval_s**2 / (12.0 * square_s2)
        shifts.append(np.array([share * _OF_THE_MEAN.get(name, 0.0) for name in names]))
    return np.stack(shifts)
