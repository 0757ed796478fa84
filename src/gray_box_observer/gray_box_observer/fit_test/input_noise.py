"""What the noise of a measured voltage or speed does to an estimate that takes both for exact.

Noise of a speed enters the voltage balance as a voltage, noise of a voltage as itself. The current
of the model answers it; that of the motor does not. Least squares make this answer small, so they
make the inductance large: the bias of errors in variables (T. Soderstrom, "Errors-in-variables
methods in system identification", Automatica 43 (6), 2007).

The estimate linearises about the readings. A push of one standard deviation moves the end of an
interval by ``e``, and its derivative by a coordinate by ``e'``. Every interval leaves a share ``a``
of both. The noise is white: then slope and residual have a mean product of ``-e e' W``, where ``W``
sums the squares of what is left at the samples that follow: ``1 / (1 - a^2)`` of many. A speed runs
straight from reading to reading, so each of these pushes two intervals, by ``f`` at the end of one
and by ``e`` at the start of the next. The mean product is then ``-f f' - (e + a f) (e' + a f') W``.

Where an estimate linearises about its own run, its bias is down to half as large. Rounded readings
count as white noise, which those of a slow speed are not. Of a motor with a rotor only the current
answers: what noise of the voltage does through the speed is left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import interval_motion
from gray_box_observer.context_nodes.recursive.normal_equations import (
    difference_noise,
)
from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.noise_filter import MERGED, rests
from gray_box_observer.context_nodes.rotor.voltage_noise import (
    FEWEST,
    NO_NOISE,
    SURE,
    VoltageNoise,
    believed_variance,
    lagged_readings,
    unanswered_variance,
)
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import UNKNOWN, Amount
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import Linear, flow
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

BY_NEIGHBOURS, BY_THE_ONE_BEFORE = 'voltage_noise', 'voltage_noise_by_the_one_before'
"""Names of the two variances of a voltage's noise, see :func:`voltage_variances`."""

LEAST_RAD_S = 1e-9
"""Noise of a speed that is none: what rounding leaves."""


@dataclass(frozen=True, eq=False)
class _Push:
    """What noise of one standard deviation does to the end of an interval.

    Attributes:
        current_a: shape (k,).
        slopes_a: shape (coordinate, k): of the current's derivatives by the coordinates'
            logarithms.
    """

    current_a: Array
    slopes_a: Array

    @property
    def products(self) -> Array:
        """Products of the current with its slopes, shape (coordinate, k)."""
        return self.current_a * self.slopes_a

    def after(self, end: _Push, decay: Array) -> _Push:
        """Return what noise does that has pushed the end of the interval before, too.

        Args:
            end: what it does there.
            decay: shape (k,): what every interval leaves of that.
        """
        current_a = self.current_a.copy()
        slopes_a = self.slopes_a.copy()
        current_a[1:] += decay[1:] * end.current_a[:-1]
        slopes_a[:, 1:] += decay[1:] * end.slopes_a[:, :-1]
        return _Push(current_a, slopes_a)


class _Motion:
    """The intervals of a free run from the readings, and from readings that are pushed.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): its present values.
        run: its free run at these.
    """

    def __init__(self, white_box: MotorWhiteBox, p: Array, run: FreeRun) -> None:
        self._white_box = white_box
        self._p = p
        self._run = run
        self._ends = self._moved(0.0, 0.0, 0.0)

    def push(
        self, *, voltage_v: float = 0.0, start_rad_s: float = 0.0, end_rad_s: float = 0.0
    ) -> _Push:
        """Return what other readings do; of an interval that is not whole, nothing."""
        ends = self._moved(voltage_v, start_rad_s, end_rad_s)
        current_a, slopes_a = (
            np.where(self._run.is_whole, np.nan_to_num(end - rest), 0.0)
            for end, rest in zip(ends, self._ends, strict=True)
        )
        return _Push(current_a, slopes_a * self._p[0][:, None])

    def _moved(self, voltage_v: float, start_rad_s: float, end_rad_s: float) -> tuple[Array, Array]:
        """Return the current in A at the ends, shape (k,), and its derivatives (coordinate, k)."""
        stretch = self._run.stretch
        start = stretch.state[:, :-1]
        signals = (
            stretch.voltage_v + voltage_v,
            stretch.speed_rad_s[:, :-1] + start_rad_s,
            stretch.speed_rad_s[:, 1:] + end_rad_s,
            stretch.interval_s,
        )
        motion: Linear
        if isinstance(self._run, RotorFreeRun):
            rotor = self._run.speed_rad_s[None, :-1]
            motion = flow(self._white_box, self._p, [start, rotor], *signals)
        else:
            motion = interval_motion.move(self._white_box, self._p, start, *signals)
        end, _, by_coordinate = motion.of_state(State.CURRENT)
        return end[0], by_coordinate[:, 0]


