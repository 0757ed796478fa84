"""What likely errors of a measured speed would do to an estimate: its lag, and its steps."""

from __future__ import annotations

import numpy as np
import pytest
from free_rotor_records import (
    KB,
    KT,
    NODES,
    RESISTANCE_OF_HALF_AN_INTERVAL,
    THETA,
    content,
    counted,
    late,
    mean_speeds,
    motion,
)
from linear_motor_records import INTERVAL_S, Floats

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test import speed_error
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.projection import Projection
from gray_box_observer.fit_test.speed_error import MOST_SAMPLES, likely_shifts
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

L_AND_R = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, speed_measured=True)
TRUTH = THETA[None, :2]


def _late_content(samples: int, lag: float, noise_rad_s: float = 0.0) -> Floats:
    """Samples of a speed so many intervals late."""
    noise = noise_rad_s * np.random.default_rng(3).normal(size=samples)
    return content(samples, late(motion(samples)[2], lag) + noise)


def _shift_of_fit(samples: Floats) -> Floats:
    """By how much the readings move the logarithms: the step of a fit from the true values."""
    window = SampleWindow.of_content(L_AND_R, samples)
    run = free_run(L_AND_R, to_coordinates(TRUTH), window)
    projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
    return projection.shift(projection.residual)


def _std(shifts: Floats) -> Floats:
    """Standard deviations of the logarithms by independent shifts."""
    return np.asarray(np.linalg.norm(shifts, axis=0))


def test_of_few_samples_a_lag_of_one_interval_is_likely() -> None:
    shifts = likely_shifts(L_AND_R, TRUTH, _late_content(20, 0.0))
    true = _shift_of_fit(_late_content(20, 1.0))
    assert _std(shifts)[1] == pytest.approx(abs(true[1]), rel=0.3)


@pytest.mark.parametrize('lag', [0.5, 2.0])
def test_what_is_likely_of_a_late_speed_contains_what_its_lag_does(lag: float) -> None:
    shifts = likely_shifts(L_AND_R, TRUTH, _late_content(200, lag, noise_rad_s=0.3))
    true = _shift_of_fit(_late_content(200, lag))
    assert abs(true[1]) > 0.01
    assert 0.3 < _std(shifts)[1] / abs(true[1]) < 2.0


def test_a_speed_that_is_seen_to_be_in_time_leaves_little_open() -> None:
    shifts = likely_shifts(L_AND_R, TRUTH, _late_content(100, 0.0))
    assert _std(shifts)[1] < 0.2 * abs(_shift_of_fit(_late_content(100, 1.0))[1])


def test_a_shaft_that_stands_for_long_leaves_nothing_open() -> None:
    still = content(MOST_SAMPLES, np.zeros(MOST_SAMPLES))
    assert not likely_shifts(L_AND_R, TRUTH, still).any()


def test_a_speed_that_has_not_come_to_its_first_step_tells_nothing() -> None:
    still = content(MOST_SAMPLES - 1, np.zeros(MOST_SAMPLES - 1))
    assert np.isnan(likely_shifts(L_AND_R, TRUTH, still)).any()


@pytest.mark.parametrize('share', [0.1, 0.01, 0.001])
def test_what_an_inductance_near_zero_cannot_take_of_a_lag_the_resistance_takes(
    share: float,
) -> None:
    """A lag looks like a smaller L. Of one that is near zero nothing can be taken off."""
    shifts = likely_shifts(L_AND_R, TRUTH * [share, 1.0], _late_content(200, 0.5))
    assert 0.65 < _std(shifts)[1] / RESISTANCE_OF_HALF_AN_INTERVAL < 3.0


@pytest.mark.parametrize('counts', [32, 128, 512, 2048])
@pytest.mark.parametrize('samples', [60, 200, 600])
def test_what_is_likely_of_an_encoder_contains_what_it_does(counts: int, samples: int) -> None:
    read = content(samples, counted(motion(samples)[2], counts))
    shifts = likely_shifts(L_AND_R, TRUTH, read)
    assert (np.abs(_shift_of_fit(read)) < 3.0 * _std(shifts)).all()
    assert shifts.shape[0] > 1


@pytest.mark.parametrize('step_rad_s', [0.5, 5.0])
def test_what_is_likely_of_a_rounded_speed_contains_what_rounding_does(step_rad_s: float) -> None:
    speed_rad_s = late(motion(200)[2], 0.0)
    read = content(200, step_rad_s * np.round(speed_rad_s / step_rad_s))
    std = _std(likely_shifts(L_AND_R, TRUTH, read))
    true = np.abs(_shift_of_fit(read))
    assert (true < 3.0 * std).all()
    assert std[1] < 1.5 * KB * step_rad_s / THETA[1]


def test_an_error_lasts_as_long_as_the_reading_does() -> None:
    """A speed between two levels is counted as one and the other: the errors cancel."""
    samples = 300
    step_rad_s = 5.0
    current_a = 0.5
    interval_s = np.full(samples, INTERVAL_S)
    toggling = 100.0 + step_rad_s * (np.arange(samples) % 2)
    lasting = 100.0 + step_rad_s * (np.arange(samples) >= samples // 2)
    stds = []
    for speed in (toggling, lasting):
        volts = THETA[1] * current_a + KB * speed
        signals = (interval_s, volts, np.full(samples, KT * current_a), speed)
        stds.append(_std(likely_shifts(L_AND_R, TRUTH, np.stack(signals)[:, None])[1:])[1])
    share = KB * step_rad_s / np.sqrt(6.0) / (THETA[1] * current_a)
    assert stds[0] < 0.15 * share
    assert stds[1] == pytest.approx(share / np.sqrt(2.0), rel=0.1)


def test_mean_speeds_over_an_interval_are_no_steps() -> None:
    read = content(200, mean_speeds(motion(200)[2]))
    assert likely_shifts(L_AND_R, TRUTH, read).shape[0] == 1


def test_of_a_motor_whose_covariance_is_no_number_nothing_can_be_told() -> None:
    """The inverse of such a matrix would never be found."""
    shifts = np.array([[1.0, 9.0]])
    assert np.isnan(speed_error._within_reach(shifts, np.full((2, 2), np.inf))).all()
