"""A motor with a rotor that changes between two of its fits is soon believed no more."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.fit_schedule import RECENT_WAIT
from gray_box_observer.fit_test.window_test import RECENT
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

pytestmark = pytest.mark.slow

RATE_HZ = 250.0
LEARNT_S, FOLLOWED_S = 5.6, 2.4  # between the fits at 1370 and 2060 samples
HEALTHY = PlantParameters(
    inductance=4e-3, resistance=2.0, hysteresis=0.0, torque_constant=0.02, back_emf_constant=0.02,
    inertia=1e-5, viscous_friction=1e-5, coulomb_friction=8.4e-3,
)  # fmt: skip
HOT = replace(HEALTHY, resistance=1.15 * HEALTHY.resistance)
CONFIGURATION = Configuration.from_flat(
    {
        'motor.torque_constant': 0.02,
        'motor.back_emf_constant': 0.02,
        'motor.speed_source': 'rotor',
        'motor.stamps_exact': True,
    }
)


@cache
def recorded(plant: PlantParameters, duration_s: float, seed: int) -> Recording:
    simulation = Simulation(
        {'motor': plant}, 'R[-12,12]D[0.05,0.5]', seed=seed, sample_rate_hz=RATE_HZ,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    return simulation.record(duration_s)


def feed(observer: Observer, recording: Recording, begin_ns: int) -> None:
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        observer.voltage('motor', begin_ns + stamp, float(recording.voltage_v[0, k]))
        observer.torque('motor', begin_ns + stamp, float(recording.torque_nm[0, k]))


def followed(plant: PlantParameters) -> Observer:
    """Return an observer of a healthy motor that goes on as another one."""
    observer = Observer(CONFIGURATION)
    feed(observer, recorded(HEALTHY, LEARNT_S, 1), 0)
    motor = observer.motors['motor']
    assert motor.identified
    before = motor.estimate.value.copy()
    feed(observer, recorded(plant, FOLLOWED_S, 2), round((LEARNT_S + 1.0 / RATE_HZ) * 1e9))
    assert (motor.estimate.value == before).all(), 'no fit has come since'
    return observer


def test_a_winding_that_gets_hot_at_once_makes_a_misfit_before_the_next_fit() -> None:
    assert 2 * RECENT_WAIT < FOLLOWED_S * RATE_HZ < RECENT + RECENT_WAIT
    motor = followed(HOT).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.fit.suspects[0].effect == 'change'
    assert not motor.identified


def test_a_motor_that_stays_as_it_is_stays_believed() -> None:
    motor = followed(HEALTHY).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.identified


def test_a_restored_motor_is_tested_at_the_same_sample(tmp_path: Path) -> None:
    observer = Observer(CONFIGURATION)
    feed(observer, recorded(HEALTHY, LEARNT_S, 1), 0)
    checkpoint.save(observer, tmp_path / 'state.safetensors')
    again = Observer(CONFIGURATION)
    checkpoint.load(again, tmp_path / 'state.safetensors')
    states = [
        one.motors['motor'].observer.state()[0]['fit']['tested_at'] for one in (observer, again)
    ]
    assert states[0] == states[1] < 0
