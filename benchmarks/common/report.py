"""Tables and figures of the identification benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from common.cases import CASES, Case
from common.estimator import OWN_RULES
from common.figures import Figure, number, table
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
    """

    outcomes: Sequence[Outcome]
    plan: Plan
    times: dict[str, float]
    alarms: int | None

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
    runs = gather(results.outcomes, own_rule(results.plan.methods) or BATCH, case.name, noise, either_way)
    if runs and noise > 0.0:
        limits = np.sqrt(np.mean([bounds[-1] ** 2 for _, bounds, _ in runs[: results.plan.seeds]], axis=0))
        blank = [''] * (len(header) - 1 - len(symbols))
        rows.append(['Cramer-Rao bound', *(number(100.0 * v) for v in limits), *blank])
    length = f'{runs[0][2][-1]:.0f} s at {case.rate_hz:g} Hz' if runs else ''
    start = f'; start: {STARTS[either_way]}' if noise == 0.01 else ''
    return f'{case.name}: {case.excitation}, {length}, noise {100 * noise:g} %{start}\n{table(header, rows)}'


def _cells(row: Summary) -> list[str]:
    errors = [number(100.0 * v) for v in row.error]
    multiples = [number(v) for v in row.multiple]
    return [*errors, *multiples, number(row.settle_s), number(row.nees), f'{row.diverged}/{row.runs}']


def _time_cells(times: dict[str, float], method: str) -> list[str]:
    spent, filter_spent = times.get(method), times.get('ekf')
    ratio = spent / filter_spent if spent and filter_spent else None
    return ['-' if spent is None else f'{spent:.0f}', number(ratio)]


def _robustness_table(results: Results) -> str:
    header = [
        '1 % noise',
        'data',
        *(f'{kind} outliers move it, x error' for kind in OUTLIERS),
        'R + 30 %: followed in s',
    ]
    rows = []
    for method in ROBUSTNESS:
        for case in [case for case in CASES if case.core]:
            moved = [_moved(results, method, case, kind) for kind in OUTLIERS]
            steps = [o.step_s[method] for o in results.outcomes if o.case == case.name and method in o.step_s]
            if any(value is not None for value in moved):
                worst = number(max(steps)) if steps else ''
                rows.append([titles()[method], case.name, *(number(value) for value in moved), worst])
    return table(header, rows)


def _moved(results: Results, method: str, case: Case, kind: str) -> float | None:
    """How far outliers move an estimate, in units of its error without them; the worst parameter, RMS over seeds."""
    moves = [o.moved[method, kind] for o in results.outcomes if o.case == case.name and (method, kind) in o.moved]
    row = results.summary(method, case, 0.01, either_way=False)
    if not moves or row is None:
        return None
    far = np.sqrt(np.mean(np.nan_to_num(np.abs(moves), nan=np.inf) ** 2, axis=0))
    return float(np.max(far / row.error))


def figures(results: Results) -> list[Figure]:
    """The figures to reach, of the package's first rule."""
    method, plan = own_rule(results.plan.methods), results.plan
    found: list[Figure] = []
    for case in CASES:
        found += _figures_of_core(results, method, case) if case.core else _figures_of_other(results, method, case)
        for either_way in (False, True):
            found += _against_peers(results, method, case, either_way)
    steps = [o.step_s[method] for o in results.outcomes if method in o.step_s]
    ours, filter_time = results.times.get(method), results.times.get('ekf')
    found += [
        Figure('R + 30 %: s until within 2 % to stay, worst seed', max(steps, default=None), 3.0, plan.counts),
        Figure('R + 30 %: the same, median seed', float(np.median(steps)) if steps else None, None),
        Figure('time a sample / filterpy EKF', ours / filter_time if ours and filter_time else None, 1.0, plan.counts),
        Figure('false alarms in an hour of each core set (--long)', results.alarms, 0.0),
    ]
    return found


def _figures_of_core(results: Results, method: str, case: Case) -> list[Figure]:
    plan, found = results.plan, []
    row = results.summary(method, case, 0.01, False, plan.own_seeds)
    if row is None:
        return []
    for name, value in zip(case.parameters, row.multiple, strict=True):
        found.append(Figure(f'{case.name}: RMS error of {name} / bound', float(value), 1.2, plan.counts))
    clean = results.summary(method, case, 0.0, False)
    batch, same = (results.summary(name, case, 0.01, False) for name in (BATCH, method))
    ratio = same.settle_s / batch.settle_s if batch and same and batch.settle_s < np.inf else None
    rare = row.overconfident / row.identified if row.identified else None
    found += [
        Figure(f'{case.name}: diverged seeds of {row.runs}', row.diverged, 0.0, plan.counts and row.runs >= 100),
        Figure(f'{case.name}: noise-free worst error in %', 100.0 * clean.worst if clean else None, 0.01, plan.counts),
        Figure(f'{case.name}: time to 1 % / batch', ratio, 1.5, plan.counts),
        Figure(f'{case.name}: mean NEES', row.nees, nees_band(len(case.parameters), row.runs), plan.counts),
        Figure(f'{case.name}: identified but beyond 3 std, fraction', rare, 0.01, plan.counts),
        Figure(f'{case.name}: false alarms in {row.runs} recordings', row.alarms, 0.0, plan.counts),
    ]
    for kind in OUTLIERS:
        moved = _moved(results, method, case, kind)
        found.append(Figure(f'{case.name}: moved by {kind} outliers / error', moved, 2.0, plan.counts))
    return found


def _figures_of_other(results: Results, method: str, case: Case) -> list[Figure]:
    row = results.summary(method, case, 0.01, False)
    if row is None:
        return []
    worst = float(np.max(row.multiple))
    band = nees_band(len(case.parameters), row.runs)
    return [
        Figure(f'{case.name}: RMS error / bound, worst parameter', worst, None),
        Figure(f'{case.name}: mean NEES, consistent in {band[0]:.2f} to {band[1]:.2f}', row.nees, None),
    ]


def _against_peers(results: Results, method: str, case: Case, either_way: bool) -> list[Figure]:
    """Ours over the best online peer: root mean square multiple of the bound over parameters and seeds."""
    ours = results.summary(method, case, 0.01, either_way)
    rows = {name: results.summary(name, case, 0.01, either_way) for name in results.plan.methods if name in PEERS}
    peers = {name: row.overall for name, row in rows.items() if row is not None}
    if ours is None or not peers:
        return []
    best = min(peers, key=lambda name: peers[name])
    title = f'{case.name}: error / best online peer ({titles()[best]}), start {STARTS[either_way]}'
    return [Figure(title, ours.overall / peers[best], 1.0, results.plan.counts)]
