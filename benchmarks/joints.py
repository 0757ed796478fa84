"""Joints of a robot: is what is identified right, whatever they carry?

Gear motors are drawn that a position or speed controller moves along trapezoids, at 200 to 1,000
Hz. They carry nothing, a constant load, gravity or a fan; nobody tells the observer. Their current
has 0.3 to 3 % noise, a measured speed 0.2 %. With ``--brushes`` they have brushes that take 0.2 to
1 V. With ``--arms`` all of them carry gravity, rest behind every move, and are watched for 40 s at
500 or 1,000 Hz, their speed unmeasured. A parameter is *false* as in ``trust``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from common.figures import Figure, figure_table, last_line, table
from common.joints.drawn_joints import LOADS
from common.joints.joint_records import joint_record
from common.progress import progress_bar
from common.trust.trial import LONGEST_FALSE_S, RELATIVE, Trial, run_trial

JOINTS = 150
QUICK_JOINTS = 6

FOUND = {'load_torque': 'load', 'quadratic_friction': 'fan', 'varying_load': 'varying load'}
"""Effects that data may add, and what the table calls them."""


@dataclass(frozen=True)
class JointTrial:
    """What came of one joint.

    Attributes:
        load: that it carries.
        has_speed: whether the observer is told its speed.
        trial: of its record.
    """

    load: str
    has_speed: bool
    trial: Trial

    @property
    def is_false(self) -> bool:
        """Whether anything is believed and wrong at the end."""
        return bool(self.trial.false_at_end)

    @property
    def is_false_on_the_way(self) -> bool:
        """Whether anything was believed and wrong for more than a second."""
        return self.trial.false_longest_s > LONGEST_FALSE_S

    @property
    def is_known(self) -> bool:
        """Whether R is identified and right."""
        is_identified = self.trial.verdicts.get('resistance') == 'identified'
        return is_identified and 'resistance' not in self.trial.false_at_end

    @property
    def is_near(self) -> bool:
        """Whether the estimate of R is right, whatever its verdict."""
        return abs(self.trial.errors.get('resistance', 1.0)) <= RELATIVE


def try_joint(seed: int, *, has_brushes: bool = False, is_arm: bool = False) -> JointTrial:
    """Draw a joint, with brushes or without, and observe it."""
    record = joint_record(seed, has_brushes=has_brushes, is_arm=is_arm)
    return JointTrial(record.scenario.name, record.scenario.speed, run_trial(record))


def rows(trials: Sequence[JointTrial]) -> list[list[str]]:
    """Return what came of the joints, load by load, as rows of the table."""
    lines = []
    for has_speed in (True, False):
        for load in LOADS:
            own = [t for t in trials if (t.load, t.has_speed) == (load, has_speed)]
            if not own:
                continue
            counts = [
                len(own),
                sum(t.is_known for t in own),
                sum(t.is_near for t in own),
                *(sum(name in t.trial.effects for t in own) for name in FOUND),
                sum(t.trial.is_misfit for t in own),
                sum(t.is_false for t in own),
                sum(t.is_false_on_the_way for t in own),
            ]
            speed = 'speed measured' if has_speed else 'no speed'
            lines.append([f'{speed}, load: {load}', *map(str, counts)])
    return lines


def figures(trials: Sequence[JointTrial]) -> list[Figure]:
    """Return the figures of a run."""
    made = []
    for has_speed, speed in ((True, 'speed measured'), (False, 'no speed')):
        own = [t for t in trials if t.has_speed == has_speed]
        if not own:
            continue
        share = 100.0 / len(own)
        made += [
            Figure(f'{speed}: joints', len(own), None),
            Figure('  R identified and right, in %', share * sum(t.is_known for t in own), None),
            Figure('  false at the end, in %', share * sum(t.is_false for t in own), 2.0),
            Figure(
                f'  false for more than {LONGEST_FALSE_S:g} s on the way, in %',
                share * sum(t.is_false_on_the_way for t in own),
                None,
            ),
        ]
    made.append(Figure('tracebacks', sum(bool(t.trial.failure) for t in trials), 0.0))
    return made


def main() -> int:
    """Print the table, what is false, and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help=f'{QUICK_JOINTS} joints')
    parser.add_argument('--joints', type=int, help=f'how many (default {JOINTS})')
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--brushes', action='store_true', help='their brushes take 0.2 to 1 V')
    parser.add_argument('--arms', action='store_true', help='arms that rest behind every move')
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.joints or (QUICK_JOINTS if options.quick else JOINTS)
    seeds = range(options.first_seed, options.first_seed + count)
    with ProcessPoolExecutor(options.processes) as pool:
        trial = partial(try_joint, has_brushes=options.brushes, is_arm=options.arms)
        jobs = pool.map(trial, seeds)
        trials = list(progress_bar(jobs, total=count, unit='joint'))
    columns = ['all', 'R known', 'R within 2 %', *FOUND.values(), 'misfit', 'false', '> 1 s']
    header = ['joints', *columns]
    print(table(header, rows(trials)), end='\n\n')
    for trial in trials:
        errors = ', '.join(
            f'{name} {100.0 * trial.trial.errors[name]:+.1f} % '
            f'({trial.trial.deviations[name]:+.1f} std)'
            for name in trial.trial.false_at_end
        )
        if errors:
            fit = trial.trial.fit.get('verdict')
            print(f'seed {trial.trial.seed}, {trial.load}: fit {fit}; {errors}')
        if trial.trial.failure:
            print(f'seed {trial.trial.seed}:\n{trial.trial.failure}')
    judged = figures(trials)
    if options.quick:
        judged = [replace(figure, counts=False) for figure in judged]
    print(figure_table(judged))
    print(last_line('joints', count, judged))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
