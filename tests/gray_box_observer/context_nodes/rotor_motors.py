"""Records of a motor with a rotor whose speed is not measured, by the simulator."""

from __future__ import annotations

from functools import cache

import numpy as np

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
KT = KB = 0.02
THETA = np.array([4e-3, 2.0, 1e-5, 1e-5, 8.4e-3])
BOX = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})
INITIAL = np.array([[parameter.initial for parameter in BOX.parameters]])
PARAMETERS = {
    'motor.torque_constant': KT,
    'motor.back_emf_constant': KB,
    'motor.speed_source': 'rotor',
}


@cache
def recorded(
    excitation: str = 'R[-12,12]D[0.05,0.5]',
    duration_s: float = 3.0,
    seed: int = 1,
    *,
    noise: float = 0.01,
    rate_hz: float = 1000.0,
) -> Recording:
    """Record the motor; noise as a share of the torque's spread."""
    inductance, resistance, inertia, viscous, coulomb = THETA.tolist()
    plant = PlantParameters(
        inductance=inductance, resistance=resistance, hysteresis=0.0, torque_constant=KT,
        back_emf_constant=KB, inertia=inertia, viscous_friction=viscous, coulomb_friction=coulomb,
    )  # fmt: skip
    simulation = Simulation(
        {'motor': plant}, excitation, seed=seed, speed_mode='rotor', sample_rate_hz=rate_hz,
        torque_noise_std=noise * KT * 1.5,
    )  # fmt: skip
    return simulation.record(duration_s)


def samples_of(recording: Recording) -> list[Sample]:
    """Return the samples without speed, as pairing would make them."""
    stamps = recording.stamp_ns
    return [
        Sample.of_one_motor(
            int(stamps[k]),
            0.0 if k == 0 else (stamps[k] - stamps[k - 1]) / 1e9,
            float(recording.voltage_v[0, max(k - 1, 0)]),
            float(recording.torque_nm[0, k]),
        )
        for k in range(stamps.size)
    ]


def content_of(recording: Recording) -> np.ndarray:
    """Return the samples as a replay buffer has them, shape (signal, n)."""
    stamps = recording.stamp_ns / 1e9
    voltage = np.concatenate([[0.0], recording.voltage_v[0, :-1]])
    interval = np.diff(stamps, prepend=stamps[:1])
    return np.stack([interval, voltage, recording.torque_nm[0], np.zeros(stamps.size)])
