"""Noise of a measured voltage or speed moves an estimate by as much as the fit test says."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from linear_motor_records import RESISTANCE_OHM, TORQUE_CONSTANT, Floats, steps
from turning_motor_records import NODES, SAMPLES, true_coordinates, turning_motor, white_box

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.free_run import free_run
from gray_box_observer.fit_test.input_noise import (
    BY_NEIGHBOURS,
    BY_THE_ONE_BEFORE,
    input_noise_scores,
    voltage_variances,
)
from gray_box_observer.fit_test.projection import UNKNOWN, Amount, Projection
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun, rotor_free_run
from gray_box_observer.fit_test.speed_noise import SpeedNoise
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates

SEEDS = 40
CURRENT_STD = 0.01
RHO = 0.3
L_AND_R = white_box(*NODES[:2])
ALL = white_box(*NODES)


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the noise of measured speed and voltage, in rad/s and V."""

    speed: float = 0.0
    voltage: float = 0.0


NOISELESS = Noise()
SPEED = Noise(speed=1.0)
VOLTAGE = Noise(voltage=0.05)


def _measured(motor: SampleWindow, seed: int, noise: Noise = NOISELESS) -> SampleWindow:
    rng = np.random.default_rng([seed, 5])
    return replace(
        motor,
        state=motor.state + CURRENT_STD * rng.normal(size=motor.state.shape),
        voltage_v=motor.voltage_v + noise.voltage * rng.normal(size=motor.voltage_v.shape),
        speed_rad_s=motor.speed_rad_s + noise.speed * rng.normal(size=motor.speed_rad_s.shape),
    )


def _shift(box: MotorWhiteBox, stretch: SampleWindow) -> Floats:
    """By how much the noise of the inputs moves the logarithms, as the fit test says."""
    p = true_coordinates(box)
    run = free_run(box, p, stretch)
    projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
    noise = SpeedNoise.from_run(box, p, run)
    scores = input_noise_scores(box, p, run, voltage_variances(run), noise)
    return projection.shift_of_scores(scores)


def _fitted_step(box: MotorWhiteBox, stretch: SampleWindow) -> Floats:
    """First step of a least-squares fit from the true values, in logarithms."""
    run = free_run(box, true_coordinates(box), stretch)
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    return np.asarray(np.linalg.lstsq(columns, run.residual_a, rcond=None)[0][1:])


@pytest.mark.parametrize('box', [L_AND_R, ALL], ids=['L and R', 'all'])
@pytest.mark.parametrize('rho', [0.3, 1.0, 3.0])
@pytest.mark.parametrize('noise', [SPEED, VOLTAGE], ids=['speed', 'voltage'])
def test_the_bias_is_that_of_repeated_fits(noise: Noise, rho: float, box: MotorWhiteBox) -> None:
    stretches = [_measured(turning_motor(rho), seed, noise) for seed in range(SEEDS)]
    first_steps = [_fitted_step(box, stretch) for stretch in stretches]
    chance = np.std(first_steps, axis=0) / np.sqrt(SEEDS)
    bias = np.mean(first_steps, axis=0)
    shift = np.mean([_shift(box, stretch) for stretch in stretches], axis=0)
    assert bias[0] > 5.0 * chance[0]  # noise makes L too large
    assert (np.abs(shift - bias) < 4.0 * chance + 0.1 * np.abs(shift)).all()


@pytest.mark.parametrize('noise', [SPEED, VOLTAGE], ids=['speed', 'voltage'])
def test_the_standard_deviation_of_the_inductance_contains_it(noise: Noise) -> None:
    p = true_coordinates(L_AND_R)
    noisy = _measured(turning_motor(RHO), 3, noise)
    exact = _measured(turning_motor(RHO), 3)
    assert np.abs(analyse(L_AND_R, p, noisy).open_shifts).max() > 0.005
    assert np.abs(analyse(L_AND_R, p, exact).open_shifts).max() < 1e-4


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('dither_v', [0.05, 2.0])
def test_noise_that_the_driver_applies_leaves_nothing_open(dither_v: float, seed: int) -> None:
    stretch = _measured(turning_motor(RHO, dither_v=dither_v), seed)
    assert np.abs(_shift(L_AND_R, stretch)).max() < 1e-4


