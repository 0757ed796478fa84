"""How well and how fast are the parameters found, beside the methods users would pick?

Monte Carlo over seeds: five data sets, torque noise of 0, 0.5, 1 and 2 % of the torque's standard
deviation, every method on the same recordings from the same starts. Errors are given in % and as
multiples of the Cramer-Rao bound. Peers are tuned for each data set on seeds of their own
(common/tuning.py says how), they are told the true noise, and a run that fails counts as infinitely
wrong. The moving-horizon estimator is slow: it gets two seeds and a third of each recording. Ends
with one line of JSON.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import multiprocessing
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

if TYPE_CHECKING:
    from common.study import Work

WORKERS = 2
BATCH = 'batch'
RIVALS = ('rls integrated', 'ekf', 'ukf')
PEER_PACKAGES = ('filterpy', 'padasip', 'do_mpc', 'scipy', 'matplotlib')


@dataclass(frozen=True, slots=True)
class Plan:
    """How much is run.

    Attributes:
        methods: which, besides the reference.
        seeds: of every method.
        own_seeds: of the package's first rule and its rivals at 1 % noise on the three core sets.
        noises: fractions of the torque's standard deviation.
        part: fraction of each recording.
        slow_seeds: of the moving-horizon estimator.
        slow_part: fraction of each recording that it gets.
        marks: instants at which errors are kept.
    """

    methods: tuple[str, ...]
    seeds: int
    own_seeds: int
    noises: tuple[float, ...]
    part: float
    slow_seeds: int
    slow_part: float
    marks: int

    @property
    def rivals(self) -> tuple[str, ...]:
        """Peers that come near enough for a fifth of the seeds to leave open who is better."""
        return tuple(name for name in self.methods if name in RIVALS)

    @property
    def counts(self) -> bool:
        """Whether this is enough for a verdict on the goals."""
        return self.seeds >= 20 and self.part == 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return the exit status."""
    options = _parse(arguments)
    missing = [name for name in PEER_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        print(
            f'identification: error: {missing[0]} is missing; install '
            'ros_ws/requirements/bench.txt '
            '(make bench does it)',
            file=sys.stderr,
        )
        return 2
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context('spawn')) as pool:
        return _tune(pool) if options.tune else _run(pool, _plan(options), options)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='identification', description=str(__doc__).partition('\n')[0]
    )
    parser.add_argument(
        '--quick',
        action='store_true',
        help='a smaller run, under a minute: no verdicts on the goals',
    )
    parser.add_argument(
        '--seeds', type=int, metavar='N', help='seeds of every method (20; quick: 2)'
    )
    parser.add_argument(
        '--own-seeds', type=int, metavar='N', help='seeds of our rule at 1 %% noise (100; quick: 2)'
    )
    parser.add_argument('--methods', metavar='A,B', help='only these, separated by commas')
    parser.add_argument(
        '--plot', type=Path, metavar='FILE', help='draw error against time (.svg or .png)'
    )
    parser.add_argument(
        '--long', action='store_true', help='add hours: false alarms, constant voltage'
    )
    parser.add_argument(
        '--tune',
        action='store_true',
        help='tune the peers on held-out seeds, then stop (half an hour)',
    )
    options = parser.parse_args(arguments)
    for name in ('seeds', 'own_seeds'):
        value = getattr(options, name)
        if value is not None and not 1 <= value <= 1000:
            parser.error(f'--{name.replace("_", "-")} must be from 1 to 1000, got {value}')
    if options.plot is not None and options.plot.suffix not in ('.svg', '.png'):
        parser.error(f'--plot must end in .svg or .png, got {options.plot}')
    if options.plot is not None and not options.plot.parent.is_dir():
        parser.error(f'--plot: there is no folder {options.plot.parent}')
    return options


def _plan(options: argparse.Namespace) -> Plan:
    from common.estimator import OWN_RULES  # after the check for what is missing
    from common.tuning import PEERS

    every = (*OWN_RULES, *PEERS)
    methods = tuple(options.methods.split(',')) if options.methods else every
    unknown = [name for name in methods if name not in every]
    if unknown:
        print(
            f'identification: error: no method {unknown[0]!r}; there are {", ".join(every)}',
            file=sys.stderr,
        )
        raise SystemExit(2)
    if options.quick:
        methods = tuple(name for name in methods if name != 'mhe')
        seeds = options.seeds or 2
        return Plan(
            methods, seeds, max(seeds, options.own_seeds or 2), (0.0, 0.01), 1.0 / 3.0, 0, 0.0, 60
        )
    seeds = options.seeds or 20
    own = max(seeds, options.own_seeds or 100)
    return Plan(methods, seeds, own, (0.0, 0.005, 0.01, 0.02), 1.0, min(2, seeds), 1.0 / 3.0, 240)


