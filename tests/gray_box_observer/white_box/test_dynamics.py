from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from dc_motor_sim.simulation import Recording
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import decaying_regressors, integrated_regressors, rate

TRUTH = np.array([[0.5, 1.0, 10.0]])


def one(*values: float) -> list[np.ndarray]:
    return [np.array([v]) for v in values]


def test_the_rate_is_the_voltage_balance_of_the_thesis(thesis_box: MotorWhiteBox) -> None:
    for voltage, current in ((12.0, 3.0), (-12.0, 3.0), (5.0, -4.0)):
        expected = (voltage - (1.0 + 1e-4) * current - 10.0 * 0.01 * abs(current) * current) / 0.5
        assert rate(thesis_box, TRUTH, *one(voltage, current, np.nan))[0] == pytest.approx(
            expected, rel=1e-14
        )


@pytest.mark.slow
@pytest.mark.parametrize('mode', ['thesis', 'rotor'])
def test_the_integrated_equation_balances_on_the_true_trajectory(
    record: Callable[..., Recording], mode: str
) -> None:
    recording = record('R[5,15]D[0.5,2]', 10.0, speed_mode=mode, sample_rate_hz=1000.0)
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'),
        0.01,
        {'back_emf_constant': 0.01},
        mode == 'rotor',
    )
    intervals = np.diff(recording.stamp_ns)[None, :] / 1e9
    current = box.state(recording.torque_nm)
    phi, target = integrated_regressors(
        box, recording.voltage_v[:, :-1], current, recording.speed_rad_s, intervals
    )
    assert phi.shape == (1, 9999, 3)
    balance = np.abs(target - phi @ TRUTH[0])
    assert (
        balance.max() < 1e-5 * np.abs(target).max()
    )  # the trapezoidal rule at a tenth of the rotor's time constant
    assert np.linalg.lstsq(phi[0], target[0], rcond=None)[0] == pytest.approx(TRUTH[0], rel=1e-4)


@pytest.mark.parametrize('intervals', [0.4, 1.0, 5.0])
def test_a_current_that_decays_fast_balances_beside_a_speed_that_ramps(intervals: float) -> None:
    """The trapezoidal rule is off by some per cent there, as if the voltage acted late."""
    rng = np.random.default_rng(1)
    box = MotorWhiteBox(('inductance', 'resistance'), 0.02, {'back_emf_constant': 0.02}, True)
    length_s = 1e-3
    resistance = 2.0
    theta = np.array([resistance * intervals * length_s, resistance])
    voltage_v = rng.normal(scale=6.0, size=(1, 60))
    speed_rad_s = np.cumsum(rng.normal(scale=20.0, size=(1, 61)), axis=1)
    current_a = np.zeros((1, 61))
    fine = 4000
    for k in range(60):
        current = current_a[0, k]
        for j in range(fine):
            share = (j + 0.5) / fine
            speed = (1.0 - share) * speed_rad_s[0, k] + share * speed_rad_s[0, k + 1]
            middle = current + 0.5 * length_s / fine * _slope(
                voltage_v[0, k], current, speed, theta
            )
            current += length_s / fine * _slope(voltage_v[0, k], middle, speed, theta)
        current_a[0, k + 1] = current
    signals = voltage_v, current_a, speed_rad_s, np.full((1, 60), length_s)
    phi, target = decaying_regressors(box, *signals, intervals)
    assert np.abs(target - phi @ theta).max() < 1e-5 * np.abs(target).max()
    phi, target = integrated_regressors(box, *signals)
    assert np.abs(target - phi @ theta).max() > 1e-3 * np.abs(target).max()


def _slope(voltage_v: float, current_a: float, speed_rad_s: float, theta: np.ndarray) -> float:
    return float((voltage_v - theta[1] * current_a - 0.02 * speed_rad_s) / theta[0])


def test_the_rate_is_the_same_for_tensors(thesis_box: MotorWhiteBox) -> None:
    twin = MotorWhiteBox.from_dict(
        thesis_box.to_dict(), lambda v: torch.as_tensor(v, dtype=torch.float64)
    )
    voltage = np.linspace(-5.0, 9.0, 12).reshape(2, 6)
    current = np.linspace(-3.0, 2.0, 12).reshape(2, 6)
    theta = np.array([[0.5, 1.0, 10.0], [0.3, 2.0, 4.0]])[:, None, :]
    expected = rate(thesis_box, theta, voltage, current, current)
    got = rate(twin, *(torch.as_tensor(x) for x in (theta, voltage, current, current)))
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-13)
