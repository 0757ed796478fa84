"""Kills the learning observer at seeded moments, and checks what the next one goes on from.

    python tests/faults/kill_observer.py [--times 50] [--seed 1] [--period 0.01]

Needs a sourced workspace. A checkpoint is taken so often that kills meet one that is being written.
After every kill the file has to be readable, and the next observer has to tell, before it has seen
a sample, what stands in the file, bit for bit. Prints a line a round, a table, and one line of
JSON; ends with 1 if a figure is not reached.
"""

from __future__ import annotations

import argparse
import random
import struct
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
from figures import Figure, tell
from observer_process import Bench
from std_msgs.msg import Float64, Float64MultiArray
from tqdm import tqdm

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.bag.joint_state import JointStateView
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.topics import LATCHED_QOS
from gray_box_observer.settings.configuration import Configuration

PARAMETERS = ('inductance', 'resistance', 'hysteresis')
TRUTH = np.array([0.5, 1.0, 10.0])
SHORTEST_S = 0.1
LONGEST_S = 2.0
"""How long an observer lives after the first sample it is sent."""
SAMPLES_AT_ONCE = 10


class Announced:
    """What an observer tells of its estimates when it starts; both topics are latched.

    Args:
        bench: whose node listens.
    """

    def __init__(self, bench: Bench) -> None:
        self._heard: dict[str, bytes] = {}
        for name in PARAMETERS:
            bench.node.create_subscription(
                Float64,
                f'/gray_box_observer/motor/{name}',
                lambda m, name=name: self._hear(name, m.data),
                LATCHED_QOS,
            )
        bench.node.create_subscription(
            Float64MultiArray,
            '/gray_box_observer/motor/covariance',
            lambda m: self._hear('covariance', *m.data),
            LATCHED_QOS,
        )

    def forget(self) -> None:
        """Listen for another observer."""
        self._heard.clear()

    @property
    def complete(self) -> bool:
        """Whether everything has been heard."""
        return len(self._heard) == len(PARAMETERS) + 1

    @property
    def content(self) -> bytes:
        """Values and covariance, as they came."""
        return b''.join(self._heard[name] for name in (*PARAMETERS, 'covariance'))

    def _hear(self, name: str, *values: float) -> None:
        self._heard[name] = struct.pack(f'<{len(values)}d', *values)


def read(path: Path) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Read a checkpoint with the core; return bytes of values and covariance, values, std.

    Raises:
        GrayBoxError: it cannot be used.
    """
    observer = Observer(Configuration.from_flat({'predictor': False}))
    checkpoint.load(observer, path)
    estimate = observer.estimates()['motor']
    content = (
        estimate.value[0].astype('<f8').tobytes() + estimate.covariance[0].astype('<f8').tobytes()
    )
    return content, estimate.value[0], estimate.std[0]


def main() -> int:
    """Run the rounds; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--times', type=int, default=50, help='how often the observer is killed')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--period', type=float, default=0.01, help='seconds between two checkpoints'
    )
    parser.add_argument(
        '--domain', type=int, default=82, help='ROS domain of everything that is started'
    )
    options = parser.parse_args()
    draw = random.Random(options.seed)
    simulation = Simulation(
        {'motor': PlantParameters()},
        'R[5,15]D[0.1,1]',
        seed=options.seed,
        torque_noise_std=1e-4,
        start_ns=10**18,
    )
    unreadable = differing = 0
    scraps: set[str] = set()
    spreads: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'observer.safetensors'
        log = Path(folder) / 'log'
        with log.open('w+', encoding='utf-8') as file:
            bench = Bench(options.domain, file)
            try:
                announced = Announced(bench)
                for number in tqdm(range(options.times + 1), unit='kill'):
                    kept = _kept(path)
                    unreadable += kept is None and path.exists()
                    announced.forget()
                    start = {'checkpoint.period_s': options.period, 'predictor': False}
                    bench.start_observer(path, **start)
                    bench.wait(lambda: announced.complete, 'the first estimates')
                    if kept is not None:
                        differing += announced.content != kept[0]
                        spreads.append(float(np.max(kept[2] / TRUTH)))
                        line = ', '.join(
                            f'{v:.6g} +- {s:.2g}' for v, s in zip(kept[1], kept[2], strict=True)
                        )
                        tqdm.write(f'{number:>3}  {line}', file=sys.stderr)
                    if number < options.times:
                        _feed(bench, simulation, draw.uniform(SHORTEST_S, LONGEST_S))
                        bench.kill_observer()
                        scraps.update(
                            scrap.name for scrap in path.parent.glob(f'.*{checkpoint.PARTIAL}')
                        )
                kept = _kept(path)
            finally:
                bench.close()
            said = log.read_text(encoding='utf-8', errors='replace')
    if kept is None:
        print('kill_observer: error: no checkpoint at the end', file=sys.stderr)
        return 1
    rises = sum(after > 1.05 * before for before, after in pairwise(spreads))
    figures = [
        Figure('checkpoints that could not be read', unreadable, 0.0),
        Figure('restored estimates that differ from the checkpoint in any bit', differing, 0.0),
        Figure('observers that knew less than the one before', rises, 0.0),
        Figure(
            'deviation at the end, own standard deviations',
            float(np.max(np.abs(kept[1] - TRUTH) / kept[2])),
            3.0,
        ),
        Figure(
            'refusals and tracebacks in the log',
            said.count('refused') + said.count('Traceback'),
            0.0,
        ),
        Figure('kills while a checkpoint was being written', len(scraps)),
        Figure('largest relative standard deviation, first checkpoint', spreads[0]),
        Figure('largest relative standard deviation, last checkpoint', spreads[-1]),
    ]
    return tell('kill_observer', options.seed, figures, {'kills': options.times})


def _kept(path: Path) -> tuple[bytes, np.ndarray, np.ndarray] | None:
    try:
        return read(path)
    except GrayBoxError:
        return None


def _feed(bench: Bench, simulation: Simulation, duration_s: float) -> None:
    """Send samples for a while, as they come."""
    until_s = time.monotonic() + duration_s
    while time.monotonic() < until_s:
        for _ in range(SAMPLES_AT_ONCE):
            sample = simulation.step()
            for signal, value in (('voltage', sample.voltage_v), ('torque', sample.torque_nm)):
                bench.send(
                    signal, JointStateView(sample.stamp_ns, ('motor',), (), (), (float(value[0]),))
                )
        bench.spin(0.01)


if __name__ == '__main__':
    raise SystemExit(main())
