"""Motors whose names are mixed up in one signal are told from each other, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.mixed_signals import mix_up
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.replay_buffer import SPEED, TORQUE, VOLTAGE
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box.interface import Array

NAMES = ('left', 'right', 'lift')
RATE_HZ = 200.0


@pytest.fixture(scope='module')
def recording() -> Recording:
    """Three geared motors, each driven by steps of its own."""
    plants = {
        name: PlantParameters(
            inductance=0.01,
            resistance=1.0 + k,
            hysteresis=0.0,
            torque_constant=0.04,
            back_emf_constant=0.04,
            inertia=5e-5,
            viscous_friction=1e-6,
        )
        for k, name in enumerate(NAMES)
    }
    simulation = Simulation(
        plants,
        'R[-12,12]D[0.05,0.3]',
        seed=7,
        sample_rate_hz=RATE_HZ,
        solver_step_s=5e-4,
        speed_mode='rotor',
        torque_noise_relative=0.01,
    )
    return simulation.record(6.0)


def samples_of(run: Recording, *, has_speed: bool = True) -> dict[str, Array]:
    """Return the samples of every motor, shape (signal, n)."""
    interval_s = np.diff(run.stamp_ns, prepend=run.stamp_ns[0]) / 1e9
    held_v = np.concatenate([run.voltage_v[:, :1], run.voltage_v[:, :-1]], axis=1)
    speed = run.speed_rad_s if has_speed else np.full_like(run.speed_rad_s, np.nan)
    return {
        name: np.stack([interval_s, held_v[k], run.torque_nm[k], speed[k]])
        for k, name in enumerate(NAMES)
    }


def swapped(samples: dict[str, Array], *rows: int) -> dict[str, Array]:
    """Exchange some signals of the first two motors."""
    changed = {name: own.copy() for name, own in samples.items()}
    for row in rows:
        changed['left'][row] = samples['right'][row]
        changed['right'][row] = samples['left'][row]
    return changed


@pytest.mark.parametrize('has_speed', [True, False])
def test_swapped_currents_and_swapped_voltages_are_told(
    recording: Recording, has_speed: bool
) -> None:
    right = samples_of(recording, has_speed=has_speed)
    for rows, signal in (((TORQUE,), 'current'), ((TORQUE, SPEED), 'voltage')):
        wrong = swapped(right, *rows)
        for motor, other in (('left', 'right'), ('right', 'left')):
            mixed = mix_up(motor, wrong)
            assert mixed is not None
            assert mixed.other == other
            if has_speed:
                assert mixed.signal == signal
            assert f'{motor}.joint: {other}' in mixed.sentence
        assert mix_up('lift', wrong) is None


def test_right_names_and_unlike_stamps_tell_nothing(recording: Recording) -> None:
    right = samples_of(recording)
    assert [mix_up(name, right) for name in NAMES] == [None] * 3
    wrong = swapped(right, TORQUE)
    wrong['right'] = wrong['right'][:, :-1]
    assert mix_up('left', wrong) is None
    assert (
        mix_up('left', {name: own[:, :100] for name, own in swapped(right, TORQUE).items()}) is None
    )


def test_a_wiring_that_fits_neither_motor_is_no_mix_up(recording: Recording) -> None:
    wrong = samples_of(recording)
    wrong['left'][VOLTAGE] = np.random.default_rng(1).uniform(-12.0, 12.0, wrong['left'].shape[1])
    assert mix_up('left', wrong) is None


def test_a_broken_sensor_of_two_wheels_that_are_driven_alike_is_no_mix_up(
    recording: Recording,
) -> None:
    alike = samples_of(recording)
    alike['right'] = alike['left'].copy()
    noise = np.random.default_rng(2).standard_normal(alike['left'].shape[1])
    alike['left'][TORQUE] = 1e-3 * noise
    assert mix_up('left', alike) is None


def test_the_observer_says_which_motors_are_mixed_up(recording: Recording) -> None:
    values = {'torque_constant': 0.04, 'back_emf_constant': 0.04}
    settings = {f'{motor}.{name}': value for motor in NAMES for name, value in values.items()}
    observer = Observer(Configuration.from_flat({'motors': list(NAMES), **settings}), None)
    for k, stamp_ns in enumerate((10**9 + recording.stamp_ns).tolist()):
        observer.ingest('voltage', NAMES, stamp_ns, recording.voltage_v[:, k])
        order = [1, 0, 2]
        torque_nm = recording.torque_nm[order, k]
        speed = recording.speed_rad_s[order, k]
        observer.ingest('torque', NAMES, stamp_ns, torque_nm, speed)
    mixed = observer.mix_up('left')
    assert mixed is not None
    assert (mixed.other, mixed.signal) == ('right', 'voltage')
    assert observer.fit('lift').verdict is not FitVerdict.MISFIT
    assert observer.mix_up('lift') is None
