"""Can ``identified`` be believed? Motors, drivers and sensors, most beyond the white box.

Every record is simulated here, by a simulator that shares nothing with the packages, and goes
through the observer as ``identify --skip-predictor`` would take it. A parameter is *false* where it
is called ``identified`` and is off by more than 3 of its own standard deviations and by more than 2
%. Half of the scenarios (``--half choose``) are to choose thresholds by; the other half reports.
Logs of real motors are read where they are (``../shared/data`` beside the repository, or ``--data
FOLDER``). ``--drawn 10000`` looks for numbers that break and for tracebacks.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

from common.figures import Figure, figure_table, last_line
from common.progress import progress_bar
from common.trust.drawn import drawn_figures, drawn_table, run_drawn
from common.trust.judge import class_table, figures, record_table
from common.trust.real_logs import RealMotor, real_figures, real_logs, real_table, run_real_log
from common.trust.records import make_record
from common.trust.scenarios import half, scenarios
from common.trust.trial import Trial, run_trial
from real_motors import DEFAULT_DATA

BEFORE = Path(__file__).parent / 'common' / 'trust' / 'before.json'


def trial_of(place: tuple[int, int]) -> Trial:
    """Make the record of a scenario, by its index, and a seed, and run it."""
    index, seed = place
    return run_trial(make_record(scenarios()[index], seed))


def run_all(
    work: Callable[[Any], Any], jobs: Sequence[Any], processes: int, unit: str
) -> list[Any]:
    """Run all jobs in so many processes; the results are in the order of the jobs."""
    results = []
    with (
        ProcessPoolExecutor(processes) as pool,
        progress_bar(total=len(jobs), unit=unit) as bar,
    ):
        for result in pool.map(work, jobs):
            results.append(result)
            bar.update()
    return results


def chosen_scenarios(options: argparse.Namespace) -> list[int]:
    """Return the indices of the scenarios of a run."""
    chosen = [
        k
        for k, scenario in enumerate(scenarios())
        if options.half in ('both', half(scenario)) and options.only in scenario.name
    ]
    if not options.quick:
        return chosen
    groups = [scenarios()[k].group for k in chosen]
    return [k for j, k in enumerate(chosen) if groups.index(groups[j]) == j]


def write_before(trials: Sequence[Trial]) -> None:
    """Store when each parameter came to be identified, where the white box holds."""
    holds = {scenario.name for scenario in scenarios() if scenario.holds}
    lines = [
        f'{json.dumps(f"{trial.name}/{trial.seed}")}: '
        + json.dumps({name: round(time_s, 4) for name, time_s in trial.identified_s.items()})
        for trial in trials
        if trial.name in holds
    ]
    BEFORE.write_text('{\n' + ',\n'.join(sorted(lines)) + '\n}\n')


def options_of_command() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--quick',
        action='store_true',
        help='one seed of one scenario a class, four short logs, 10 drawn motors',
    )
    parser.add_argument('--seeds', type=int, default=0, help='seeds (default: 3, with --quick 1)')
    parser.add_argument('--half', choices=('choose', 'report', 'both'), default='report')
    parser.add_argument(
        '--only', default='', metavar='TEXT', help='scenarios whose name contains it, nothing else'
    )
    parser.add_argument(
        '--drawn', type=int, metavar='N', help='drawn motors, excitations and faults (default: 300)'
    )
    parser.add_argument('--data', type=Path, default=DEFAULT_DATA, help='folder of the real logs')
    parser.add_argument(
        '--processes',
        type=int,
        default=1,
        help='records at a time; with more than one costs are not to be trusted',
    )
    parser.add_argument('--records', action='store_true', help='print a line a record, too')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write every trial there')
    parser.add_argument(
        '--write-before', action='store_true', help=f'store what is identified now in {BEFORE.name}'
    )
    options = parser.parse_args()
    if options.seeds < 0:
        parser.error(f'--seeds must be at least 1, got {options.seeds}')
    options.seeds = options.seeds or (1 if options.quick else 3)
    if options.drawn is None:
        options.drawn = 0 if options.only else 10 if options.quick else 300
    return options


def main() -> int:
    """Print the tables and one line of JSON."""
    options = options_of_command()
    places = [(k, seed) for seed in range(1, options.seeds + 1) for k in chosen_scenarios(options)]
    trials: list[Trial] = run_all(trial_of, places, options.processes, 'record')
    if options.json:
        options.json.write_text(json.dumps([trial.to_dict() for trial in trials]))
    if options.write_before:
        write_before(trials)
    before = json.loads(BEFORE.read_text()) if BEFORE.is_file() else {}
    if options.records:
        print(record_table(trials))
    print(class_table(trials))
    judged = figures(trials, before)
    if not options.only:
        judged += judged_logs(options)
    if options.drawn:
        drawn = run_all(run_drawn, range(options.drawn), options.processes, 'drawn')
        print(drawn_table(drawn))
        judged += drawn_figures(drawn)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(f'\n{figure_table(judged)}')
    print(last_line('trust', options.seeds, judged))
    return 0


def judged_logs(options: argparse.Namespace) -> list[Figure]:
    """Run the real logs that are there, of a quick run a few short ones."""
    logs = list(real_logs(options.data))
    if options.quick:
        logs = [log for log in logs if log.is_short][:4]
    runs: list[list[RealMotor]] = run_all(run_real_log, logs, options.processes, 'log')
    motors = [motor for run in runs for motor in run]
    print(f'\n{real_table(motors)}' if motors else f'\nno logs of real motors in {options.data}')
    return real_figures(motors)


if __name__ == '__main__':
    raise SystemExit(main())
