"""The data of the benchmarks: motors, excitations and seeded recordings with torque noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from common.motion import FloatArray, Form, Inputs
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation

START_FACTOR = 3.0
"""Every method starts with every parameter this many times off."""

SOLVER_STEPS_PER_SAMPLE = 5
"""At least; the plant's solution is then exact to 1e-6 of the torque's spread, far below what is
measured."""


THESIS_MOTOR = PlantParameters()


@dataclass(frozen=True, slots=True)
class Case:
    """One data set: a motor under an excitation, sampled at a rate.

    Attributes:
        name: short, for tables.
        excitation: in the language of the simulator.
        plant: the truth.
        rate_hz: samples a second.
        duration_s: length of one recording.
        parameters: what is identified.
        rotor: speed is a state of the plant and measured; else ``w = Kt i``.
        core: whether the figures to reach are stated for this set.
    """

    name: str
    excitation: str
    plant: PlantParameters = THESIS_MOTOR
    rate_hz: float = 100.0
    duration_s: float = 60.0
    parameters: tuple[str, ...] = ('inductance', 'resistance', 'hysteresis')
    rotor: bool = False
    core: bool = True

    @property
    def form(self) -> Form:
        """The equation with its unknowns."""
        return Form(
            self.parameters, self.plant.torque_constant, self.plant.back_emf_constant, self.rotor
        )

    @property
    def truth(self) -> FloatArray:
        """True values, shape (parameter,)."""
        return np.array([getattr(self.plant, name) for name in self.parameters])

    def start(self, seed: int, either_way: bool) -> FloatArray:
        """Where identification starts, shape (parameter,).

        Every parameter three times too large; or ``either_way``: each two to three times too large
        or too small, drawn anew for every seed. With all too large by the same factor, R/L and
        K_HS/L are right from the beginning, and a filter that lives in these coordinates is told
        the truth in passing.
        """
        if not either_way:
            return START_FACTOR * self.truth
        random = np.random.default_rng([seed, 3])
        factors = random.uniform(2.0, START_FACTOR, len(self.parameters))
        return self.truth * factors ** random.choice([-1.0, 1.0], len(self.parameters))


FAST_MOTOR = PlantParameters(
    inductance=0.003,
    resistance=0.6,
    hysteresis=0.0896,
    torque_constant=0.05,
    back_emf_constant=0.05,
)
"""Electrical time constant 5 ms; at 10 V its steady current is 14.9 A and hysteresis takes 1 V of
the 10."""

ROTOR_MOTOR = PlantParameters(
    inductance=0.05,
    resistance=1.0,
    hysteresis=0.002,
    torque_constant=0.05,
    back_emf_constant=0.05,
    inertia=4e-3,
    viscous_friction=1e-3,
)
"""At 10 V it runs at about 135 rad/s: back-EMF takes 6.6 V, resistance 2.7 V, hysteresis 0.7 V.

