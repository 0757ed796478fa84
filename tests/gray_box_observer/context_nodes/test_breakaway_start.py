"""Slow voltages of a motor that friction holds first: where its fit begins, and where it ends."""

from __future__ import annotations

import numpy as np
import pytest
from rotor_motors import INITIAL, NODES, content_of
from rotor_records import driven

from dc_motor_sim.plant import PlantParameters
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.breakaway_start import begins_held, breakaway_starts
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.rest_search import ends_of_rest
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.context_nodes.rotor.window_search import Search, SearchEnd
from gray_box_observer.white_box import MotorWhiteBox

MOTOR = PlantParameters(
    inductance=3e-3, resistance=1.8, hysteresis=0.0, torque_constant=0.021,
    back_emf_constant=0.021, inertia=1.6e-5, viscous_friction=2e-5, coulomb_friction=7.6e-3,
)  # fmt: skip
BOX = MotorWhiteBox(NODES, 0.021, {'back_emf_constant': 0.021})
TRUTH = np.array([getattr(MOTOR, name) for name in NODES])
VAGUE = LogPrior(np.log(INITIAL[0]), np.eye(TRUTH.size) / 25.0)
NOISE_NM = 5e-5

TIME_S = 1e-3 * np.arange(500)
SLOW_SINE = 8.0 * np.sin(2.0 * np.pi * 0.3 * TIME_S)
STEP_THEN_RAMP = 10.0 - 4.0 * TIME_S
STEPS = np.repeat([6.0, -3.0, 9.0, -8.0, 2.0], 100)


def samples_under(voltage_v: np.ndarray) -> np.ndarray:
    return content_of(driven(MOTOR, voltage_v, noise_nm=NOISE_NM))


def fitted(window: Window, start: np.ndarray = INITIAL[0]) -> Fit:
    starts = [start, *weak_starts(BOX, window)]
    fit = completed(fit_window(BOX, window, VAGUE, starts))
    assert fit is not None
    return fit


@pytest.mark.parametrize('count', [100, 250, 500])
def test_a_rotor_that_is_held_first_tells_resistance_and_dry_friction(count: int) -> None:
    window = Window.from_samples(BOX, samples_under(SLOW_SINE)[:, :count])
    weak = [*weak_starts(BOX, window)]
    starts = np.array([*breakaway_starts(BOX, window, weak)])
    assert len(starts) == len(weak)
    np.testing.assert_allclose(starts[:, 1], MOTOR.resistance, rtol=0.05)
    np.testing.assert_allclose(starts[:, 4], MOTOR.coulomb_friction, rtol=0.6)
    kept = [[theta[0] / theta[1], theta[1] * theta[2]] for theta in starts]
    np.testing.assert_allclose(kept, [[t[0] / t[1], t[1] * t[2]] for t in weak], rtol=0.02)


@pytest.mark.parametrize(
    'samples',
    [
        pytest.param(samples_under(STEPS), id='steps'),
        pytest.param(samples_under(SLOW_SINE)[:, 250:], id='a rotor that turns'),
        pytest.param(samples_under(0.0 * TIME_S), id='no voltage'),
        pytest.param(samples_under(SLOW_SINE)[:, :12], id='too few'),
    ],
)
def test_nothing_else_is_taken_for_a_hold(samples: np.ndarray) -> None:
    window = Window.from_samples(BOX, samples)
    assert not [*breakaway_starts(BOX, window, [TRUTH])]
    assert not begins_held(BOX, window)


def test_a_white_box_without_dry_friction_has_no_such_start() -> None:
    box = MotorWhiteBox(NODES[:-1], 0.021, {'back_emf_constant': 0.021})
    window = Window.from_samples(box, samples_under(SLOW_SINE))
    assert not [*breakaway_starts(box, window, [TRUTH[:-1]])]


@pytest.mark.parametrize('count', [250, 500])
def test_a_fit_ends_at_the_motor_before_a_slow_voltage_has_turned(count: int) -> None:
    """From the weak form alone it ended at 1.15 ohm, surely, with a rotor that turned backwards."""
    window = Window.from_samples(BOX, samples_under(SLOW_SINE)[:, :count])
    assert begins_held(BOX, window)
    fit = fitted(window)
    assert fit.theta[1] == pytest.approx(MOTOR.resistance, rel=0.02)
    assert fit.theta[2] == pytest.approx(MOTOR.inertia, rel=0.05)


