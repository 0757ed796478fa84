"""The delay of a motor whose rotor turns unseen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, STEPS, recorded_in_steps

from dc_motor_sim.simulation import Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.delay import DelayVerdict, hidden_rotor_delay, watch
from gray_box_observer.delay.hidden_rotor_delay import HiddenRotorDelay, HiddenRotorSearch
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.raw_history import RawSignals
from gray_box_observer.settings.configuration import Configuration

INTERVAL_S = 1e-3
LATE = 7
"""Steps, of which a sample interval has five."""

DELAY_S = LATE * INTERVAL_S / STEPS


def _signals(late: int, begin: int = 200, end: int = 1224) -> RawSignals:
    """Return what a driver stamps that acts so many steps later."""
    record = recorded_in_steps(late)
    torque_nm = record.torque_nm[0, ::STEPS][begin:end]
    moves = np.arange(0, record.voltage_v.shape[1] - late, STEPS)
    time_s = INTERVAL_S * np.arange(begin, end)
    return RawSignals(
        time_s - time_s[-1],
        torque_nm,
        np.full(torque_nm.size, np.nan),
        moves / STEPS * INTERVAL_S - time_s[-1],
        record.voltage_v[0, moves + late],
    )


def _found(signals: RawSignals, applied_s: float = 0.0) -> HiddenRotorDelay | None:
    motor = Configuration.from_flat({**CONSTANTS, 'motor.speed_source': 'rotor'}).motors['motor']
    search = HiddenRotorSearch(
        motor.white_box(speed_measured=False),
        np.array(motor.initial()),
        signals,
        np.zeros(signals.time_s.size - 1, dtype=bool),
        INTERVAL_S,
        (-0.02, 0.06),
    )
    pieces = search.run(applied_s)
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            result: HiddenRotorDelay | None = end.value
            return result


@pytest.mark.slow
@pytest.mark.parametrize('late', [2, LATE, 40])
def test_a_delay_is_told_to_a_part_of_an_interval(late: int) -> None:
    result = _found(_signals(late))
    assert result is not None
    assert result.std_s < 0.03 * INTERVAL_S
    assert abs(result.delay_s - late * INTERVAL_S / STEPS) < 4.0 * result.std_s
    assert result.evidence > watch.EVIDENCE


def test_a_punctual_voltage_brings_no_evidence_for_another_delay() -> None:
    result = _found(_signals(0))
    assert result is not None
    assert abs(result.delay_s) < 4.0 * result.std_s
    assert result.evidence < watch.EVIDENCE


def test_a_voltage_that_acts_earlier_than_it_is_stamped_is_told_too() -> None:
    signals = _signals(0)
    early = RawSignals(
        signals.time_s,
        signals.torque_nm,
        signals.speed_rad_s,
        signals.voltage_time_s + 2.4e-3,
        signals.voltage_v,
    )
    result = _found(early)
    assert result is not None
    assert abs(result.delay_s + 2.4e-3) < 4.0 * result.std_s


def test_what_no_delay_explains_tells_none() -> None:
    signals = _signals(0)
    torque_nm = np.cumsum(np.random.default_rng(2).normal(size=signals.time_s.size))
    noisy = RawSignals(
        signals.time_s, torque_nm, signals.speed_rad_s, signals.voltage_time_s, signals.voltage_v
    )
    assert _found(noisy) is None


def test_a_driver_that_filters_its_voltage_is_not_told_a_delay() -> None:
    rng = np.random.default_rng(8)
    levels_v = [np.full(n, rng.uniform(-12.0, 12.0)) for n in rng.integers(30, 300, 99)]
    voltage_v = np.concatenate(levels_v)[:2200]
    plant = replace(GEAR_MOTOR, inductance=6e-4)  # L/R of 0.3 intervals behind a lag of 1.5
    simulation = Simulation(
        {'motor': plant}, 'external', seed=6, sample_rate_hz=1e3 * STEPS,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    torques_nm = []
    filtered_v = 0.0
    for step in range(voltage_v.size * STEPS):
        filtered_v += -np.expm1(-1.0 / (1.5 * STEPS)) * (voltage_v[step // STEPS] - filtered_v)
        simulation.command('motor', float(filtered_v))
        torque_nm = float(simulation.step().torque_nm[0])
        if step % STEPS == 0:
            torques_nm.append(torque_nm)
    time_s = INTERVAL_S * np.arange(voltage_v.size)
    keep = slice(100, 2100)
    signals = RawSignals(
        time_s[keep] - time_s[keep][-1],
        np.array(torques_nm)[keep],
        np.full(2000, np.nan),
        time_s - time_s[keep][-1],
        voltage_v,
    )
    assert _found(signals) is None


def test_two_levels_are_moves_enough_and_one_step_is_none() -> None:
    signals = _signals(0)
    square_v = np.where(np.arange(signals.voltage_v.size) // 100 % 2, 6.0, -6.0)
    step_v = np.where(np.arange(signals.voltage_v.size) < 600, 6.0, -6.0)
    volts = (square_v, step_v)
    moves = [watch._moves(replace(signals, voltage_v=voltage_v)) for voltage_v in volts]
    assert moves == [True, False]


def _fed(observer: Observer, late: int, begin: int = 0, end: int = 3000) -> Observer:
    record = recorded_in_steps(late)
    for place in range(begin, end):
        step = place * STEPS
        stamp_ns = place * 1_000_000
        acts = min(step + late, record.voltage_v.shape[1] - 1)
        observer.voltage('motor', stamp_ns, float(record.voltage_v[0, acts]))
        observer.torque('motor', stamp_ns, float(record.torque_nm[0, step]))
    return observer


def _observer(**values: object) -> Observer:
    flat = {f'motor.{name}': value for name, value in values.items()}
    return Observer(Configuration.from_flat({**CONSTANTS, **flat}))


def _check_known(observer: Observer, *names: str) -> None:
    """Check that parameters of the motor are known, and its delay with them."""
    delay = observer.delays()['motor']
    assert delay.verdict is DelayVerdict.ESTIMATED
    assert delay.applied_s == pytest.approx(DELAY_S, abs=0.05 * INTERVAL_S)
    assert observer.fit('motor').verdict is FitVerdict.OK
    estimate = observer.estimates()['motor']
    places = [parameter.name for parameter in estimate.parameters]
    for name in names:
        place = places.index(name)
        off = float(estimate.value[0, place]) - getattr(GEAR_MOTOR, name)
        assert estimate.verdicts[0][place] is Verdict.IDENTIFIED
        assert abs(off) < 3.0 * float(estimate.std[0, place])


@pytest.mark.slow
@pytest.mark.parametrize('source', ['auto', 'rotor'])
def test_a_delay_that_is_to_be_estimated_is_found_and_applied(source: str) -> None:
    observer = _fed(_observer(delay='estimate', speed_source=source), LATE)
    observer.finish()
    assert observer.motors['motor'].white_box.speed_source == 'rotor'
    _check_known(observer, 'inductance', 'resistance')


@pytest.mark.slow
def test_the_delay_that_is_told_is_the_one_that_samples_are_paired_by() -> None:
    observer = _observer(delay='estimate')
    sources = []
    for place in range(3000):
        _fed(observer, LATE, begin=place, end=place + 1)
        if 'motor' in observer.motors:
            pairing = observer.group_of('motor').pairing
            told_s = observer.delays()['motor'].applied_s
            assert round(told_s * 1e9) == pairing.delay_ns
            sources.append(observer.motors['motor'].white_box.speed_source)
    assert sources[0] == 'torque_constant'
    assert sources[-1] == 'rotor'


@pytest.mark.slow
@pytest.mark.parametrize('stood', [1500, 6000])
def test_a_motor_that_has_stood_is_asked_as_soon_as_it_moves(stood: int) -> None:
    observer = _observer(delay='estimate', speed_source='rotor')
    for place in range(stood):
        stamp_ns = (place - stood) * 1_000_000
        observer.voltage('motor', stamp_ns, 0.0)
        observer.torque('motor', stamp_ns, 3e-4 * (-1.0) ** (place // 2))
    _fed(observer, LATE)
    assert observer.delays()['motor'].applied_s == pytest.approx(DELAY_S, abs=0.05 * INTERVAL_S)


@pytest.mark.slow
def test_an_undeclared_delay_is_told_with_its_remedy_and_nothing_is_believed() -> None:
    observer = _fed(_observer(), LATE)
    delay = observer.delays()['motor']
    assert delay.verdict is DelayVerdict.UNDECLARED
    assert delay.value_s == pytest.approx(DELAY_S, abs=0.05 * INTERVAL_S)
    assert 'set motor.delay to 0.0014 or to estimate' in (delay.complaint('motor') or '')
    assert Verdict.IDENTIFIED not in observer.estimates()['motor'].verdicts[0]


@pytest.mark.slow
def test_a_punctual_rotor_that_fits_is_never_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    asked_at: list[float] = []
    run = HiddenRotorSearch.run

    def counted(search: HiddenRotorSearch, applied_s: float) -> Any:
        asked_at.append(applied_s)
        return run(search, applied_s)

    monkeypatch.setattr(hidden_rotor_delay.HiddenRotorSearch, 'run', counted)
    observer = _fed(_observer(speed_source='rotor'), 0)
    assert observer.fit('motor').verdict is FitVerdict.OK
    assert asked_at == []


@pytest.mark.slow
@pytest.mark.parametrize('cut', [700, 1500])
def test_a_restored_motor_goes_on_with_its_delay(tmp_path: Path, cut: int) -> None:
    first = _fed(_observer(delay='estimate'), LATE, end=cut)
    checkpoint.save(first, tmp_path / 'checkpoint')
    second = _observer(delay='estimate')
    checkpoint.load(second, tmp_path / 'checkpoint')
    assert second.delays()['motor'] == first.delays()['motor']
    _fed(second, LATE, begin=cut)
    second.finish()
    _check_known(second, 'resistance')
