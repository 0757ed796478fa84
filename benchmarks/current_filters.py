"""Drivers that filter the current: is anything believed that is wrong?

Gear motors are drawn with the excitation of ``rotor``; the observer is told Kt and Kb. A reading is
the mean of its interval, or passes an analogue filter, or a driver publishes an exponential moving
average of the readings, so that their noise has a memory. L and R of such a motor look larger than
they are. A claim is *false* as in ``rotor``.
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

MOTORS = 10
QUICK_MOTORS = 1
DURATION_S = 20.0
QUICK_S = 3.0
RATES_HZ = (200.0, 500.0)
SPEED_NOISE = 0.01

FILTERS: dict[str, tuple[bool, float, float, bool]] = {
    'none': (False, 1.0, 0.0, False),
    'mean of the interval': (True, 1.0, 0.0, False),
    'analogue, half an interval': (False, 1.0, 0.5, False),
    'analogue, 0.6 intervals, of noise too': (False, 1.0, 0.6, True),
    'analogue, 1.5 intervals, of noise too': (False, 1.0, 1.5, True),
    'moving average, newest weighs 0.85': (False, 0.85, 0.0, False),
    'moving average, newest weighs 0.7': (False, 0.7, 0.0, False),
    'moving average, newest weighs 0.5': (False, 0.5, 0.0, False),
    'moving average, newest weighs 0.3': (False, 0.3, 0.0, False),
}
"""Whether readings are means, weight of the newest one, analogue time constant in intervals, and
whether the noise passes the analogue filter, too."""


def cases(duration_s: float) -> dict[tuple[str, str], list[DriverCase]]:
    """Return the cases by speed and filter, one for each rate."""
    speeds = {'no speed': None, f'speed with {100.0 * SPEED_NOISE:g} % noise': SPEED_NOISE}
    return {
        (speed, name): [DriverCase(*settings, rate_hz, noise, duration_s) for rate_hz in RATES_HZ]
        for speed, noise in speeds.items()
        for name, settings in FILTERS.items()
    }


def row(speed: str, name: str, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    return [f'{speed}, filter: {name}', *counts(trials)]


def figures(trials: dict[tuple[str, str], list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run: false claims of all filters together, by speed."""
    made = []
    for speed in dict.fromkeys(speed for speed, _ in trials):
        own = [trial for key, some in trials.items() if key[0] == speed for trial in some]
        claim_count = sum(trial.claims for trial in own)
        false_share = 100.0 * sum(trial.false for trial in own) / max(claim_count, 1)
        known_share = 100.0 * sum(trial.is_known for trial in own) / len(own)
        made += [
            Figure(f'{speed}: false claims, in %', false_share, 2.0),
            Figure('  R identified and right at the end, in % of motors', known_share, None),
        ]
    return made


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one motor, for a few seconds')
    parser.add_argument('--motors', type=int, help=f'of each case (default {MOTORS})')
    parser.add_argument('--first-seed', type=int, default=100)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.motors or (QUICK_MOTORS if options.quick else MOTORS)
    seeds = range(options.first_seed, options.first_seed + count)
    chosen_cases = cases(QUICK_S if options.quick else DURATION_S)
    trials: dict[tuple[str, str], list[MotorTrial]] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = {
            key: [pool.map(partial(run_driver, case), seeds) for case in some]
            for key, some in chosen_cases.items()
        }
        for key, some in progress_bar(jobs.items(), total=len(jobs), unit='case'):
            trials[key] = [trial for job in some for trial in job]
    header = ['motors', 'all', 'R known', 'R within 2 %', 'misfit', 'claims', 'false']
    print(table(header, [row(*key, own) for key, own in trials.items()]), end='\n\n')
    judged = figures(trials)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(figure_table(judged))
    print(last_line('current_filters', count, judged))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
