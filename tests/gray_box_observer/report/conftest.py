"""Synthetic runs for tests of the report: seeded, and shaped like an observer's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gray_box_observer.report.run.history import (
    FloatArray,
    MotorHistory,
    ParameterHistory,
    RunHistory,
    Truth,
)

UNITS = {'inductance': 'H', 'resistance': 'ohm', 'hysteresis': 'V s / (rad A)'}
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}


def held_voltage(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Levels drawn from 5 to 15 V, each held for 1 to 6 s."""
    voltage = np.empty(len(time_s))
    start = float(time_s[0])
    while start <= time_s[-1]:
        voltage[time_s >= start] = rng.uniform(5.0, 15.0)
        start += rng.uniform(1.0, 6.0)
    return voltage


def torque_of(time_s: FloatArray, voltage_v: FloatArray) -> FloatArray:
    """Thesis motor by many small Euler steps: 0.5 H, 1 ohm, hysteresis 10, Kt 0.01."""
    current = 0.0
    torque = np.empty(len(time_s))
    step_s = float(time_s[1] - time_s[0]) / 10.0
    for k, volts in enumerate(voltage_v):
        torque[k] = 0.01 * current
        for _ in range(10):
            current += step_s / 0.5 * (volts - 1.0001 * current - 0.1 * abs(current) * current)
    return torque


def parameter(
    name: str, time_s: FloatArray, rng: np.random.Generator, truth: Truth | None, start: float = 3.0
) -> ParameterHistory:
    """An estimate that starts off by a factor and settles on the truth within its own deviation."""
    goal = np.full(len(time_s), TRUTH.get(name, 1.0))
    if isinstance(truth, tuple):
        goal = truth[1][np.searchsorted(truth[0], time_s, side='right') - 1]
    since = time_s - time_s[0]
    std = goal * (0.9 * np.exp(-since / 0.5) + 0.02 / np.sqrt(1.0 + 40.0 * since))
    walk = np.cumsum(rng.normal(size=len(time_s))) * 0.02
    wander = walk - np.linspace(0.0, walk[-1], len(time_s))
    value = (
        goal * (1.0 + (start - 1.0) * np.exp(-since / 0.4))
        + std * np.clip(wander, -1.2, 1.2)
        + 0.3 * std
    )
    verdict = ['unexcited' if t < 0.4 else 'converging' if t < 6.0 else 'identified' for t in since]
    return ParameterHistory(name, UNITS.get(name, ''), time_s, value, std, verdict, truth)


def synthetic_motor(
    name: str = 'motor', samples: int = 1_500, duration_s: float = 60.0, seed: int = 4
) -> MotorHistory:
    """One motor with all that a report can show; the resistance steps in mid-run."""
    rng = np.random.default_rng(seed)
    time_s = np.linspace(0.0, duration_s, samples)
    voltage = held_voltage(time_s, rng)
    torque = torque_of(time_s, voltage)
    predicted = torque * (1.0 + 0.01 * rng.normal(size=samples)) + 0.02 * np.exp(-time_s / 2.0)
    predicted[: samples // 50] = np.nan
    white_box = torque * (1.0 + 0.4 * np.exp(-time_s / 3.0)) + 2e-4 * rng.normal(size=samples)
    step = (np.array([0.0, duration_s / 2.0]), np.array([1.0, 1.08]))
    return MotorHistory(
        name=name,
        time_s=time_s,
        voltage_v=voltage,
        torque_nm=torque + 2e-4 * rng.normal(size=samples),
        predicted_torque_nm=predicted,
        white_box_torque_nm=white_box,
        parameters=(
            parameter('inductance', time_s, rng, TRUTH['inductance']),
            parameter('resistance', time_s, rng, step),
            parameter('hysteresis', time_s, rng, None, start=0.3),
        ),
        rejection_counts={'non_finite': 3, 'out_of_order': 14, 'outlier': 41, 'duplicate': 0},
        rejected_time_s={
            'non_finite': np.array([3.0, 3.1, 40.0]),
            'out_of_order': np.sort(rng.uniform(0.0, duration_s, 14)),
            'outlier': np.sort(rng.uniform(0.3, 0.5, 41)) * duration_s,
        },
        scores={'nmae': 0.0046, 'skill_vs_persistence': 0.83, 'skill_vs_white_box': -0.021},
        notes=(
            'Torque constant and back-EMF constant are taken as known; an error goes into '
            'resistance.',
        ),
        sensitivity={
            'torque_constant': {'inductance': 1.0, 'resistance': 1.0, 'hysteresis': 2.0},
            'back_emf_constant': {'inductance': 0.0, 'resistance': -0.01, 'hysteresis': 0.0},
        },
    )


def synthetic_run(*motors: MotorHistory) -> RunHistory:
    """A run over the motors given, one by default."""
    return RunHistory(
        title='Thesis motor, R[5,15]D[1,6]',
        source=('bags/thesis_motor',),
        creation_time='2025-01-02T03:04:05+00:00',
        motors=motors or (synthetic_motor(),),
        summary={'samples': 1500, 'duration_s': 60.0, 'sample_rate_hz': 25.0, 'note': 'synthetic'},
        command='ros2 run gray_box_observer identify bags/thesis_motor --report report.html',
        digest='9f' * 32,
    )


@pytest.fixture(name='make_motor')
def _make_motor() -> Callable[..., MotorHistory]:
    return synthetic_motor


@pytest.fixture(name='make_run')
def _make_run() -> Callable[..., RunHistory]:
    return synthetic_run


@pytest.fixture(scope='session')
def whole_run() -> RunHistory:
    """One motor with all that a report can show."""
    return synthetic_run()
