"""Lets the core run for simulated hours: estimates true, covariance honest, memory flat.

    python tests/faults/soak.py [--hours 24] [--rate 100] [--seed 1] [--predictor]

The simulator and the observer run in this process, as fast as they can. Through two nodes it is
`node_soak`.

Prints a table and one line of JSON; ends with 1 if a figure is not reached.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import psutil
from figures import Figure, growth, tell
from tqdm import tqdm

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

TRUTH = np.array([0.5, 1.0, 10.0])
LOOK_EVERY_S = 60
"""Simulated seconds between two looks at estimates and memory."""
SETTLING_S = 600
"""What comes before is not judged."""


class NoTraining:
    """A predictor that is not taught: what is left of it runs in the sample path."""

    is_resting = True
    busy = False
    failure = None

    def __init__(self, _configuration: dict[str, Any]) -> None:
        pass

    def submit(self, _job: dict[str, Any]) -> None:
        """Take a job."""

    def collect(self) -> None:
        """Give nothing."""

    def close(self) -> None:
        """End nothing."""


def main() -> int:
    """Run the hours; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--hours', type=float, default=24.0, help='simulated')
    parser.add_argument('--rate', type=float, default=100.0, help='samples a second')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--predictor', action='store_true', help='predict as well, without training'
    )
    options = parser.parse_args()
    simulation = Simulation(
        {'motor': PlantParameters()},
        'R[5,15]D[0.1,1]',
        seed=options.seed,
        sample_rate_hz=options.rate,
        torque_noise_std=1e-4,
    )
    observer = Observer(Configuration.from_flat({}), NoTraining if options.predictor else None)
    minutes = round(options.hours * 3600 / LOOK_EVERY_S)
    deviations = []
    memory_mb = []
    used = 0
    for minute in tqdm(range(minutes), unit='simulated min', mininterval=1.0):
        for _ in range(round(LOOK_EVERY_S * options.rate)):
            sample = simulation.step()
            used += len(observer.voltage('motor', sample.stamp_ns, float(sample.voltage_v[0])))
            used += len(observer.torque('motor', sample.stamp_ns, float(sample.torque_nm[0])))
        estimate = observer.estimates()['motor']
        memory_mb.append(psutil.Process().memory_info().rss / 1e6)
        if (minute + 1) * LOOK_EVERY_S >= SETTLING_S:
            deviations.append(np.abs(estimate.value[0] - TRUTH) / estimate.std[0])
    worst = np.max(deviations, axis=0)
    rms = np.sqrt(np.mean(np.square(deviations), axis=0))
    sent = minutes * round(LOOK_EVERY_S * options.rate)
    counters = observer.motors['motor'].counters
    figures = [
        Figure('simulated hours', minutes * LOOK_EVERY_S / 3600),
        Figure('samples lost', float(sent - used), 0.0),
        Figure(
            'largest deviation at the end, own standard deviations',
            float(np.max(deviations[-1])),
            3.0,
        ),
        Figure('largest deviation of all minutes, own standard deviations', float(np.max(worst))),
        Figure('root mean square deviation, own standard deviations', float(np.max(rms))),
        Figure('changes announced that were none', counters['motor changes'], 0.0),
        Figure('growth of memory in the second half, MB', growth(memory_mb), 5.0),
        Figure('largest memory, MB', max(memory_mb)),
    ]
    return tell('soak', options.seed, figures, {'counters': counters})


if __name__ == '__main__':
    raise SystemExit(main())
