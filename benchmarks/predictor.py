"""How well the predictor forecasts torque from voltages alone, on every set of the thesis.

Its network has seen none of them: it ships pre-trained, and nothing is trained here but where it
says so.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from common.cases import THESIS_MOTOR
from common.figures import Figure, figure_table, last_line, number, table
from common.prediction import (
    SETS,
    OneStep,
    Scores,
    after_a_step,
    identified,
    microseconds,
    motors,
    one_step,
    record,
    scores,
    taught_from_scratch,
    theta_of,
)
from common.progress import progress_bar

SLOW_HZ = 5.0
"""Slow sampling: an interval is a good part of a time constant, and the way there matters."""

OFF = 0.4
"""How far the parameters of a motor never seen are off."""

DURATIONS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Lengths of forecasts in one step, in time constants."""

COLUMNS = ('network', 'untrained', 'white box')


class Progress:
    """One bar over all the work."""

    def __init__(self, total: int) -> None:
        self._bar = progress_bar(total=total, unit='run')

    def done(self, what: str) -> None:
        """Count one piece."""
        self._bar.set_postfix_str(what)
        self._bar.update()


def by_set(title: str, rows: dict[str, Scores], worst: bool = False) -> str:
    """Lay out the errors of the sets; with several motors median and, where asked, worst."""
    header = ['set', *COLUMNS] + (['network, worst', 'white box, worst'] if worst else [])
    cells = []
    for name, score in rows.items():
        row = [
            name,
            *(
                number(float(np.median(getattr(score, c))))
                for c in ('network', 'untrained', 'white_box')
            ),
        ]
        if worst:
            row += [number(float(score.network.max())), number(float(score.white_box.max()))]
        cells.append(row)
    return f'{title}\n\n{table(header, cells)}\n'


def forecasts(rows: Sequence[OneStep]) -> str:
    """Lay out forecasts in one step."""
    title = (
        'One step of any length, motors of every kind, error in % of the way left to the steady '
        'state'
    )
    header = [
        'time constants',
        'network, mean',
        'untrained, mean',
        'network, 99 of 100',
        'untrained, 99 of 100',
    ]
    cells = []
    for row in rows:
        both = row.trained, row.untrained
        values = [*(float(e.mean()) for e in both), *(float(np.quantile(e, 0.99)) for e in both)]
        cells.append([f'{row.duration:g}', *(number(value) for value in values)])
    return f'{title}\n\n{table(header, cells)}\n'


def joined(parts: Sequence[Scores]) -> Scores:
    """Several runs of one set as one."""
    return Scores(
        *(
            np.concatenate([getattr(p, name) for p in parts])
            for name in ('network', 'untrained', 'white_box')
        )
    )


