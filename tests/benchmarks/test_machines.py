"""The benchmark of machines: its plant against the other one, and what its figures count."""

from __future__ import annotations

import machines
import numpy as np
import pytest
from common.machines.drawn_machines import EFFECTS, Machine, draw_machine
from common.machines.machine_plant import MachinePlant
from common.machines.machine_runs import CRUISE, DRIVES, STEPS, MachineCase, record, run_machine
from common.motor_trial import MotorTrial
from common.trust.plant import Plant

INTERVAL_S = 1e-3
LEVELS_V = (9.0, -6.0, 0.0, 3.0)


def _machine(effect: str, seed: int = 3) -> Machine:
    return draw_machine(effect, np.random.default_rng(seed))


def _run(machine: Machine, load_nm: float = 0.0) -> np.ndarray:
    """Hold some voltages for 0.1 s each; return currents and speeds, shape (2, k)."""
    plant = MachinePlant(machine, INTERVAL_S)
    states = []
    for voltage_v in np.repeat(LEVELS_V, 100).tolist():
        plant.hold(voltage_v, load_nm)
        states.append((plant.current_a, plant.speed_rad_s))
    return np.array(states).T


def test_a_motor_with_nothing_odd_is_that_of_the_other_plant() -> None:
    machine = _machine('nothing')
    exact = Plant(machine.motor, INTERVAL_S / 50)
    current, speed = exact.run(np.repeat(LEVELS_V, 100 * 50).tolist())
    expected = np.array([current[49::50], speed[49::50]])
    error = np.abs(_run(machine) - expected).max(axis=1)
    assert (error < 5e-3 * expected.std(axis=1)).all()


@pytest.mark.parametrize('effect', EFFECTS[1:])
def test_what_is_drawn_is_seen_in_the_current(effect: str) -> None:
    machine = _machine(effect)
    plain = _run(Machine(machine.motor))
    if effect == 'payload':
        plant = MachinePlant(machine, INTERVAL_S)
        plant.take_payload()
        plant.hold(9.0, 0.0)
        assert plant.speed_rad_s != plain[1, 0]
        return
    odd = _run(machine, machine.restless_nm)
    assert np.abs(odd - plain)[0].max() > 1e-3 * plain[0].std()
    assert np.isfinite(odd).all()


def test_no_current_flows_where_a_driver_has_opened_or_against_its_command() -> None:
    open_a = _run(_machine('coasting driver'))[0, 210:300]  # at 0 V, once it has died
    assert (open_a == 0.0).all()
    assert np.abs(_run(_machine('nothing'))[0, 210:300]).max() > 0.1
    one_way_a = _run(_machine('one-way driver'))[0]
    assert (one_way_a * np.repeat(LEVELS_V, 100) >= 0.0).all()


@pytest.mark.parametrize('drive', DRIVES)
def test_the_same_seed_gives_the_same_record(drive: str) -> None:
    case = MachineCase('restless load', drive, 250.0, None, 2.0)
    one, other = (record(_machine(case.effect), case, np.random.default_rng(1)) for _ in range(2))
    assert all(np.array_equal(*pair) for pair in zip(one, other, strict=True))
    assert one[0].size + 1 == one[1].size == one[2].size == 501


def test_rows_and_figures_count_motors_and_claims() -> None:
    good = MotorTrial(is_known=True, is_near=True, is_misfit=False, claims=9, false=0)
    bad = MotorTrial(is_known=False, is_near=False, is_misfit=True, claims=3, false=3)
    assert machines.row(('cogging', None), [good, bad]) == [
        'cogging, no speed', '2', '1', '1', '1', '12', '3',
    ]  # fmt: skip
    trials = {('nothing', None): [good, good], ('cogging', None): [bad]}
    false_share, known_share, held_share, coasting_share = machines.figures(trials)
    assert false_share.value == pytest.approx(100.0 * 3 / 21)
    assert not false_share.met
    assert known_share.value == 100.0
    assert held_share.value == coasting_share.value == 0.0


def test_a_cruise_ramps_between_stops_and_travel_and_holds_them() -> None:
    case = MachineCase('nothing', CRUISE, 1000.0, None, 20.0)
    voltage_v = record(_machine(case.effect), case, np.random.default_rng(1))[0]
    rate_v_s = np.abs(np.diff(voltage_v)) * case.rate_hz
    assert rate_v_s.max() == pytest.approx(24.0)
    assert np.mean(rate_v_s == 0.0) > 0.8
    assert (voltage_v == 0.0).any()


@pytest.mark.slow
@pytest.mark.parametrize('noise', [None, 0.01])
def test_of_a_machine_that_coasts_nothing_false_is_claimed(noise: float | None) -> None:
    trial = run_machine(MachineCase('coasting driver', STEPS, 1000.0, noise, 5.0), seed=7)
    assert trial.is_known
    assert trial.false == 0
