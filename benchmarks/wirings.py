"""Are wirings that go wrong named, and is a right one left alone?

A robot with two geared wheels publishes duty cycles, a battery's voltage and joint states. Eleven
mistakes of wiring are made on every drawn robot. One is named where what diagnostics say of some
wheel holds its words after 10 s of data. Rightly wired robots run for hours, and every ten seconds
each wheel is looked at: whatever is said of it then is a false flag.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from common.figures import Figure, figure_table, last_line, table
from common.progress import progress_bar
from common.wirings.mistakes import MISTAKES, NOMINAL, Mistake, right_parameters
from common.wirings.robot import (
    START_NS,
    WHEELS,
    Log,
    Published,
    Wheel,
    draw_wheel,
    drive,
    messages,
)

from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.data_sheet import contradiction
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

RATE_HZ = 200.0
NAMED_WITHIN_S = 10.0
LOOK_S = 10.0
"""Between two looks at a right robot."""


def draw(seed: int) -> tuple[tuple[Wheel, ...], np.random.Generator]:
    """Draw the wheels of a robot."""
    rng = np.random.default_rng(seed)
    return tuple(draw_wheel(rng) for _ in WHEELS), rng


class Robot:
    """An observer that listens to a robot."""

    def __init__(self, parameters: dict[str, object]) -> None:
        self.configuration = Configuration.from_flat(parameters)
        self.observer = Observer(self.configuration, None)
        self.message_input = MessageInput(self.observer, self.configuration)
        self._signals: dict[str, list[str]] = {}
        for feed in self.configuration.feeds:
            self._signals.setdefault(feed.topic, []).extend(feed.signals)

    def listen(self, one: Published) -> None:
        """Take one message."""
        for signal in self._signals.get(one.topic, ()):
            taken = self.message_input.ingest(signal, one.message, one.stamp_ns, one.topic)
            for group in taken.groups:
                self.observer.results(group)

    def says(self, name: str) -> str:
        """Return all that is said of a motor, and of the signals; empty where nothing is wrong."""
        lines = list(self.message_input.complaints.values())
        motor = self.observer.motors.get(name)
        if motor is None:
            strangers = {
                stranger
                for signal in self.message_input.signals.values()
                for stranger in signal.unknown_names
            }
            return '\n'.join([*lines, f'names there: {", ".join(sorted(strangers))}'])
        if motor.fit.verdict in (FitVerdict.WARNING, FitVerdict.MISFIT):
            lines.append(motor.fit.sentence)
        lines += [f'{suspect.effect}: {suspect.remedy}' for suspect in motor.fit.suspects]
        quantity = self.configuration['torque.quantity']
        lines.append(contradiction(motor.configuration, motor.estimate, quantity) or '')
        mixed = self.observer.mix_up(name)
        lines.append('' if mixed is None else mixed.sentence)
        return '\n'.join(line for line in lines if line)

    def wrong(self, wheels: Sequence[Wheel]) -> list[str]:
        """Return the parameters that are called identified and are more than 3 std and 2 % off."""
        found = []
        for name, wheel in zip(WHEELS, wheels, strict=True):
            motor = self.observer.motors.get(name)
            if motor is None:
                continue
            estimate = motor.estimate
            for j, parameter in enumerate(estimate.parameters):
                truth = {'inductance': wheel.inductance, 'resistance': wheel.resistance}
                if parameter.name not in truth or estimate.verdicts[0][j].value != 'identified':
                    continue
                away = abs(estimate.value[0, j] - truth[parameter.name])
                if away > max(3.0 * estimate.std[0, j], 0.02 * truth[parameter.name]):
                    found.append(f'{name}.{parameter.name}')
        return found


@dataclass(frozen=True)
class Trial:
    """What came of one mistake on one robot.

    Attributes:
        mistake: its name.
        seed: of the robot.
        named: for every motor that is wired wrongly, whether the mistake is named.
        wrong: parameters that are called identified and are not right.
    """

    mistake: str
    seed: int
    named: tuple[bool, ...]
    wrong: list[str]


def try_mistake(place: int, seed: int) -> Trial:
    """Make a mistake on a robot, and look what is said of it after NAMED_WITHIN_S."""
    mistake: Mistake = MISTAKES[place]
    wheels, rng = draw(seed)
    log = drive(wheels, mistake.battery, RATE_HZ, NAMED_WITHIN_S, rng)
    robot = Robot(mistake.wired(wheels))
    for one in mistake.published(log):
        robot.listen(one)
    named = tuple(mistake.is_named(robot.says(motor)) for motor in mistake.motors)
    return Trial(mistake.name, seed, named, robot.wrong(wheels))


def false_flags(duration_s: float, seed: int) -> tuple[list[str], list[str]]:
    """Let a right robot run; return what is said at all looks, and what is wrong and sure."""
    wheels, rng = draw(seed)
    robot = Robot(right_parameters(wheels))
    flags = []
    log: Log = drive(wheels, NOMINAL, RATE_HZ, duration_s, rng)
    look_ns: int | None = None
    for one in messages(log):
        robot.listen(one)
        look_ns = one.stamp_ns + round(LOOK_S * 1e9) if look_ns is None else look_ns
        if one.stamp_ns >= look_ns:
            look_ns += round(LOOK_S * 1e9)
            at_s = (one.stamp_ns - START_NS) * 1e-9
            said = ((name, robot.says(name)) for name in WHEELS)
            flags += [f'robot {seed}, {at_s:.0f} s, {name}: {text}' for name, text in said if text]
    return flags, robot.wrong(wheels)


def _row(mistake: str, trials: Sequence[Trial]) -> list[str]:
    """Return what came of a mistake on all robots, as a row of the table."""
    own = [trial for trial in trials if trial.mistake == mistake]
    misses = [str(trial.seed) for trial in own if not any(trial.named)]
    wheels = [is_named for trial in own for is_named in trial.named]
    wrong = sorted({name for trial in own for name in trial.wrong})
    return [
        mistake,
        f'{len(own) - len(misses)} of {len(own)}',
        f'{sum(wheels)} of {len(wheels)}',
        ', '.join(misses),
        ', '.join(wrong),
    ]


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one seed, one right robot')
    parser.add_argument('--seeds', type=int, help='robots of each mistake (default 3)')
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--hours', type=float, help='of right robots, in all (default 24)')
    parser.add_argument('--robot-s', type=float, default=600.0, help='of each right robot')
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count = options.seeds
    hours = options.hours
    if count is None:
        count = 1 if options.quick else 3
    if hours is None:
        hours = options.robot_s / 3600.0 if options.quick else 24.0
    seeds = range(options.first_seed, options.first_seed + count)
    robots = round(hours * 3600.0 / options.robot_s)
    hours = robots * options.robot_s / 3600.0
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = [pool.submit(try_mistake, k, seed) for k in range(len(MISTAKES)) for seed in seeds]
        flag = partial(false_flags, options.robot_s)
        long_jobs = [pool.submit(flag, 10_000 + options.first_seed + k) for k in range(robots)]
        results = [job.result() for job in progress_bar(jobs, unit='mistake')]
        runs = []
        for job in progress_bar(long_jobs, unit='robot'):
            runs.append(job.result())
            for line in runs[-1][0]:
                print(line, flush=True)
    print(table(['mistake', 'named', 'on wheels', 'not with seeds', 'identified and wrong'],
                [_row(mistake.name, results) for mistake in MISTAKES]), end='\n\n')  # fmt: skip
    named = sum(any(trial.named) for trial in results)
    figures = [
        Figure('mistakes named, in %', 100.0 * named / len(results), (100.0, 100.0)),
        Figure('of these records, identified and wrong', sum(bool(t.wrong) for t in results), 0.0),
        Figure(f'false flags in {hours:g} h of right robots', sum(len(r[0]) for r in runs), 0.0),
        Figure('right robots with anything wrong and sure', sum(bool(r[1]) for r in runs), 0.0),
    ]
    print(figure_table(figures))
    print(last_line('wirings', len(seeds), figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