def input_noise_scores(
    white_box: WhiteBox, p: Array, run: FreeRun, variances: Mapping[str, Amount]
) -> Array:
    """Return the mean products of slopes and residual that noise of voltage and speed makes.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): its present values.
        run: its free run at these.
        variances: of the voltage's noise in V2, as :func:`voltage_variances` has them.

    Returns:
        Shape (1 + coordinate,): by the first state and by the coordinates' logarithms; zero where
        neither has noise, and of a rotor whose values cannot be run.
    """
    assert isinstance(white_box, MotorWhiteBox)
    scores = np.zeros(1 + p.shape[1])
    if white_box.has_rotor and not isinstance(run, RotorFreeRun):
        return scores
    voltage_v2 = _voltage_variance(run, variances)
    if run.noise is not NO_NOISE:
        voltage_v2 = variances[BY_NEIGHBOURS].std  # its mean is taken off by the fit
    std_rad_s = _speed_std(run) if white_box.speed_measured else 0.0
    if not max(voltage_v2, std_rad_s) > 0.0:
        return scores
    motion = _Motion(white_box, p, run)
    weight = _lasting_weight(run)
    products = np.zeros((p.shape[1], run.decay.size))
    if voltage_v2 > 0.0:
        push = motion.push(voltage_v=math.sqrt(voltage_v2))
        products += push.products * weight
    if std_rad_s > 0.0:
        start, end = motion.push(start_rad_s=std_rad_s), motion.push(end_rad_s=std_rad_s)
        share = _share_of_noise(run, start, end, std_rad_s)
        products += share * end.products * run.weight[1:]
        products += share * start.after(end, run.decay).products * weight
    scores[1:] = -products.sum(axis=1)
    return scores


def _lasting_weight(run: FreeRun) -> Array:
    """Return what the squares of a push at the end of every interval come to, shape (k,).

    At the samples that follow it is ever smaller, until the run begins anew.
    """
    later = np.concatenate([run.decay[1:], [0.0]]) ** 2
    backward = recurrence(later[None, ::-1], run.weight[None, None, :0:-1], np.zeros((1, 1)))
    return np.asarray(backward[0, 0, :0:-1])


def _speed_std(run: FreeRun) -> float:
    """Standard deviation in rad/s of the noise of a measured speed, as its readings have it."""
    speed_rad_s = run.stretch.speed_rad_s
    step_rad_s = float(quantisation_step(speed_rad_s)[0])
    std_rad_s = max(difference_noise(speed_rad_s[0]), step_rad_s * STEP_TO_STD)
    return std_rad_s if std_rad_s > LEAST_RAD_S else 0.0


def _innovation(run: FreeRun) -> Array:
    """Return what an interval adds to the residual, shape (k,)."""
    return run.residual_a[1:] - run.decay * run.residual_a[:-1]


def _is_plain(run: FreeRun) -> NDArray[np.bool_]:
    """Tell which intervals are whole, and none of merged samples, shape (k,)."""
    interval_s = run.stretch.interval_s[0]
    is_plain: NDArray[np.bool_] = run.is_whole & (interval_s < MERGED * usual_interval(interval_s))
    return is_plain


