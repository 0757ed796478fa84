"""Wrong units, a flipped speed and a forgotten Kb are told by name, and nothing else is."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.data_doubts import doubts
from gray_box_observer.fit_test.data_sheet import doubt_of_data_sheet
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array

INTERVAL, VOLTAGE, TORQUE, SPEED = range(4)

DRAWN = 8

RATE_HZ = 1000.0

DURATION_S = 2.0

LARGEST_V = 12.0


STEPS = 10
"""Of the simulation, within an interval."""


@cache
def _gear_motors(seed: int = 0) -> tuple[tuple[PlantParameters, Array], ...]:
    """Draw gear motors with dry and viscous friction, driven to and fro; (signal, n)."""
    rng = np.random.default_rng(seed)
    resistance = np.exp(rng.uniform(np.log(0.5), np.log(8.0), DRAWN))
    constant = np.exp(rng.uniform(np.log(0.05), np.log(0.8), DRAWN))
    damping = constant**2 / resistance
    drawn = {
        'inductance': resistance * rng.uniform(3e-4, 2e-3, DRAWN),
        'resistance': resistance,
        'torque_constant': constant,
        'back_emf_constant': constant,
        'inertia': rng.uniform(0.03, 0.2, DRAWN) * damping,
        'viscous_friction': 0.05 * damping,
        'coulomb_friction': 0.1 * constant * LARGEST_V / resistance,
    }
    plants = [
        PlantParameters(hysteresis=0.0, **{name: float(value[k]) for name, value in drawn.items()})
        for k in range(DRAWN)
    ]
    count = round(DURATION_S * RATE_HZ)
    levels = np.repeat(rng.uniform(-LARGEST_V, LARGEST_V, (DRAWN, count // 200 + 1)), 200, axis=1)
    return tuple(zip(plants, _moved(drawn, levels[:, :count], rng), strict=True))


def _moved(drawn: dict[str, Array], voltage_v: Array, rng: np.random.Generator) -> Array:
    """Let motors with a rotor run, with 1 % noise on torque; shape (motor, signal, n)."""
    step_s = 1.0 / RATE_HZ / STEPS
    kept = np.exp(-step_s * drawn['resistance'] / drawn['inductance'])
    constant = drawn['torque_constant']
    soft = 0.005 * LARGEST_V / constant
    current = np.zeros(DRAWN)
    speed = np.zeros(DRAWN)
    samples = np.zeros((DRAWN, 4, voltage_v.shape[1]))
    for k in range(voltage_v.shape[1]):
        samples[:, TORQUE, k] = constant * current
        samples[:, SPEED, k] = speed
        for _ in range(STEPS):
            final = (voltage_v[:, k] - constant * speed) / drawn['resistance']
            current = final + (current - final) * kept
            friction = drawn['viscous_friction'] * speed + drawn['coulomb_friction'] * np.tanh(
                speed / soft
            )
            speed = speed + step_s * (constant * current - friction) / drawn['inertia']
    samples[:, INTERVAL, 1:] = 1.0 / RATE_HZ
    samples[:, VOLTAGE, 1:] = voltage_v[:, :-1]
    noise = 0.01 * samples[:, TORQUE].std(axis=1, keepdims=True)
    samples[:, TORQUE] += noise * rng.standard_normal(samples[:, TORQUE].shape)
    return samples


@cache
def _thesis_motor(resistance: float) -> tuple[PlantParameters, Array]:
    """Record the motor of the thesis, at 100 Hz, its speed ``w = Kt i`` measured."""
    plant = PlantParameters(resistance=resistance, inductance=0.5 * resistance)
    recording = Simulation({'motor': plant}, 'R[-15,15]D[1,5]').record(30.0)
    samples = np.zeros((4, recording.stamp_ns.size))
    samples[INTERVAL, 1:] = np.diff(recording.stamp_ns) / 1e9
    samples[VOLTAGE, 1:] = recording.voltage_v[0, :-1]
    samples[TORQUE] = recording.torque_nm[0]
    samples[SPEED] = recording.speed_rad_s[0]
    return plant, samples


def _effects(plant: PlantParameters, samples: Array, speed: bool = True, **given: Any) -> list[str]:
    """Return the doubted effects of a motor; Kt and Kb are stated unless told otherwise."""
    stated = {
        'torque_constant': plant.torque_constant,
        'back_emf_constant': plant.back_emf_constant,
        **given,
    }
    values = {f'motor.{name}': value for name, value in stated.items() if value is not None}
    motor = Configuration.from_flat(values).motors['motor']
    white_box = motor.white_box(speed_measured=speed)
    truth = {'inductance': plant.inductance, 'resistance': plant.resistance}
    theta = np.array([truth.get(name, 1.0) for name in white_box.context_nodes])
    return [suspect.effect for suspect in doubts(white_box, samples, theta, motor).suspects]


def _scaled(samples: Array, row: int, factor: float) -> Array:
    changed = samples.copy()
    changed[row] *= factor
    return changed


drawn_motor = pytest.mark.parametrize('k', range(DRAWN))


@drawn_motor
@pytest.mark.parametrize('speed', [True, False])
def test_a_healthy_gear_motor_gives_no_doubt(k: int, speed: bool) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, samples, speed=speed) == []


@drawn_motor
def test_ma_for_a_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, TORQUE, 1e3)) == ['units_of_current']


@drawn_motor
def test_mv_for_v_is_told_and_not_taken_for_another_kb(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, VOLTAGE, 1e3)) == ['units_of_voltage']


@drawn_motor
def test_ms_for_s_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, INTERVAL, 1e3)) == ['units_of_time']


@drawn_motor
def test_ms_for_s_is_told_where_every_sample_begins_a_new_history(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, INTERVAL, 0.0)) == ['units_of_time']


@pytest.mark.slow
def test_us_for_s_is_told() -> None:
    plant, samples = _gear_motors()[0]
    assert _effects(plant, _scaled(samples, INTERVAL, 1e-3))[:1] == ['units_of_time']


@drawn_motor
@pytest.mark.parametrize('among_nodes', [False, True])
def test_a_flipped_speed_is_told(k: int, among_nodes: bool) -> None:
    plant, samples = _gear_motors()[k]
    nodes = ['inductance', 'resistance', 'back_emf_constant']
    given = {'context_nodes': nodes, 'back_emf_constant': None} if among_nodes else {}
    assert _effects(plant, _scaled(samples, SPEED, -1.0), **given) == ['speed_sign']


@drawn_motor
def test_a_flipped_voltage_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, VOLTAGE, -1.0))[0] == 'voltage_sign'


@drawn_motor
def test_a_flipped_torque_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, TORQUE, -1.0)) == ['torque_sign']


def _sheet_doubt(
    k: int, samples: Array, quantity: str, sheet_ohm: float, relative_std: float = 0.3
) -> Suspect | None:
    """Return the doubt of a motor of which a short record has identified nothing yet."""
    plant, _ = _gear_motors()[k]
    stated = {
        'torque_constant': plant.torque_constant,
        'back_emf_constant': plant.back_emf_constant,
        'initial.resistance': sheet_ohm,
        'initial_relative_std.resistance': relative_std,
    }
    values = {f'motor.{name}': value for name, value in stated.items()}
    motor = Configuration.from_flat(values).motors['motor']
    white_box = motor.white_box(speed_measured=True)
    names = white_box.parameters
    estimate = Estimate(
        0,
        names,
        np.ones((1, len(names))),
        np.eye(len(names))[None],
        ((Verdict.CONVERGING,) * len(names),),
    )
    balance = doubts(white_box, samples, np.ones(len(names)), motor).balance
    return doubt_of_data_sheet(motor, estimate, quantity, balance, is_duty=False)


@drawn_motor
def test_a_short_record_contradicts_its_data_sheet_before_anything_is_identified(k: int) -> None:
    plant, samples = _gear_motors()[k]
    samples = samples[:, :600]
    for sheet_ohm in (0.6 * plant.resistance, plant.resistance, 1.6 * plant.resistance):
        assert _sheet_doubt(k, samples, 'torque', sheet_ohm) is None
    as_current = _scaled(samples, TORQUE, 1.0 / plant.torque_constant)  # a current taken for torque
    if plant.torque_constant < 0.2:  # that a sheet to 30 % contradicts for sure
        suspect = _sheet_doubt(k, as_current, 'torque', plant.resistance)
        assert suspect is not None
        assert 'torque.quantity: current' in suspect.remedy
        assert _sheet_doubt(k, as_current, 'torque', plant.resistance, 0.0) is None, 'no sheet'


@drawn_motor
def test_a_torque_that_is_read_as_a_current_contradicts_its_data_sheet(k: int) -> None:
    plant, samples = _gear_motors()[k]
    samples = samples[:, :600]
    assert _sheet_doubt(k, samples, 'current', plant.resistance) is None
    as_torque = _scaled(samples, TORQUE, plant.torque_constant)  # a torque taken for a current
    if plant.torque_constant < 0.2:
        suspect = _sheet_doubt(k, as_torque, 'current', plant.resistance)
        assert suspect is not None
        assert 'torque.quantity: torque (it is current now)' in suspect.remedy
        assert _sheet_doubt(k, as_torque, 'current', plant.resistance, 0.0) is None, 'no sheet'


@pytest.mark.parametrize(
    ('inductance', 'resistance', 'names_unit'),
    [(1e3, 1e3, True), (1e3, 1.0, False), (1e3, 1e2, False)],
)
def test_a_unit_is_named_where_resistance_and_inductance_are_off_alike(
    inductance: float, resistance: float, names_unit: bool
) -> None:
    sheet = {'inductance': 2e-3, 'resistance': 3.0}
    stated = {f'motor.initial.{name}': value for name, value in sheet.items()}
    stated |= {f'motor.initial_relative_std.{name}': 0.2 for name in sheet}
    motor = Configuration.from_flat({**stated, 'motor.context_nodes': [*sheet]}).motors['motor']
    parameters = motor.white_box(speed_measured=True).parameters
    value = np.array([sheet['inductance'] * inductance, sheet['resistance'] * resistance])
    verdicts = ((Verdict.IDENTIFIED,) * len(parameters),)
    covariance = np.diag((0.01 * value) ** 2)[None]
    estimate = Estimate(0, parameters, value[None], covariance, verdicts)
    suspect = doubt_of_data_sheet(motor, estimate, 'torque', None, is_duty=False)
    assert suspect is not None
    assert ('voltage is in mV' in suspect.remedy) == names_unit


@drawn_motor
@pytest.mark.parametrize(('unit', 'factor'), [('deg/s', 57.296), ('rpm', 9.5493), ('Hz', 0.159155)])
def test_a_speed_in_another_unit_is_told_by_kb(k: int, unit: str, factor: float) -> None:
    plant, samples = _gear_motors()[k]
    assert _effects(plant, _scaled(samples, SPEED, factor))[0] == 'units_of_speed'
    values = {name: getattr(plant, name) for name in ('torque_constant', 'back_emf_constant')}
    motor = Configuration.from_flat({f'motor.{n}': v for n, v in values.items()}).motors['motor']
    white_box = motor.white_box(speed_measured=True)
    first = doubts(white_box, _scaled(samples, SPEED, factor), np.ones(3), motor).suspects[0]
    assert first.remedy.startswith(f'speed.scale: {1.0 / factor:.3g}'[:17])
    assert unit in first.remedy


COUNTS = 2000


def _counted(samples: Array, *, as_rate: bool) -> Array:
    """Return samples whose speed is the count of an encoder, or its rate in counts per second."""
    turned_rad = np.cumsum(samples[SPEED] * samples[INTERVAL])
    count = np.floor(turned_rad * COUNTS / (2.0 * np.pi))
    changed = samples.copy()
    changed[SPEED] = np.diff(count, prepend=count[0]) * RATE_HZ if as_rate else count
    return changed


def _only_suspect(plant: PlantParameters, samples: Array, **given: float) -> Suspect:
    stated = {'torque_constant': plant.torque_constant, **given}
    values = {f'motor.{name}': value for name, value in stated.items()}
    motor = Configuration.from_flat(values).motors['motor']
    white_box = motor.white_box(speed_measured=True)
    (suspect,) = doubts(white_box, samples, np.ones(3), motor).suspects
    return suspect


@drawn_motor
@pytest.mark.parametrize('as_rate', [False, True])
def test_an_encoder_without_its_scale_is_told_with_its_counts(k: int, as_rate: bool) -> None:
    plant, samples = _gear_motors()[k]
    counted = _counted(samples, as_rate=as_rate)
    suspect = _only_suspect(plant, counted, back_emf_constant=plant.back_emf_constant)
    assert suspect.effect == ('units_of_speed' if as_rate else 'angle_for_speed')
    counts = float(suspect.remedy.removeprefix('speed=diff(NAME)*2*pi/').split()[0])
    assert counts == pytest.approx(COUNTS, rel=0.05)


@drawn_motor
def test_an_angle_for_a_speed_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    turned = samples.copy()
    turned[SPEED] = np.cumsum(samples[SPEED] * samples[INTERVAL])
    suspect = _only_suspect(plant, turned, back_emf_constant=plant.back_emf_constant)
    assert suspect.effect == 'angle_for_speed'
    assert 'diff(NAME)' in suspect.remedy
    assert _only_suspect(plant, turned).remedy.startswith('speed=diff(NAME)*2*pi/COUNTS')


@drawn_motor
def test_a_duty_cycle_for_a_voltage_is_told(k: int) -> None:
    plant, samples = _gear_motors()[k]
    duty = _scaled(samples, VOLTAGE, 1.0 / LARGEST_V)
    assert _effects(plant, duty)[0] == 'units_of_voltage'
    # a motor that is really driven by less than 1 V is none
    kb = 1.0 / LARGEST_V
    low = _scaled(_scaled(samples, VOLTAGE, kb), TORQUE, kb)
    low[SPEED] *= kb
    assert _effects(plant, low) == []


@drawn_motor
def test_ma_for_a_is_told_beside_a_data_sheet(k: int) -> None:
    plant, samples = _gear_motors()[k]
    wrong = _scaled(samples, TORQUE, 1e3)
    sheet = {'initial.resistance': plant.resistance, 'initial_relative_std.resistance': 0.2}
    assert _effects(plant, wrong, **sheet) == ['units_of_current']
    small = {**sheet, 'initial.resistance': 1e-3 * plant.resistance}
    assert _effects(plant, wrong, **small) == []
    known = {'known.resistance': plant.resistance, 'context_nodes': ['inductance']}
    assert 'units_of_current' in _effects(plant, wrong, **known)


@drawn_motor
def test_a_forgotten_kb_is_told_with_its_value(k: int) -> None:
    plant, samples = _gear_motors()[k]
    motor = Configuration.from_flat({'motor.torque_constant': plant.torque_constant}).motors[
        'motor'
    ]
    found = doubts(motor.white_box(speed_measured=True), samples, np.ones(3), motor).suspects
    assert [suspect.effect for suspect in found] == ['back_emf_constant']
    told = float(found[0].remedy.split()[1])
    assert told == pytest.approx(plant.back_emf_constant, rel=0.1)


@drawn_motor
def test_a_speed_that_is_noisy_and_late_is_no_doubt_about_kb_or_sign(k: int) -> None:
    plant, samples = _gear_motors()[k]
    late = samples.copy()
    late[SPEED, 3:] = samples[SPEED, :-3]
    late[SPEED] += np.random.default_rng(k).normal(
        0.0, 0.05 * np.std(samples[SPEED]), late.shape[1]
    )
    assert _effects(plant, late) == []


@pytest.mark.parametrize('rows', [1, 10, 49])
def test_too_few_samples_are_not_judged(rows: int) -> None:
    plant, samples = _gear_motors()[0]
    assert _effects(plant, _scaled(samples, TORQUE, 1e3)[:, :rows]) == []


def test_speeds_that_are_not_measured_may_be_anything() -> None:
    plant, samples = _gear_motors()[0]
    assert _effects(plant, _scaled(samples, SPEED, np.nan), speed=False) == []
    assert _effects(plant, _scaled(samples, SPEED, np.nan), speed=True) == []


def test_a_data_sheet_ends_the_doubt_about_its_unit() -> None:
    plant, samples = _gear_motors()[0]
    strong = _scaled(samples, TORQUE, 1e3)
    sheet = {'initial.resistance': plant.resistance / 1e3, 'initial_relative_std.resistance': 0.1}
    assert _effects(plant, strong, **sheet) == []


@pytest.mark.slow
@pytest.mark.parametrize('resistance', [0.03, 1.0, 400.0])
@pytest.mark.parametrize('noise', [0.0, 0.01, 0.5])
@pytest.mark.parametrize('speed', [True, False])
def test_the_motor_of_the_thesis_gives_no_doubt_whatever_its_resistance(
    resistance: float, noise: float, speed: bool
) -> None:
    plant, exact = _thesis_motor(resistance)
    samples = exact.copy()
    white = np.random.default_rng(0).standard_normal(exact.shape[1])
    samples[TORQUE] += noise * exact[TORQUE].std() * white
    assert _effects(plant, samples, speed=speed, torque_constant=None, back_emf_constant=None) == []


def test_a_motor_at_rest_gives_no_doubt() -> None:
    plant, samples = _gear_motors()[0]
    still = samples.copy()
    still[VOLTAGE:] = 0.0
    assert _effects(plant, still) == []
