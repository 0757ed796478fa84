"""Tables, the ranking in words, and figures of the experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from common.figures import Figure, number, table
from common.table_5_1 import thesis
from common.table_5_1.recordings import MOTOR, PLAIN_SETS_OUT_OF_RANGE, SETS
from common.table_5_1.settings import Setting
from common.table_5_1.study import (
    CONSTANT,
    PERSISTENCE,
    WHITE_BOX,
    WHITE_BOX_GRADIENT,
    Outcome,
    extra_variants,
    untaught,
)
from gray_box_observer.white_box.interface import Array

PHYSICS = 'physics'
TITLES = {
    'main': '1 main',
    'sees_data': '2 sees data',
    'supervised_with_parameters': '3 superv. + theta',
    'supervised': '4 supervised',
    PHYSICS: '5 physics',
    untaught(PHYSICS): '5 untrained',
    WHITE_BOX: 'white box',
    WHITE_BOX_GRADIENT: 'white box, gradient theta',
    PERSISTENCE: 'persistence',
    CONSTANT: 'constant',
}
PARAMETERS = {'inductance': 'L', 'resistance': 'R', 'hysteresis': 'K_HS'}
PAIRS = tuple(combinations(thesis.FOUR, 2))


@dataclass(frozen=True, slots=True)
class Results:
    """Everything that was run in one setting.

    Attributes:
        setting: which.
        outcomes: of every piece, in any order.
        counts: whether the run was large enough for a verdict.
    """

    setting: Setting
    outcomes: Sequence[Outcome]
    counts: bool

    @property
    def rows(self) -> tuple[str, ...]:
        """Rows that were run: the thesis's four, further variants, then those without training."""
        further = [row for variant in extra_variants() for row in (variant, untaught(variant))]
        order = (*thesis.FOUR, *further, WHITE_BOX, WHITE_BOX_GRADIENT, PERSISTENCE, CONSTANT)
        return tuple(row for row in order if any(True for _ in self._of(row)))

    def difference_nm(self, row: str) -> Array:
        """The thesis's score, shape (run, set)."""
        return np.array([o.score.difference_nm for o in self._of(row)])

    def error_percent(self, row: str) -> Array:
        """Error of the torque itself, shape (run, set)."""
        return np.array([o.score.error_percent for o in self._of(row)])

    def theta(self, row: str) -> Array:
        """Identified parameters, shape (run, parameter)."""
        return np.array([o.theta for o in self._of(row) if o.theta is not None])

    def settled(self, row: str) -> float | None:
        """Validation loss at half time over that at the end, median of the runs, or None."""
        found = [o.settled for o in self._of(row) if o.settled is not None]
        return float(np.median(found)) if found else None

    def _of(self, row: str) -> list[Outcome]:
        found = [o for o in self.outcomes if o.setting == self.setting.name and o.row == row]
        return sorted(found, key=lambda o: o.run)


def tables(results: Results) -> str:
    """All that is said of one setting."""
    parts = [
        f'=== {results.setting.title}',
        _excess_table(results),
        _error_table(results),
        _theta_table(results),
        '\n'.join(ranking_in_words(results)),
    ]
    settled = {row: results.settled(row) for row in thesis.FOUR}
    if all(value is not None for value in settled.values()):
        said = ', '.join(f'{TITLES[row]} {number(value)}' for row, value in settled.items())
        parts.append(f'Validation loss half way / at the end (1: converged): {said}')
    if not extra_variants():
        parts.append(f'The package has no variant beyond the four of the thesis: no row {PHYSICS}.')
    return '\n\n'.join(parts)


def _excess_table(results: Results) -> str:
    """Table 5.1, one line per set: relative to the best of four, less one; thesis in brackets."""
    medians = {row: np.median(results.difference_nm(row), axis=0) for row in results.rows}
    lines = []
    for j, name in enumerate(SETS):
        best = min(medians[row][j] for row in thesis.FOUR)
        cells = [name]
        for row in results.rows:
            quoted = f' ({thesis.EXCESS[row][j]:.3g})' if row in thesis.EXCESS else ''
            cells.append(f'{number(medians[row][j] / best - 1.0)}{quoted}')
        lines.append([*cells, number(1e6 * best), f'{thesis.BASELINE_ERROR[j]:g}'])
    header = ['set', *(title(row) for row in results.rows), 'best, uN m', 'baseline row']
    caption = (
        'L1 of first differences, relative to the best of the four (0: the best), median run; in '
        'brackets and last: '
        f'{thesis.SOURCE}.\nIts baseline row is the absolute error of the best, in a unit that it '
        'does not give; '
        'ours is in micronewton metres a sample.'
    )
    return f'{caption}\n{table(header, lines)}'


