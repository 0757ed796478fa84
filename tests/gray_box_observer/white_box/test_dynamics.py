from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from dc_motor_sim.simulation import Recording
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import (
    MAX_SUBSTEPS,
    advance,
    decay_rate,
    integrated_regressors,
    rate,
    substeps_for,
)

TRUTH = np.array([[0.5, 1.0, 10.0]])
ALL = ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'brush_drop')
THETA_ALL = np.array([[0.5, 1.0, 10.0, 0.4, 0.3]])


def one(*values: float) -> list[np.ndarray]:
    return [np.array([v]) for v in values]


def test_the_rate_is_the_voltage_balance_of_the_thesis(thesis_box: MotorWhiteBox) -> None:
    for voltage, current in ((12.0, 3.0), (-12.0, 3.0), (5.0, -4.0)):
        expected = (voltage - (1.0 + 1e-4) * current - 10.0 * 0.01 * abs(current) * current) / 0.5
        assert rate(thesis_box, TRUTH, *one(voltage, current, np.nan))[0] == pytest.approx(expected, rel=1e-14)


def test_without_hysteresis_the_current_rises_like_that_of_an_rl_circuit() -> None:
    box = MotorWhiteBox(('inductance', 'resistance'), 0.01)
    state, elapsed = np.zeros(1), 0.0
    for interval in (0.001, 0.3, 0.02, 0.7, 0.1):
        state = advance(box, TRUTH[:, :2], state, *one(12.0, np.nan, np.nan, interval))
        elapsed += interval
        assert state[0] == pytest.approx(12.0 * (1.0 - np.exp(-elapsed / 0.5)), rel=3e-4)


def test_the_white_box_agrees_with_the_closed_form_of_the_thesis_motor(thesis_box: MotorWhiteBox) -> None:
    r, k, voltage = 1.0 + 1e-4, 0.1, 10.0  # L di/dt = V - r i - k i^2 from rest: i = 2 V tanh(x) / (s + r tanh(x))
    s = np.sqrt(r * r + 4.0 * k * voltage)
    state = np.zeros(1)
    for step in range(1, 101):
        state = advance(thesis_box, TRUTH, state, *one(voltage, np.nan, np.nan, 0.01))
        x = np.tanh(s * 0.01 * step / (2.0 * 0.5))
        assert state[0] == pytest.approx(2.0 * voltage * x / (s + r * x), rel=1e-8)


def test_advancing_is_of_fourth_order(thesis_box: MotorWhiteBox) -> None:
    def error(intervals: int) -> float:
        state, exact = np.full(1, 2.0), np.full(1, 2.0)
        for _ in range(intervals):
            state = advance(thesis_box, TRUTH, state, *one(12.0, np.nan, np.nan, 0.32 / intervals))
        for _ in range(1024):
            exact = advance(thesis_box, TRUTH, exact, *one(12.0, np.nan, np.nan, 0.32 / 1024))
        return abs(float(state[0] - exact[0]))

    assert error(8) / error(16) == pytest.approx(16.0, rel=0.15)
    assert error(16) / error(32) == pytest.approx(16.0, rel=0.15)


def test_a_long_held_voltage_leads_to_the_root_of_the_quadratic(thesis_box: MotorWhiteBox) -> None:
    r, k, voltage = 1.0 + 1e-4, 0.1, 12.0
    state = np.zeros(1)
    for _ in range(20):
        state = advance(thesis_box, TRUTH, state, *one(voltage, np.nan, np.nan, 0.5))
    root = (np.sqrt(r * r + 4.0 * k * voltage) - r) / (2.0 * k)
    assert state[0] == pytest.approx(root, rel=1e-6)
    assert rate(thesis_box, TRUTH, *one(voltage, root, np.nan))[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ('names', 'known', 'measured'),
    [
        (ALL, {}, True),
        (ALL[:3], {'back_emf_constant': 0.4, 'brush_drop': 0.3}, True),
        (ALL[:3], {'back_emf_constant': 0.4, 'brush_drop': 0.3}, False),
        (('inductance', 'hysteresis'), {'resistance': 1.0}, False),
    ],
)
def test_the_decay_rate_is_the_slope_of_the_rate(
    names: tuple[str, ...], known: dict[str, float], measured: bool
) -> None:
    box = MotorWhiteBox(names, 0.3, known, measured)
    theta = THETA_ALL[:, [ALL.index(name) for name in names]]
    h = 1e-6
    for current in (-3.0, -0.1, 0.05, 8.0):
        up, down = (rate(box, theta, *one(5.0, current + d, 2.5)) for d in (h, -h))
        assert decay_rate(box, theta, *one(current, 2.5))[0] == pytest.approx(-(up - down)[0] / (2 * h), rel=1e-6)


def test_a_fast_motor_gets_more_substeps_and_never_endlessly_many() -> None:
    interval_s = np.array([0.01])
    assert substeps_for(2.0, interval_s) == 1
    assert substeps_for(200.0, interval_s) == 4
    assert substeps_for(1e5, interval_s) == MAX_SUBSTEPS
    assert substeps_for(np.inf, interval_s) == MAX_SUBSTEPS


def test_advancing_moves_every_motor_as_it_would_alone() -> None:
    both = MotorWhiteBox(
        ('inductance', 'resistance'), np.array([0.1, 0.5]), {'back_emf_constant': np.array([0.1, 0.2])}
    )
    theta, state = np.array([[0.5, 1.0], [0.3, 2.0]]), np.array([1.0, 4.0])
    blank = np.full(2, np.nan)
    together = advance(both, theta, state, np.array([5.0, 9.0]), blank, blank, np.array([0.01, 0.02]))
    for m in range(2):
        chosen = slice(m, m + 1)
        alone = advance(
            both.of_motors(chosen), theta[chosen], state[chosen], *one([5.0, 9.0][m], np.nan, np.nan, 0.01 * (m + 1))
        )
        assert alone[0] == pytest.approx(together[m], rel=1e-13)


@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
def test_the_integrated_equation_balances_on_the_true_trajectory(record: Callable[..., Recording], mode: str) -> None:
    recording = record('R[5,15]D[0.5,2]', 10.0, speed_mode=mode, sample_rate_hz=1000.0)
    box = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}, mode == 'rotor')
    intervals = np.diff(recording.stamp_ns)[None, :] / 1e9
    current = box.state(recording.torque_nm)
    phi, target = integrated_regressors(box, recording.voltage_v[:, :-1], current, recording.speed_rad_s, intervals)
    assert phi.shape == (1, 9999, 3)
    balance = np.abs(target - phi @ TRUTH[0])
    assert balance.max() < 1e-5 * np.abs(target).max()  # the trapezoidal rule at a tenth of the rotor's time constant
    assert np.linalg.lstsq(phi[0], target[0], rcond=None)[0] == pytest.approx(TRUTH[0], rel=1e-4)


def test_the_rate_is_the_same_for_tensors(thesis_box: MotorWhiteBox) -> None:
    twin = MotorWhiteBox.from_dict(thesis_box.to_dict(), lambda v: torch.as_tensor(v, dtype=torch.float64))
    voltage, current = np.linspace(-5.0, 9.0, 12).reshape(2, 6), np.linspace(-3.0, 2.0, 12).reshape(2, 6)
    theta = np.array([[0.5, 1.0, 10.0], [0.3, 2.0, 4.0]])[:, None, :]
    expected = rate(thesis_box, theta, voltage, current, current)
    got = rate(twin, *(torch.as_tensor(x) for x in (theta, voltage, current, current)))
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-13)
