"""Pauses of a joint tell R and what its brushes drop; steady speeds that look like them do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, feed, recording_of, told

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_forms.standstill import (
    BLOCK,
    FEWEST_PAUSES,
    StandstillLine,
    Standstills,
)
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.motor_configuration import VARYING_LOAD

R_OHM = 2.0
DROP_V = 0.6
NOISE_A = 0.02
INTERVAL_S = 1e-3


def pauses(
    count: int, *, drop_v: float = DROP_V, offset_v: float = 0.0, emf_v: float = 0.0, seed: int = 1
) -> np.ndarray:
    """Return currents and voltages of pauses, shape (2, n), with a motion of one block before each.

    Args:
        count: of the pauses.
        drop_v: what brushes drop.
        offset_v: that is missing whatever the current.
        emf_v: standard deviation of the back-EMF, another one in every pause.
        seed: of loads and noise.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for k in range(count):
        load_a = (1.0 if k % 2 else -1.0) * rng.uniform(0.3, 2.0)
        moving_a = rng.uniform(-3.0, 3.0, BLOCK)
        moving = np.stack([moving_a, R_OHM * moving_a + rng.uniform(-6.0, 6.0, BLOCK)])
        level_v = R_OHM * load_a + drop_v * np.sign(load_a) + offset_v + emf_v * rng.normal()
        held = np.stack([np.full(4 * BLOCK, load_a), np.full(4 * BLOCK, level_v)])
        parts += [moving, held]
    signals = np.concatenate(parts, axis=1)
    signals[0] += NOISE_A * rng.normal(size=signals.shape[1])
    return signals


def collected(signals: np.ndarray, begin: int = 0, into: Standstills | None = None) -> Standstills:
    """Let currents and voltages be collected, sample by sample."""
    standstills = Standstills() if into is None else into
    for k, (current_a, voltage_v) in enumerate(signals.T.tolist(), begin + 1):
        standstills.add(round(k * INTERVAL_S * 1e9), INTERVAL_S, current_a, voltage_v)
    return standstills


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('drop_v', [0.0, DROP_V])
def test_pauses_tell_the_resistance_and_what_brushes_drop(drop_v: float, seed: int) -> None:
    line = collected(pauses(16, drop_v=drop_v, seed=seed)).line
    assert line is not None
    assert line.has_drop == (drop_v > 0.0)
    assert line.resistance_ohm == pytest.approx(R_OHM, rel=4.0 * line.resistance_std)
    assert line.resistance_std < 0.015
    assert line.drop_v == pytest.approx(drop_v, rel=4.0 * line.drop_std, abs=1e-9)


def test_few_pauses_tell_nothing() -> None:
    assert collected(pauses(FEWEST_PAUSES - 1)).line is None


def test_steady_speeds_of_any_size_lie_on_no_line() -> None:
    assert collected(pauses(30, emf_v=1.0)).line is None


def test_some_steady_speeds_among_pauses_do_not_count() -> None:
    held = pauses(20)
    turning = pauses(6, emf_v=2.0, seed=2)
    line = collected(np.concatenate([held, turning], axis=1)).line
    assert line is not None
    assert line.resistance_ohm == pytest.approx(R_OHM, rel=4.0 * line.resistance_std)


def test_currents_of_one_sign_do_not_tell_brushes_from_an_offset() -> None:
    signals = pauses(30)
    assert collected(np.abs(signals)).line is None


def test_an_offset_is_on_no_line() -> None:
    assert collected(pauses(30, offset_v=0.5)).line is None


