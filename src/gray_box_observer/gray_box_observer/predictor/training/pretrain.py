"""Makes the network that variant ``physics`` begins with.

Run it by ``python -m gray_box_observer.predictor.training.pretrain``.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.predictor.initial_network import SHIPPED, fresh, save
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.training.physics_batches import (
    exact_run,
    free_run,
    spread,
    training_batch,
)
from gray_box_observer.predictor.training.synthetic_sequences import draw_family
from gray_box_observer.predictor.training.training_backend import TORCH_MISSING
from gray_box_observer.safe_io.command_parser import CommandParser
from gray_box_observer.white_box.interface import Array

SEQUENCES = 128
LENGTH = 24
HELD_OUT = 1000
FIRST_RATE, LAST_RATE = 1e-2, 1e-4


def pretrain(seed: int, hidden: int, progress: Iterator[float]) -> Weights:
    """Teach a fresh network on the whole family of motors.

    Args:
        seed: of the first weights and of everything drawn.
        hidden: hidden units.
        progress: yields how far training has come, 0 to 1, before each step.
    """
    from gray_box_observer.predictor.training.teaching import TrainableNetwork

    random = np.random.default_rng([seed, 1])
    trainable = TrainableNetwork(fresh(hidden, seed), FIRST_RATE, TrainingSettings().gradient_clip)
    for progress_share in progress:
        rate = LAST_RATE + (FIRST_RATE - LAST_RATE) * 0.5 * (
            1.0 + math.cos(math.pi * progress_share)
        )
        trainable.optimiser.param_groups[0]['lr'] = rate
        trainable.learn(training_batch(trainable.weights, draw_family(random, SEQUENCES, LENGTH)))
    return trainable.weights


def held_out_errors(weights: Weights, seed: int) -> Array:
    """Mean free-run error on motors that never taught, in units of each spread, (motor,)."""
    sequences = draw_family(np.random.default_rng([seed, 4]), HELD_OUT, LENGTH)
    exact = exact_run(sequences)
    errors: Array = np.abs(free_run(weights, sequences)[0] - exact).mean(axis=1) / spread(
        sequences, exact
    )
    return errors


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    parser = CommandParser(
        prog='python -m gray_box_observer.predictor.training.pretrain',
        description='Teach a fresh network on drawn motors of every kind and write it as the start '
        'of variant physics.',
    )
    parser.add_argument(
        '--seed', type=int, default=0, help='of weights and drawn motors (default: 0)'
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        '--steps',
        type=int,
        default=8000,
        help='Adam steps: the same file every time (default: 8000)',
    )
    length.add_argument('--minutes', type=float, help='stop after so long instead')
    parser.add_argument(
        '--hidden',
        type=int,
        default=TrainingSettings().hidden,
        help='hidden units (default: %(default)s)',
    )
    parser.add_argument(
        '--output', type=Path, default=SHIPPED, help='file to write (default: the shipped one)'
    )
    options = parser.parse_args(arguments)
    too_short = options.steps < 1 or (options.minutes is not None and not options.minutes > 0.0)
    if too_short or options.hidden < 1 or options.seed < 0:
        parser.error(
            '--steps, --hidden and --minutes must be positive and --seed must not be negative'
        )
    try:
        progress = _for_minutes(options.minutes) if options.minutes else _for_steps(options.steps)
        weights = pretrain(options.seed, options.hidden, progress)
        save(weights, options.output, f'{parser.prog}, seed {options.seed}')
    except ImportError:
        print(f'pretrain: error: {TORCH_MISSING}', file=sys.stderr)
        return 2
    except GrayBoxError as error:
        print(f'pretrain: error: {error}', file=sys.stderr)
        return 2
    print(f'error on {HELD_OUT} held-out drawn motors, in % of the spread of the current:')
    for name, network in (('untrained', fresh(options.hidden, options.seed)), ('trained', weights)):
        percent = 100.0 * held_out_errors(network, options.seed)
        print(
            f'  {name:10s} mean {percent.mean():.3f}  median {np.median(percent):.4f}  '
            f'99 of 100 below {np.quantile(percent, 0.99):.2f}  worst {percent.max():.2f}'
        )
    print(f'wrote {options.output} ({options.output.stat().st_size} bytes)')
    return 0


def _for_steps(steps: int) -> Iterator[float]:
    for k in tqdm(range(steps), desc='teaching', unit='step', disable=None):
        yield k / steps


def _for_minutes(minutes: float) -> Iterator[float]:
    start_s = time.monotonic()
    whole_s = 60.0 * minutes
    with tqdm(total=round(whole_s), desc='teaching', unit='s', disable=None) as bar:
        while (passed_s := time.monotonic() - start_s) < whole_s:
            bar.update(round(passed_s) - bar.n)
            yield passed_s / whole_s


if __name__ == '__main__':
    raise SystemExit(main())
