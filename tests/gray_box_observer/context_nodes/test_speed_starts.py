"""Where the fit of a noisy speed begins: noise and counts of an encoder hide no rotor."""

from __future__ import annotations

import numpy as np
import pytest
from measured_speed_readings import START, TRUTH, fitted, noisy, window_of
from rotor_motors import BOX, THETA, content_of, recorded
from rotor_records import STICKY_MOTOR, counted_speed, driven

from gray_box_observer.context_nodes import MeasuredSpeedUpdate, RecursiveSettings, VerdictSettings
from gray_box_observer.context_nodes.measured_speed import output_update
from gray_box_observer.context_nodes.measured_speed.speed_start import (
    noisy_speed_start,
    speed_start,
)
from gray_box_observer.context_nodes.rotor.history_unknowns import SpeedOutput, Unknowns
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.white_box import MotorWhiteBox


@pytest.mark.slow
def test_noise_of_a_speed_is_estimated_and_its_start_is_near() -> None:
    recording = recorded()
    speed = recording.speed_rad_s[0]
    window = window_of(content_of(recording), noisy(speed))
    start = speed_start(BOX, window, THETA)
    assert start is not None
    np.testing.assert_allclose(start[:2], TRUTH, rtol=0.05)
    fit = fitted(window)
    assert fit.explains
    assert fit.noise.speed_rad_s == pytest.approx(0.02 * np.std(speed), rel=0.1)
    lag_s, std_s = fit.lag()
    assert abs(lag_s) < 4.0 * std_s < 1e-3


STICKY_NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
STICKY_KB = {'back_emf_constant': STICKY_MOTOR.back_emf_constant}
STICKY_BOX = MotorWhiteBox(STICKY_NODES, STICKY_MOTOR.torque_constant, STICKY_KB)


def sticky_content(samples: int, counts: int, rate_hz: float = 0.4) -> np.ndarray:
    """Samples of a shaft that begins to turn under 8 V of a slow sine, counted by an encoder."""
    voltage_v = 8.0 * np.sin(2.0 * np.pi * rate_hz * 1e-3 * np.arange(samples))
    recording = driven(STICKY_MOTOR, voltage_v, seed=8, noise_nm=1.3e-5)
    content = content_of(recording)
    content[3] = counted_speed(recording.speed_rad_s[0], counts)
    return content[:, None]


@pytest.mark.parametrize(
    ('samples', 'counts', 'rate_hz'),
    [
        (160, 64, 0.4),
        (160, 500, 0.4),
        (250, 64, 0.4),
        (250, 500, 0.4),
        (160, 64, 0.15),  # friction is seen by the torque before the first count alone
        (170, 64, 0.14),  # and inertia over more samples than 24 alone
    ],
)
def test_a_shaft_that_begins_to_turn_is_found_by_the_counts_of_its_encoder(
    samples: int, counts: int, rate_hz: float
) -> None:
    """Another end has a rotor that turns too early, its speed 20 intervals late, R 20 % smaller."""
    update = output_update.OutputUpdate(STICKY_BOX, np.array([[1.5, 3.0, 1e-4, 1e-4, 1e-3]]))
    update.begin_with(sticky_content(samples, counts, rate_hz), 1_000_000 * samples)
    update.begin_fit()
    update.complete()
    assert update.output_fit is not None
    found = STICKY_BOX.values(update.output_fit.fit.theta)
    assert found['resistance'] == pytest.approx(STICKY_MOTOR.resistance, rel=0.03)
    assert found['coulomb_friction'] == pytest.approx(STICKY_MOTOR.coulomb_friction, rel=0.1)


def test_a_start_of_a_noisy_speed_has_the_inertia_that_its_noise_would_hide() -> None:
    samples = sticky_content(250, 500)[:, 0]
    window = Window.from_samples(STICKY_BOX, samples, Unknowns(SpeedOutput(1.0)))
    other = np.ones(5)
    start = noisy_speed_start(STICKY_BOX, window, other, 3.6)
    plain = speed_start(STICKY_BOX, window, other)
    assert start is not None
    assert plain is not None
    assert start[2] == pytest.approx(STICKY_MOTOR.inertia, rel=0.3)
    assert start[4] == pytest.approx(STICKY_MOTOR.coulomb_friction, rel=0.3)
    assert plain[2] < 0.3 * STICKY_MOTOR.inertia


def test_two_levels_of_a_speed_are_asked_of_no_fit_before_a_thousand_samples() -> None:
    content = sticky_content(1400, 500)
    content[3] = np.where(content[3] > np.median(content[3]), 100.0, 0.0)
    fits = {}
    for levels in (2, 3):
        content[3, 0, 5] = 0.0 if levels == 2 else 50.0
        update = MeasuredSpeedUpdate(
            MotorWhiteBox(STICKY_NODES[:2], STICKY_MOTOR.torque_constant, STICKY_KB, True),
            START, 0, RecursiveSettings(), VerdictSettings(), np.zeros((1, 2)),
        )  # fmt: skip
        update._outputs.begin_with(content[:, :, :900], 0)
        few = update._is_worth_asking(update._outputs.unfitted)
        update._outputs.begin_with(content, 0)
        fits[levels] = (few, update._is_worth_asking(update._outputs.unfitted))
    assert fits == {2: (False, True), 3: (True, True)}