def _error_table(results: Results) -> str:
    """The torque itself: median and worst run."""
    lines = []
    for j, name in enumerate(SETS):
        cells = [results.error_percent(row)[:, j] for row in results.rows]
        lines.append(
            [name, *(f'{number(float(np.median(c)))} / {number(float(c.max()))}' for c in cells)]
        )
    caption = (
        "Mean absolute error of the torque in % of the set's torque standard deviation, median / "
        'worst run.'
    )
    return f'{caption}\n{table(["set", *(title(row) for row in results.rows)], lines)}'


def _theta_table(results: Results) -> str:
    truth = np.array([getattr(MOTOR, name) for name in PARAMETERS])
    lines = []
    for row in (WHITE_BOX, WHITE_BOX_GRADIENT):
        if row in results.rows:
            error = 100.0 * np.abs(results.theta(row) / truth - 1.0)
            cells = [f'{number(float(np.median(e)))} / {number(float(e.max()))}' for e in error.T]
            rule = (
                'gradient'
                if row == WHITE_BOX_GRADIENT
                else results.setting.configuration('main')['context_update']
            )
            lines.append([f'theta by the {rule} rule', *cells])
    header = ['error in %, median / worst run', *PARAMETERS.values()]
    return table(header, lines)


def title(row: str) -> str:
    """What a row is called."""
    return TITLES.get(row, row)


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the order of the four on one set compares with the thesis's.

    Attributes:
        same_best: whether the thesis's best is the best here too, in the median run; None where the
            best two are tied.
        agree: pairs in the thesis's order in every run.
        opposite: pairs in the opposite order in every run.
        open: pairs that are tied, or whose order changes from run to run.
    """

    same_best: bool | None
    agree: int
    opposite: int
    open: int


def agreement(errors: Mapping[str, Array], column: int) -> Agreement:
    """Compare the order on one set.

    Args:
        errors: by variant, shape (run, set).
        column: which set.
    """
    agree = opposite = 0
    for pair in PAIRS:
        first, second = sorted(pair, key=lambda row: thesis.EXCESS[row][column])
        runs = list(zip(errors[first][:, column], errors[second][:, column], strict=True))
        agree += all(thesis.better(a, b) for a, b in runs)
        opposite += all(thesis.better(b, a) for a, b in runs)
    medians = _medians(errors)
    best, next_best = order(medians, column)[:2]
    alone = thesis.better(medians[best][column], medians[next_best][column])
    same = best == order(thesis.EXCESS, column)[0]
    return Agreement(same if alone else None, agree, opposite, len(PAIRS) - agree - opposite)


def order(errors: thesis.Errors, column: int) -> list[str]:
    """The four from the best to the worst on one set."""
    return sorted(thesis.FOUR, key=lambda row: errors[row][column])


def ranking_in_words(results: Results) -> list[str]:
    """Say, set by set and claim by claim, where the ranking agrees with the thesis's."""
    errors = {row: results.difference_nm(row) for row in thesis.FOUR}
    here = _medians(errors)
    torque = _medians({row: results.error_percent(row) for row in thesis.FOUR})
    compared = [agreement(errors, j) for j in range(len(SETS))]
    lines = [
        'Ranking of the four by first differences, best first, "=" within 1 %; a pair counts if '
        'every run agrees:'
    ]
    for j, (name, found) in enumerate(zip(SETS, compared, strict=True)):
        best = {True: 'the same best', False: 'another best', None: 'no single best'}[
            found.same_best
        ]
        lines.append(
            f'  {name}: thesis {_numbers(thesis.EXCESS, j, ties=False)}, here {_numbers(here, j)} '
            f'(by torque {_numbers(torque, j)}): {best}; of {len(PAIRS)} pairs {found.agree} '
            'agree, '
            f'{found.opposite} are the other way round, {found.open} open'
        )
    same = sum(found.same_best is True for found in compared)
    agree = sum(found.agree for found in compared)
    opposite = sum(found.opposite for found in compared)
    lines.append(
        f'  Together: the same best on {same} of {len(SETS)} sets; of {len(PAIRS) * len(SETS)} '
        f'pairs {agree} agree and '
        f'{opposite} are the other way round.'
    )
    lines.append(
        'What the thesis reads from its table (pages 42, 43), and on how many sets it holds there '
        'and here:'
    )
    for claim in thesis.CLAIMS:
        said = claim.count(thesis.ratios())
        found_here = claim.count(here)
        many = len(claim.columns)
        verdict = (
            'confirmed'
            if found_here >= said
            else 'not confirmed'
            if 2 * found_here <= said
            else 'in part'
        )
        lines.append(
            f'  {claim.text}: thesis {said} of {many}, here {found_here} of {many}: {verdict}'
        )
    idle = [name for j, name in enumerate(SETS) if not _beats_constant(results, here, j)]
    lines.append(
        'By first differences no variant beats a torque that never changes on: '
        f'{", ".join(idle) or "no set"}'
    )
    return lines


