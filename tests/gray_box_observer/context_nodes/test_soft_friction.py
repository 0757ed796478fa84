"""Softened friction: a motor that turns slowly has estimates that are a little off, and says so."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_motors import BOX, INITIAL, KT, THETA

from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.free_runs import free_runs
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.soft_friction import soft_friction_pull
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import search_from
from gray_box_observer.context_nodes.rotor.window_learner import WindowLearner
from gray_box_observer.white_box import MotorWhiteBox

INTERVAL_S = 1e-3
COUNT = 2000
NOISE_A = 2e-3
PARTS = 40
"""Steps of the plant in an interval."""


SLOW_KT = 0.5
SLOW = np.array([4e-3, 2.0, 6e-3, 1e-3, 0.3])
"""A motor behind a gear that turns by a few rad/s."""

SLOW_BOX = MotorWhiteBox(BOX.context_nodes, SLOW_KT, {'back_emf_constant': SLOW_KT})


SINE_V = 6.0 * np.sin(2.0 * np.pi * 2.0 * INTERVAL_S * np.arange(COUNT))


def sharp(
    theta: np.ndarray, constant: float, volts: np.ndarray = SINE_V, noise_a: float = NOISE_A
) -> np.ndarray:
    """Samples of a motor with sharp dry friction under a voltage, shape (signal, n)."""
    inductance, resistance, inertia, viscous, dry = theta
    step_s = INTERVAL_S / PARTS
    current = speed = 0.0
    currents = [0.0]
    for volt in volts[:-1].tolist():
        for _ in range(PARTS):
            current += step_s * (volt - resistance * current - constant * speed) / inductance
            free = speed + step_s * (constant * current - viscous * speed) / inertia
            speed = float(np.sign(free)) * max(abs(free) - step_s * dry / inertia, 0.0)
        currents.append(current)
    noise = np.random.default_rng(7).normal(0.0, noise_a, volts.size)
    samples = np.zeros((4, volts.size))
    samples[0, 1:] = INTERVAL_S
    samples[1, 1:] = volts[:-1]
    samples[2] = constant * (np.array(currents) + noise)
    return samples


def errors_and_shifts(box: MotorWhiteBox, theta: np.ndarray, kt: float) -> np.ndarray:
    """Return errors of a fit, their deviations without softness, and the shift by it, (3, p)."""
    window = Window.from_samples(box, sharp(theta, kt))
    prior = LogPrior(np.log(theta), np.eye(theta.size) / 25.0)
    fit = completed(search_from(box, window, prior, theta))
    assert fit is not None
    covariance = np.linalg.inv(fit.information + prior.precision)
    shift = covariance @ soft_friction_pull(fit.runs, fit.noise_a)
    return np.stack([fit.logarithms - np.log(theta), np.sqrt(np.diag(covariance)), shift])


def test_a_slow_motor_is_known_to_be_pulled_as_it_is() -> None:
    error, std, shift = errors_and_shifts(SLOW_BOX, SLOW, SLOW_KT)
    resistance = 1
    assert abs(error[resistance]) > 5.0 * std[resistance], 'it would be wrong and sure'
    assert error[resistance] * shift[resistance] > 0.0, 'the direction is right'
    assert (np.abs(error) < 3.0 * np.hypot(std, shift)).all()


def test_a_motor_that_turns_fast_is_hardly_pulled() -> None:
    _, std, shift = errors_and_shifts(BOX, THETA, KT)
    assert (np.abs(shift) < std).all()


def test_without_dry_friction_nothing_is_pulled() -> None:
    window = Window.from_samples(SLOW_BOX, sharp(SLOW, SLOW_KT))
    theta = np.append(SLOW[:-1], 1e-10)
    runs = free_runs(SLOW_BOX, theta, window, np.zeros((1, 2)))
    none = np.linalg.norm(soft_friction_pull(runs, NOISE_A))
    some = np.linalg.norm(
        soft_friction_pull(free_runs(SLOW_BOX, SLOW, window, np.zeros((1, 2))), NOISE_A)
    )
    assert none < 1e-6 * some


def test_the_learner_counts_it_in_its_deviations_and_remembers_it() -> None:
    learner = WindowLearner(SLOW_BOX, INITIAL, None, 30.0)
    learner.begin_at(SLOW)
    window = Window.from_samples(SLOW_BOX, sharp(SLOW, SLOW_KT))
    assert completed(learner.learn(window, is_full=True))
    shift = learner.arrays()['soft_shift']
    assert shift.any()
    assert (np.diag(learner.covariance) > shift**2)[:3].all(), 'of L, R and J'


RAMP_KT = 0.03
RAMPED = np.array([3e-3, 1.5, 1e-5, 3e-6, 1.5e-3])
RAMP_BOX = MotorWhiteBox(BOX.context_nodes, RAMP_KT, {'back_emf_constant': RAMP_KT})


@pytest.mark.slow
def test_a_slow_ramp_does_not_tell_the_inertia_from_dry_friction() -> None:
    """Window after window seemed to tell more of it: T_c was 9 % off, and sure."""
    volts = 0.72 * INTERVAL_S * np.arange(6 * 2048)
    samples = sharp(RAMPED, RAMP_KT, volts, 7.5e-4)
    learner = WindowLearner(RAMP_BOX, INITIAL, None, 30.0)
    for begin in range(0, volts.size, 2048):
        part = samples[:, begin : begin + 2048].copy()
        part[0, 0] = 0.0
        assert completed(learner.learn(Window.from_samples(RAMP_BOX, part), is_full=True))
        off = learner.logarithms - np.log(RAMPED)
        assert (np.abs(off) < 4.0 * np.sqrt(np.diag(learner.covariance)))[2:].all(), begin
