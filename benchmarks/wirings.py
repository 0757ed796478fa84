"""Are wirings that go wrong named, and is a right one left alone?

A robot with two geared wheels publishes duty cycles, a battery's voltage and joint states. Eleven
mistakes of wiring are made on every drawn robot. One is named where what diagnostics say of some
wheel holds its words after 10 s of data. Rightly wired robots run for hours: every verdict but a
fit that is ``ok`` is a false flag.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from common.figures import Figure, figure_table, last_line, table
from common.wirings.mistakes import MISTAKES, NOMINAL, Mistake, right_parameters
from common.wirings.robot import WHEELS, Log, Published, Wheel, draw_wheel, drive, messages
from tqdm import tqdm

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

    def says(self) -> str:
        """Return all that is said of the motors."""
        lines = list(self.message_input.complaints.values())
        for name in self.configuration.motors:
            motor = self.observer.motors.get(name)
            if motor is None:
                strangers = {
                    stranger
                    for signal in self.message_input.signals.values()
                    for stranger in signal.unknown_names
                }
                lines.append(f'names there: {", ".join(sorted(strangers))}')
                continue
            quantity = self.configuration['torque.quantity']
            mixed = self.observer.mix_up(name)
            lines += [f'{suspect.effect}: {suspect.remedy}' for suspect in motor.fit.suspects]
            lines += [
                contradiction(motor.configuration, motor.estimate, quantity) or '',
                '' if mixed is None else mixed.sentence,
            ]
        return '\n'.join(lines)

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


def try_mistake(place: int, seed: int) -> tuple[str, int, bool, list[str]]:
    """Make a mistake on a robot; return whether it is named, and what is wrong and sure."""
    mistake: Mistake = MISTAKES[place]
    wheels, rng = draw(seed)
    log = drive(wheels, mistake.battery, RATE_HZ, NAMED_WITHIN_S, rng)
    robot = Robot(mistake.wired(wheels))
    for one in mistake.published(log):
        robot.listen(one)
    return mistake.name, seed, mistake.is_named(robot.says()), robot.wrong(wheels)


def false_flags(duration_s: float, seed: int) -> tuple[int, list[str]]:
    """Let a right robot run; return the flags at all looks, and what is wrong and sure."""
    wheels, rng = draw(seed)
    robot = Robot(right_parameters(wheels))
    flags = 0
    log: Log = drive(wheels, NOMINAL, RATE_HZ, duration_s, rng)
    look_ns: int | None = None
    for one in messages(log):
        robot.listen(one)
        look_ns = one.stamp_ns + round(LOOK_S * 1e9) if look_ns is None else look_ns
        if one.stamp_ns >= look_ns:
            look_ns += round(LOOK_S * 1e9)
            fits = [motor.fit for motor in robot.observer.motors.values()]
            flags += sum(fit.verdict in (FitVerdict.WARNING, FitVerdict.MISFIT) for fit in fits)
    return flags, robot.wrong(wheels)


def main() -> int:
    """Print tables and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--quick', action='store_true', help='one seed, two hours')
    parser.add_argument('--seeds', type=int, default=3, help='robots of each mistake')
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--hours', type=float, default=24.0, help='of right robots, in all')
    parser.add_argument('--robot-s', type=float, default=600.0, help='of each right robot')
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    count, hours = (1, 2.0) if options.quick else (options.seeds, options.hours)
    seeds = range(options.first_seed, options.first_seed + count)
    robots = round(hours * 3600.0 / options.robot_s)
    with ProcessPoolExecutor(options.processes) as pool:
        jobs = [pool.submit(try_mistake, k, seed) for k in range(len(MISTAKES)) for seed in seeds]
        flag = partial(false_flags, options.robot_s)
        long_jobs = [pool.submit(flag, 10_000 + options.first_seed + k) for k in range(robots)]
        results = [job.result() for job in tqdm(jobs, unit='mistake', disable=None)]
        runs = [job.result() for job in tqdm(long_jobs, unit='robot', disable=None)]
    rows = []
    for mistake in MISTAKES:
        own = [result for result in results if result[0] == mistake.name]
        misses = [str(seed) for _, seed, is_named, _ in own if not is_named]
        sure = sorted({name for *_, wrong in own for name in wrong})
        named = f'{len(own) - len(misses)} of {len(own)}'
        rows.append([mistake.name, named, ', '.join(misses), ', '.join(sure)])
    print(table(['mistake', 'named', 'not with seeds', 'identified and wrong'], rows), end='\n\n')
    named = sum(is_named for _, _, is_named, _ in results)
    figures = [
        Figure('mistakes named, in %', 100.0 * named / len(results), (100.0, 100.0)),
        Figure('of these records, identified and wrong', sum(bool(r[3]) for r in results), 0.0),
        Figure(f'false flags in {hours:g} h of right robots', sum(r[0] for r in runs), 0.0),
        Figure('right robots with anything wrong and sure', sum(bool(r[1]) for r in runs), 0.0),
    ]
    print(figure_table(figures))
    print(last_line('wirings', len(seeds), figures))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
