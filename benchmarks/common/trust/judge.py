"""The figures of trust, and its tables."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from common.figures import Figure, number, table
from common.trust.kinds import POINT_5
from common.trust.records import Scenario
from common.trust.scenarios import scenarios
from common.trust.trial import KNOWN, LONGEST_FALSE_S, STDS, Trial

COLOURED_LOOP = 'coloured noise, closed loop'
HEATING = 'a winding that heats'
UNITS_GROUP = 'units and signs'


def scenario_of(trial: Trial) -> Scenario:
    """Return the scenario of a trial."""
    return _BY_NAME[trial.name]


_BY_NAME = {scenario.name: scenario for scenario in scenarios()}


def figures(trials: Sequence[Trial], before: Mapping[str, Mapping[str, float]]) -> list[Figure]:
    """Return what was asked, each with its goal."""
    judged = [trial for trial in trials if not scenario_of(trial).scale]
    right = [trial for trial in judged if scenario_of(trial).holds]
    wrong = [trial for trial in judged if not scenario_of(trial).holds]
    believed = [trial for trial in wrong if trial.identified_s]
    return [
        Figure('records where the white box does not hold', float(len(wrong)), None),
        Figure('  false identified at the end, in %', _percent(_is_false, wrong), 2.0),
        Figure(
            '  false identified for more than 1 s on the way, in %',
            _percent(_was_false, wrong),
            None,
        ),
        Figure(
            '  the same at the end, of those that identify anything, in %',
            _percent(_is_false, believed),
            None,
        ),
        Figure('  called misfit, in %', _percent(lambda t: t.is_misfit, wrong), None),
        Figure(
            '  right in all that is identified, and not a misfit, in %',
            _percent(_is_right, wrong),
            None,
        ),
        Figure('records where it holds', float(len(right)), None),
        Figure('  false identified at the end', float(sum(map(_is_false, right))), 0.0),
        Figure(
            '  false identified for more than 1 s on the way',
            float(sum(map(_was_false, right))),
            None,
        ),
        Figure('  called misfit', float(sum(trial.is_misfit for trial in right)), None),
        *_compared(right, before),
        _first_suspects(wrong),
        _coloured_loop(judged),
        *_heated(judged),
        *_mistakes(judged),
        *_costs(right, wrong),
        Figure('tracebacks', float(sum(bool(trial.failure) for trial in trials)), 0.0),
    ]


def _is_false(trial: Trial) -> bool:
    return bool(trial.false_at_end)


def _was_false(trial: Trial) -> bool:
    return trial.false_longest_s > LONGEST_FALSE_S


def _is_right(trial: Trial) -> bool:
    return bool(trial.identified_s) and not trial.false_at_end and not trial.is_misfit


def _percent(question: object, trials: Sequence[Trial]) -> float | None:
    assert callable(question)
    return 100.0 * float(np.mean([bool(question(trial)) for trial in trials])) if trials else None


def at_least(name: str, value: float | None, goal: float) -> Figure:
    """Return a figure in % that must not be smaller than its goal."""
    return Figure(name, value, (goal, 100.0))


def _compared(right: Sequence[Trial], before: Mapping[str, Mapping[str, float]]) -> list[Figure]:
    """Compare with what was identified before: whether it still is, and how soon."""
    still = []
    ratios = []
    for trial in right:
        times_s = before.get(f'{trial.name}/{trial.seed}')
        if not times_s:
            continue
        still.append(set(times_s) <= set(trial.identified_s))
        if still[-1]:
            now_s = max(trial.identified_s[name] for name in times_s)
            ratios.append(now_s / max(max(times_s.values()), 1e-9))
    share = 100.0 * float(np.mean(still)) if still else None
    return [
        at_least('  identified before that still are, in %', share, 95.0),
        Figure('  time to identified over before, mean', _mean(ratios), 1.15),
        Figure('  time to identified over before, worst', max(ratios, default=None), None),
    ]


def _first_suspects(wrong: Sequence[Trial]) -> Figure:
    asked = [t for t in wrong if t.is_misfit and POINT_5 & set(scenario_of(t).suspects)]
    right = [t.suspects[:1] != [] and t.suspects[0] in scenario_of(t).suspects for t in asked]
    share = 100.0 * float(np.mean(right)) if right else None
    return at_least(
        f'right suspect first, of {len(asked)} misfits of known kinds, in %', share, 80.0
    )


def _coloured_loop(judged: Sequence[Trial]) -> Figure:
    """Share of estimates within 3 std, of all parameters that are not zero and not withheld."""
    within = [
        abs(trial.deviations[name]) <= STDS
        for trial in judged
        if scenario_of(trial).group == COLOURED_LOOP
        for name, verdict in trial.verdicts.items()
        if verdict in ('identified', 'converging')
        and trial.errors.get(name, trial.values[name]) != trial.values[name]
    ]
    share = 100.0 * float(np.mean(within)) if within else None
    return at_least(
        f'closed loop, coloured noise: within 3 std, of {len(within)}, in %', share, 97.0
    )


def _heated(judged: Sequence[Trial]) -> list[Figure]:
    """Share of the time in which R of a winding that heats is known and right, and its misfits."""
    some = [trial for trial in judged if scenario_of(trial).group == HEATING]
    by_name: dict[str, list[float]] = {}
    for trial in some:
        by_name.setdefault(trial.name, []).append(trial.right_shares.get('resistance', 0.0))
    worst = min((float(np.mean(shares)) for shares in by_name.values()), default=None)
    kinds = f'worst of {len(by_name)} kinds'
    name = f'winding that heats: R known and right, of the time, {kinds}, in %'
    return [
        at_least(name, None if worst is None else 100.0 * worst, 45.0),
        Figure('  misfit at the end, in %', _percent(lambda t: t.is_misfit, some), None),
    ]


def _mistakes(judged: Sequence[Trial]) -> Iterable[Figure]:
    """Count the mistakes of the user that are named in every record, nothing being identified."""
    asked = [trial for trial in judged if scenario_of(trial).words]
    names = sorted({trial.name for trial in asked})
    good = [
        name for name in names if all(_is_named(trial) for trial in asked if trial.name == name)
    ]
    if names:
        value = 100.0 * len(good) / len(names)
        yield at_least(
            f'units and signs named, nothing identified, of {len(names)}, in %', value, 100.0
        )


def _is_named(trial: Trial) -> bool:
    words = re.search(scenario_of(trial).words, trial.messages)
    return bool(words) and 'identified' not in trial.verdicts.values()


def _costs(right: Sequence[Trial], wrong: Sequence[Trial]) -> list[Figure]:
    """Compare mean CPU times of a sample, record by record, each over a fixed piece of work.

    The goal is about equally many samples of every record; whole records are shown beside it.
    """
    healthy = [trial for trial in right if np.isfinite(trial.cost_share)]
    misfits = [trial for trial in wrong if np.isfinite(trial.cost_share)]
    if not healthy or not misfits:
        return []
    median_ms = float(np.median([trial.cost_ms for trial in healthy]))
    late_ms = float(np.percentile([trial.cost_ms for trial in misfits], 90))
    end_ms = float(np.percentile([trial.end_ms for trial in misfits], 90))
    first = _late_over_median(
        [trial.cost_share for trial in misfits], [trial.cost_share for trial in healthy]
    )
    whole = _late_over_median(
        [trial.whole_cost_share for trial in misfits],
        [trial.whole_cost_share for trial in healthy],
    )
    return [
        Figure('cost of one of 5,000 samples where it holds, median in ms', median_ms, None),
        Figure('cost of one where it does not, 90 % of records, in ms', late_ms, None),
        Figure('  over the median where it holds, clock for clock', first, 3.0),
        Figure('  the same over whole records, 5,000 to 40,000 samples', whole, None),
        Figure('work behind the last sample where it does not hold, 90 %, in ms', end_ms, None),
    ]


def _late_over_median(misfits: Sequence[float], healthy: Sequence[float]) -> float:
    return float(np.percentile(misfits, 90) / np.median(healthy))


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def class_table(trials: Sequence[Trial]) -> str:
    """Lay out what came of every class."""
    titles = 'class|holds|records|false|> 1 s|misfit|named|L id|R id|worst L %|worst R %|worst std'
    header = f'{titles}|fit ratio|warned|ms'.split('|')
    rows = []
    for group in dict.fromkeys(scenario.group for scenario in scenarios()):
        some = [trial for trial in trials if scenario_of(trial).group == group]
        if some:
            rows.append(_class_row(group, some))
    return table(header, rows)


def _class_row(group: str, trials: Sequence[Trial]) -> list[str]:
    holds = {scenario_of(trial).holds for trial in trials}
    named = [t for t in trials if t.suspects and t.suspects[0] in scenario_of(t).suspects]
    ratios = [t.fit['ratio'] for t in trials if t.fit.get('ratio') is not None]
    believed = [
        abs(z) for t in trials for name, z in t.deviations.items() if t.verdicts[name] in KNOWN
    ]
    return [
        group,
        {(True,): 'yes', (False,): 'no'}.get(tuple(holds), 'part'),
        str(len(trials)),
        str(sum(map(_is_false, trials))),
        str(sum(map(_was_false, trials))),
        str(sum(trial.is_misfit for trial in trials)),
        str(len(named)),
        *(
            str(sum(t.verdicts.get(n) in KNOWN for t in trials))
            for n in ('inductance', 'resistance')
        ),
        *(_worst_error(trials, name) for name in ('inductance', 'resistance')),
        number(max(believed, default=None)),
        '-' if not ratios else f'{min(ratios):.2g}..{max(ratios):.3g}',
        str(sum(bool(trial.warnings) for trial in trials)),
        number(_mean([trial.cost_ms for trial in trials])),
    ]


def _worst_error(trials: Sequence[Trial], name: str) -> str:
    """Largest error in % of those that are believed."""
    errors = [abs(t.errors[name]) for t in trials if t.verdicts.get(name) in KNOWN]
    return number(100.0 * max(errors)) if errors else '-'


def record_table(trials: Sequence[Trial]) -> str:
    """Lay out every record."""
    titles = 'scenario|seed|false|false s|L % (z)|R % (z)|other % (z)|fit|suspects|ms|worst'
    header = titles.split('|')
    rows = []
    for t in trials:
        others = [name for name in t.verdicts if name not in ('inductance', 'resistance')]
        fit = (
            '-'
            if not t.fit
            else f'{t.fit["verdict"]} {number(t.fit["ratio"])} {number(t.fit["whiteness"])}'
        )
        rows.append(
            [
                t.name,
                str(t.seed),
                ','.join(name[:5] for name in t.false_at_end) or '-',
                number(t.false_longest_s),
                _cell(t, 'inductance'),
                _cell(t, 'resistance'),
                ' '.join(_cell(t, name) for name in others),
                fit if not t.failure else f'TRACEBACK {t.failure.strip().splitlines()[-1]}',
                ','.join(t.suspects[:2]) or '-',
                number(t.cost_ms),
                number(t.worst_ms),
            ]
        )
    return table(header, rows)


def _cell(trial: Trial, name: str) -> str:
    if name not in trial.verdicts:
        return '-'
    verdict = trial.verdicts[name]
    if name not in trial.errors:
        return verdict[:4]
    return f'{verdict[:4]} {100.0 * trial.errors[name]:.3g} ({trial.deviations[name]:.1f})'