@pytest.mark.parametrize(
    'plant',
    [
        replace(GEAR_MOTOR, viscous_friction=1e-4),
        replace(GEAR_MOTOR, quadratic_friction=5e-7, brush_drop=0.5),
        replace(GEAR_MOTOR, viscous_friction=2e-4, coulomb_friction=0.0, brush_drop=0.5),
    ],
)
def test_a_rotor_whose_speed_follows_its_current_does_not_pause(plant: PlantParameters) -> None:
    """Its steady speeds lie on a line, too, whose R is larger by Kb Kt / B."""
    simulation = Simulation(
        {'motor': plant}, 'R[-12,12]D[0.3,0.9]', seed=3, sample_rate_hz=1000.0,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    record = simulation.record(20.0)
    current = record.torque_nm[0] / plant.torque_constant
    voltage = np.concatenate([[0.0], record.voltage_v[0, :-1]])
    assert collected(np.stack([current, voltage])).line is None


def test_a_gap_divides_pauses_and_a_long_one_forgets_them() -> None:
    signals = pauses(16)
    standstills = collected(signals)
    assert standstills.line is not None
    assert not standstills.add(10**11, INTERVAL_S, 0.0, 0.0)
    assert standstills.line is None
    assert collected(signals, 200_000, standstills).line is not None


def test_it_goes_on_bit_for_bit_where_it_is_restored() -> None:
    signals = pauses(20)
    for cut in (40, 900, 2000):
        one = collected(signals[:, :cut])
        other = Standstills.restored(*one.state())
        for standstills in (one, other):
            collected(signals[:, cut:], cut, standstills)
        assert other.line == one.line is not None
        arrays = [standstills.state()[1] for standstills in (one, other)]
        assert all(arrays[0][key].tobytes() == arrays[1][key].tobytes() for key in arrays[0])


@pytest.mark.parametrize(
    ('key', 'absurd'),
    [
        ('line', [2.0, 0.01, 0.5]),
        ('line', [-2.0, 0.01, 0.5, 0.01]),
        ('line', [2.0, 0.01, 0.5, 0.0]),
        ('largest_v', -1.0),
        ('is_paused', 3),
        ('standstill_pauses', np.zeros((3, 3))),
        ('standstill_peaks', np.zeros((0, 2))),
        ('standstill_peaks', np.zeros((999, 2))),
        ('standstill_block', np.full((3, 2), np.nan)),
        ('standstill_block', np.zeros((BLOCK, 2))),
    ],
)
def test_what_no_pauses_can_have_left_is_refused(key: str, absurd: object) -> None:
    plain, arrays = collected(pauses(16)).state()
    target = plain if key in plain else arrays
    target[key] = absurd
    with pytest.raises(CheckpointError):
        Standstills.restored(plain, arrays)


def test_a_line_is_saved() -> None:
    line = StandstillLine(2.0, 0.01, 0.5, 0.02)
    assert StandstillLine.restored({'line': line.state()}, 'line') == line
    assert set(line.beliefs) == {'resistance', 'brush_drop'}
    assert set(StandstillLine(2.0, 0.01).beliefs) == {'resistance'}


ARM = replace(GEAR_MOTOR, coulomb_friction=4e-3, brush_drop=0.6)
GEAR_RATIO = 60.0
GRAVITY_NM = 0.02


@cache
def arm_that_pauses(samples: int, seed: int = 1) -> Recording:
    """An arm behind brushes that is driven to one place after another, and pauses there."""
    rng = np.random.default_rng(seed)
    simulation = Simulation(
        {'motor': ARM}, 'external', seed=seed, sample_rate_hz=1000.0, torque_noise_std=3e-4,
        speed_mode='rotor',
    )  # fmt: skip
    goal_rad = begin_rad = angle_rad = 0.0
    left = span = 1
    taken = []
    for _ in range(samples):
        left -= 1
        if left == 0:
            begin_rad = goal_rad
            goal_rad = rng.uniform(-1.5, 1.5)
            span = round(rng.uniform(300, 700))
            left = span + round(rng.uniform(400, 1200))
            pause = left - span
        moved = min(1.0, (span + pause - left) / span) if taken else 0.0
        wanted_rad = begin_rad + moved * (goal_rad - begin_rad)
        speed = float(taken[-1].speed_rad_s[0]) if taken else 0.0
        volts = 60.0 * (wanted_rad - angle_rad) - 0.015 * speed
        simulation.command('motor', float(np.clip(volts, -12.0, 12.0)))
        load = replace(ARM, load_torque=GRAVITY_NM * float(np.sin(angle_rad)))
        simulation.set_parameters({'motor': load})
        taken.append(simulation.step())
        angle_rad += 1e-3 * float(taken[-1].speed_rad_s[0]) / GEAR_RATIO
    return recording_of(taken)


@pytest.mark.slow
def test_an_arm_behind_brushes_is_known_by_its_pauses() -> None:
    observer = Observer(Configuration.from_flat(CONSTANTS), None)
    feed(observer, [arm_that_pauses(26_000)])
    motor = observer.motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert set(motor.added_effects) == {VARYING_LOAD, 'brush_drop'}
    value, _, verdict = told(motor, 'resistance')
    assert verdict is Verdict.IDENTIFIED
    assert value == pytest.approx(ARM.resistance, rel=0.01)
    assert told(motor, 'brush_drop')[0] == pytest.approx(ARM.brush_drop, rel=0.03)