def _work(plan: Plan) -> list[Work]:
    """Cut the plan into pieces, the longest first."""
    from common.cases import CASES
    from common.estimator import OWN_RULES
    from common.study import Work

    fast = tuple(name for name in plan.methods if name != 'mhe')
    other = tuple(noise for noise in plan.noises if noise != 0.01)
    pieces = []
    if 'mhe' in plan.methods:
        pieces += [
            Work(case, seed, ('mhe',), (0.01,), part=plan.slow_part)
            for case in CASES
            for seed in range(plan.slow_seeds)
        ]
    for case in CASES:
        for seed in range(plan.seeds):
            pieces.append(
                Work(
                    case,
                    seed,
                    (*fast, BATCH),
                    (0.01,),
                    (False,),
                    plan.part,
                    plan.marks,
                    robustness=case.core,
                )
            )
            pieces.append(Work(case, seed, fast, (0.01,), (True,), plan.part, plan.marks))
            pieces.append(Work(case, seed, (*fast, BATCH), other, (False,), plan.part, 24))
        own = next(iter(OWN_RULES))
        if case.core and own in plan.methods:
            extra = range(plan.seeds, plan.own_seeds)
            for either_way in (False, True):
                starts = (either_way,)
                against = (own, *plan.rivals)
                pieces += [
                    Work(case, seed, against, (0.01,), starts, plan.part, plan.marks)
                    for seed in extra
                ]
    return pieces


def _run(pool: ProcessPoolExecutor, plan: Plan, options: argparse.Namespace) -> int:
    from common import report
    from common.cases import CASES
    from common.figures import figure_table, last_line
    from common.plot import draw
    from common.study import carry_out, constant_hour, false_alarms_in_an_hour, gather, timing

    outcomes = _progress('recordings', [pool.submit(carry_out, work) for work in _work(plan)])
    # One at a time, so that nothing else of this run competes for the machine.
    times = pool.submit(timing, plan.methods, plan.part).result()
    alarms = None
    held = None
    own = report.own_rule(plan.methods)
    if options.long and own:
        hours = [pool.submit(false_alarms_in_an_hour, case, own, 0) for case in CASES if case.core]
        alarms = sum(_progress('hours', hours))
        still = [
            pool.submit(constant_hour, case, own, seed)
            for case in CASES
            if case.core
            for seed in range(3)
        ]
        held = _progress('hours of constant voltage', still)
    results = report.Results(outcomes, plan, times, alarms, held)
    print(report.tables(results))
    figures = report.figures(results) if own else []
    print(figure_table(figures))
    if options.plot is not None:
        core = [case for case in CASES if case.core]
        names = [*plan.methods, BATCH]
        runs = {
            (n, c.name): gather(outcomes, n, c.name, 0.01, False, plan.seeds)
            for n in names
            for c in core
        }
        draw(
            options.plot,
            core,
            {key: run for key, run in runs.items() if key[0] != 'mhe'},
            report.titles(),
        )
        print(f'identification: drew {options.plot}', file=sys.stderr)
    print(last_line('identification', plan.seeds, figures))
    return 0


def _tune(pool: ProcessPoolExecutor) -> int:
    from common.tuning import TUNED, jobs, tune

    found = sorted(_progress('tuning', [pool.submit(tune, *job) for job in jobs()]))
    TUNED.write_text(json.dumps({key: settings for key, settings, _ in found}, indent=1) + '\n')
    for key, settings, multiple in found:
        print(f'{key}: {settings}, {multiple:.3g} times the bound')
    return 0


def _progress(title: str, futures: Iterable[Future[Any]]) -> list[Any]:
    """Wait for all runs, in the order of completion; the progress bar goes to stderr."""
    waiting = list(futures)
    return [
        f.result()
        for f in tqdm(as_completed(waiting), title, len(waiting), file=sys.stderr, smoothing=0.0)
    ]


if __name__ == '__main__':
    sys.exit(main())
