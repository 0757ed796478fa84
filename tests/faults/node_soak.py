"""Lets simulator and observer run long, with fast `/clock`: estimates true, memory flat.

    python tests/faults/node_soak.py [--hours 24] [--speed-up 10] [--seed 1]

Needs a sourced workspace. The predictor trains in its process. What is asked of the core alone is
in `soak`, which is faster. Prints a table and one line of JSON; ends with 1 if a figure is not
reached.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import psutil
from figures import Figure, growth, tell
from observer_process import SIMULATOR, Bench
from tqdm import tqdm

RATE_HZ = 100.0
LOOK_EVERY_S = 2.0


def main() -> int:
    """Run the hours; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--hours', type=float, default=24.0, help='simulated')
    parser.add_argument(
        '--speed-up', type=float, default=10.0, help='simulated seconds in a second'
    )
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--domain', type=int, default=86, help='ROS domain of everything that is started'
    )
    options = parser.parse_args()
    memory_mb: list[float] = []
    training_mb: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'log'
        with log.open('w+', encoding='utf-8') as file:
            bench = Bench(options.domain, file)
            try:
                bench.start_observer(Path(folder) / 'observer.safetensors', use_sim_time=True)
                assert bench.observer is not None
                simulator = bench.start(
                    SIMULATOR,
                    {
                        'excitation': 'R[5,15]D[0.1,1]',
                        'torque_noise_std': 1e-4,
                        'publish_clock': True,
                        'clock_speed_up': options.speed_up,
                        'duration_s': options.hours * 3600.0,
                        'seed': options.seed,
                        'wait_for_subscribers': 1,
                    },
                )
                sent = round(options.hours * 3600.0 * RATE_HZ)
                with tqdm(total=sent, unit='sample', mininterval=1.0) as bar:
                    while simulator.poll() is None:
                        bench.check_alive()
                        bench.spin(LOOK_EVERY_S)
                        bar.update(int(bench.facts.get('samples used', 0)) - bar.n)
                        memory_mb.append(bench.memory_mb())
                        children = psutil.Process(bench.observer.pid).children(recursive=True)
                        training_mb.append(sum(child.memory_info().rss for child in children) / 1e6)
                bench.rest()
                facts = dict(bench.facts)
                deviations = bench.deviations()
            finally:
                bench.close()
            said = log.read_text(encoding='utf-8', errors='replace')
    figures = [
        Figure('simulated hours', options.hours),
        Figure('samples lost', float(sent - int(facts['samples used'])), 0.0),
        Figure(
            'largest deviation at the end, own standard deviations',
            max(map(abs, deviations.values())),
            3.0,
        ),
        Figure('changes announced that were none', float(facts['motor changes']), 0.0),
        Figure('growth of memory in the second half, MB', growth(memory_mb), 5.0),
        Figure('largest memory, MB', max(memory_mb)),
        Figure('growth of the training process in the second half, MB', growth(training_mb), 5.0),
        Figure('training jobs done', float(facts['training jobs done'])),
        Figure('tracebacks', float(said.count('Traceback')), 0.0),
    ]
    return tell('node_soak', options.seed, figures)


if __name__ == '__main__':
    raise SystemExit(main())
