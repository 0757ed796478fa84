"""The judge of trust: its simulator by closed forms, its classes by name, its rules."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common.trust import effects
from common.trust.drawn import command_failure, draw
from common.trust.effects import STAMP_0_NS, Grid, Readings
from common.trust.excitations import CurrentLoop, constant, steps
from common.trust.faults import FAULTS
from common.trust.judge import figures, scenario_of
from common.trust.motors import gear_motor
from common.trust.plant import Motor, Plant
from common.trust.real_logs import RealMotor
from common.trust.records import make_record
from common.trust.scenarios import half, scenarios
from common.trust.trial import Trial, Watch, run_trial, truth_at
from scipy.integrate import solve_ivp

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.white_box.declaration import TERMS

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'trust.py'
BY_NAME = {scenario.name: scenario for scenario in scenarios()}
GRID = Grid(10, 1e-3)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_without_a_rotor_a_held_voltage_leads_along_the_hyperbolic_tangent() -> None:
    motor = Motor(0.5, 1.0, 10.0, 0.01, 0.01)
    found = Plant(motor, 1e-3).run([8.0] * 3000)[0]
    r, k = 1.0 + 1e-4, 0.1
    root = math.sqrt(r * r + 4.0 * k * 8.0)
    time_s = 1e-3 * np.arange(1, 3001)
    closed = (root * np.tanh(root * time_s + math.atanh(r / root)) - r) / (2.0 * k)
    np.testing.assert_allclose(found, closed, rtol=1e-8)


def test_a_rotor_that_is_held_leaves_an_exponential() -> None:
    motor = replace(gear_motor(rng()), coulomb_friction=1e3)
    currents, speeds = Plant(motor, 1e-4).run([6.0] * 500)
    time_s = 1e-4 * np.arange(1, 501)
    closed = 6.0 / motor.resistance * -np.expm1(-time_s * motor.resistance / motor.inductance)
    np.testing.assert_allclose(currents, closed, rtol=1e-10)
    assert not any(speeds)


def test_a_motor_with_everything_agrees_with_an_integrator_of_small_steps() -> None:
    motor = replace(gear_motor(rng()), hysteresis=2e-4, brush_drop=0.4)
    voltages = np.repeat([5.0, 8.0, 11.0], 400)

    def slope(t: float, state: list[float]) -> list[float]:
        i, w = state
        volt = voltages[min(int(t / 1e-4), voltages.size - 1)]
        lost = (motor.resistance + motor.hysteresis * abs(w)) * i + motor.back_emf_constant * w
        torque = motor.torque_constant * i - motor.viscous_friction * w - motor.coulomb_friction
        moves = w > 0.0 or torque > 0.0
        return [(volt - lost - motor.brush_drop) / motor.inductance, moves * torque / motor.inertia]

    fine = solve_ivp(slope, (0.0, 0.12), [0.0, 0.0], max_step=2e-5, rtol=1e-9, atol=1e-12)
    plant = Plant(motor, 1e-4)
    plant.run(voltages.tolist())
    assert plant.current_a == pytest.approx(fine.y[0, -1], rel=1e-3)
    assert plant.speed_rad_s == pytest.approx(fine.y[1, -1], rel=1e-3)


def test_energy_is_conserved_through_reversals_of_current_and_speed() -> None:
    motor = replace(gear_motor(rng()), brush_drop=0.5)
    step_s = 1e-6
    voltages = np.repeat([10.0, -8.0, 6.0, 0.0], 40_000)
    plant = Plant(motor, step_s)
    i, w = (np.array(states) for states in plant.run(voltages.tolist()))
    power = voltages * i
    heat = motor.resistance * i**2 + motor.brush_drop * np.abs(i)
    friction = motor.viscous_friction * w**2 + motor.coulomb_friction * np.abs(w)
    stored = 0.5 * (motor.inductance * i[-1] ** 2 + motor.inertia * w[-1] ** 2)
    given = step_s * power.sum()
    assert step_s * (heat + friction).sum() + stored == pytest.approx(given, rel=2e-3)


@pytest.mark.parametrize('drop', [0.0, 0.001, 1.0])
def test_a_step_of_the_plant_may_be_halved(drop: float) -> None:
    motor = replace(gear_motor(rng()), brush_drop=drop)
    voltages = np.repeat(rng().uniform(-12.0, 12.0, 40), 500)
    coarse = np.array(Plant(motor, 1e-4).run(voltages.tolist())[0])
    fine = np.array(Plant(motor, 2e-5).run(np.repeat(voltages, 5).tolist())[0])[4::5]
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 1e-3 * fine.std()


def readings(size: int = 2000) -> Readings:
    stamps = STAMP_0_NS + np.arange(size) * 1_000_000
    current = np.sin(np.arange(size) / 50.0)
    return Readings(stamps, stamps, 5.0 * current, current, 100.0 + 20.0 * current)


def test_effects_do_what_their_names_say() -> None:
    log = readings()
    ramp = np.linspace(-6.0, 6.0, 1000)
    stepped = effects.quantised_current(0.3)(log, rng()).current_a / (0.3 * log.current_a.std())
    np.testing.assert_allclose(stepped, np.round(stepped), atol=1e-9)
    np.testing.assert_array_equal(effects.late_voltage(1.5)(ramp, GRID, rng())[15:], ramp[:-15])
    assert np.abs(effects.dead_zone(2.0)(ramp, GRID, rng())).max() == pytest.approx(4.0)
    assert effects.sag(0.2)(ramp, GRID, rng())[-1] == pytest.approx(0.8 * 6.0)
    slewed = effects.slew(3.0, 12.0)(np.full(100, 6.0), GRID, rng())
    np.testing.assert_allclose(np.diff(slewed)[:10], 0.4)
    counts = effects.encoder(64)(log, rng()).speed_rad_s * 1e-3 / (2.0 * math.pi / 64)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert effects.encoder(64)(log, rng()).speed_rad_s.mean() == pytest.approx(100.0, rel=0.05)
    late = effects.jittered_stamps(3.0)(log, rng()).torque_stamp_ns
    assert np.all(np.diff(late) > 0)
    assert np.all(late >= log.torque_stamp_ns)


def test_low_pass_and_average_delay_a_ramp_by_their_means() -> None:
    ramp = np.arange(4000.0)
    assert ramp[-1] - effects.low_pass(2.0)(ramp, GRID, rng())[-1] == pytest.approx(20.0, abs=1.0)
    assert ramp[-1] - effects.averaging(8.0)(ramp, GRID, rng())[-1] == pytest.approx(39.5)


@pytest.mark.parametrize('memory', [0.0, 0.9])
def test_noise_has_its_spread_and_its_memory(memory: float) -> None:
    drawn = effects.noise(200_000, 2.0, rng(), memory)
    assert drawn.std() == pytest.approx(2.0, rel=0.03)
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(memory, abs=0.02)


def test_a_signal_changes_at_the_instants_at_which_it_should() -> None:
    signal = steps(1.0, 2.0, 3.0, 3.0)(np.arange(1000) / 100.0, rng())
    np.testing.assert_array_equal(np.flatnonzero(np.diff(signal)) + 1, [300, 600, 900])


def test_scenarios_are_many_have_names_of_their_own_and_stand_in_both_halves() -> None:
    assert len(scenarios()) >= 60
    assert len(BY_NAME) == len(scenarios())
    for group in {scenario.group for scenario in scenarios()}:
        halves = {half(scenario) for scenario in scenarios() if scenario.group == group}
        assert halves == {'choose', 'report'}, group


def test_a_record_is_the_same_every_time_and_another_with_every_seed() -> None:
    scenario = replace(BY_NAME['gear, speed measured: wide steps'], duration_s=0.2)
    first, again, other = (make_record(scenario, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.torque_nm, again.torque_nm)
    assert first.truth != other.truth


def test_a_current_loop_reaches_its_reference() -> None:
    name = 'gear, closed loop, white noise: current loop'
    scenario = replace(BY_NAME[name], duration_s=1.0, noise=0.0)
    record = make_record(scenario, 1)
    log = record.readings
    balance = log.voltage_v - record.truth['back_emf_constant'] * log.speed_rad_s
    quiet = np.abs(np.diff(log.current_a, append=0.0)) < 1e-4
    assert quiet.sum() > 50
    expected = balance[quiet] / record.truth['resistance']
    np.testing.assert_allclose(log.current_a[quiet], expected, atol=0.02)


def test_the_truth_changes_where_the_motor_does() -> None:
    record = make_record(BY_NAME['a motor that keeps changing: R by 30 %'], 1)
    assert len(record.change_ns) == 24
    assert len(record.truths) == 25
    for k, truth in enumerate(record.truths):
        factor = 1.3 if k % 2 else 1.0
        assert truth['resistance'] == pytest.approx(factor * record.truth['resistance'])


def test_a_healthy_motor_is_identified_and_a_wrong_scale_is_false() -> None:
    healthy = replace(BY_NAME['thesis sets: R[5,15]D[0.001,2]'], duration_s=20.0)
    trial = run_trial(make_record(healthy, 1))
    assert not trial.failure
    assert trial.verdicts['resistance'] == 'identified'
    assert trial.false_at_end == []
    assert 0.0 < trial.identified_s['resistance'] < 20.0
    scale = replace(healthy, log=(effects.current_gain(1.1),))
    wrong = run_trial(make_record(scale, 1))
    assert 'resistance' in wrong.false_at_end
    assert wrong.false_longest_s > 1.0


def test_figures_tell_false_from_withheld() -> None:
    name = 'voltage lost: 1 V, speed measured'
    false = Trial(name, 1, verdicts={'resistance': 'identified'}, false_at_end=['resistance'])
    withheld = Trial(
        name,
        2,
        verdicts={'resistance': 'misfit'},
        fit={'verdict': 'misfit', 'suspects': [{'effect': 'lost_voltage'}]},
    )
    assert not scenario_of(false).holds
    values = {figure.name.strip(): figure.value for figure in figures([false, withheld], {})}
    assert values['false identified at the end, in %'] == 50.0
    assert values['called misfit, in %'] == 50.0
    assert values['right suspect first, of 1 misfits of known kinds, in %'] == 100.0


def test_what_was_identified_before_must_still_be() -> None:
    name = 'thesis sets: R[5,15]D[1,20]'
    now = Trial(name, 1, identified_s={'resistance': 2.0})
    before = {f'{name}/1': {'resistance': 1.0}, f'{name}/2': {'resistance': 1.0}}
    lost = Trial(name, 2)
    values = {figure.name.strip(): figure.value for figure in figures([now, lost], before)}
    assert values['identified before that still are, in %'] == 50.0
    assert values['time to identified over before, mean'] == 2.0


def test_a_real_motor_is_wrong_only_where_it_is_believed_and_far_from_its_band() -> None:
    bands = {'resistance': (3.9, 4.5)}
    rows = {'identified': True, 'converging': False, 'misfit': False}
    for verdict, wrong in rows.items():
        motor = RealMotor('m', True, bands, {'resistance': (6.0, 0.1, verdict)})
        assert bool(motor.wrong()) is wrong
    near = RealMotor('m', True, bands, {'resistance': (4.7, 0.1, 'identified')})
    assert near.wrong() == []


def test_drawn_records_differ_and_one_goes_through_the_command() -> None:
    record, names = draw(7)
    assert names != draw(8)[1]
    assert command_failure(record) == ''


def test_the_program_ends_with_one_line_of_json() -> None:
    arguments = ['--quick', '--only', 'thesis sets: R[5,15]D[1,20]', '--processes', '1']
    run = subprocess.run(
        [sys.executable, str(PROGRAM), *arguments], capture_output=True, text=True, check=True
    )
    last = json.loads(run.stdout.splitlines()[-1])
    assert last['benchmark'] == 'trust'
    assert {figure['name'] for figure in last['figures']} >= {'tracebacks'}


def test_a_log_that_loses_samples_loses_them_of_every_signal() -> None:
    healthy = replace(BY_NAME['thesis sets: R[5,15]D[1,20]'], duration_s=2.0)
    log = make_record(replace(healthy, log=(FAULTS['lost samples'],)), 1).readings
    sizes = {log.voltage_v.size, log.current_a.size, log.speed_rad_s.size, log.torque_stamp_ns.size}
    assert len(sizes) == 1
    assert sizes.pop() < 200


def test_what_stands_while_the_motor_changes_is_false_from_then_on() -> None:
    scenario = replace(BY_NAME['a motor that changes: R by 30 %, speed measured'], duration_s=4.0)
    record = make_record(scenario, 1)
    watch = Watch(record)
    first_ns = int(record.readings.torque_stamp_ns[0])
    names = ('inductance', 'resistance')
    value = np.array([[record.truth[name] for name in names]])
    parameters = tuple(TERMS[name].parameter for name in names)
    identified = ((Verdict.IDENTIFIED, Verdict.IDENTIFIED),)
    covariance = 1e-12 * np.eye(2)[None]
    watch.believe(Estimate(first_ns, parameters, value, covariance, identified), first_ns)
    for stamp_ns in record.readings.torque_stamp_ns.tolist():
        watch.believe(None, stamp_ns)
    watch.close()
    assert watch.longest_ns / 1e9 == pytest.approx(2.0, abs=0.01)
    assert watch.right_share('inductance') == pytest.approx(1.0, abs=0.01)
    assert watch.right_share('resistance') == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize('loop', [False, True])
def test_a_motor_drifts_along_its_record_with_a_controller_too(loop: bool) -> None:
    excitation = CurrentLoop(constant(0.5)) if loop else constant(3.0)
    scenario = replace(
        BY_NAME['a winding that heats: by 10 %, blocked'],
        excitation=excitation,
        duration_s=2.0,
        noise=0.0,
    )
    record = make_record(scenario, 1)
    log = record.readings
    assert len(record.truths) == 400
    cold, hot = (truth['resistance'] for truth in (record.truth, record.truths[-1]))
    assert hot == pytest.approx(1.1 * cold, rel=1e-3)
    for k in (500, 1900):
        resistance = truth_at(record, int(log.torque_stamp_ns[k]))['resistance']
        assert log.voltage_v[k] / log.current_a[k] == pytest.approx(resistance, rel=2e-3)
    shaped = replace(scenario, sensor=(effects.averaging(0.4),))
    if loop:
        with pytest.raises(ValueError, match='a controller reads'):
            make_record(shaped, 1)


def test_what_a_winding_that_heats_loses_is_a_figure() -> None:
    trials = [
        Trial(f'a winding that heats: by 10 %, {kind}', seed, right_shares={'resistance': share})
        for kind, seed, share in (('blocked', 1, 0.9), ('blocked', 2, 0.1), ('sine', 1, 0.8))
    ]
    (figure,) = (one for one in figures(trials, {}) if one.name.startswith('winding'))
    assert figure.value == pytest.approx(50.0)
    assert figure.goal == (45.0, 100.0)
