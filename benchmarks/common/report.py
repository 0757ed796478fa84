"""Tables and figures of the identification benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.cases import CASES, Case
from common.changes import STEPS, Step
from common.estimator import OWN_RULES
from common.figures import Figure, number, table
from common.motion import FloatArray
from common.study import OUTLIERS, ROBUSTNESS, Outcome, gather
from common.summary import Summary, nees_band, summarise
from common.tuning import PEERS

BATCH = 'batch'
SYMBOLS = {'inductance': 'L', 'resistance': 'R', 'hysteresis': 'K_HS', 'back_emf_constant': 'Kb'}
STARTS = {False: 'every parameter 3 times too large', True: '2 to 3 times off either way'}


class Plan(Protocol):
    """What of the plan the tables need."""

    methods: tuple[str, ...]
    seeds: int
    own_seeds: int
    noises: tuple[float, ...]
    rivals: tuple[str, ...]

    @property
    def counts(self) -> bool:
        """Whether the run was large enough for a verdict."""


@dataclass(frozen=True, slots=True)
class Results:
    """Everything that was run.

    Attributes:
        outcomes: of every piece of work, in any order.
        plan: what was asked for.
        times: microseconds a sample by method.
        alarms: false alarms in the hours of the core sets; None where they were not run.
        held: of each core set, shape (parameter,): least ratio of the standard deviations in an
            hour of constant voltage to those before; None where they were not run.
    """

    outcomes: Sequence[Outcome]
    plan: Plan
    times: dict[str, float]
    alarms: int | None
    held: Sequence[FloatArray] | None

    def summary(
        self, method: str, case: Case, noise: float, either_way: bool, seeds: int | None = None
    ) -> Summary | None:
        """One row; None where the method did not run."""
        runs = gather(self.outcomes, method, case.name, noise, either_way, seeds or self.plan.seeds)
        return summarise(runs, noise) if runs else None


def titles() -> dict[str, str]:
    """What the methods are called in tables."""
    own = {'recursive': 'ours', 'gradient': "thesis's rule"}
    peers = {name: peer.title for name, peer in PEERS.items()}
    return {**own, **peers, BATCH: 'batch output error (scipy), offline'}


def own_rule(methods: Sequence[str]) -> str:
    """The package's rule that the figures speak of; empty where none runs."""
    return next((name for name in OWN_RULES if name in methods), '')


def tables(results: Results) -> str:
    """All tables, one a data set, noise and kind of start."""
    parts = [
        _table(results, case, noise, either_way)
        for case in CASES
        for noise in results.plan.noises
        for either_way in ((False, True) if noise == 0.01 else (False,))
    ]
    return '\n\n'.join([*parts, _robustness_table(results)]) + '\n'


def _table(results: Results, case: Case, noise: float, either_way: bool) -> str:
    symbols = [SYMBOLS[name] for name in case.parameters]
    header = ['method', *(f'{s} %' for s in symbols), *(f'{s} x bound' for s in symbols)]
    header += ['within 1 % from s', 'NEES', 'diverged', 'us/sample', 'x EKF']
    rows = []
    for method in (*results.plan.methods, BATCH):
        row = results.summary(method, case, noise, either_way)
        if row is not None:
            rows.append([titles()[method], *_cells(row), *_time_cells(results.times, method)])
    runs = gather(
        results.outcomes, own_rule(results.plan.methods) or BATCH, case.name, noise, either_way
    )
    if runs and noise > 0.0:
        limits = np.sqrt(
            np.mean([bounds[-1] ** 2 for _, bounds, _ in runs[: results.plan.seeds]], axis=0)
        )
        blank = [''] * (len(header) - 1 - len(symbols))
        rows.append(['Cramer-Rao bound', *(number(100.0 * v) for v in limits), *blank])
    length = f'{runs[0][2][-1]:.0f} s at {case.rate_hz:g} Hz' if runs else ''
    start = f'; start: {STARTS[either_way]}' if noise == 0.01 else ''
    return (
        f'{case.name}: {case.excitation}, {length}, noise {100 * noise:g} '
        f'%{start}\n{table(header, rows)}'
    )


