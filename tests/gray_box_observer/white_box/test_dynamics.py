from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from dc_motor_sim.simulation import Recording
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors, rate

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
