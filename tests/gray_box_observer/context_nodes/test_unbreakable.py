"""For any motor, voltage and fault: finite estimates, positive definite covariances.

Every case is drawn from its own seed. ``DRAWN_MOTORS=10000`` draws as many instead of those of the
suite.
"""

from __future__ import annotations

import os
import warnings

import numpy as np
import pytest

from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import TERMS

CASES = int(os.environ.get('DRAWN_MOTORS', '100'))
PARTS = 10

SETS_OF_NODES = (
    ('inductance', 'resistance', 'hysteresis'),
    ('inductance', 'resistance'),
    ('inductance', 'resistance', 'hysteresis', 'brush_drop'),
    ('inductance', 'resistance', 'back_emf_constant'),
    ('inductance', 'resistance', 'hysteresis', 'back_emf_constant'),
)


def _voltage(rng: np.random.Generator, samples: int) -> np.ndarray:
    """A voltage of some kind, in V."""
    size = 10.0 ** rng.uniform(-1.0, 2.0)
    time = np.arange(samples)
    levels = rng.uniform(rng.choice([-1.0, 0.0, 0.3]), 1.0, samples)
    held = np.repeat(levels, rng.integers(1, rng.choice([3, 30, 200]), samples))[:samples]
    kinds = (
        held, held, held, np.sin(time / rng.uniform(1.0, 200.0)), np.ones(samples),
        np.zeros(samples),
        (time > samples // 2).astype(float), time / samples, rng.standard_normal(samples),
        np.sign(levels),
    )  # fmt: skip
    return size * kinds[rng.integers(len(kinds))]


def _motor(
    rng: np.random.Generator, voltage: np.ndarray, step_s: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Current in A, speed in rad/s and torque constant of a motor with or without a rotor."""
    constant = 10.0 ** rng.uniform(-3.0, 0.0)
    resistance = 10.0 ** rng.uniform(-1.5, 2.0)
    decay = np.exp(-step_s / (10.0 ** rng.uniform(-5.0, 0.5)))
    friction = rng.choice([0.0, 0.05, 0.5])
    free = rng.random() < 0.6
    slow = np.exp(-step_s / 10.0 ** rng.uniform(-2.5, 1.0))
    current = np.zeros(voltage.size + 1)
    speed = np.zeros(voltage.size + 1)
    for k, volt in enumerate(voltage):
        steady = (volt - constant * speed[k]) / resistance
        current[k + 1] = steady + (current[k] - steady) * decay
        driven = volt / constant * (1.0 - friction)
        turning = driven + (speed[k] - driven) * slow
        speed[k + 1] = turning if free else constant * current[k + 1]
    return current, speed, constant


def _spoilt(rng: np.random.Generator, current: np.ndarray) -> np.ndarray:
    """The current as a sensor might tell it."""
    size = np.abs(current).max() + 1e-12
    measured = current + rng.choice([0.0, 1e-4, 0.01, 0.3]) * size * rng.standard_normal(
        current.size
    )
    if rng.random() < 0.3:
        step = size * 10.0 ** rng.uniform(-3.0, 0.0)
        measured = np.round(measured / step) * step
    faults = (
        measured, measured, measured, -measured, measured + 0.1 * size, 1e3 * measured,
        1e-3 * measured, np.where(np.arange(measured.size) > measured.size // 2, 0.0, measured),
        np.where(rng.random(measured.size) < 0.02, 1e6, measured),
        np.where(np.arange(measured.size) > measured.size // 2, 1.5 * measured, measured),
        np.roll(measured, 7), np.clip(measured, -0.2 * size, 0.2 * size), np.zeros(measured.size),
    )  # fmt: skip
    return faults[rng.integers(len(faults))]


def _samples(seed: int) -> tuple[RecursiveEstimator, list[Sample]]:
    rng = np.random.default_rng(seed)
    step_s = float(rng.choice([1e-4, 1e-3, 1e-2, 0.1]))
    count = int(rng.choice([80, 160, 240, 400]))
    names = SETS_OF_NODES[rng.integers(len(SETS_OF_NODES))]
    voltage = _voltage(rng, count)
    current, speed, constant = _motor(rng, voltage, step_s)
    torque = constant * _spoilt(rng, current)
    with_speed = 'back_emf_constant' in names or rng.random() < 0.4
    speed = speed + rng.choice([0.0, 0.01]) * np.abs(speed).max() * rng.standard_normal(speed.size)
    told = {} if 'back_emf_constant' in names else {'back_emf_constant': constant}
    box = MotorWhiteBox(names, constant, told, speed_measured=with_speed)
    guess = np.array(
        [
            [
                TERMS[name].parameter.initial * 10.0 ** rng.uniform(-1.0, 3.5 * rng.random())
                for name in names
            ]
        ]
    )
    gaps = rng.random(count + 1) < rng.choice([0.0, 0.0, 0.02])
    samples = [
        Sample.of_one_motor(
            round(k * step_s * 1e9),
            0.0 if k == 0 or gaps[k] else step_s,
            voltage[max(k - 1, 0)],
            torque[k],
            speed[k] if with_speed else np.nan,
        )
        for k in range(count + 1)
    ]
    return RecursiveEstimator(box, guess), samples


def _assert_sound(nodes: RecursiveEstimator, seed: int, at: int) -> None:
    estimate = nodes.estimate()
    where = f'case {seed}, sample {at}'
    assert np.isfinite(estimate.value).all(), where
    assert np.isfinite(estimate.covariance).all(), where
    variance = np.diagonal(estimate.covariance, axis1=1, axis2=2)
    assert (variance > 0.0).all(), where
    std = np.sqrt(variance)
    correlation = estimate.covariance / std[:, :, None] / std[:, None, :]
    assert (np.linalg.eigvalsh(correlation) > 0.0).all(), where
    assert np.isfinite(nodes.noise_std_nm).all(), where


@pytest.mark.slow
@pytest.mark.parametrize('part', range(PARTS))
def test_no_drawn_motor_makes_numbers_that_are_none_or_a_covariance_that_is_indefinite(
    part: int,
) -> None:
    for seed in range(part, CASES, PARTS):
        nodes, samples = _samples(seed)
        estimate_count = 0
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            for at, sample in enumerate(samples):
                if nodes.learn(sample):
                    estimate_count += 1
                    _assert_sound(nodes, seed, at)
        assert estimate_count > 0, seed