def _cells(row: Summary) -> list[str]:
    errors = [number(100.0 * v) for v in row.error]
    multiples = [number(v) for v in row.multiple]
    return [
        *errors,
        *multiples,
        number(row.settle_s),
        number(row.nees),
        f'{row.diverged}/{row.runs}',
    ]


def _time_cells(times: dict[str, float], method: str) -> list[str]:
    spent, filter_spent = times.get(method), times.get('ekf')
    ratio = spent / filter_spent if spent and filter_spent else None
    return ['-' if spent is None else f'{spent:.0f}', number(ratio)]


def _robustness_table(results: Results) -> str:
    header = [
        '1 % noise',
        'data',
        *(f'{kind} outliers move it, x error' for kind in OUTLIERS),
        *(f'{step.title}: followed in s' for step in STEPS),
        *(f'R climbs 20 %: {SYMBOLS[name]} % (std)' for name in CASES[0].parameters),
    ]
    rows = []
    for method in ROBUSTNESS:
        for case in [case for case in CASES if case.core]:
            moved = [_moved(results, method, case, kind) for kind in OUTLIERS]
            if any(value is not None for value in moved):
                followed = [_settled(results, method, case, step.title) for step in STEPS]
                cells = [number(value) if value is not None else '' for value in followed]
                rows.append(
                    [
                        titles()[method],
                        case.name,
                        *map(number, moved),
                        *cells,
                        *_climb(results, method, case),
                    ]
                )
    return table(header, rows)


def _settled(results: Results, method: str, case: Case, step: str) -> float | None:
    """Longest time of any seed until a step was followed; None where it was not run."""
    key = (method, step)
    return max(
        (
            o.steps[key].settled_s
            for o in results.outcomes
            if o.case == case.name and key in o.steps
        ),
        default=None,
    )


def _climb(results: Results, method: str, case: Case) -> list[str]:
    """Root mean square error of each parameter during a slow climb of R, in % and in std."""
    climbs = [
        o.climbs[method] for o in results.outcomes if o.case == case.name and method in o.climbs
    ]
    if not climbs:
        return []
    errors = 100.0 * np.sqrt(np.mean([c.error**2 for c in climbs], axis=0))
    stds = np.sqrt(np.mean([c.stds**2 for c in climbs], axis=0))
    return [f'{number(float(e))} ({number(float(s))})' for e, s in zip(errors, stds, strict=True)]


def _moved(results: Results, method: str, case: Case, kind: str) -> float | None:
    """Shift of an estimate by outliers, in units of its error without them, RMS over seeds.

    The worst parameter counts.
    """
    moves = [
        o.moved[method, kind]
        for o in results.outcomes
        if o.case == case.name and (method, kind) in o.moved
    ]
    row = results.summary(method, case, 0.01, either_way=False)
    if not moves or row is None:
        return None
    far = np.sqrt(np.mean(np.nan_to_num(np.abs(moves), nan=np.inf) ** 2, axis=0))
    return float(np.max(far / row.error))


def figures(results: Results) -> list[Figure]:
    """The figures to reach, of the package's first rule."""
    method = own_rule(results.plan.methods)
    plan = results.plan
    found: list[Figure] = []
    for case in CASES:
        found += (
            _figures_of_core(results, method, case)
            if case.core
            else _figures_of_other(results, method, case)
        )
        for either_way in (False, True):
            found += _against_peers(results, method, case, either_way)
    for step in STEPS:
        found += _figures_of_step(results, method, step)
    ours = results.times.get(method)
    filter_time = results.times.get('ekf')
    found += [
        Figure(
            'time a sample / filterpy EKF',
            ours / filter_time if ours and filter_time else None,
            1.0,
            plan.counts,
        ),
        Figure('false alarms in an hour of each core set (--long)', results.alarms, 0.0),
    ]
    if (
        results.held is not None
    ):  # what the level cannot tell: everything but what heats; given as a ratio to pass
        least = float(min(np.min(np.delete(ratio, 1)) for ratio in results.held))
        found.append(
            Figure(
                'hour of constant voltage: std before / after, L and K_HS, worst (--long)',
                1.0 / least,
                1.01,
            )
        )
    return found


