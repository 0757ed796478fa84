"""Data of the experiment: one training and one validation recording, eight test sets.

No seed is used twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.excitation import TABLE_5_1
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.white_box.interface import Array

SETS = tuple(TABLE_5_1.values())
"""The eight sets in the order of the table's columns; noise is on the voltage, where the thesis has
it."""

TRAINING_SET = SETS[0]

MOTOR = PlantParameters()
"""The thesis's (5.1.1), which is the simulator's default."""

PLAIN_SETS_OUT_OF_RANGE = tuple(
    name for name in SETS if name.startswith(('R[5,15]', 'R[0,33]')) and '+' not in name
)
"""Four: voltages that training never saw, nothing added to them."""

STEP_S = 0.01
"""Of solver and logger (thesis 4.1.2)."""


class Role(IntEnum):
    """What a recording is for."""

    TRAINING = 0
    VALIDATION = 1
    TEST = 2


def seed_of(run: int, role: Role) -> int:
    """Seed of the simulator: no two runs and roles share one."""
    return len(Role) * run + role


@dataclass(frozen=True, slots=True)
class Series:
    """Regularly sampled recordings of equal length, free of sensor noise.

    Attributes:
        names: shape (set,): excitations.
        seed: of the simulator.
        stamp_ns: shape (sample,).
        voltage_v: shape (set, sample): mean over the interval that ends at the sample; the first is
            that of the second.
        torque_nm: shape (set, sample): at the stamp.
    """

    names: tuple[str, ...]
    seed: int
    stamp_ns: NDArray[np.int64]
    voltage_v: Array
    torque_nm: Array

    @property
    def interval_s(self) -> float:
        """Time between two samples."""
        return float(self.stamp_ns[1] - self.stamp_ns[0]) * 1e-9


@dataclass(frozen=True, slots=True)
class Recordings:
    """Everything one run is allowed to see, and what it is judged by."""

    training: Series
    validation: Series
    tests: Series


def record(excitations: Sequence[str], seed: int, duration_s: float, every: int) -> Series:
    """Record the thesis's motor under each excitation.

    Args:
        excitations: one a set.
        seed: of the levels and of the noise on the voltage.
        duration_s: length.
        every: keep one record in so many (thesis 4.1.2); voltages in between are averaged, not
            lost.
    """
    motors = {f'set_{j}': MOTOR for j in range(len(excitations))}
    simulation = Simulation(
        motors,
        dict(zip(motors, excitations, strict=True)),
        sample_rate_hz=1.0 / STEP_S,
        seed=seed,
        solver_step_s=STEP_S,
    )
    whole = simulation.record(duration_s)
    kept = whole.stamp_ns[::every]
    held = (
        whole.voltage_v[:, : every * (kept.size - 1)]
        .reshape(len(excitations), -1, every)
        .mean(axis=2)
    )
    voltage = np.concatenate([held[:, :1], held], axis=1)
    return Series(tuple(excitations), seed, kept, voltage, whole.true_torque_nm[:, ::every])


def record_all(run: int, training_s: float, test_s: float, every: int) -> Recordings:
    """Record what one run needs; validation is half as long as training."""
    return Recordings(
        record([TRAINING_SET], seed_of(run, Role.TRAINING), training_s, every),
        record([TRAINING_SET], seed_of(run, Role.VALIDATION), 0.5 * training_s, every),
        record(SETS, seed_of(run, Role.TEST), test_s, every),
    )
