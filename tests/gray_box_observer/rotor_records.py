"""A motor with a rotor that turns freely, recorded without its speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Sample, Simulation
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.observer.builder import motor_observer
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample as PairedSample
from gray_box_observer.settings.configuration import Configuration

GEAR_MOTOR = PlantParameters(
    inductance=4e-3, resistance=2.0, hysteresis=0.0, torque_constant=0.02, back_emf_constant=0.02,
    inertia=1e-5, viscous_friction=1e-5, coulomb_friction=8.4e-3,
)  # fmt: skip
STICKY_MOTOR = PlantParameters(
    inductance=0.011, resistance=5.8, hysteresis=0.0, torque_constant=0.013,
    back_emf_constant=0.013, inertia=2.1e-6, viscous_friction=6.6e-7, coulomb_friction=1.4e-3,
)  # fmt: skip
"""Its shaft begins to turn at 0.6 V."""

CONSTANTS = {'motor.torque_constant': 0.02, 'motor.back_emf_constant': 0.02}
LIVELY = 'R[-12,12]D[0.05,0.5]'


@cache
def recorded(
    plant: PlantParameters, excitation: str, duration_s: float, seed: int, rate_hz: float = 1000.0
) -> Recording:
    """Record a motor with 1 % noise; one with K_HS moves as in the thesis, others have a rotor."""
    simulation = Simulation(
        {'motor': plant}, excitation, seed=seed, sample_rate_hz=rate_hz, torque_noise_std=3e-4,
        speed_mode='rotor' if plant.hysteresis == 0.0 else 'thesis',
    )  # fmt: skip
    return simulation.record(duration_s)


def driven(
    plant: PlantParameters, voltage_v: NDArray[np.float64], seed: int = 3, noise_nm: float = 3e-4
) -> Recording:
    """Record a motor under a given voltage at 1 kHz, with 1 % noise of a lively torque."""
    simulation = Simulation(
        {'motor': plant}, 'external', seed=seed, sample_rate_hz=1000.0, torque_noise_std=noise_nm,
        speed_mode='rotor',
    )  # fmt: skip
    samples = []
    for volts in voltage_v.tolist():
        simulation.command('motor', volts)
        samples.append(simulation.step())
    return recording_of(samples)


STEPS = 5
"""Steps of :func:`recorded_in_steps` in a sample interval of 1 ms."""


@cache
def recorded_in_steps(late: int, samples: int = 3000) -> Recording:
    """Record the gear motor in steps; its voltage moves so many of them behind a sample."""
    rng = np.random.default_rng(5)
    simulation = Simulation(
        {'motor': GEAR_MOTOR}, 'external', seed=6, sample_rate_hz=1e3 * STEPS,
        torque_noise_std=3e-4, speed_mode='rotor',
    )  # fmt: skip
    levels_v = [np.full(n, rng.uniform(-12.0, 12.0)) for n in rng.integers(2, 300, 99)]
    voltage_v = np.concatenate(levels_v)
    taken = []
    for step in range(samples * STEPS):
        place, rest = divmod(step - late, STEPS)
        if rest == 0 and place >= 0:
            simulation.command('motor', float(voltage_v[place % voltage_v.size]))
        taken.append(simulation.step())
    return recording_of(taken)


def recorded_under(
    plant: PlantParameters, load_nm: Callable[[float], float], samples: int, seed: int
) -> Recording:
    """Record a lively motor at 1 kHz, with 1 % noise, whose load follows its angle in rad."""
    simulation = Simulation(
        {'motor': plant}, LIVELY, seed=seed, sample_rate_hz=1000.0, torque_noise_std=3e-4,
        speed_mode='rotor',
    )  # fmt: skip
    taken = []
    angle_rad = 0.0
    for _ in range(samples):
        simulation.set_parameters({'motor': replace(plant, load_torque=load_nm(angle_rad))})
        taken.append(simulation.step())
        angle_rad += 1e-3 * float(taken[-1].speed_rad_s[0])
    return recording_of(taken)


def counted_speed(
    speed_rad_s: NDArray[np.float64], counts: int, rate_hz: float = 1000.0
) -> NDArray[np.float64]:
    """Return a speed as an encoder of so many counts a turn has it, over every interval."""
    unit_rad = 2.0 * np.pi / counts
    turned_rad = np.cumsum(0.5 * (speed_rad_s[1:] + speed_rad_s[:-1])) / rate_hz
    count = np.floor(np.concatenate([[0.3], 0.3 + turned_rad]) / unit_rad)
    return np.asarray(np.diff(count, prepend=count[0]) * unit_rad * rate_hz)


def recording_of(samples: Sequence[Sample]) -> Recording:
    """Put the samples of one motor together."""
    stamps = np.array([sample.stamp_ns for sample in samples])
    names = ('voltage_v', 'torque_nm', 'true_torque_nm', 'speed_rad_s')
    signals = (np.stack([getattr(one, name) for one in samples], axis=1) for name in names)
    return Recording(('motor',), stamps, *signals)


def feed(observer: Observer, recordings: Sequence[Recording], begin_ns: int = 0) -> int:
    """Feed recordings one after another; return the stamp behind them."""
    for recording in recordings:
        for k, stamp in enumerate(recording.stamp_ns.tolist()):
            observer.voltage('motor', begin_ns + stamp, float(recording.voltage_v[0, k]))
            observer.torque('motor', begin_ns + stamp, float(recording.torque_nm[0, k]))
        begin_ns += int(recording.stamp_ns[-1]) + 1_000_000
    return begin_ns


def part(record: Recording, samples: int) -> Recording:
    """Return the first samples of a record."""
    kept = slice(samples)
    return replace(
        record, stamp_ns=record.stamp_ns[kept], voltage_v=record.voltage_v[:, kept],
        torque_nm=record.torque_nm[:, kept], true_torque_nm=record.true_torque_nm[:, kept],
        speed_rad_s=record.speed_rad_s[:, kept],
    )  # fmt: skip


def resistance_claims(
    observer: Observer,
    recording: Recording,
    resistance_ohm: float,
    speed_rad_s: Sequence[float] | None = None,
) -> list[tuple[int, float, float]]:
    """Feed a recording; return sample, error and deviation of R wherever it was identified.

    Error and deviation are relative to the true resistance.
    """
    claims = []
    for k, stamp in enumerate(recording.stamp_ns.tolist()):
        observer.voltage('motor', stamp, float(recording.voltage_v[0, k]))
        speed = () if speed_rad_s is None else (speed_rad_s[k],)
        results = observer.torque('motor', stamp, float(recording.torque_nm[0, k]), *speed)
        for estimate in [one.estimate for one in results if one.estimate is not None]:
            if estimate.verdicts[0][1] is Verdict.IDENTIFIED:
                error = float(estimate.value[0, 1] / resistance_ohm - 1.0)
                claims.append((k, error, float(estimate.std[0, 1] / resistance_ohm)))
    return claims


def samples_of(record: Recording, *, has_speed: bool = False) -> list[PairedSample]:
    """Return samples of one motor at 1 kHz, as pairing would make them."""
    return [
        PairedSample.of_one_motor(
            stamp,
            1e-3 if k else 0.0,
            float(record.voltage_v[0, max(k - 1, 0)]),
            float(record.torque_nm[0, k]),
            float(record.speed_rad_s[0, k]) if has_speed else math.nan,
        )
        for k, stamp in enumerate(record.stamp_ns.tolist())
    ]


def made(source: str = 'auto') -> MotorObserver:
    """Return a motor that has learnt nothing, its predictor left out."""
    configuration = Configuration.from_flat({**CONSTANTS, 'motor.speed_source': source})
    motors = list(configuration.motors.values())
    return motor_observer(configuration, motors, None, speed_measured=False)


def observed(
    record: Recording, speed_rad_s: NDArray[np.float64] | None = None, **values: object
) -> Observer:
    """Return an observer of a record, with its speed where that is measured."""
    observer = Observer(Configuration.from_flat({**CONSTANTS, **values}))
    if speed_rad_s is None:
        feed(observer, [record])
        return observer
    signals = (record.voltage_v[0], record.torque_nm[0], speed_rad_s)
    for stamp, volt, torque, speed in zip(record.stamp_ns, *signals, strict=True):
        observer.voltage('motor', int(stamp), float(volt))
        observer.torque('motor', int(stamp), float(torque), float(speed))
    return observer


def told(motor: MotorView, name: str) -> tuple[float, float, Verdict]:
    """Return value, standard deviation and verdict of a parameter."""
    estimate = motor.estimate
    place = [parameter.name for parameter in estimate.parameters].index(name)
    value, std = float(estimate.value[0, place]), float(estimate.std[0, place])
    return value, std, estimate.verdicts[0][place]