AWAY = pytest.mark.parametrize('share', [0.6, 1.6])
"""Times R, L and 1/J: then (1 - share) V / Kb for the first speed explains the same ramp."""


@AWAY
def test_a_rotor_without_current_and_voltage_at_first_is_at_rest(share: float) -> None:
    voltage_v = np.where(TIME_S < 0.005, 0.0, STEP_THEN_RAMP)
    window = Window.from_samples(BOX, samples_under(voltage_v))
    fit = fitted(window, TRUTH * np.array([share, share, 1.0 / share, 1.0, 1.0]))
    assert fit.starts[0, 1] == pytest.approx(0.0, abs=1.5)
    assert fit.theta[1] == pytest.approx(MOTOR.resistance, rel=0.01)
    assert 1e-4 < np.sqrt(fit.covariance(VAGUE)[1, 1]) < 2e-3
    assert not fit.spread.any()


@AWAY
def test_a_step_may_meet_a_rotor_that_turns_and_has_no_current(share: float) -> None:
    """A record may begin where the current of a turning rotor passes zero."""
    window = Window.from_samples(BOX, samples_under(STEP_THEN_RAMP))
    fit = fitted(window, TRUTH * np.array([share, share, 1.0 / share, 1.0, 1.0]))
    off = fit.theta[1] / MOTOR.resistance - 1.0
    assert abs(off) < 3.0 * np.sqrt((fit.covariance(VAGUE) + fit.spread)[1, 1])


def test_a_rotor_that_turns_at_first_without_a_current_is_believed() -> None:
    """It coasts where its driver is switched on: its steps tell the speed."""
    samples = samples_under(np.concatenate([np.full(300, 8.0), STEPS]))[:, 300:]
    samples[0, 0] = 0.0
    samples[2, 0] = 0.0
    fit = fitted(Window.from_samples(BOX, samples))
    assert fit.starts[0, 1] > 100.0
    assert fit.theta[1] == pytest.approx(MOTOR.resistance, rel=0.03)


def test_of_two_histories_one_rests_and_the_other_turns_on() -> None:
    samples = samples_under(np.concatenate([SLOW_SINE, STEPS]))
    samples[0, 700] = 0.0
    window = Window.from_samples(BOX, samples)
    fit = fitted(window)
    assert [abs(speed) < 2.0 for speed in fit.starts[:, 1]] == [True, False]
    assert fit.theta[1] == pytest.approx(MOTOR.resistance, rel=0.02)


def test_a_ramp_that_begins_at_a_turning_rotor_leaves_r_open_or_right() -> None:
    """Of a record that begins where its current passes zero R was 35 % off, and sure."""
    voltage_v = np.interp(TIME_S, [0.0, 0.1, 0.2, 0.5], [9.0, 9.0, 5.0, 9.0])
    samples = samples_under(voltage_v)
    turning = np.abs(samples[2, 50:300]) + 1.0 * (np.arange(250) < 50)
    begin = 50 + int(np.argmin(turning))
    part = samples[:, begin:].copy()
    part[0, 0] = 0.0
    fit = fitted(Window.from_samples(BOX, part))
    off = fit.theta[1] / MOTOR.resistance - 1.0
    assert abs(off) < max(0.02, 3.0 * np.sqrt((fit.covariance(VAGUE) + fit.spread)[1, 1]))


def test_behind_a_driver_that_coasts_no_rotor_is_taken_to_rest() -> None:
    """Many histories begin without a current there, and the rotor turns on."""
    samples = samples_under(np.concatenate([np.full(300, 8.0), STEPS, np.full(300, 6.0)]))
    part = np.concatenate([samples[:, 300:700], samples[:, 800:]], axis=1)
    part[0, [0, 400]] = 0.0
    part[2, [0, 400]] = 0.0
    window = Window.from_samples(BOX, part)
    fit = fitted(window)
    assert (np.abs(fit.starts[:, 1]) > 20.0).all()
    search = Search(BOX, window, VAGUE, fit.logarithms)
    search.starts = fit.starts
    assert completed(ends_of_rest(SearchEnd(fit, search, fit.logarithms), [])) == []