def _figures_of_step(results: Results, method: str, step: Step) -> list[Figure]:
    key = (method, step.title)
    runs = [o.steps[key] for o in results.outcomes if key in o.steps]
    if not runs:
        return []
    times = [run.settled_s for run in runs]
    goal = 3.0 if step is STEPS[0] else None
    counts = results.plan.counts
    multiple = float(np.max(np.sqrt(np.mean([run.multiple**2 for run in runs], axis=0))))
    return [
        Figure(f'{step.title}: s until within 2 % to stay, worst seed', max(times), goal, counts),
        Figure(f'{step.title}: the same, median seed', float(np.median(times)), None),
        Figure(
            f'{step.title}: error 10 s later / bound of these 10 s, worst parameter',
            multiple,
            1.2,
            counts,
        ),
    ]


def _figures_of_core(results: Results, method: str, case: Case) -> list[Figure]:
    plan = results.plan
    found = []
    row = results.summary(method, case, 0.01, False, plan.own_seeds)
    if row is None:
        return []
    for name, value in zip(case.parameters, row.multiple, strict=True):
        found.append(
            Figure(f'{case.name}: RMS error of {name} / bound', float(value), 1.2, plan.counts)
        )
    clean = results.summary(method, case, 0.0, False)
    batch, same = (results.summary(name, case, 0.01, False) for name in (BATCH, method))
    ratio = same.settle_s / batch.settle_s if batch and same and batch.settle_s < np.inf else None
    rare = row.overconfident / row.identified if row.identified else None
    found += [
        Figure(
            f'{case.name}: diverged seeds of {row.runs}',
            row.diverged,
            0.0,
            plan.counts and row.runs >= 100,
        ),
        Figure(
            f'{case.name}: noise-free worst error in %',
            100.0 * clean.worst if clean else None,
            0.01,
            plan.counts,
        ),
        Figure(f'{case.name}: time to 1 % / batch', ratio, 1.5, plan.counts),
        Figure(
            f'{case.name}: mean NEES',
            row.nees,
            nees_band(len(case.parameters), row.runs),
            plan.counts,
        ),
        Figure(f'{case.name}: identified but beyond 3 std, fraction', rare, 0.01, plan.counts),
        Figure(f'{case.name}: false alarms in {row.runs} recordings', row.alarms, 0.0, plan.counts),
    ]
    climbs = [
        o.climbs[method] for o in results.outcomes if o.case == case.name and method in o.climbs
    ]
    if climbs:
        stds = float(np.max(np.sqrt(np.mean([c.stds**2 for c in climbs], axis=0))))
        errors = 100.0 * np.max(np.sqrt(np.mean([c.error**2 for c in climbs], axis=0)))
        found += [
            Figure(f'{case.name}: R climbs 20 %: error in %, worst parameter', float(errors), None),
            Figure(
                f'{case.name}: R climbs 20 %: error in stated std, worst parameter',
                stds,
                2.0,
                plan.counts,
            ),
        ]
    for kind in OUTLIERS:
        moved = _moved(results, method, case, kind)
        found.append(
            Figure(f'{case.name}: moved by {kind} outliers / error', moved, 2.0, plan.counts)
        )
    return found


def _figures_of_other(results: Results, method: str, case: Case) -> list[Figure]:
    row = results.summary(method, case, 0.01, False)
    if row is None:
        return []
    worst = float(np.max(row.multiple))
    band = nees_band(len(case.parameters), row.runs)
    return [
        Figure(f'{case.name}: RMS error / bound, worst parameter', worst, None),
        Figure(
            f'{case.name}: mean NEES, consistent in {band[0]:.2f} to {band[1]:.2f}', row.nees, None
        ),
    ]


def _against_peers(results: Results, method: str, case: Case, either_way: bool) -> list[Figure]:
    """Ours over the best online peer: RMS multiple of the bound, parameters and common seeds."""
    ratios = {}
    for name in [name for name in results.plan.methods if name in PEERS]:
        seeds = results.plan.own_seeds if name in results.plan.rivals else results.plan.seeds
        ours, peer = (results.summary(who, case, 0.01, either_way, seeds) for who in (method, name))
        if ours is not None and peer is not None:
            ratios[name] = ours.overall / peer.overall
    if not ratios:
        return []
    best = max(ratios, key=lambda name: ratios[name])
    title = f'{case.name}: error / best online peer ({titles()[best]}), start {STARTS[either_way]}'
    return [Figure(title, ratios[best], 1.0, results.plan.counts)]