def highest(rows: dict[str, Scores]) -> float:
    """Largest error of the network over all sets and motors."""
    return max(float(score.network.max()) for score in rows.values())


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='few seeds and short runs, under a minute'
    )
    parser.add_argument('--seeds', type=int, default=0, help='seeds (default: 6, with --quick 2)')
    options = parser.parse_args()
    if options.seeds < 0:
        parser.error(f'--seeds must be at least 1, got {options.seeds}')
    seeds = options.seeds or (2 if options.quick else 6)
    duration_s = 10.0 if options.quick else 60.0
    bar = Progress(3 * seeds + len(SETS) * (3 * seeds + 2) + 1)
    own = [THESIS_MOTOR]
    truth = theta_of([THESIS_MOTOR])

    estimates = {}
    for noise in (0.0, 0.01):
        for seed in range(1, seeds + 1):
            estimates[noise, seed] = identified(seed, noise, 60.0)
            bar.done('identifying')
    steps = []
    for seed in range(1, seeds + 1):
        steps.append(after_a_step(seed))
        bar.done('step of R')
    network, spent_min = taught_from_scratch(1, 150 if options.quick else 1500)
    bar.done('teaching')

    known, clean, noisy, unseen, slow, scratch = ({} for _ in range(6))
    strangers = motors(4 * seeds, 1, OFF)
    for name in SETS:
        parts: dict[str, list[Scores]] = {'known': [], 'clean': [], 'noisy': []}
        for seed in range(1, seeds + 1):
            recording = record(own, name, 100 + seed, duration_s)
            for kind, theta in (
                ('known', truth),
                ('clean', estimates[0.0, seed]),
                ('noisy', estimates[0.01, seed]),
            ):
                parts[kind].append(scores(own, recording, theta))
                bar.done(name)
        known[name], clean[name], noisy[name] = (
            joined(parts[kind]) for kind in ('known', 'clean', 'noisy')
        )
        unseen[name] = scores(
            strangers, record(strangers, name, 200, duration_s), theta_of(strangers)
        )
        bar.done(name)
        slowly = record(strangers, name, 300, 5.0 * duration_s, SLOW_HZ)
        slow[name] = scores(strangers, slowly, theta_of(strangers))
        scratch[name] = scores(strangers, slowly, theta_of(strangers), network)
        bar.done(name)

    print(
        "\nMean absolute error of the free run in % of the torque's standard deviation; medians.\n"
    )
    print(by_set('Thesis motor, true parameters', known, worst=True))
    print(by_set('Parameters identified on R[1,2]D[3,3], 60 s, no noise', clean, worst=True))
    print(
        by_set('Parameters identified on R[1,2]D[3,3], 60 s, 1 % torque noise', noisy, worst=True)
    )
    off = (
        f'{len(strangers)} motors never seen, L, R and K_HS each off by up to {100 * OFF:.0f} %, '
        'true parameters'
    )
    print(by_set(off, unseen, worst=True))
    print(by_set(f'The same at {SLOW_HZ:g} Hz', slow, worst=True))
    again = (
        f'The same at {SLOW_HZ:g} Hz, another network taught from scratch, {60.0 * spent_min:.0f} '
        's of one core'
    )
    print(by_set(again, scratch, worst=True))
    print(forecasts([one_step(duration, 2000, 1) for duration in DURATIONS]))
    steps_s = np.array(steps)
    print(
        f'R + 30 %: identified within 2 % after {np.median(steps_s[:, 0]):.2f} s (worst '
        f'{steps_s[:, 0].max():.2f}), '
    )
    print(
        f'prediction within 2 % after {np.median(steps_s[:, 1]):.2f} s (worst '
        f'{steps_s[:, 1].max():.2f}), '
        f'rollout after {np.median(steps_s[:, 2]):.2f} s (worst {steps_s[:, 2].max():.2f}); no '
        'training\n'
    )
    predict_us, learn_us = microseconds(record(own, 'R[5,15]D[1,20]+sin', 1, 60.0))
    counts = not options.quick
    later_s = float((steps_s[:, 1] - steps_s[:, 2]).max())
    figures = [
        Figure('known parameters, worst of the sets, %', highest(known), 1.0, counts),
        Figure('identified without noise, worst of the sets, %', highest(clean), 1.0, counts),
        Figure('identified with 1 % noise, worst of the sets, %', highest(noisy), 1.0, counts),
        Figure('motors never seen, worst of the sets, %', highest(unseen), 2.0, counts),
        Figure(f'motors never seen at {SLOW_HZ:g} Hz, worst of the sets, %', highest(slow), None),
        Figure(
            f'another network from scratch, at {SLOW_HZ:g} Hz, worst of the sets, %',
            highest(scratch),
            2.0,
            counts,
        ),
        Figure('teaching that network from scratch, min of one core', spent_min, 5.0, counts),
        Figure('R + 30 %: prediction back later than the rollout, worst, s', later_s, 0.1, counts),
        Figure(
            'R + 30 %: error afterwards, worst seed, %', float(steps_s[:, 3].max()), 1.0, counts
        ),
        Figure('one prediction, us', predict_us, 100.0),
        Figure('learning of the sample, us', learn_us, None),
    ]
    print(figure_table(figures))
    print(last_line('predictor', seeds, figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
