"""A motor whose voltage is held for seconds, while samples come fast."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import (
    CONSTANTS,
    GEAR_MOTOR,
    driven,
    feed,
    made,
    observed,
    recording_of,
    samples_of,
    told,
)

from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.delay import DelayVerdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_forms.trial_memory import TrialMemory
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

HOLD = 2500
LEVELS_V = (6.0, -9.0, 3.0, -4.0, 11.0, -7.0)
BOX = MotorWhiteBox(('inductance', 'resistance'), 0.02, {'back_emf_constant': 0.02})


@cache
def _record() -> Recording:
    """Record a motor whose voltage moves every 2.5 s, a thousand samples a second."""
    return driven(GEAR_MOTOR, np.repeat(LEVELS_V, HOLD))


@pytest.mark.slow
@pytest.mark.parametrize('source', ['auto', 'rotor'])
def test_the_motor_is_found_behind_few_moves(source: str) -> None:
    observer = Observer(Configuration.from_flat({**CONSTANTS, 'motor.speed_source': source}))
    feed(observer, [_record()])
    motor = observer.motors['motor']
    assert motor.white_box.speed_source == 'rotor'
    value, _, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert value == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)
    held = motor.remembered().content()[0, 0]
    assert held.max() > 10 * np.median(held)


@pytest.mark.slow
@pytest.mark.parametrize(('source', 'end'), [('auto', 4000), ('auto', 6200), ('rotor', 9300)])
def test_what_is_saved_on_the_way_goes_on_bit_for_bit(source: str, end: int) -> None:
    through = made(source)
    for sample in samples_of(_record())[:end]:
        through.step(sample)
    restored = made(source)
    restored.restore(*through.state())
    for sample in samples_of(_record())[end:]:
        through.step(sample)
        restored.step(sample)
    states = [motor.state() for motor in (through, restored)]
    assert states[0][0]['speed'] == states[1][0]['speed']
    assert states[0][0]['context_nodes'] == states[1][0]['context_nodes']
    assert {name: array.tobytes() for name, array in states[0][1].items()} == {
        name: array.tobytes() for name, array in states[1][1].items()
    }


def _cruise() -> np.ndarray:
    """Return a voltage that ramps between stops and travel, and holds each for a while."""
    voltage_v = 0.0
    voltages_v = []
    for level_v in (7.0, 0.0, -9.0, 4.0, 0.0, 6.0):
        for _ in range(HOLD):
            voltage_v += float(np.clip(level_v - voltage_v, -0.024, 0.024))
            voltages_v.append(voltage_v)
    return np.array(voltages_v)


@pytest.mark.slow
def test_beside_a_noisy_speed_the_motor_stays_the_same_and_punctual() -> None:
    record = driven(GEAR_MOTOR, _cruise())
    speed_rad_s = record.speed_rad_s[0]
    noise = np.random.default_rng(2).normal(size=speed_rad_s.size)
    observer = observed(record, speed_rad_s + 0.01 * speed_rad_s.std() * noise)
    motor = observer.motors['motor']
    assert motor.counters['motor changes'] == 0
    assert observer.delays()['motor'].verdict is not DelayVerdict.UNDECLARED
    assert motor.fit.verdict is FitVerdict.OK
    value, _, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert value == pytest.approx(GEAR_MOTOR.resistance, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize('seed', [0, 5])
def test_a_ramp_from_rest_tells_the_motor_beside_a_noisy_speed(seed: int) -> None:
    """At first it stands: what begins with a rotor that turns ends at another motor."""
    plant = replace(
        GEAR_MOTOR, inductance=3.2e-3, resistance=1.2, inertia=2.8e-5, viscous_friction=4.6e-5,
        coulomb_friction=0.0217, torque_constant=0.0276, back_emf_constant=0.0276,
    )  # fmt: skip
    constants = {'motor.torque_constant': 0.0276, 'motor.back_emf_constant': 0.0276}
    record = driven(plant, np.minimum(0.024 * np.arange(1, 701), 8.0))
    noise = 2.0 * np.random.default_rng(seed).normal(size=700)
    motor = observed(record, record.speed_rad_s[0] + noise, **constants).motors['motor']
    value, _, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert value == pytest.approx(plant.resistance, rel=0.02)


@pytest.mark.slow
def test_at_slow_samples_a_motor_that_has_changed_in_a_hold_is_found_soon_after_it() -> None:
    rng = np.random.default_rng(6)
    lively_v = np.repeat(rng.uniform(-12.0, 12.0, 400), 10)
    after_v = np.repeat(rng.uniform(-12.0, 12.0, 60), 10)
    voltage_v = np.concatenate([lively_v, np.full(1200, 6.0), after_v])
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'external', seed=6, sample_rate_hz=50.0, torque_noise_std=3e-4,
        speed_mode='rotor',
    )  # fmt: skip
    hot = replace(GEAR_MOTOR, resistance=2.6)
    samples = []
    for place, volts in enumerate(voltage_v.tolist()):
        if place == lively_v.size + 600:
            simulation.set_parameters({'motor': hot})
        simulation.command('motor', volts)
        samples.append(simulation.step())
    record = recording_of(samples)
    speed_rad_s = record.speed_rad_s[0]
    noise = 0.02 * speed_rad_s.std() * rng.normal(size=speed_rad_s.size)
    motor = observed(record, speed_rad_s + noise).motors['motor']
    assert told(motor, 'resistance')[0] == pytest.approx(hot.resistance, rel=0.02)
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.counters['motor changes'] == 1


def test_a_memory_for_trials_reaches_over_more_moves_than_the_newest_samples() -> None:
    record = _record()
    content = np.zeros((4, 1, record.stamp_ns.size))
    content[0, 0, 1:] = np.diff(record.stamp_ns) * 1e-9
    content[1, 0, 1:] = record.voltage_v[0, :-1]
    content[2] = record.torque_nm
    memory = TrialMemory(2048)
    memory.keep(content)
    reached = memory.content()
    assert reached.shape == (6, 1, 2048)
    assert Window.from_samples(BOX, reached[:, 0]).moves >= 3
    assert Window.from_samples(BOX, content[:, 0, -2048:]).moves == 0


@pytest.mark.parametrize('level_v', [6.0, 0.5])
def test_noise_of_a_measured_voltage_is_no_move(level_v: float) -> None:
    content = np.zeros((4, 2048))
    content[0] = 1e-3
    content[1] = level_v + 0.02 * np.random.default_rng(3).normal(size=2048)
    held = replace(Window.from_samples(BOX, content), voltage_elsewhere_v=12.0)
    assert held.moves == 0
    content[1, 1000:] += 1.0
    stepping = replace(Window.from_samples(BOX, content), voltage_elsewhere_v=12.0)
    assert stepping.moves == 1
