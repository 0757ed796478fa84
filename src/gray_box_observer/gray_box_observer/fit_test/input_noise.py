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
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
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
from gray_box_observer.fit_test.projection import Amount
from gray_box_observer.fit_test.pushed_motion import PushedMotion
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.fit_test.speed_noise import SpeedNoise
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

BY_NEIGHBOURS, BY_THE_ONE_BEFORE = 'voltage_noise', 'voltage_noise_by_the_one_before'
"""Names of the two variances of a voltage's noise, see :func:`voltage_variances`."""


def input_noise_scores(
    white_box: WhiteBox,
    p: Array,
    run: FreeRun,
    variances: Mapping[str, Amount],
    speed_noise: SpeedNoise | None,
) -> Array:
    """Return the mean products of slopes and residual that noise of voltage and speed makes.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): its present values.
        run: its free run at these.
        variances: of the voltage's noise in V2, as :func:`voltage_variances` has them.
        speed_noise: of the readings of its speed; None: they have none.

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
    if voltage_v2 > 0.0:
        push = PushedMotion(white_box, p, run).push(voltage_v=math.sqrt(voltage_v2))
        scores[1:] -= (push.products * run.lasting_weight).sum(axis=1)
    if speed_noise is not None:
        scores[1:] += speed_noise.most_share * speed_noise.scores(run)
    return scores


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
    by_neighbours = unanswered_variance(
        -0.5 * np.diff(change_v),
        run.added_a[1:-1],
        gain[1:-1],
        whole[:-2] & whole[1:-1] & whole[2:],
    )
    by_the_one_before = unanswered_variance(
        change_v, run.residual_a[2:], (gain * (1.0 - run.decay))[1:], whole[:-1] & whole[1:]
    )
    return {
        BY_NEIGHBOURS: Amount.from_pair(by_neighbours),
        BY_THE_ONE_BEFORE: Amount.from_pair(by_the_one_before),
    }


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
    readings = lagged_readings(run.stretch.voltage_v[0], run.added_a, run.gain, _is_plain(run))
    variance_v2 = believed_variance([readings])
    if not variance_v2:
        return run
    assert isinstance(white_box, MotorWhiteBox)
    noise = VoltageNoise(variance_v2, held_share)
    intervals_s = run.stretch.interval_s[0]
    power_a2 = noise.power_a2(white_box, np.log(theta), intervals_s)
    return replace(run, noise=noise, noise_power_a2=power_a2)


def _voltage_variance(run: FreeRun, variances: Mapping[str, Amount]) -> float:
    """Return the variance in V2 that counts; under a controller that answers, its upper end."""
    by_neighbours = variances[BY_NEIGHBOURS]
    by_the_one_before = variances[BY_THE_ONE_BEFORE]
    if by_neighbours.mean < -SURE * by_neighbours.std:  # no noise does that: a controller answers
        upper_v2 = max(0.0, by_the_one_before.mean + by_the_one_before.std)
        noise_v = difference_noise(run.stretch.voltage_v[0])
        return min(upper_v2, noise_v * noise_v)
    both = by_neighbours, by_the_one_before
    return max(one.mean if one.exceeds(SURE) else 0.0 for one in both)
