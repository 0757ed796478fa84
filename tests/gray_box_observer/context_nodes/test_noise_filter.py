"""What takes noise of the voltage off residuals: what is left is white, its slopes are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rotor_motors import BOX, KT, THETA, content_of, recorded

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.history_unknowns import SpeedOutput, Unknowns
from gray_box_observer.context_nodes.rotor.noise_filter import (
    NoiseFilter,
    ReadingNoise,
    interval_motion,
    rotor_jacobian,
)
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.samples.replay_buffer import VOLTAGE
from gray_box_observer.white_box.declaration import TERMS, State

INTERVAL_S = 2e-3
NOISE_V, NOISE_A = 0.2, 0.01
UNIT_A_S = 0.004
COUNT = 4000
P = coordinates(BOX, THETA)
INVERSE_H = float(P[tuple(TERMS).index('inductance')])


def motion(length_s: float, *, is_held: bool = False) -> tuple[np.ndarray, np.ndarray]:
    return interval_motion(rotor_jacobian(P, KT, 0.0), INVERSE_H, length_s, is_held=is_held)


def noise_filter(interval_s: np.ndarray, is_held: np.ndarray) -> NoiseFilter:
    variance_v2 = np.full(interval_s.size, NOISE_V**2)
    is_read = np.ones(interval_s.size + 1, dtype=bool)
    return NoiseFilter(interval_s, variance_v2, is_held, is_read, UNIT_A_S, NOISE_A, P, KT, 0.0)


def residuals(own: NoiseFilter, seed: int) -> np.ndarray:
    """Residuals of a model that answers noise of its voltage, shape (output, k + 1, 1)."""
    rng = np.random.default_rng(seed)
    count = own.interval_s.size + 1
    states = np.zeros((count, 2))
    for k in range(1, count):
        state, drive = motion(own.interval_s[k - 1], is_held=bool(own.is_held[k - 1]))
        states[k] = state @ states[k - 1] + drive * rng.normal(0.0, NOISE_V)
    readings = rng.normal(0.0, NOISE_A, size=(2, count))
    return (states.T * np.array([[1.0], [UNIT_A_S]]) + readings)[:, :, None]


@pytest.fixture(name='own')
def _own() -> NoiseFilter:
    """Of intervals of two lengths; friction holds the rotor for a while."""
    interval_s = np.where(np.arange(COUNT) % 7 == 0, 2.0 * INTERVAL_S, INTERVAL_S)
    is_held = (np.arange(COUNT) > 1000) & (np.arange(COUNT) < 1600)
    return noise_filter(interval_s, is_held)


def test_what_is_left_is_white_and_as_large_as_the_noise_of_the_readings(own: NoiseFilter) -> None:
    rows = residuals(own, 1)
    assert np.std(rows[State.CURRENT]) > 2.0 * NOISE_A, 'before it holds more'
    for white in own.white_rows(rows)[:, :, 0]:
        assert np.std(white) == pytest.approx(NOISE_A, rel=0.05)
        assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 4.0 / np.sqrt(COUNT)


def test_compiled_code_does_as_python(own: NoiseFilter) -> None:
    rows = residuals(own, 2)
    np.testing.assert_allclose(
        own.white_rows(rows), own.white_rows(rows, is_compiled=False), rtol=1e-9, atol=1e-15
    )


def test_compiled_code_and_python_answer_voltages_alike(own: NoiseFilter) -> None:
    volts = np.random.default_rng(6).normal(size=(COUNT, 3))
    np.testing.assert_allclose(
        own.response(volts), own.response(volts, is_compiled=False), rtol=1e-9, atol=1e-15
    )


def test_noise_alone_adds_to_products_of_slopes_as_many_draws_do(own: NoiseFilter) -> None:
    """Of residuals that hold noise of the voltage and of the readings, and nothing else."""
    place = 0  # of the inductance
    by_logarithm = slopes(BOX, P)[:, [place]]
    step = 1e-3
    products = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        volts = rng.normal(0.0, NOISE_V, (COUNT, 1))
        readings = rng.normal(0.0, NOISE_A, (1, COUNT + 1, 1))
        ends = []
        for sign in (1.0, -1.0):
            other = replace(own, p=P + sign * step * by_logarithm[:, 0])
            ends.append(other.white_rows(readings - other.response(volts)[None, :, :, 0]))
        products.append(float(np.sum(((ends[0] - ends[1]) / (2.0 * step)) ** 2)))
    share = own.noise_information(1, by_logarithm)
    assert share.shape == (1, 1)
    assert share[0, 0] == pytest.approx(np.mean(products), rel=0.1)


def test_without_noise_of_the_voltage_nothing_is_added(own: NoiseFilter) -> None:
    quiet = replace(own, voltage_v2=np.zeros(COUNT))
    assert not quiet.noise_information(2, slopes(BOX, P)).any()


def test_without_noise_of_the_voltage_residuals_stay_as_they_are(own: NoiseFilter) -> None:
    rows = residuals(own, 3)
    quiet = replace(own, voltage_v2=np.zeros(COUNT))
    np.testing.assert_array_equal(quiet.white_rows(rows), rows)


def test_a_speed_that_is_not_read_tells_nothing(own: NoiseFilter) -> None:
    rows = residuals(own, 4)
    blind = replace(own, is_read=np.zeros(COUNT + 1, dtype=bool))
    np.testing.assert_allclose(blind.white_rows(rows)[:1], blind.white_rows(rows[:1]))


def test_an_interval_is_as_two_of_half_its_length() -> None:
    for is_held in (False, True):
        half, half_drive = motion(INTERVAL_S, is_held=is_held)
        whole, drive = motion(2.0 * INTERVAL_S, is_held=is_held)
        np.testing.assert_allclose(whole, half @ half, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(drive, half @ half_drive + half_drive, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize('has_speed', [False, True], ids=['current', 'current and speed'])
def test_derivatives_of_filtered_residuals_are_those_of_small_steps(*, has_speed: bool) -> None:
    """The filter itself depends on the values, too. Longer steps meet kinks of the friction."""
    samples = content_of(recorded('R[-12,12]D[0.1,0.3]', 1.0))
    samples[VOLTAGE] += np.random.default_rng(5).normal(0.0, NOISE_V, samples.shape[1])
    unknowns = Unknowns(SpeedOutput(UNIT_A_S)) if has_speed else Unknowns()
    window = Window.from_samples(BOX, samples, unknowns)
    noise = ReadingNoise(NOISE_V**2, NOISE_A, window.interval_s, follows_speed=has_speed)
    starts = np.zeros((1, unknowns.count))
    at = free_runs(BOX, THETA, window, starts, noise=noise)
    step = 1e-6
    for place in range(THETA.size):
        ends = []
        for sign in (1.0, -1.0):
            theta = THETA.copy()
            theta[place] *= np.exp(sign * step)
            ends.append(free_runs(BOX, theta, window, starts, noise=noise).residual_a)
        slope = (ends[1] - ends[0]) / (2.0 * step)
        apart = np.linalg.norm(at.by_parameter[:, place] - slope)
        assert apart < 1e-3 * np.linalg.norm(slope)