def voltage_variances(run: FreeRun) -> dict[str, Amount]:
    """Return variances in V2 of a noise of the voltage that the current does not answer.

    Let ``d`` be what a voltage differs by from the mean of its neighbours, and ``b`` what one volt
    does to the current. The innovation at the end of its interval, ``r' - a r`` of the residual,
    has the mean product ``-b s^2`` with ``d``. Where a controller answers the noise of every
    reading, that is false. But the residual ``r'`` itself has the mean product ``-b (1 - a) s^2``
    with the voltage less the one before, and these only know earlier readings. That tells little.
    """
    gain = run.reach_s / run.inductance_h
    whole = _is_plain(run)
    change_v = np.diff(run.stretch.voltage_v[0])
    by_neighbours = _noise_variance(
        -0.5 * np.diff(change_v),
        _innovation(run)[1:-1],
        gain[1:-1],
        whole[:-2] & whole[1:-1] & whole[2:],
    )
    by_the_one_before = _noise_variance(
        change_v, run.residual_a[2:], (gain * (1.0 - run.decay))[1:], whole[:-1] & whole[1:]
    )
    return {BY_NEIGHBOURS: by_neighbours, BY_THE_ONE_BEFORE: by_the_one_before}


def with_voltage_noise(white_box: WhiteBox, theta: Array, run: FreeRun) -> FreeRun:
    """Return a run that knows the noise of its voltage; where it shows none, the run itself.

    Args:
        white_box: of one motor.
        theta: shape (parameter,): its values, whose fit knows of such noise.
        run: the free run at these.
    """
    held_share = 1.0
    if isinstance(run, RotorFreeRun):
        held_share = float(np.mean(rests(run.speed_rad_s)))
    if white_box.has_rotor and not isinstance(run, RotorFreeRun):  # it cannot be run
        return run
    if run.noise_memory:  # no fit takes off both
        return run
    if run.stretch.voltage_v.shape[1] < FEWEST:
        return run
    readings = lagged_readings(run.stretch.voltage_v[0], _innovation(run), run.gain, _is_plain(run))
    variance_v2 = believed_variance([readings])
    if not variance_v2:
        return run
    assert isinstance(white_box, MotorWhiteBox)
    noise = VoltageNoise(variance_v2, held_share)
    intervals_s = run.stretch.interval_s[0]
    power_a2 = noise.power_a2(white_box, np.log(theta), intervals_s)
    return replace(run, noise=noise, noise_power_a2=power_a2)


def shows_noise(variance: Amount) -> bool:
    """Tell whether a variance, as :func:`voltage_variances` has it, is that of some noise."""
    return variance.mean > SURE * variance.std


def _voltage_variance(run: FreeRun, variances: Mapping[str, Amount]) -> float:
    """Return the variance in V2 that counts; under a controller that answers, its upper end."""
    by_neighbours = variances[BY_NEIGHBOURS]
    by_the_one_before = variances[BY_THE_ONE_BEFORE]
    if by_neighbours.mean < -SURE * by_neighbours.std:  # no noise does that: a controller answers
        upper_v2 = max(0.0, by_the_one_before.mean + by_the_one_before.std)
        noise_v = difference_noise(run.stretch.voltage_v[0])
        return min(upper_v2, noise_v * noise_v)
    both = by_neighbours, by_the_one_before
    return max(one.mean if shows_noise(one) else 0.0 for one in both)


def _share_of_noise(run: FreeRun, start: _Push, end: _Push, std_rad_s: float) -> float:
    """Share of a speed's supposed variance that the current lets be noise, 0 to 1.

    A shaft that really runs so restlessly is no noise, and neither is a speed that is sampled too
    slowly to be smooth: the current answers it.
    """
    whole = run.is_whole
    gain = 0.5 * (start.current_a[1:] + end.current_a[:-1]) / std_rad_s
    innovation_a = _innovation(run)
    both_a = innovation_a[1:] + innovation_a[:-1]
    difference_rad_s = -0.5 * np.diff(run.stretch.speed_rad_s[0], 2)
    variance = _noise_variance(difference_rad_s, both_a, gain, whole[1:] & whole[:-1])
    return min(1.0, max(0.0, variance.mean + SURE * variance.std) / (std_rad_s * std_rad_s))


def _noise_variance(
    difference: Array, answer_a: Array, gain: Array, is_sound: NDArray[np.bool_]
) -> Amount:
    """Return the variance of a signal's noise; see :func:`unanswered_variance`."""
    outcome = unanswered_variance(difference, answer_a, gain, is_sound)
    return UNKNOWN if outcome is None else Amount(*outcome)
