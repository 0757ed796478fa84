"""The step of a quantised reading is read from the readings; continuous ones have none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gray_box_observer.samples.noise_floor import quantisation_step, reading_step, speed_step


def _current(samples: int, noise: float, seed: int) -> np.ndarray:
    """Current of a motor under drawn voltages, in A."""
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.uniform(0.0, 10.0, 200), rng.integers(5, 60, 200))[:samples]
    current = np.zeros(samples)
    value = 0.0
    for k in range(samples):
        value += 0.2 * (level[k] - value)
        current[k] = value
    return current + noise * rng.standard_normal(samples)


@pytest.mark.parametrize('step', [0.01, 0.1, 1.0])
@pytest.mark.parametrize('noise_steps', [0.0, 0.3, 1.0])
@pytest.mark.parametrize('unit', [1.0, 0.0173])
def test_the_step_of_a_quantised_current_is_found_whatever_the_unit(
    step: float, noise_steps: float, unit: float
) -> None:
    readings = np.stack(
        [np.round(_current(640, noise_steps * step, seed) / step) * step for seed in range(5)]
    )
    assert quantisation_step(unit * readings) == pytest.approx(np.full(5, unit * step), rel=1e-3)


@pytest.mark.parametrize('noise', [0.0, 0.01, 0.3])
@pytest.mark.parametrize('samples', [40, 160, 4096])
def test_a_continuous_current_has_no_step(samples: int, noise: float) -> None:
    readings = np.stack([_current(samples, noise, seed) for seed in range(10)])
    assert not quantisation_step(readings).any()


def test_single_precision_is_no_step_and_does_not_hide_one() -> None:
    current = _current(1000, 0.01, 0)[None]
    assert quantisation_step(np.float64(np.float32(current))) < 1e-6
    assert quantisation_step(np.float64(np.float32(np.round(current, 2)))) == pytest.approx(
        0.01, rel=1e-3
    )


def test_a_few_readings_off_the_grid_do_not_hide_the_step() -> None:
    readings = np.round(_current(4096, 0.003, 0), 2)
    readings[::50] += np.random.default_rng(0).uniform(-0.02, 0.02, readings[::50].size)
    assert quantisation_step(readings[None]) == pytest.approx(0.01, rel=0.03)


def test_two_levels_are_a_step_where_the_reading_toggles_between_them() -> None:
    rng = np.random.default_rng(0)
    assert quantisation_step(0.02 * rng.integers(0, 2, (1, 100))) == pytest.approx(0.02)
    assert quantisation_step(np.repeat([[0.0, 1.7, 0.0, 1.7]], 30, axis=1)) == 0.0


def test_readings_that_never_change_or_are_no_numbers_have_no_step() -> None:
    assert quantisation_step(np.zeros((1, 50))) == 0.0
    assert quantisation_step(np.full((1, 50), np.nan)) == 0.0


def test_a_rotor_that_jumps_back_to_the_same_speed_is_read_in_steps() -> None:
    """At first it stands, then its encoder now and then reports a count."""
    counts = np.concatenate([np.zeros(95), [1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0], np.ones(25)])
    assert quantisation_step(-49.0 * counts[None]) == 0.0
    assert speed_step(-49.0 * counts) == pytest.approx(49.0)
    assert speed_step(-49.0 * np.sort(counts)) == 0.0  # it has moved once


@pytest.mark.parametrize('noise', [0.0, 0.01])
def test_a_continuous_speed_has_no_step_even_where_it_rests(noise: float) -> None:
    speed = _current(400, noise, 3)
    assert speed_step(speed) == 0.0
    assert speed_step(np.where(speed < 5.0, 0.0, speed - 5.0)) == 0.0


def test_a_reading_moves_by_a_step_or_by_what_passes_between_two_readings() -> None:
    speed = _current(400, 0.01, 3)
    assert reading_step(speed) == 0.0
    counted = 49.0 * np.repeat([0.0, 1.0, 0.0, 1.0, 2.0, 1.0], 20)
    assert reading_step(counted) == pytest.approx(49.0)
    assert reading_step(counted[:40]) == pytest.approx(49.0)  # it has moved once
    assert reading_step(0.5 * np.round(_current(4096, 1.0, 3) / 0.5)) == pytest.approx(0.5)
    seldom = np.repeat(speed, 10)
    assert reading_step(seldom) == pytest.approx(np.median(np.abs(np.diff(speed))))
    assert math.isnan(reading_step(np.full(50, 49.0)))
