"""A moving average that passes for the winding of a rotor: where it is doubted, and by how much."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linear_motor_records import INTERVAL_S, Floats, Record, steps
from scipy.signal import lfilter

from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.context_nodes.rotor.voltage_noise import VoltageNoise
from gray_box_observer.fit_test import smoothed_current
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Doubt, Projection
from gray_box_observer.fit_test.rotor_free_run import rotor_free_run
from gray_box_observer.fit_test.smoothed_current import (
    FAST,
    SMOOTHEST_IN_NOISE,
    shows_colour,
    smoothing_doubts,
)
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 2000
KT = KB = 0.02
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
ROTOR = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})
RESISTANCE = 2.0
KEPT = 0.15
"""Weight of the average before."""

INTERVALS = -1.0 / np.log(KEPT)
"""Sample intervals in an L/R that lags as such an average does."""


def _theta(intervals: float) -> Floats:
    inductance = intervals * INTERVAL_S * RESISTANCE
    return np.array([inductance, RESISTANCE, 2e-6, 1e-5, 1e-9])


def _current(theta: Floats) -> Floats:
    voltage_v = steps(SAMPLES, 2)[:-1]
    interval_s = np.full(voltage_v.size, INTERVAL_S)
    limits = np.array([1e3, 1e6])
    path = run(KT, coordinates(ROTOR, theta), np.zeros(2), voltage_v, interval_s, limits)
    current_a: Floats = path.states[:, 0]
    return current_a


def _doubts(
    white_box: MotorWhiteBox, free: FreeRun, theta: Floats, intervals: float
) -> list[Doubt]:
    has_colour = shows_colour(free)
    return smoothing_doubts(white_box, free, theta, intervals, has_colour=has_colour)


def test_the_doubt_is_the_reading_of_a_fast_winding_behind_the_average() -> None:
    theta = _theta(INTERVALS)
    current_a = _current(theta)
    free = rotor_free_run(
        ROTOR, to_coordinates(theta[None]), Record(steps(SAMPLES, 2), current_a).stretch
    )
    (doubt,) = _doubts(ROTOR, free, theta, INTERVALS)
    fast = _current(_theta(FAST))
    read_a = lfilter([1.0 - KEPT], [1.0, -KEPT], fast)
    expected_a = read_a - current_a
    assert np.std(doubt.response_a - expected_a) < 0.02 * np.std(expected_a)
    assert 0.005 * np.std(current_a) < np.std(expected_a) < 0.1 * np.std(current_a)


@pytest.mark.parametrize('intervals', [1.2, 3.0, np.inf, np.nan])
def test_of_a_winding_that_lags_longer_its_shape_tells(intervals: float) -> None:
    theta = _theta(2.0)
    record = Record(steps(SAMPLES, 2), _current(theta))
    free = rotor_free_run(ROTOR, to_coordinates(theta[None]), record.stretch)
    assert _doubts(ROTOR, free, theta, intervals) == []


def test_colour_beside_noise_of_the_voltage_leaves_the_inductance_open_as_a_whole() -> None:
    theta = _theta(2.0)
    record = Record(steps(SAMPLES, 2), _current(theta))
    free = rotor_free_run(ROTOR, to_coordinates(theta[None]), record.stretch)
    white_a = np.random.default_rng(1).normal(size=SAMPLES)
    coloured_a = lfilter([0.8], [1.0, -0.6], white_a)
    noisy = replace(free, residual_a=coloured_a, noise=VoltageNoise(1e-3, 1.0), noise_power_a2=0.1)
    (doubt,) = _doubts(ROTOR, noisy, theta, 3.0)
    assert doubt.exchange is not None
    assert doubt.exchange.tolist() == [1.0 - 0.1 / 3.0, *[0.0] * (theta.size - 1)]
    assert _doubts(ROTOR, noisy, theta, SMOOTHEST_IN_NOISE) == []
    explained = replace(noisy, noise_power_a2=1.0)  # the winding forgets as slowly
    assert _doubts(ROTOR, explained, theta, 3.0) == []
    assert _doubts(ROTOR, replace(noisy, residual_a=white_a), theta, 3.0) == []
    projection = Projection(free.jacobian, coloured_a, free.weight, free.jacobian.shape[1])
    own = replace(doubt, exchange=None)
    shifts = [projection.open_shift(one, 1.0, is_white=True)[0] for one in (doubt, own)]
    further = shifts[0] - shifts[1]
    assert further[0] > 0.1
    assert shifts[1][1] > 0.0, 'R is too large with L'
    np.testing.assert_array_equal(further[1:], 0.0)


def test_the_doubt_stays_where_a_fast_winding_cannot_be_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    theta = _theta(INTERVALS)
    record = Record(steps(SAMPLES, 2), _current(theta))
    free = rotor_free_run(ROTOR, to_coordinates(theta[None]), record.stretch)
    (doubt,) = _doubts(ROTOR, free, theta, INTERVALS)
    monkeypatch.setattr(smoothed_current, 'free_runs', _given_up)
    (other,) = _doubts(ROTOR, free, theta, INTERVALS)
    assert np.std(other.response_a) > np.std(doubt.response_a)


def _given_up(*arguments: object) -> SimpleNamespace:
    return SimpleNamespace(is_bounded=False)


def test_a_motor_with_hysteresis_is_doubted_as_one_without() -> None:
    """Its winding is followed in many steps."""
    theta = np.append(_theta(INTERVALS), 1e-5)
    box = MotorWhiteBox((*NODES, 'hysteresis'), KT, {'back_emf_constant': KB})
    current_a = _current(theta[:-1])
    free = rotor_free_run(
        box, to_coordinates(theta[None]), Record(steps(SAMPLES, 2), current_a).stretch
    )
    (doubt,) = _doubts(box, free, theta, INTERVALS)
    fast = _current(_theta(FAST))
    read_a = lfilter([1.0 - KEPT], [1.0, -KEPT], fast)
    assert np.std(doubt.response_a - (read_a - current_a)) < 0.1 * np.std(read_a - current_a)