def test_noise_of_the_voltage_is_seen_where_a_controller_answers_that_of_the_current() -> None:
    """The loop answers every reading; what is measured of its voltage has noise of its own."""
    blocked = MotorWhiteBox(NODES[:2], TORQUE_CONSTANT)
    rng = np.random.default_rng(5)
    decay = np.exp(-RHO)
    gain = (1.0 - decay) / RESISTANCE_OHM
    references_a = steps(SAMPLES, 6, -0.3, 0.3)
    current_a = 0.0
    voltage_v = np.zeros(SAMPLES)
    readings_a = np.zeros(SAMPLES)
    for sample, reference_a in enumerate(references_a):
        readings_a[sample] = current_a + CURRENT_STD * rng.normal()
        voltage_v[sample] = RESISTANCE_OHM * reference_a
        voltage_v[sample] += 0.5 / gain * (reference_a - readings_a[sample])
        current_a = decay * current_a + gain * voltage_v[sample]
    motor = turning_motor(RHO)
    stretch = replace(
        motor,
        state=readings_a[None],
        voltage_v=(voltage_v + 0.05 * rng.normal(size=SAMPLES))[None, :-1],
        speed_rad_s=0.0 * motor.speed_rad_s,
    )
    inductance_shift = _shift(blocked, stretch)[0]
    bias = _fitted_step(blocked, stretch)[0]
    assert bias > 0.05
    assert 0.5 * bias < inductance_shift < 5.0 * bias


def test_under_a_controller_that_answers_the_largest_likely_noise_counts() -> None:
    p = true_coordinates(L_AND_R)
    stretch = _measured(turning_motor(RHO), 1, VOLTAGE)
    run = free_run(L_AND_R, p, stretch)

    def scores(by_neighbours: Amount, by_the_one_before: Amount) -> Floats:
        variances = {BY_NEIGHBOURS: by_neighbours, BY_THE_ONE_BEFORE: by_the_one_before}
        noise = SpeedNoise.from_run(L_AND_R, p, run)
        return input_noise_scores(L_AND_R, p, run, variances, noise)

    answered = Amount(-1.0, 0.1)
    little = Amount(1e-4, 2e-4)
    much = Amount(1.0, 2.0)
    expected = scores(Amount(3e-4, 1e-9), UNKNOWN)  # the mean and a standard deviation
    assert scores(answered, little) == pytest.approx(expected, rel=1e-3)
    largest_v2 = difference_noise(stretch.voltage_v[0]) ** 2  # the readings scatter by no more
    expected = scores(Amount(largest_v2, 1e-9), UNKNOWN)
    assert scores(answered, much) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize('seed', range(5))
def test_a_shaft_that_turns_restlessly_has_hardly_any_noise(seed: int) -> None:
    restless = _measured(turning_motor(RHO, turning_rad_s=3.0), seed)
    noisy = _measured(turning_motor(RHO), seed, Noise(speed=3.0))
    assert _shift(L_AND_R, restless)[0] < 0.25 * _shift(L_AND_R, noisy)[0]


def test_rounding_adds_to_the_noise_of_a_speed() -> None:
    step_rad_s = 4.0
    noisy = _measured(turning_motor(RHO), 2, Noise(speed=0.5 * step_rad_s))
    rounded = replace(noisy, speed_rad_s=step_rad_s * np.round(noisy.speed_rad_s / step_rad_s))
    both = _measured(turning_motor(RHO), 2, Noise(speed=step_rad_s * np.sqrt(0.25 + 1.0 / 12.0)))
    assert _shift(L_AND_R, rounded)[0] == pytest.approx(_shift(L_AND_R, both)[0], rel=0.2)


def test_intervals_without_a_past_count_for_nothing() -> None:
    stretch = _measured(turning_motor(RHO), 1, SPEED)
    restart = np.zeros_like(stretch.restart)
    restart[0, 300::300] = True
    gaps = replace(stretch, restart=restart)
    assert _shift(L_AND_R, gaps)[0] == pytest.approx(_shift(L_AND_R, stretch)[0], rel=0.3)


def test_a_speed_that_nobody_measures_has_no_noise() -> None:
    blocked = MotorWhiteBox(('inductance', 'resistance'), TORQUE_CONSTANT)
    assert not _shift(blocked, _measured(turning_motor(RHO), 0, Noise(speed=4.0))).any()


def test_a_rotor_that_cannot_be_run_answers_no_noise() -> None:
    """A trial of a form may end at values at which nothing can be run."""
    nodes = 'inductance', 'resistance', 'inertia', 'viscous_friction'
    rotor = MotorWhiteBox(nodes, TORQUE_CONSTANT, {'back_emf_constant': 0.02})
    p = to_coordinates(np.array([[1e2, 1e-4, 1e-12, 1e-12]]))
    run = rotor_free_run(rotor, p, _measured(turning_motor(RHO), 1, VOLTAGE))
    noise = Amount(VOLTAGE.voltage**2, 1e-6)
    variances = {BY_NEIGHBOURS: noise, BY_THE_ONE_BEFORE: noise}
    assert not isinstance(run, RotorFreeRun)
    assert (input_noise_scores(rotor, p, run, variances, None) == 0.0).all()
