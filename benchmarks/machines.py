"""Machines as they are built: is what is claimed of L and R right where no form knows the machine?

Gear motors are drawn, each with one thing that no form of the observer knows or that data have to
add: ripple, cogging, a gear that gives or has play, a payload, a restless load, a driver that
coasts, or one whose current flows one way alone. The observer is told Kt and Kb. A claim is *false*
as in ``rotor``; R is judged against its mean over a turn.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

from common.figures import Figure, figure_table, last_line, table
from common.machines.drawn_machines import EFFECTS
from common.machines.machine_runs import SPEED_LOOP, STEPS, MachineCase, run_machine
from common.motor_trial import MotorTrial, counts
from common.progress import progress_bar

MOTORS = 4
QUICK_MOTORS = 1
RATES_HZ = (1000.0, 250.0)
SAMPLES = {1000.0: 10_000, 250.0: 5_000}
QUICK_SAMPLES = 600
SPEED_NOISES = (None, 0.01)

Key = tuple[str, float | None]
"""Effect, and noise of the measured speed."""


def cases(samples: int | None = None) -> dict[Key, list[MachineCase]]:
    """Return the cases, of so many samples each; None: of as many as a rate takes."""
    return {
        (effect, noise): [
            MachineCase(effect, drive, rate_hz, noise, (samples or SAMPLES[rate_hz]) / rate_hz)
            for drive in (STEPS, SPEED_LOOP)
            for rate_hz in RATES_HZ
        ]
        for effect in EFFECTS
        for noise in SPEED_NOISES
    }


def row(key: Key, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the machines of a case, as a row of the table."""
    effect, noise = key
    return [f'{effect}, {_speed(noise)}', *counts(trials)]


def figures(trials: dict[Key, list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run: false claims by speed, and R of two kinds of motors."""
    made = []
    for noise in dict.fromkeys(noise for _, noise in trials):
        own = {effect: some for (effect, other), some in trials.items() if other == noise}
        every = [one for some in own.values() for one in some]
        claim_count = sum(trial.claims for trial in every)
        false_share = 100.0 * sum(trial.false for trial in every) / max(claim_count, 1)
        made.append(Figure(f'{_speed(noise)}: false claims, in %', false_share, 2.0))
        for effect, goal in (('nothing', (95.0, 100.0)), ('coasting driver', None)):
            some = own.get(effect, [])
            share = 100.0 * sum(trial.is_known for trial in some) / max(len(some), 1)
            name = f'  {effect}: R identified and right, in % of motors'
            made.append(Figure(name, share, goal))
    return made


def _speed(noise: float | None) -> str:
    return 'no speed' if noise is None else f'speed with {100.0 * noise:g} % noise'


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one motor, few samples')
    parser.add_argument('--motors', type=int, help=f'of each case (default {MOTORS})')
    parser.add_argument('--first-seed', type=int, default=100)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.motors or (QUICK_MOTORS if options.quick else MOTORS)
    seeds = range(options.first_seed, options.first_seed + count)
    trials: dict[Key, list[MotorTrial]] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = {
            key: [pool.submit(run_machine, case, seed) for case in own_cases for seed in seeds]
            for key, own_cases in cases(QUICK_SAMPLES if options.quick else None).items()
        }
        for key, own_jobs in progress_bar(jobs.items(), total=len(jobs), unit='case'):
            trials[key] = [job.result() for job in own_jobs]
    header = ['machines', 'all', 'R known', 'R within 2 %', 'misfit', 'claims', 'false']
    print(table(header, [row(key, own) for key, own in trials.items()]), end='\n\n')
    judged = figures(trials)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(figure_table(judged))
    print(last_line('machines', count, judged))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
