"""The benchmark of a wide range: its motors, its drives, and what its figures count."""

from __future__ import annotations

import numpy as np
import pytest
import wide_range
from common.motor_trial import MotorTrial
from common.wide.drives import CRUISE, DRIVES, LOOPS, PRBS, SINE
from common.wide.wide_motors import wide_motor
from common.wide.wide_runs import WideCase, record, run_wide

RATE_HZ = 200.0
SAMPLES = 800


def _record(drive: str, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return voltages, currents and speeds of a drawn motor, and its supply."""
    rng = np.random.default_rng(seed)
    driven = wide_motor(rng)
    case = WideCase(drive, speed_is_measured=False, voltage_is_measured=False, most=SAMPLES)
    return (*record(driven, case, RATE_HZ, rng), driven.supply_v)


def test_motors_are_what_the_text_says() -> None:
    drawn = [wide_motor(np.random.default_rng(seed)) for seed in range(300)]
    resistances = np.array([one.motor.resistance for one in drawn])
    assert resistances.min() < 0.1
    assert resistances.max() > 20.0
    for one in drawn:
        motor = one.motor
        stiffness = motor.torque_constant * motor.back_emf_constant
        assert one.mechanical_s == pytest.approx(motor.resistance * motor.inertia / stiffness)
        assert 40.0 <= one.supply_v / motor.back_emf_constant <= 800.0
        stall_nm = motor.torque_constant * one.supply_v / motor.resistance
        assert motor.coulomb_friction <= 0.2 * stall_nm


@pytest.mark.parametrize('drive', DRIVES)
def test_the_same_seed_gives_the_same_record_within_the_supply(drive: str) -> None:
    voltage, current, speed, supply_v = _record(drive)
    again = _record(drive)
    assert all(map(np.array_equal, (voltage, current, speed), again[:3]))
    assert voltage.size + 1 == current.size == speed.size == SAMPLES + 1
    assert 0.0 < np.abs(voltage).max() <= supply_v
    assert np.isfinite([*current, *speed]).all()
    assert np.abs(current).max() > 0.0


def test_drives_move_as_they_are_called() -> None:
    cruise_v, *_, supply_v = _record(CRUISE)
    assert np.abs(np.diff(cruise_v)).max() == pytest.approx(2.0 * supply_v / RATE_HZ)
    assert np.unique(np.abs(_record(PRBS)[0])).size == 1
    assert np.abs(np.diff(_record(SINE)[0], 2)).max() < 0.1 * supply_v
    for drive in LOOPS:
        assert np.ptp(_record(drive)[2]) > 0.0


def test_rows_and_figures_count_motors_and_claims() -> None:
    good = MotorTrial(is_known=True, is_near=True, is_misfit=False, claims=9, false=0)
    bad = MotorTrial(is_known=False, is_near=False, is_misfit=True, claims=3, false=3)
    assert wide_range.row((SINE, True, False), [good, bad]) == [
        'sine, speed with noise, command', '2', '1', '1', '1', '12', '3',
    ]  # fmt: skip
    trials = {(SINE, False, False): [good, good], (SINE, True, True): [bad]}
    false_share, known_share, other_false_share, other_known_share = wide_range.figures(trials)
    assert (false_share.value, known_share.value) == (0.0, 100.0)
    assert (other_false_share.value, other_known_share.value) == (100.0, 0.0)


@pytest.mark.slow
def test_a_wheel_motor_under_steps_is_known() -> None:
    trial = run_wide(WideCase('steps', True, False, 2000), seed=1)
    assert trial.is_known
    assert trial.false == 0