The load's inertia keeps speed nearly straight between samples; what is left of its bend, 4e-4 of
the current's spread, every method suffers.
"""

CASES = (
    Case('training', 'R[1,2]D[3,3]'),
    Case('long holds', 'R[5,15]D[1,20]'),
    Case('short holds', 'R[5,15]D[0.001,2]'),
    Case(
        'fast motor', 'R[5,15]D[0.001,0.1]', FAST_MOTOR, rate_hz=1000.0, duration_s=6.0, core=False
    ),
    Case(
        'rotor',
        'R[5,15]D[0.001,2]',
        ROTOR_MOTOR,
        parameters=('inductance', 'resistance', 'hysteresis', 'back_emf_constant'),
        rotor=True,
        core=False,
    ),
)


@dataclass(frozen=True, slots=True)
class Record:
    """One recording of one motor; sample k's voltage is held from its stamp to the next.

    Attributes:
        case: what was recorded.
        seed: of the excitation, and of the noise added to it.
        noise: standard deviation of the torque noise as a fraction of that of the torque.
        stamp_ns: shape (sample,).
        voltage_v: shape (sample,): as reported; wrong where outliers were put in.
        torque_nm: shape (sample,): measured.
        true_torque_nm: shape (sample,).
        speed_rad_s: shape (sample,): measured speed, free of noise; NaN where there is none.
        noise_nm: the standard deviation in N m.
        start: shape (parameter,): where every method starts.
    """

    case: Case
    seed: int
    noise: float
    stamp_ns: NDArray[np.int64]
    voltage_v: FloatArray
    torque_nm: FloatArray
    true_torque_nm: FloatArray
    speed_rad_s: FloatArray
    noise_nm: float
    start: FloatArray

    @property
    def time_s(self) -> FloatArray:
        """Time since the first sample, shape (sample,)."""
        return (self.stamp_ns - self.stamp_ns[0]) * 1e-9

    @property
    def inputs(self) -> Inputs:
        """The signals between the samples."""
        return Inputs(np.diff(self.stamp_ns) * 1e-9, self.voltage_v[:-1], self.speed_rad_s)

    @property
    def noise_a(self) -> float:
        """Standard deviation of the measured current, T / Kt."""
        return self.noise_nm / self.case.plant.torque_constant


@dataclass(frozen=True, slots=True)
class Clean:
    """Noise-free recordings of one case, one motor per seed; noise is added to copies later."""

    case: Case
    seeds: tuple[int, ...]
    stamp_ns: NDArray[np.int64]
    voltage_v: FloatArray
    torque_nm: FloatArray
    speed_rad_s: FloatArray

    def record(
        self, seed: int, noise: float, *, outliers: str = '', either_way: bool = False
    ) -> Record:
        """Add white torque noise and, where asked, gross outliers to ``torque`` or ``voltage``.

        One sample in a hundred is an outlier, by up to 20 standard deviations: of the torque noise,
        or for the voltage of the same fraction of its own spread.
        """
        m = self.seeds.index(seed)
        truth = self.torque_nm[m]
        voltage = self.voltage_v[m]
        random = np.random.default_rng([seed, round(1e5 * noise), 20])
        sigma = noise * float(truth.std())
        torque = truth + sigma * random.standard_normal(truth.size)
        hit = random.random(truth.size) < 0.01
        size = random.uniform(-20.0, 20.0, truth.size) * hit
        if outliers == 'torque':
            torque = torque + sigma * size
        elif outliers == 'voltage':
            voltage = voltage + noise * float(voltage.std()) * size
        speed = self.speed_rad_s[m] if self.case.rotor else np.full(truth.size, np.nan)
        start = self.case.start(seed, either_way)
        return Record(
            self.case, seed, noise, self.stamp_ns, voltage, torque, truth, speed, sigma, start
        )


def simulate(
    case: Case, seeds: Sequence[int], duration_s: float | None = None, schedule: Sequence[str] = ()
) -> Clean:
    """Record a case without noise, one excitation a seed.

    Args:
        case: what to record.
        seeds: of the excitations.
        duration_s: length, the case's own unless given.
        schedule: changes of the one motor, named ``motor``.
    """
    parts = []
    for seed in seeds:
        simulation = Simulation(
            {'motor': case.plant},
            case.excitation,
            sample_rate_hz=case.rate_hz,
            seed=seed,
            speed_mode='rotor' if case.rotor else 'thesis',
            solver_step_s=1.0 / (SOLVER_STEPS_PER_SAMPLE * case.rate_hz),
            schedule=schedule,
        )
        parts.append(simulation.record(duration_s or case.duration_s))
    return Clean(
        case,
        tuple(seeds),
        parts[0].stamp_ns,
        np.concatenate([part.voltage_v for part in parts]),
        np.concatenate([part.true_torque_nm for part in parts]),
        np.concatenate([part.speed_rad_s for part in parts]),
    )
