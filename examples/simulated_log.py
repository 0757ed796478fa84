"""Writes the log of a simulated gear motor, as the board of a small robot would log it.

    ros_ws/run.sh python examples/simulated_log.py trial/log.csv

It stands in for your own log in docs/TUTORIAL.md. An H-bridge drives the motor from a battery. The
motor drives a wheel through a gear of 30 to 1, and an encoder on the wheel's shaft gives the speed.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dc_motor_sim.errors import SimulationError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation

NAME = 'simulated_log'

TRUTH = PlantParameters(
    inductance=2.3e-3,
    resistance=2.1,
    hysteresis=0.0,
    torque_constant=0.022,
    back_emf_constant=0.022,
    inertia=1.2e-5,
    viscous_friction=2e-6,
    coulomb_friction=2e-3,
)
"""The motor, at its own shaft in front of the gear."""

GEAR_RATIO = 30.0
"""Turns of the motor in one turn of the output shaft."""

EXCITATION = 'R[-10,10]D[0.05,0.5]'
"""A new voltage between -10 and 10 V every 0.05 to 0.5 s."""

CURRENT_NOISE_A = 0.01
CURRENT_STEP_A = 0.005
SPEED_NOISE_RAD_S = 0.2

BATTERY_V = 12.0
BATTERY_SWING_V = 0.3
BATTERY_RAD_S = 0.7
"""The battery wanders slowly about its nominal voltage."""

COLUMNS = ('t_s', 'duty', 'battery_V', 'i_A', 'speed_rpm')


@dataclass(frozen=True, slots=True)
class Encoder:
    """How the board makes a speed of the encoder.

    Attributes:
        counts: edges in one turn of the motor; the speed is the edges of one sample. 0: no steps.
        window: samples over which the board averages the speed, which makes it late.
    """

    counts: int = 0
    window: int = 1

    def step_rad_s(self, rate_hz: float) -> float:
        """Return the smallest difference between two speeds in rad/s; 0 for none."""
        return 2.0 * math.pi / self.counts * rate_hz if self.counts else 0.0

    def averaged(self, speed_rad_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean of the newest samples, shape (sample,)."""
        weights = np.full(self.window, 1.0 / self.window)
        return np.convolve(speed_rad_s, weights)[: speed_rad_s.size]


EXIT_USER_ERROR = 2


def write_log(
    path: Path,
    duration_s: float = 20.0,
    rate_hz: float = 1000.0,
    seed: int = 1,
    encoder: Encoder | None = None,
) -> int:
    """Simulate the motor and write its log; return the number of rows.

    Args:
        path: of the CSV file.
        duration_s: of the log in s.
        rate_hz: rows a second.
        seed: of voltage and noise; the same seed gives the same file.
        encoder: what makes the speed; None: one with fine steps.

    Raises:
        SimulationError: a number is out of range.
        OSError: the file cannot be written.
    """
    encoder = encoder or Encoder()
    recording = Simulation(
        {'motor': TRUTH},
        EXCITATION,
        sample_rate_hz=rate_hz,
        seed=seed,
        speed_mode='rotor',
        torque_noise_std=CURRENT_NOISE_A * TRUTH.torque_constant,
        torque_quantisation=CURRENT_STEP_A * TRUTH.torque_constant,
        speed_noise_std=SPEED_NOISE_RAD_S,
        speed_quantisation=encoder.step_rad_s(rate_hz),
    ).record(duration_s)
    time_s = recording.stamp_ns * 1e-9
    battery_v = BATTERY_V + BATTERY_SWING_V * np.sin(BATTERY_RAD_S * time_s)
    duty = recording.voltage_v[0] / battery_v
    current_a = recording.torque_nm[0] / TRUTH.torque_constant
    motor_rad_s = encoder.averaged(recording.speed_rad_s[0])
    output_rpm = motor_rad_s / GEAR_RATIO * 60.0 / (2.0 * math.pi)
    columns = (time_s, duty, battery_v, current_a, output_rpm)
    with path.open('w', newline='', encoding='utf-8') as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for row in zip(*columns, strict=True):
            table.writerow([f'{value:.5f}' for value in row])
    return time_s.size


def main() -> int:
    """Write the log; the result is the exit code."""
    parser = argparse.ArgumentParser(prog=NAME, description='Write the log of a simulated motor.')
    default = 'default: %(default)s'
    parser.add_argument('log', type=Path, metavar='LOG.csv', help='file to write')
    parser.add_argument('--duration', type=float, default=20.0, help=f'in s ({default})')
    parser.add_argument('--rate', type=float, default=1000.0, help=f'rows a second ({default})')
    parser.add_argument('--seed', type=int, default=1, help=f'of voltage and noise ({default})')
    parser.add_argument(
        '--counts',
        type=int,
        default=0,
        help='encoder edges in a turn of the motor, 0: no steps (%(default)s)',
    )
    parser.add_argument('--window', type=int, default=1, help=f'samples in a speed ({default})')
    options = parser.parse_args()
    if options.counts < 0 or options.window < 1:
        wrong = '--counts must not be negative and --window must be at least 1'
        parser.exit(EXIT_USER_ERROR, f'{NAME}: error: {wrong}\n')
    encoder = Encoder(options.counts, options.window)
    try:
        rows = write_log(options.log, options.duration, options.rate, options.seed, encoder)
    except (SimulationError, OSError) as error:
        parser.exit(EXIT_USER_ERROR, f'{NAME}: error: {error}\n')
    print(f'{rows} rows in {options.log}: {", ".join(COLUMNS)}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
