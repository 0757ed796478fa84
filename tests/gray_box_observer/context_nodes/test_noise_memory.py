"""Noise that a filter remembers is known by its correlation, and taken off whatever is compared."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, LIVELY, recorded

from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns, free_runs
from gray_box_observer.context_nodes.rotor.history_unknowns import Unknowns
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.noise_memory import (
    LONGEST_MEMORY,
    memory_of,
    without_memory,
)
from gray_box_observer.context_nodes.rotor.window import History, Window
from gray_box_observer.context_nodes.rotor.window_fit import search_from
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

MEMORY = 0.6
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
BOX = MotorWhiteBox(NODES, GEAR_MOTOR.torque_constant, {'back_emf_constant': 0.02})
THETA = np.array([getattr(GEAR_MOTOR, name) for name in NODES])


def remembered_noise(count: int, memory: float, seed: int) -> Array:
    """Return noise of unit size of which every value remembers the one before."""
    noise = np.random.default_rng(seed).normal(size=count)
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
    return noise


def window_of(memory: float, seed: int, noise_memory: float, samples: int = 1000) -> Window:
    """Return a window of a motor whose current has 1 % of such noise."""
    record = recorded(GEAR_MOTOR, LIVELY, 2.0, seed)
    size_a = 3e-4 / GEAR_MOTOR.torque_constant
    current_a = record.true_torque_nm[0, :samples] / GEAR_MOTOR.torque_constant
    current_a = current_a + size_a * remembered_noise(samples, memory, seed)
    history = History(current_a, record.voltage_v[0, : samples - 1], np.full(samples - 1, 1e-3))
    return Window((history,), Unknowns(noise_memory=noise_memory), samples)


def runs_at(window: Window, theta: Array = THETA) -> FreeRuns:
    """Run freely from rest."""
    return free_runs(BOX, theta, window, np.zeros((1, 2)))


def test_what_noise_remembers_is_taken_off() -> None:
    signal = np.array([2.0, 1.0, 0.5])
    np.testing.assert_allclose(without_memory(signal, 0.5), [np.sqrt(3.0), 0.0, 0.0])
    assert without_memory(signal, 0.0) is signal


def test_a_signal_history_remembers_nothing_of_the_one_before() -> None:
    signal = np.array([[2.0, 4.0], [1.0, 2.0], [0.5, 1.0]])
    begins = np.array([True, True, False])
    expected = np.sqrt([[3.0, 12.0], [0.75, 3.0], [0.0, 0.0]])
    np.testing.assert_allclose(without_memory(signal, 0.5, begins), expected)


@pytest.mark.parametrize('memory', [0.2, 0.6, 0.9])
def test_the_memory_of_noise_is_found_whatever_lies_far_off(memory: float) -> None:
    parts = [remembered_noise(3000, memory, seed) for seed in (1, 2)]
    parts[0][[100, 2000]] += 1e3
    assert memory_of(parts) == pytest.approx(memory, abs=0.03)
    assert memory_of(parts, 0.5 * memory) == pytest.approx(0.5 * memory)


@pytest.mark.parametrize('share', [0.2, 0.4, 0.6])
def test_noise_behind_an_average_that_is_undone_has_a_negative_memory(share: float) -> None:
    new = np.random.default_rng(4).normal(size=(2, 3000))
    parts = [np.concatenate([one[:1], one[1:] - share * one[:-1]]) for one in new]
    assert memory_of(parts, is_undone=True) == pytest.approx(-share, abs=0.07)
    assert memory_of(parts, 0.5 * share, is_undone=True) == pytest.approx(-0.5 * share)
    assert memory_of(parts) == 0.0
    begins = np.arange(6000) % 3000 == 0
    white = without_memory(np.concatenate(parts), -share, begins)
    np.testing.assert_allclose(white[100:3000], new[0, 100:], atol=1e-6)
    np.testing.assert_allclose(white[3100:], new[1, 100:], atol=1e-6)
    columns = without_memory(np.stack([parts[0], 2.0 * parts[0]], axis=1), -share)
    np.testing.assert_allclose(columns, np.stack([white[:3000], 2.0 * white[:3000]], axis=1))


def test_white_noise_remembers_nothing_and_nothing_remembers_for_ever() -> None:
    found = [memory_of([remembered_noise(500, 0.0, seed)]) for seed in range(50)]
    assert np.count_nonzero(found) <= 1
    assert memory_of([remembered_noise(500, -0.5, 1)]) == 0.0
    assert memory_of([np.linspace(-1.0, 1.0, 500)]) == LONGEST_MEMORY
    assert memory_of([np.zeros(10)]) == 0.0


def test_residuals_and_derivatives_are_without_it() -> None:
    plain = runs_at(window_of(MEMORY, 3, 0.0))
    white = runs_at(window_of(MEMORY, 3, MEMORY))
    for signal, expected in (
        (white.residual_a, plain.residual_a),
        (white.by_parameter, plain.by_parameter),
        (white.by_start[0], plain.by_start[0]),
    ):
        np.testing.assert_allclose(signal, without_memory(expected, MEMORY), rtol=1e-9, atol=1e-12)
    assert memory_of(plain.misread_a) == pytest.approx(MEMORY, abs=0.1)
    assert memory_of([white.residual_a]) == 0.0


def test_deviations_are_those_that_fits_scatter_by() -> None:
    """They are too small where the memory is not known."""
    prior = LogPrior(np.log(THETA), np.zeros((THETA.size, THETA.size)))
    errors: dict[float, list[float]] = {0.0: [], MEMORY: []}
    for noise_memory, own_errors in errors.items():
        for seed in range(12):
            window = window_of(MEMORY, seed, noise_memory)
            fit = completed(search_from(BOX, window, prior, THETA))
            assert fit is not None
            std = np.sqrt(np.linalg.inv(fit.information)[1, 1])
            own_errors.append((fit.logarithms[1] - np.log(THETA[1])) / std)
    sizes = {memory: np.sqrt(np.mean(np.square(one))) for memory, one in errors.items()}
    assert 0.6 < sizes[MEMORY] < 1.4
    assert sizes[0.0] > 1.5 * sizes[MEMORY]
