"""Voltages that move within a sample interval: where it is cut, and what a run makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rotor_motors import BOX, KT, THETA

from gray_box_observer.context_nodes.rotor.coordinates import coordinates, slopes
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.context_nodes.rotor.voltage_parts import VoltageParts, equivalent_voltage
from gray_box_observer.context_nodes.rotor.window import Window

Floats = NDArray[np.float64]
LIMITS = np.array([1e3, 1e6])
FINE = 5
"""Steps of the voltage in a sample interval."""

SMOOTH = np.append(THETA[:-1], 1e-9)
"""The motor without dry friction, whose derivatives depend on the steps of a run."""


def _moving(count: int, phase: int) -> tuple[Floats, Floats]:
    """Return voltages of fine steps, and interval means, that move a few steps behind a sample."""
    levels_v = np.repeat(np.random.default_rng(4).uniform(-12.0, 12.0, count // 3 + 1), 3)[:count]
    fine_v = np.concatenate([np.full(phase, levels_v[0]), np.repeat(levels_v, FINE)])
    fine_v = fine_v[: count * FINE]
    return fine_v, fine_v.reshape(count, FINE).mean(axis=1)


def _held(fine_v: Floats) -> Floats:
    return np.concatenate([fine_v[:1], fine_v[FINE - 1 :: FINE]])


def _moments(fine_v: Floats) -> Floats:
    """Return the first moments of intervals about their middles."""
    middles = (np.arange(FINE) + 0.5) / FINE - 0.5
    moments_v: Floats = fine_v.reshape(-1, FINE) @ middles / FINE
    return moments_v


def _by_unknowns(by_coordinate: Floats, p: Floats) -> Floats:
    """Return derivatives by first states and by the logarithms of the parameters."""
    by_parameter = by_coordinate[:, :, 2:] @ slopes(BOX, p)[:, :-1]
    return np.concatenate([by_coordinate[:, :, :2], by_parameter], axis=2)


@pytest.mark.parametrize('phase', [1, 2, 4])
def test_a_run_through_cut_intervals_is_that_of_the_voltage_itself(phase: int) -> None:
    fine_v, mean_v = _moving(60, phase)
    p = coordinates(BOX, SMOOTH)
    start = np.array([0.1, 3.0])
    fine = run(KT, p, start, fine_v, np.full(fine_v.size, 1e-3 / FINE), LIMITS)
    parts = VoltageParts.of_intervals(mean_v, np.full(60, 1e-3), _held(fine_v), _moments(fine_v))
    assert parts is not None
    cut = parts.over_intervals(run(KT, p, start, parts.voltage_v, parts.interval_s, LIMITS))
    plain = run(KT, p, start, mean_v, np.full(60, 1e-3), LIMITS)
    sizes = np.abs(fine.states).max(axis=0)
    off = np.abs(cut.states - fine.states[::FINE]) / sizes
    assert off.max() < 3e-4
    assert np.abs(plain.states - fine.states[::FINE])[:, 0].max() / sizes[0] > 0.01
    told, expected = (_by_unknowns(path.slopes, p) for path in (cut, fine))
    scale = np.abs(expected).max(axis=0)
    assert (np.abs(told - expected[::FINE]) / np.maximum(scale, 1e-9)).max() < 1e-3
    whole = fine.transitions.reshape(60, FINE, 2, 2)
    product = whole[:, 0]
    for step in range(1, FINE):
        product = whole[:, step] @ product
    assert cut.transitions == pytest.approx(product, rel=1e-3, abs=1e-6)


def test_intervals_in_which_nothing_moves_are_not_cut() -> None:
    at_samples_v = np.array([1.0, 5.0, 5.0, -3.0])
    held_v = np.array([1.0, 1.0, 5.0, 5.0, -3.0])  # moves at the samples themselves
    parts = VoltageParts.of_intervals(at_samples_v, np.full(4, 1e-3), held_v, np.zeros(4))
    assert parts is None


def test_of_several_moves_mean_and_first_moment_are_kept() -> None:
    held_v = np.array([0.0, 12.0])  # and 6 V for nearly all of the interval between
    shares = np.array([0.005, 0.99, 0.005])
    volts = np.array([0.0, 6.0, 12.0])
    middles = np.cumsum(shares) - 0.5 * shares - 0.5
    moment_v = np.array([float(shares * volts @ middles)])
    parts = VoltageParts.of_intervals(
        np.array([float(shares @ volts)]), np.full(1, 1e-3), held_v, moment_v
    )
    assert parts is not None
    assert parts.interval_s == pytest.approx([0.5e-3, 0.5e-3])
    assert parts.voltage_v == pytest.approx([6.0, 6.0], abs=0.2)
    assert parts.range_v[0] == pytest.approx(8.0 * moment_v[0])


def test_a_voltage_that_moves_several_times_leaves_the_run_nearly_as_it_is() -> None:
    rng = np.random.default_rng(7)
    fine_v = 6.0 + 3.0 * rng.normal(size=60 * FINE)
    mean_v = fine_v.reshape(60, FINE).mean(axis=1)
    p = coordinates(BOX, SMOOTH)
    fine = run(KT, p, np.zeros(2), fine_v, np.full(fine_v.size, 1e-3 / FINE), LIMITS)
    parts = VoltageParts.of_intervals(mean_v, np.full(60, 1e-3), _held(fine_v), _moments(fine_v))
    assert parts is not None
    cut = parts.over_intervals(run(KT, p, np.zeros(2), parts.voltage_v, parts.interval_s, LIMITS))
    plain = run(KT, p, np.zeros(2), mean_v, np.full(60, 1e-3), LIMITS)
    off_a = [np.std((path.states - fine.states[::FINE])[:, 0]) for path in (cut, plain)]
    assert off_a[0] < 0.2 * off_a[1]


def test_what_holds_over_an_interval_holds_over_its_parts() -> None:
    held_v = np.array([1.0, 5.0, 5.0])
    moments_v = np.array([0.5, 0.0])
    parts = VoltageParts.of_intervals(np.array([3.0, 5.0]), np.full(2, 1e-3), held_v, moments_v)
    assert parts is not None
    loads = parts.repeated(np.array([7.0, 8.0]))
    assert loads is not None
    assert loads.tolist() == [7.0, 7.0, 8.0]
    assert parts.repeated(None) is None


def test_a_window_knows_the_voltage_in_force_where_samples_tell_it() -> None:
    fine_v, mean_v = _moving(40, 2)
    p = coordinates(BOX, THETA)
    fine = run(KT, p, np.zeros(2), fine_v, np.full(fine_v.size, 1e-3 / FINE), LIMITS)
    samples = np.zeros((6, 41))
    samples[0, 1:] = 1e-3
    samples[1, 1:] = mean_v
    samples[2] = KT * fine.states[::FINE, 0]
    samples[4] = _held(fine_v)
    samples[5, 1:] = _moments(fine_v)
    told = Window.from_samples(BOX, samples)
    untold = Window.from_samples(BOX, samples[:4])
    residuals_a = [
        free_runs(BOX, THETA, window, np.zeros((1, 2))).residual_a for window in (told, untold)
    ]
    assert np.abs(residuals_a[0]).max() < 0.01 * np.abs(residuals_a[1]).max()
    late = told.delayed(1e-3)
    assert late.histories[0].parts is None  # whose ends are not known
    assert told.tail(20).histories[0].parts is not None


@pytest.mark.parametrize('length', [1e-9, 0.3, 2.0, 40.0])
def test_an_equivalent_voltage_leaves_a_winding_as_the_moving_one_does(length: float) -> None:
    before_v = 4.0
    after_v = -7.0
    share = 0.3
    mean_v = share * before_v + (1.0 - share) * after_v
    held_v = np.array([before_v, after_v, after_v])
    moment_v = 0.5 * share * (1.0 - share) * (after_v - before_v)
    moments_v = np.array([moment_v, 0.0])
    same_v = equivalent_voltage(np.array([mean_v, after_v]), moments_v, held_v, np.full(2, length))
    kept = np.exp(-(1.0 - share) * length)
    end = kept * before_v * -np.expm1(-share * length) - after_v * np.expm1(-(1.0 - share) * length)
    expected_v = mean_v if length < 1e-6 else end / -np.expm1(-length)
    assert same_v == pytest.approx([expected_v, after_v], rel=1e-5)
