"""A benchmark of drawn motors: its options, its runs, a table, figures, and one line of JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from common.figures import Figure, figure_table, last_line, table
from common.motor_trial import MotorTrial
from common.progress import progress_bar

QUICK_MOTORS = 1

Key = TypeVar('Key')
Case = TypeVar('Case')


@dataclass(frozen=True)
class MotorStudy(Generic[Key, Case]):
    """What a benchmark of drawn motors consists of.

    Attributes:
        name: of the benchmark.
        description: what it asks.
        drawn: what is drawn, in the plural.
        motors: of each case.
        first_seed: of the motors.
        run: draws a motor of a case by its seed, and tries it.
        row: of the table: what came of the motors under a key.
        figures: of the whole run.
    """

    name: str
    description: str
    drawn: str
    motors: int
    first_seed: int
    run: Callable[[Case, int], MotorTrial]
    row: Callable[[Key, Sequence[MotorTrial]], list[str]]
    figures: Callable[[dict[Key, list[MotorTrial]]], list[Figure]]

    def main(self, cases: Callable[[bool], Mapping[Key, Sequence[Case]]]) -> int:
        """Run it as the command line says; print what came of it.

        Args:
            cases: returns them by their keys; of a quick run short ones.
        """
        parser = argparse.ArgumentParser(
            description=self.description, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.add_argument('--quick', action='store_true', help='one motor, few samples')
        parser.add_argument('--motors', type=int, help=f'of each case (default {self.motors})')
        parser.add_argument('--first-seed', type=int, default=self.first_seed)
        parser.add_argument('--processes', type=int, default=2)
        options = parser.parse_args()
        count = options.motors or (QUICK_MOTORS if options.quick else self.motors)
        seeds = range(options.first_seed, options.first_seed + count)
        trials: dict[Key, list[MotorTrial]] = {}
        with ProcessPoolExecutor(options.processes) as pool:
            jobs = {
                key: [pool.submit(self.run, case, seed) for case in some for seed in seeds]
                for key, some in cases(options.quick).items()
            }
            for key, own_jobs in progress_bar(jobs.items(), total=len(jobs), unit='case'):
                trials[key] = [job.result() for job in own_jobs]
        header = [self.drawn, 'all', 'R known', 'R within 2 %', 'misfit', 'claims', 'false']
        print(table(header, [self.row(key, own) for key, own in trials.items()]), end='\n\n')
        judged = self.figures(trials)
        if options.quick:
            judged = [replace(figure, counts=False) for figure in judged]
        print(figure_table(judged))
        print(last_line(self.name, count, judged))
        return 0


def false_share(trials: Sequence[MotorTrial]) -> float:
    """Return how much of what was claimed is false, in %."""
    claim_count = sum(trial.claims for trial in trials)
    return 100.0 * sum(trial.false for trial in trials) / max(claim_count, 1)


def known_share(trials: Sequence[MotorTrial]) -> float:
    """Return how many motors have R identified and right at the end, in %."""
    return 100.0 * sum(trial.is_known for trial in trials) / max(len(trials), 1)


def figures_by_speed(
    trials: Mapping[tuple[str, str], Sequence[MotorTrial]],
    can_be_known: Callable[[str], bool] = lambda _: True,
) -> list[Figure]:
    """Return false claims, and how many motors were known, speed by speed.

    Args:
        trials: by speed and name of a case.
        can_be_known: tells by its name whether motors of a case count among those to be known.
    """
    made = []
    for speed in dict.fromkeys(speed for speed, _ in trials):
        own = {name: some for (other, name), some in trials.items() if other == speed}
        every = [trial for some in own.values() for trial in some]
        asked = [trial for name, some in own.items() if can_be_known(name) for trial in some]
        made += [
            Figure(f'{speed}: false claims, in %', false_share(every), 2.0),
            Figure('  R identified and right at the end, in % of motors', known_share(asked), None),
        ]
    return made


def speed_in_words(noise: float | None) -> str:
    """Say how the speed is measured.

    Args:
        noise: of its readings, as a share of the speed's spread; None: it is not measured.
    """
    return 'no speed' if noise is None else f'speed with {100.0 * noise:g} % noise'
