"""A measured speed that comes late: how late the mechanics say, and what is left open of R."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import INTERVAL_S, Floats, Record, steps
from scipy.linalg import expm

from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.late_speed import lag_of_speed, late_speed_doubts, likely_shift
from gray_box_observer.fit_test.least_squares import LEAST_SQUARES
from gray_box_observer.fit_test.projection import Projection
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


L_AND_R = MotorWhiteBox(NODES[:2], KT, {'back_emf_constant': KB}, speed_measured=True)


def _content(samples: int, lag: float, noise_rad_s: float = 0.0) -> Floats:
    """Samples as a replay buffer gives them, of a speed so many intervals late."""
    voltage_v, current_a, speed_rad_s = _motion(samples)
    noise = noise_rad_s * np.random.default_rng(3).normal(size=samples)
    interval_s = np.full(samples, INTERVAL_S)
    interval_s[0] = 0.0
    before_v = np.concatenate([voltage_v[:1], voltage_v[:-1]])
    signals = (interval_s, before_v, KT * current_a[::FINE], _late(speed_rad_s, lag) + noise)
    return np.stack(signals)[:, None]


def _shift_of_lag(samples: int, lag: float) -> Floats:
    """By how much a lag moves the logarithms: the step of a fit from the true values."""
    run = _run_freely(_content(samples, lag)[3, 0], *_inputs(samples), L_AND_R)
    projection = Projection(run.jacobian, run.residual_a, run.weight, run.jacobian.shape[1])
    return projection.shift(projection.residual)


def _inputs(samples: int) -> tuple[Floats, Floats]:
    voltage_v, current_a, _ = _motion(samples)
    return voltage_v, current_a[::FINE]


def test_of_few_samples_a_lag_of_one_interval_is_likely() -> None:
    shift = likely_shift(L_AND_R, THETA[None, :2], _content(20, 0.0))
    assert shift[1] == pytest.approx(_shift_of_lag(20, 1.0)[1], rel=0.3)


@pytest.mark.parametrize('lag', [0.5, 2.0])
def test_what_is_likely_of_a_late_speed_contains_what_its_lag_does(lag: float) -> None:
    content = _content(200, lag, noise_rad_s=0.3)
    shift = likely_shift(L_AND_R, THETA[None, :2], content)
    true = _shift_of_lag(200, lag)
    assert abs(true[1]) > 0.01
    assert 0.3 < abs(shift[1]) / abs(true[1]) < 2.0


def test_a_speed_that_is_seen_to_be_in_time_leaves_little_open() -> None:
    shift = likely_shift(L_AND_R, THETA[None, :2], _content(100, 0.0))
    assert abs(shift[1]) < 0.2 * abs(_shift_of_lag(100, 1.0)[1])


def test_a_shaft_that_stands_still_leaves_nothing_open() -> None:
    content = _content(100, 0.0)
    content[3] = 0.0
    assert not likely_shift(L_AND_R, THETA[None, :2], content).any()


@pytest.mark.parametrize('share', [0.1, 0.01, 0.001])
def test_what_an_inductance_near_zero_cannot_take_of_a_lag_the_resistance_takes(
    share: float,
) -> None:
    """A lag looks like a smaller L. Of one that is near zero nothing can be taken off."""
    resistance_share = 0.5 * INTERVAL_S * KB * KT / (INERTIA * THETA[1])
    content = _content(200, 0.5)
    shift = likely_shift(L_AND_R, THETA[None, :2] * [share, 1.0], content)
    assert 0.65 * resistance_share < abs(shift[1]) < 3.0 * resistance_share
