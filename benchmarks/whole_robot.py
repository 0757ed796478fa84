"""A robot whose motors come in one message: is every motor known, and what does it cost?

Gear motors are drawn with the excitation of ``rotor``, twelve to a robot; nobody tells the observer
what they are. Their speed is not measured, or with noise. They are observed by the defaults, and
computed together for comparison, which costs less and knows less. A claim is *false* as in
``rotor``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial

from common.figures import Figure, figure_table, last_line, table
from common.progress import progress_bar
from common.robot_runs import RobotCase, RobotTrial, run_robot

ROBOTS = 5
QUICK_ROBOTS = 1
MOTORS = 12
RATE_HZ = 200.0
DURATION_S = 20.0
QUICK_S = 5.0
TOGETHER = 2
"""``group_from`` of robots whose motors are computed together."""

NOISES = (None, 0.005, 0.01, 0.03)
"""Of the measured speed; None: it is not measured."""


def cases(duration_s: float) -> dict[str, RobotCase]:
    """Return the cases by what the table calls them."""
    made = {}
    for how, group_from in (('defaults', None), ('together', TOGETHER)):
        for noise in NOISES:
            speed = 'no speed' if noise is None else f'speed with {100.0 * noise:g} % noise'
            case = RobotCase(MOTORS, RATE_HZ, duration_s, noise, group_from)
            made[f'{how}, {speed}'] = case
    return made


def row(name: str, trials: Sequence[RobotTrial]) -> list[str]:
    """Return what came of the robots of a case, as a row of the table."""
    claims = sum(trial.claims for trial in trials)
    return [
        name,
        str(MOTORS * len(trials)),
        str(sum(trial.known for trial in trials)),
        str(sum(trial.near for trial in trials)),
        str(sum(trial.misfits for trial in trials)),
        str(claims),
        f'{_false_share(trials):.2f}',
        f'{sum(trial.sample_us for trial in trials) / len(trials):.0f}',
    ]


def _false_share(trials: Sequence[RobotTrial]) -> float:
    """Return the share of false claims in %; 0 where there is no claim."""
    claims = sum(trial.claims for trial in trials)
    return 100.0 * sum(trial.false for trial in trials) / max(claims, 1)


def figures(trials: dict[str, list[RobotTrial]]) -> list[Figure]:
    """Return the figures of a run."""
    made = []
    for name, own in trials.items():
        if not name.startswith('defaults'):
            continue
        known = 100.0 * sum(trial.known for trial in own) / (MOTORS * len(own))
        made += [
            Figure(f'{name}: R identified and right, in % of motors', known, (95.0, 100.0)),
            Figure('  false claims, in %', _false_share(own), 2.0),
        ]
    return made


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one robot, for a few seconds')
    parser.add_argument('--robots', type=int, help=f'how many (default {ROBOTS})')
    parser.add_argument('--first-seed', type=int, default=100)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.robots or (QUICK_ROBOTS if options.quick else ROBOTS)
    seeds = range(options.first_seed, options.first_seed + count)
    chosen_cases = cases(QUICK_S if options.quick else DURATION_S)
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = {
            name: pool.map(partial(run_robot, case), seeds) for name, case in chosen_cases.items()
        }
        trials = {
            name: list(progress_bar(job, total=count, unit='robot')) for name, job in jobs.items()
        }
    header = [
        'robots', 'motors', 'R known', 'R within 2 %', 'misfit', 'claims', 'false %', 'us/sample',
    ]  # fmt: skip
    print(table(header, [row(name, own) for name, own in trials.items()]), end='\n\n')
    judged = figures(trials)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(figure_table(judged))
    print(last_line('whole_robot', count, judged))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
