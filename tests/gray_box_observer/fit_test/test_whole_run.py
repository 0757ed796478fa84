"""The free run over a whole record, its fit, and the correlation of what is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.fit_test import whole_run
from gray_box_observer.fit_test.whole_run import autocorrelation, fit_percent, white_box_torque
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

TRUTH = np.array([0.5, 1.0, 10.0])

BOX = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01})


def signals_of(recording: Recording) -> tuple[Array, Array, Array]:
    """Return interval, voltage and torque, (n,), of the first motor, as pairing makes them."""
    interval_s = np.diff(recording.stamp_ns, prepend=recording.stamp_ns[:1]) / 1e9
    voltage_v = np.concatenate([[0.0], recording.voltage_v[0, :-1]])
    return interval_s, voltage_v, recording.torque_nm[0]


def test_with_the_true_values_the_run_is_what_was_measured(
    record: Callable[..., Recording],
) -> None:
    interval_s, voltage_v, torque_nm = signals_of(record('R[-15,15]D[0.2,2]', 20.0))
    run_nm = white_box_torque(
        BOX, TRUTH, interval_s, voltage_v, torque_nm, np.zeros_like(torque_nm)
    )
    assert np.max(np.abs(run_nm - torque_nm)) < 1e-4 * np.max(np.abs(torque_nm))
    assert fit_percent(torque_nm, run_nm) == pytest.approx(100.0, abs=0.02)


def test_pieces_make_the_same_run_as_the_whole(
    record: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    interval_s, voltage_v, torque_nm = signals_of(record('R[-15,15]D[0.2,2]', 20.0))
    theta = 1.3 * TRUTH
    whole = white_box_torque(BOX, theta, interval_s, voltage_v, torque_nm, np.zeros_like(torque_nm))
    monkeypatch.setattr(whole_run, 'CHUNK', 300)
    pieces = white_box_torque(
        BOX, theta, interval_s, voltage_v, torque_nm, np.zeros_like(torque_nm)
    )
    np.testing.assert_allclose(pieces, whole, rtol=0.0, atol=1e-7 * np.max(np.abs(torque_nm)))


def test_a_new_history_sets_the_run_to_the_measurement_and_values_that_are_none_give_no_run(
    record: Callable[..., Recording],
) -> None:
    interval_s, voltage_v, torque_nm = signals_of(record('R[-15,15]D[0.2,2]', 20.0))
    interval_s[700] = 0.0
    run_nm = white_box_torque(
        BOX, 2.0 * TRUTH, interval_s, voltage_v, torque_nm, np.zeros_like(torque_nm)
    )
    assert run_nm[700] == pytest.approx(torque_nm[700], rel=1e-9)
    none = white_box_torque(
        BOX, np.full(3, np.nan), interval_s, voltage_v, torque_nm, np.zeros_like(torque_nm)
    )
    assert np.isnan(none).all()


def test_the_mean_fits_by_0_per_cent_and_what_does_not_vary_by_nothing() -> None:
    measured = np.array([1.0, 2.0, 4.0, np.nan])
    assert fit_percent(measured, np.full(4, 7.0 / 3.0)) == pytest.approx(0.0, abs=1e-12)
    assert fit_percent(measured, measured) == 100.0
    assert fit_percent(np.ones(5), np.ones(5)) is None
    constant = np.full(1001, 0.1)
    assert np.std(constant) > 0.0, 'by rounding alone'
    assert fit_percent(constant, np.zeros(1001)) is None


def test_of_white_noise_99_per_cent_of_the_correlations_stay_in_the_band() -> None:
    noise = np.random.default_rng(1).normal(size=4000)
    found = autocorrelation(noise)
    assert found is not None
    assert np.mean(np.abs(found[0]) > found[1]) < 0.05
    coloured = autocorrelation(np.cumsum(noise))
    assert coloured is not None
    assert np.all(coloured[0][:20] > 0.5)
    assert autocorrelation(np.zeros(1000)) is None
