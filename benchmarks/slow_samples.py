"""Slow samples: is R known where L/R is far below a sample interval, and is it right?

Gear motors are drawn with the excitation of ``rotor``; the observer is told Kt and Kb, and nothing
of the stamps. A voltage may act anywhere in its interval, so L stays open there. Some drivers are
late by a part of an interval. A claim is *false* as in ``rotor``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

from common.driver_runs import DriverCase, run_driver
from common.figures import Figure, figure_table, last_line, table
from common.motor_trial import MotorTrial, counts
from common.progress import progress_bar

MOTORS = 12
QUICK_MOTORS = 1
SAMPLES = 4000
QUICK_SAMPLES = 1000
RATES_HZ = (200.0, 100.0, 50.0)
SPEED_NOISES = (None, 0.01)
LATE = (0.0, 0.3, 0.5)
"""Sample intervals by which the voltage acts after its stamp."""

Key = tuple[float | None, float, float]
"""Noise of the measured speed, rate in Hz, and how late the voltage is."""


def cases(samples: int) -> dict[Key, DriverCase]:
    """Return the cases of records of so many samples."""
    return {
        (noise, rate_hz, late): DriverCase(
            False, 1.0, 0.0, False, rate_hz, noise, samples / rate_hz, late
        )
        for noise in SPEED_NOISES
        for rate_hz in RATES_HZ
        for late in LATE
    }


def row(key: Key, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    noise, rate_hz, late = key
    return [f'{_speed(noise)}, {rate_hz:g} Hz, late by {late:g}', *counts(trials)]


def figures(trials: dict[Key, list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run, by speed: R of punctual drivers, and false claims of all."""
    by_speed = []
    for noise in dict.fromkeys(key[0] for key in trials):
        own = {key: some for key, some in trials.items() if key[0] == noise}
        punctual = [one for key, some in own.items() if key[2] == 0.0 for one in some]
        every = [one for some in own.values() for one in some]
        known_share = 100.0 * sum(trial.is_known for trial in punctual) / max(len(punctual), 1)
        claim_count = sum(trial.claims for trial in every)
        false_share = 100.0 * sum(trial.false for trial in every) / max(claim_count, 1)
        name = f'{_speed(noise)}, punctual: R identified and right, in % of motors'
        by_speed += [
            Figure(name, known_share, (90.0, 100.0)),
            Figure('  false claims, in %', false_share, 2.0),
        ]
    return by_speed


def _speed(noise: float | None) -> str:
    return 'no speed' if noise is None else f'speed with {100.0 * noise:g} % noise'


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one motor, few samples')
    parser.add_argument('--motors', type=int, help=f'of each case (default {MOTORS})')
    parser.add_argument('--first-seed', type=int, default=200)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.motors or (QUICK_MOTORS if options.quick else MOTORS)
    seeds = range(options.first_seed, options.first_seed + count)
    chosen_cases = cases(QUICK_SAMPLES if options.quick else SAMPLES)
    trials: dict[Key, list[MotorTrial]] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = {
            key: pool.map(partial(run_driver, case), seeds) for key, case in chosen_cases.items()
        }
        for key, job in progress_bar(jobs.items(), total=len(jobs), unit='case'):
            trials[key] = list(job)
    header = ['motors', 'all', 'R known', 'R within 2 %', 'misfit', 'claims', 'false']
    print(table(header, [row(key, own) for key, own in trials.items()]), end='\n\n')
    judged = figures(trials)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(figure_table(judged))
    print(last_line('slow_samples', count, judged))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
