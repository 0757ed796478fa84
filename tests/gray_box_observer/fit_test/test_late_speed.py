"""A measured speed that comes late: how late the mechanics say, and what is left open of R."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import INTERVAL_S, Floats, Record, steps
from scipy.linalg import expm

from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.late_speed import lag_of_speed, late_speed_doubts
from gray_box_observer.fit_test.least_squares import LEAST_SQUARES
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 4000
KT = KB = 0.02
INERTIA = 4e-6  # a mechanical time constant of 20 ms
NODES = ('inductance', 'resistance', 'back_emf_constant')
THETA = np.array([4e-3, 2.0, KB])
WHITE_BOX = MotorWhiteBox(NODES, KT, speed_measured=True)
RESISTANCE = NODES.index('resistance')
FINE = 20


def _motion(samples: int = SAMPLES) -> tuple[Floats, Floats, Floats]:
    """Voltage, current and speed of a free rotor, exact at every twentieth of an interval."""
    rates = np.zeros((3, 3))
    rates[0] = -THETA[1] / THETA[0], -KB / THETA[0], 1.0 / THETA[0]
    rates[1, 0] = KT / INERTIA
    step = expm(rates * INTERVAL_S / FINE)
    voltage_v = steps(samples, 3)
    states = np.zeros((samples * FINE, 2))
    for place, volt in enumerate(np.repeat(voltage_v, FINE)[:-1]):
        states[place + 1] = step[:2, :2] @ states[place] + step[:2, 2] * volt
    return voltage_v, states[:, 0], states[:, 1]


def _late(speed_rad_s: Floats, lag: float) -> Floats:
    """A speed so many sample intervals late, at the samples."""
    return np.asarray(np.roll(speed_rad_s, round(lag * FINE))[::FINE])


def _differences(speed_rad_s: Floats) -> Floats:
    """Differences of the angle over the interval that has passed, at the samples."""
    means = speed_rad_s.reshape(-1, FINE)
    trapezoids = means.sum(axis=1) + 0.5 * (np.append(means[1:, 0], means[-1, -1]) - means[:, 0])
    return np.concatenate([[0.0], trapezoids[:-1] / FINE])


def _run_freely(
    speed_rad_s: Floats, voltage_v: Floats, current_a: Floats, white_box: MotorWhiteBox = WHITE_BOX
) -> FreeRun:
    stretch = Record(voltage_v, current_a).stretch
    stretch.speed_rad_s[0] = speed_rad_s
    theta = THETA[: len(white_box.context_nodes)]
    return free_run(white_box, to_coordinates(theta[None]), stretch)


@pytest.mark.parametrize('lag', [0.0, 0.25, 0.5, 1.0])
def test_the_mechanics_tell_how_late_a_speed_is(lag: float) -> None:
    voltage_v, current_a, speed_rad_s = _motion()
    free = _run_freely(_late(speed_rad_s, lag), voltage_v, current_a[::FINE])
    assert lag_of_speed(free).mean == pytest.approx(lag, rel=0.07, abs=0.05)
    assert lag_of_speed(free).std < 0.02


def test_a_difference_of_angles_is_half_an_interval_late() -> None:
    voltage_v, current_a, speed_rad_s = _motion()
    free = _run_freely(_differences(speed_rad_s), voltage_v, current_a[::FINE])
    assert lag_of_speed(free).mean == pytest.approx(0.5, abs=0.05)


def test_the_lag_is_as_uncertain_as_the_speed_is_noisy() -> None:
    voltage_v, current_a, speed_rad_s = _motion()
    amounts = []
    for seed in range(20):
        noise = 0.01 * np.std(speed_rad_s) * np.random.default_rng(seed).normal(size=SAMPLES)
        noisy = _late(speed_rad_s, 0.5) + noise
        amounts.append(lag_of_speed(_run_freely(noisy, voltage_v, current_a[::FINE])))
    spread = np.std([amount.mean for amount in amounts])
    assert 0.6 < np.mean([amount.std for amount in amounts]) / spread < 1.6


def _open_std(speed_rad_s: Floats, voltage_v: Floats, current_a: Floats) -> float:
    """Standard deviation of log R that is left open, of a noisy current, at its least squares."""
    noise_a = 0.01 * np.std(current_a) * np.random.default_rng(1).normal(size=SAMPLES)
    stretch = Record(voltage_v, current_a + noise_a).stretch
    stretch.speed_rad_s[0] = speed_rad_s
    evidence = analyse(WHITE_BOX, to_coordinates(THETA[None]), stretch).evidence
    least_squares = np.exp([evidence.amount(f'{LEAST_SQUARES}{name}').mean for name in NODES])
    shifts = analyse(WHITE_BOX, to_coordinates(least_squares[None]), stretch).open_shifts
    return float(np.sqrt((shifts[:, RESISTANCE] ** 2).sum()))


def test_a_late_speed_opens_the_resistance_by_what_it_takes_it_for() -> None:
    voltage_v, current_a, speed_rad_s = _motion()
    resistance_share = (
        0.5 * INTERVAL_S * KB * KT / (INERTIA * THETA[1])
    )  # the rotor has no friction
    late = _open_std(_differences(speed_rad_s), voltage_v, current_a[::FINE])
    assert late == pytest.approx(resistance_share, rel=0.25)
    assert _open_std(_late(speed_rad_s, 0.0), voltage_v, current_a[::FINE]) < 0.1 * resistance_share


def test_a_known_back_emf_constant_leaves_no_such_doubt() -> None:
    voltage_v, current_a, speed_rad_s = _motion()
    white_box = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, speed_measured=True)
    free = _run_freely(_differences(speed_rad_s), voltage_v, current_a[::FINE], white_box)
    assert late_speed_doubts(white_box, free, THETA[:2]) == []


@pytest.mark.parametrize('speed_rad_s', [0.0, 50.0])
def test_a_speed_that_does_not_move_tells_no_lag(speed_rad_s: float) -> None:
    voltage_v, current_a, _ = _motion(400)
    free = _run_freely(np.full(400, speed_rad_s), voltage_v, current_a[::FINE])
    assert late_speed_doubts(WHITE_BOX, free, THETA) == []
