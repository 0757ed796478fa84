"""A voltage that acts late, beside a measured speed: how it moves the fit, and how much is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rotor_motors import BOX, KT, THETA

from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit, fit_outputs
from gray_box_observer.context_nodes.measured_speed.speed_start import speed_start
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.history_unknowns import SpeedOutput, Unknowns
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.rotor_trajectory import run
from gray_box_observer.context_nodes.rotor.window import Window

SAMPLES = 1500
INTERVAL_S = 1e-2
NOISE = 0.01
"""Of current and speed, as shares of their spread."""


def _fit(late: float, noise_v: float = 0.0) -> OutputFit:
    """Fit both outputs of a motor whose voltage acts a part of an interval late.

    Args:
        late: in sample intervals.
        noise_v: with which the voltage is read.
    """
    rng = np.random.default_rng(3)
    voltage_v = np.repeat(rng.uniform(-12.0, 12.0, SAMPLES // 10), 10)[: SAMPLES - 1]
    before_v = np.concatenate([voltage_v[:1], voltage_v[:-1]])
    parts_v = np.column_stack([before_v, voltage_v]).ravel()
    parts_s = np.tile(
        [(late + 1e-9) * INTERVAL_S, (1.0 - late - 1e-9) * INTERVAL_S], voltage_v.size
    )
    limits = np.array([1e3, 1e6])
    path = run(KT, coordinates(BOX, THETA), np.zeros(2), parts_v, parts_s, limits)
    states = path.states[::2]
    states = states + NOISE * states.std(axis=0) * rng.normal(size=states.shape)
    content = np.zeros((4, SAMPLES))
    content[0, 1:] = INTERVAL_S
    content[1, 1:] = voltage_v + rng.normal(0.0, noise_v, voltage_v.size)
    content[2] = KT * states[:, 0]
    content[3] = states[:, 1]
    window = Window.from_samples(BOX, content, Unknowns(SpeedOutput(1.0)))
    mean = np.log(THETA)
    start = speed_start(BOX, window, THETA)
    assert start is not None
    fit = completed(fit_outputs(BOX, window, LogPrior(mean, np.eye(mean.size) / 25.0), [start]))
    assert fit is not None
    return fit


def test_of_a_punctual_voltage_both_outputs_tell_that_it_is() -> None:
    instant = LateInstant.from_fit(_fit(0.0))
    assert abs(instant.mean) < 4.0 * instant.std < 0.2


def test_noise_of_the_voltage_is_no_voltage_that_is_late() -> None:
    fit = _fit(0.0, noise_v=0.1)
    assert fit.shows_voltage_noise
    instant = LateInstant.from_fit(fit)
    assert abs(instant.mean) < 4.0 * instant.std < 0.5


def test_beside_such_noise_a_late_voltage_still_shows() -> None:
    instant = LateInstant.from_fit(_fit(0.4, noise_v=0.03))
    assert instant.supports(0.4)


@pytest.mark.parametrize('late', [0.1, 0.3])
def test_a_late_voltage_moves_r_as_the_shift_says_and_is_told(late: float) -> None:
    """L takes over what the winding shows, so of R no more than the rotor's share moves."""
    fit = _fit(late)
    instant = LateInstant.from_fit(fit)
    off = float(np.log(fit.fit.theta[1] / THETA[1]))
    assert off == pytest.approx(-late * instant.shift[1], rel=0.5)
    assert instant.mean > 5.0 * instant.std
    assert late / 3.0 < instant.mean < 1.5 * late


@pytest.mark.parametrize(
    ('mean', 'std', 'delay', 'is_supported'),
    [
        (0.5, 0.1, 0.4, True),
        (1.2, 0.1, 3.0, True),
        (-0.5, 0.1, -2.0, True),
        (0.5, 0.2, 0.5, False),
        (0.5, 0.1, -0.5, False),
        (0.0, math.inf, 1.0, False),
    ],
)
def test_a_delay_is_supported_where_the_readings_show_it(
    mean: float, std: float, delay: float, is_supported: bool
) -> None:
    assert LateInstant(np.zeros(2), mean, std).supports(delay) == is_supported
    assert not LateInstant(np.zeros(2), mean, std).supports(math.nan)