def _beats_constant(results: Results, medians: thesis.Errors, column: int) -> bool:
    idle = float(np.median(results.difference_nm(CONSTANT)[:, column]))
    return any(thesis.better(row[column], idle) for row in medians.values())


def _medians(errors: Mapping[str, Array]) -> dict[str, list[float]]:
    """Over the runs."""
    return {row: np.median(value, axis=0).tolist() for row, value in errors.items()}


def _numbers(errors: thesis.Errors, column: int, ties: bool = True) -> str:
    """The order on one set as the numbers of the variants."""
    rows = order(errors, column)
    text = str(thesis.FOUR.index(rows[0]) + 1)
    for before, row in pairwise(rows):
        sign = (
            '=' if ties and not thesis.better(errors[before][column], errors[row][column]) else '<'
        )
        text += f' {sign} {thesis.FOUR.index(row) + 1}'
    return text


def figures(results: Results) -> list[Figure]:
    """The figures of one setting; goals are stated for ours."""
    name = results.setting.name
    found = []
    wide = SETS.index('R[0,33]D[1,20]')
    for k, row in enumerate(thesis.FOUR, start=1):
        value = float(np.median(results.error_percent(row)[:, wide]))
        found.append(Figure(f'variant {k} on R[0,33]D[1,20], MAE % of std ({name})', value, None))
    errors = {row: results.difference_nm(row) for row in thesis.FOUR}
    compared = [agreement(errors, j) for j in range(len(SETS))]
    same = sum(c.same_best is True for c in compared)
    agree = sum(c.agree for c in compared)
    opposite = sum(c.opposite for c in compared)
    limit = float(results.error_percent(WHITE_BOX).max())
    found += [
        Figure(f'sets with the same best variant as in the thesis, of 8 ({name})', same, None),
        Figure(f'pairs of variants ranked as in the thesis, of 48 ({name})', agree, None),
        Figure(f'pairs of variants ranked the other way round, of 48 ({name})', opposite, None),
        Figure(f'white box: worst MAE % of std over eight sets ({name})', limit, None),
    ]
    return found + _physics_figures(results)


def _physics_figures(results: Results) -> list[Figure]:
    """Figure of the fifth variant, on the worst run; no value where the package lacks it."""
    name = results.setting.name
    goal = results.setting.online
    worst = typical = ratio = control = None
    if PHYSICS in results.rows:
        errors = results.error_percent(PHYSICS)
        worst = float(errors.max())
        typical = float(np.median(errors, axis=0).max())
        columns = [SETS.index(plain) for plain in PLAIN_SETS_OUT_OF_RANGE]
        ratio = float((errors / results.error_percent('supervised'))[:, columns].max())
    if untaught(PHYSICS) in results.rows:
        control = float(results.error_percent(untaught(PHYSICS)).max())
    plain = 'the four plain sets out of the training range'
    return [
        Figure(
            f'physics: worst MAE % of std over eight sets ({name}), worst run',
            worst,
            1.0 if goal else None,
            results.counts,
        ),
        Figure(f'physics: worst MAE % of std over eight sets ({name}), median run', typical, None),
        Figure(
            f'physics, its network untrained: worst MAE % of std over eight sets ({name}), worst '
            'run',
            control,
            None,
        ),
        Figure(
            f'physics / variant 4, MAE on {plain}, largest ({name})',
            ratio,
            0.01 if goal else None,
            results.counts,
        ),
    ]
