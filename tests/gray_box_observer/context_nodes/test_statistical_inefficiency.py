"""Neighbours that err alike count for less, and what a white box leaves out is no change."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.signal import lfilter

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.statistical_inefficiency import (
    statistical_inefficiency,
    without_columns,
)
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

NOISE_NM = 1.1e-4
MOST_CHANGES = 4


@pytest.mark.parametrize('samples', [0, 1, 15, 16, 100, 4000])
def test_of_white_noise_every_sample_counts(samples: int) -> None:
    noise = np.random.default_rng(samples).standard_normal((20, samples))
    assert np.all(statistical_inefficiency(noise) >= 1.0)
    assert np.all(statistical_inefficiency(noise) < 1.3)


@pytest.mark.parametrize('memory', [0.5, 0.9, 0.97])
def test_of_noise_that_remembers_as_many_count_for_one_as_its_spectrum_says(memory: float) -> None:
    noise = np.random.default_rng(1).standard_normal((20, 100_000))
    inefficiency = statistical_inefficiency(lfilter([1.0], [1.0, -memory], noise, axis=1))
    expected = (1.0 + memory) / (1.0 - memory)
    assert np.all((0.6 * expected < inefficiency) & (inefficiency < 1.2 * expected))


def test_a_residual_of_nothing_is_no_division_by_zero() -> None:
    np.testing.assert_array_equal(statistical_inefficiency(np.zeros((2, 100))), 1.0)


def test_what_columns_explain_is_taken_off_though_one_of_them_is_empty() -> None:
    columns = np.random.default_rng(2).standard_normal((3, 50, 3))
    columns[..., 2] = 0.0
    other = np.random.default_rng(3).standard_normal((3, 50))
    left = without_columns(other, columns)
    explained = columns @ np.array([2.0, -1.0, 5.0])
    np.testing.assert_allclose(without_columns(other + explained, columns), left, atol=1e-12)
    np.testing.assert_allclose(columns.swapaxes(1, 2) @ left[..., None], 0.0, atol=1e-12)


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_brush_drop_that_no_node_explains_is_rarely_told_as_a_change(
    samples_of: Callable[..., Sequence[Sample]], seed: int
) -> None:
    plant = PlantParameters(hysteresis=0.0, brush_drop=1.0)
    simulation = Simulation(
        {'motor': plant}, 'R[-15,15]D[0.1,1]', seed=seed, torque_noise_std=NOISE_NM
    )
    box = MotorWhiteBox(('inductance', 'resistance'), 0.01, {'back_emf_constant': 0.01})
    nodes = RecursiveEstimator(box, np.array([[0.75, 3.0]]))
    for sample in samples_of(simulation.record(60.0)):
        nodes.learn(sample)
    assert nodes.change_count <= MOST_CHANGES


def test_an_inductance_that_only_rare_transitions_tell_is_followed_when_it_falls(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., Sequence[Sample]],
) -> None:
    for seed in range(12):
        at_s = 20.0 + float(np.random.default_rng(seed).uniform(0.0, 4.0))
        fall = (f'motor.inductance=0.35@{at_s:.4f}',)
        recording = record(
            'R[5,15]D[0.001,2]', at_s + 10.0, seed, torque_noise_std=NOISE_NM, schedule=fall
        )
        nodes = RecursiveEstimator(thesis_box, np.array([[1.5, 3.0, 30.0]]))
        for sample in samples_of(recording):
            nodes.learn(sample)
        assert nodes.theta[0, 0] == pytest.approx(0.35, rel=0.02)


@pytest.mark.parametrize('seed', [1, 7])
def test_a_winding_that_heats_within_seconds_does_not_hide_itself(
    samples_of: Callable[..., Sequence[Sample]], seed: int
) -> None:
    plant = PlantParameters(
        inductance=0.003,
        resistance=0.6,
        hysteresis=0.0896,
        torque_constant=0.05,
        back_emf_constant=0.05,
    )
    simulation = Simulation(
        {'motor': plant},
        'R[5,15]D[0.001,0.1]',
        seed=seed,
        sample_rate_hz=1000.0,
        torque_noise_std=9e-4,
        schedule=('motor.resistance=0.6..0.72@0..6',),
    )
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), 0.05, {'back_emf_constant': 0.05}
    )
    nodes = RecursiveEstimator(box, np.array([[0.009, 1.8, 0.27]]))
    inductance = []
    for sample in samples_of(simulation.record(6.0)):
        nodes.learn(sample)
        inductance.append(nodes.theta[0, 0])
    error = np.array(inductance[3000:]) / 0.003 - 1.0
    assert np.sqrt(np.mean(error**2)) < 0.08
