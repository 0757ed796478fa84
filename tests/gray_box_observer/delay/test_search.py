from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.delay.coarse import Profile, credible, profile
from gray_box_observer.delay.fine import FineSearch, Fitted, evidence
from gray_box_observer.samples.raw_history import RawHistory, RawSignals
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.flow import to_coordinates

STEP_S = 0.01
REACH_S = (-0.1, 0.4)
INITIAL = to_coordinates(np.array([[1.5, 3.0, 1.0]]))


def signals_of(recording: Recording, delay_s: float) -> RawSignals:
    """A recording with voltage stamped too early, cut to where every delay is known."""
    history = RawHistory()
    shift_ns = round(delay_s * 1e9)
    for k, stamp_ns in enumerate(recording.stamp_ns.tolist()):
        history.voltage(stamp_ns - shift_ns, float(recording.voltage_v[0, k]))
        history.torque(stamp_ns, float(recording.torque_nm[0, k]))
    signals = history.signals(int(recording.stamp_ns[-1]), 0)
    assert signals is not None
    keep = (signals.time_s >= signals.voltage_time_s[0] + REACH_S[1]) & (
        signals.time_s <= REACH_S[0]
    )
    return replace(
        signals,
        time_s=signals.time_s[keep],
        torque_nm=signals.torque_nm[keep],
        speed_rad_s=signals.speed_rad_s[keep],
    )


def coarse(box: MotorWhiteBox, signals: RawSignals, gap_s: float = 0.5) -> Profile:
    found = finished(profile(box, signals, np.diff(signals.time_s) > gap_s, STEP_S, REACH_S))
    assert found is not None
    return found


def finished(work: Generator[None, None, Any]) -> Any:
    """Do every piece of work; return what comes of it."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


def fine(box: MotorWhiteBox, signals: RawSignals, start_s: float, free: bool) -> Fitted:
    search = FineSearch(box, signals, np.diff(signals.time_s) > 0.5, STEP_S, INITIAL, REACH_S)
    return finished(search.fit(start_s, free=free))


@pytest.mark.parametrize('delay', [-0.05, 0.0, 0.03, 0.3])
def test_the_coarse_profile_is_that_of_least_squares_at_every_delay_one_by_one(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox, delay: float
) -> None:
    signals = signals_of(record('R[5,15]D[0.2,2]', 12.0, torque_noise_relative=0.02), delay)
    found = coarse(thesis_box, signals)
    window = 12
    state = thesis_box.state(signals.torque_nm)[None]
    for at in range(0, found.delay_s.size, 7):
        volt = np.diff(signals.voltage_integral(signals.time_s - found.delay_s[at]))[None] / STEP_S
        blank = np.full_like(state, np.nan)
        phi, drive = integrated_regressors(
            thesis_box, volt, state, blank, np.full_like(volt, STEP_S)
        )
        whole = np.concatenate([phi[0], drive[0][:, None]], axis=1)
        rows = np.cumsum(np.pad(whole, ((1, 0), (0, 0))), axis=0)
        rows = rows[window:] - rows[:-window]
        columns = np.stack([rows[:, -1], *(-rows[:, 1:-1]).T], axis=1)
        solution, *_ = np.linalg.lstsq(columns, rows[:, 0], rcond=None)
        if solution[0] < 0.0:  # no inductance is negative: then the voltage explains nothing
            solution = np.concatenate(
                [[0.0], np.linalg.lstsq(columns[:, 1:], rows[:, 0], rcond=None)[0]]
            )
        expected = np.sum((rows[:, 0] - columns @ solution) ** 2)
        assert found.misfit[at] == pytest.approx(expected, rel=1e-4)
    assert found.best() == pytest.approx(delay, abs=0.003)


def test_an_absurd_current_is_bounded_and_a_short_peak_is_not() -> None:
    current = np.concatenate([np.full(100, 0.01), np.linspace(1.0, 4.0, 8), [1e6]])
    np.testing.assert_array_equal(credible(current)[:-1], current[:-1])
    assert credible(current)[-1] < 100.0


@pytest.mark.parametrize('delay', [0.0, 0.0033, 0.0127, 0.05, 0.3, -0.02])
def test_without_noise_a_delay_is_found_to_a_thousandth_of_an_interval(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox, delay: float
) -> None:
    signals = signals_of(record('R[5,15]D[1,20]', 40.0), delay)
    found = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
    assert found.delay_s == pytest.approx(delay, abs=1e-3 * STEP_S)


@pytest.mark.slow
def test_the_standard_deviation_is_that_of_the_errors(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox
) -> None:
    errors = []
    for seed, delay in enumerate([0.0, 0.004, 0.01, 0.023, 0.05, 0.08, 0.12, 0.3]):
        recording = record('R[5,15]D[0.2,2]', 12.0, seed, torque_noise_relative=0.02)
        signals = signals_of(recording, delay)
        found = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
        assert 0.01 * STEP_S < found.std_s < 0.2 * STEP_S
        errors.append((found.delay_s - delay) / found.std_s)
    assert np.max(np.abs(errors)) < 3.5
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.7


@pytest.mark.parametrize('delay', [0.0, 0.002, 0.01, 0.05])
def test_evidence_grows_with_the_delay_and_is_that_of_chance_without_one(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox, delay: float
) -> None:
    signals = signals_of(record('R[5,15]D[0.2,2]', 20.0, torque_noise_relative=0.01), delay)
    best = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
    brought = evidence(best, fine(thesis_box, signals, 0.0, free=False))
    expected = (
        0.5 * (delay / best.std_s) ** 2
    )  # the log-likelihood of a Gaussian, where the delay is small
    if delay == 0.0:
        assert brought < 5.0
    elif delay <= 0.002:
        assert brought == pytest.approx(expected, rel=0.5)
    else:
        assert brought > 200.0


def test_gaps_and_outliers_do_not_move_the_delay(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox
) -> None:
    random = np.random.default_rng(3)
    whole = signals_of(record('R[5,15]D[0.2,2]', 40.0, torque_noise_relative=0.01), 0.07)
    kept = random.random(whole.time_s.size) < 0.95
    kept[500:600] = kept[1500:1570] = False
    torque = whole.torque_nm[kept]
    struck = random.random(torque.size) < 0.002
    torque = np.where(struck, torque + 0.2 * random.normal(size=torque.size), torque)
    torque[1000] = 1e6
    signals = replace(
        whole, time_s=whole.time_s[kept], torque_nm=torque, speed_rad_s=whole.speed_rad_s[kept]
    )
    found = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
    assert found.delay_s == pytest.approx(0.07, abs=4.0 * found.std_s)
    assert found.std_s < 0.1 * STEP_S


def test_a_search_changes_nothing_that_it_was_given(
    record: Callable[..., Recording], thesis_box: MotorWhiteBox
) -> None:
    signals = signals_of(record('R[5,15]D[0.2,2]', 12.0, torque_noise_relative=0.02), 0.03)
    copies: dict[str, Any] = {
        name: getattr(signals, name).copy() for name in RawSignals.__dataclass_fields__
    }
    first = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
    again = fine(thesis_box, signals, coarse(thesis_box, signals).best(), free=True)
    assert first == again
    for name, copy in copies.items():
        np.testing.assert_array_equal(getattr(signals, name), copy)


def test_a_motor_at_rest_brings_no_evidence_of_a_delay() -> None:
    nothing = Fitted(0.0, 0.0, 0.0, 0.0, 1.0)
    assert evidence(nothing, nothing) == 0.0
