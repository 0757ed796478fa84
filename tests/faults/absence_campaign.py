"""Takes signals from the observer's core, alone and together, for one sample to ten seconds.

    python tests/faults/absence_campaign.py [--outages 12] [--seed 1] [--motors 1 2 9 64]
        [--longest 10000] [--runs N]

Every combination of number of motors, source of the speed, rate of voltage to rate of torque, and
predictor on or off is one run. The network of one motor is trained, a step a job; those of several
are not. In a run signals come regularly, between 0 and 10,000 times. Then
some of them are missing for a while, in one of three ways: no message, a message of NaN, a message
without some of the motors. This repeats, and at the end all come again. Every sample, estimate,
prediction and forecast must be finite, every message accounted for, and every motor observed again.
Prints a table and one line of JSON; ends with 1 if a figure is not reached.
"""

from __future__ import annotations

import argparse
import itertools
import math
import random
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from figures import Figure, tell
from tqdm import tqdm
from watched_core import IdleTraining, WatchedCore

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.predictor import InlineTraining

TICK_NS = 10_000_000
MOTORS = (1, 2, 9, 64)
RATES = ((1, 1), (1, 3), (3, 1))
"""Voltages to torques: every so many ticks one comes."""
SPEEDS = ('none', 'own topic', 'in torque')
WAYS = ('no message', 'NaN', 'some motors only')
REGULAR = (0, 1, 20, 100, 990, 1000, 1021, 1100, 2500, 10_000)
"""Samples before an outage; a signal has a habit after 20, and comes regularly after 1000 more."""
HABIT = 1021
"""Samples after which a signal is known to come regularly."""
MISSING = (1, 2, 5, 15, 19, 21, 26, 30, 46, 55, 64, 65, 100, 250, 1000)
"""Samples of 10 ms that are missing."""
MOST_MOTOR_SAMPLES = 20_000
"""Regular samples of all motors before an outage at most, but for the habit: many take their time.
"""
RECOVERY = 150
"""Samples at the end by which every motor must be observed again."""


@dataclass(frozen=True, slots=True)
class Case:
    """What a run is made of."""

    motors: int
    rates: tuple[int, int]
    speed: str
    predictor: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Of the motors."""
        return tuple(f'm{k}' for k in range(self.motors))

    @property
    def settings(self) -> dict[str, object]:
        """Parameters of the observer."""
        own = {'speed.topic': 'motor/speed'} if self.speed == 'own topic' else {}
        fixed = {'motors': list(self.names), 'predictor': self.predictor, 'horizon_s': 0.05}
        little = {'training.steps': 1, 'training.replay_capacity': 500}
        return {**fixed, **little, **own}

    @property
    def is_taught(self) -> bool:
        """Whether the network of its predictor is trained, as of one motor it is."""
        return self.predictor and self.motors == 1

    @property
    def signals(self) -> tuple[str, ...]:
        """What can be missing; the velocity is that of the torque messages."""
        of_speed = {'none': (), 'own topic': ('speed',), 'in torque': ('velocity',)}
        return ('voltage', 'torque', *of_speed[self.speed])


@dataclass(frozen=True, slots=True)
class Outage:
    """Regular voltages with the signals beside them, then samples of 10 ms with some missing."""

    regular: int
    missing: int
    signals: frozenset[str]
    way: str


@cache
def recording() -> Recording:
    """A motor of the thesis, again and again."""
    motors = {'motor': PlantParameters()}
    noise = {'torque_noise_std': 1e-4, 'speed_noise_std': 1e-3}
    return Simulation(motors, 'R[5,15]D[0.1,1]', seed=1, **noise).record(40.0)


def every_case(motors: list[int]) -> list[Case]:
    """All combinations."""
    return [Case(*parts) for parts in itertools.product(motors, RATES, SPEEDS, (True, False))]


def outages(case: Case, count: int, longest: int, source: random.Random) -> list[Outage]:
    """Draw outages of one run."""
    limit = min(longest, max(1200, MOST_MOTOR_SAMPLES // case.motors))
    regular = [min(samples, limit) for samples in REGULAR]
    # the first is what once ended the observer
    drawn = [Outage(min(HABIT, limit), 55, frozenset({'voltage'}), WAYS[0])]
    for _ in range(count - 1):
        some = source.sample(case.signals, source.randint(1, len(case.signals)))
        way = WAYS[1] if some == ['velocity'] else source.choice(WAYS)
        drawn.append(Outage(source.choice(regular), source.choice(MISSING), frozenset(some), way))
    return drawn


class Run:
    """One observer, and what comes to it.

    Args:
        case: what it is made of.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        self.core = WatchedCore(case.settings, InlineTraining if case.is_taught else IdleTraining)
        self.messages = 0
        self._tick = 0

    def pass_through(self, outage: Outage) -> None:
        """Let signals come regularly, and then some of them be missing."""
        for _ in range(outage.regular * self.case.rates[1]):
            self._deliver(frozenset(), '')
        for _ in range(outage.missing):
            self._deliver(outage.signals, outage.way)

    def recover(self) -> int:
        """Let everything come again; return how many motors are not observed at its end."""
        for _ in range(RECOVERY):
            self._deliver(frozenset(), '')
        names = self.case.names
        before = {name: self.core.observer.counts(name).used_count for name in names}
        for _ in range(RECOVERY):
            self._deliver(frozenset(), '')
        self.core.close()
        expected = RECOVERY // self.case.rates[0] - 2
        return sum(
            self.core.observer.counts(name).used_count - before[name] < expected for name in names
        )

    def _deliver(self, missing: frozenset[str], way: str) -> None:
        """Deliver what a tick brings."""
        for signal, message in self._messages(missing, way):
            self.messages += 1
            self.core.feed(signal, message)
        self._tick += 1

    def _messages(self, missing: frozenset[str], way: str) -> Iterator[tuple[str, bytes]]:
        data = recording()
        tick = self._tick
        at = tick % data.stamp_ns.size
        stamp_ns = tick * TICK_NS
        every_voltage, every_torque = self.case.rates[1], self.case.rates[0]
        speed = float(data.speed_rad_s[0, at])
        if tick % every_voltage == 0:
            voltage_v = float(data.voltage_v[0, at])
            yield from self._message('voltage', stamp_ns, voltage_v, (), missing, way)
        if self.case.speed == 'own topic':
            yield from self._message('speed', stamp_ns, speed, (speed,), missing, way)
        if tick % every_torque == 0:
            lost = 'velocity' in missing
            velocity = () if self.case.speed != 'in torque' else (math.nan if lost else speed,)
            torque_nm = float(data.torque_nm[0, at])
            yield from self._message('torque', stamp_ns, torque_nm, velocity, missing, way)

    def _message(
        self, signal: str, stamp_ns: int, value: float, velocity: tuple[float, ...],
        missing: frozenset[str], way: str,
    ) -> Iterator[tuple[str, bytes]]:  # fmt: skip
        """Make one message, as far as it is there."""
        names = self.case.names
        effort = np.full(len(names), value)
        speeds = np.full(len(names), velocity[0]) if velocity else np.empty(0)
        if signal in missing:
            lost = slice(0, None) if len(names) == 1 else slice(0, None, 2)
            if way == WAYS[0]:
                return
            if way == WAYS[1]:
                effort[lost] = math.nan
                speeds[lost] = math.nan if signal == 'speed' else speeds[lost]
            else:
                names = names[1::2]
                effort = effort[1::2]
                speeds = speeds[1::2]
        yield (
            signal,
            encode_joint_state(stamp_ns, names, velocity=speeds.tolist(), effort=effort.tolist()),
        )


def main() -> int:
    """Run the campaign; the exit code is 1 where a figure is not reached."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument('--outages', type=int, default=12, help='in each run')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--motors', type=int, nargs='+', default=MOTORS, help='numbers of motors')
    longest = 'regular samples before an outage, at most'
    parser.add_argument('--longest', type=int, default=REGULAR[-1], help=longest)
    runs = 'so many of all combinations, drawn by the seed; 0: all'
    parser.add_argument('--runs', type=int, default=0, help=runs)
    options = parser.parse_args()
    cases = every_case(list(options.motors))
    if options.runs:
        cases = random.Random(options.seed).sample(cases, options.runs)
    sums: Counter[str] = Counter()
    for number, case in enumerate(tqdm(cases, unit='run', mininterval=1.0)):
        source = random.Random(f'{options.seed} {number}')
        drawn = outages(case, options.outages, options.longest, source)
        run = Run(case)
        try:
            for outage in drawn:
                run.pass_through(outage)
            blind = run.recover()
            if blind:
                print(f'{case} after {drawn}: {blind} motors are not observed again')
            sums['not observed again'] += blind
        except Exception:
            sums['exceptions'] += 1
            print(f'{case} after {drawn}:\n{traceback.format_exc()}')
        sums['non-finite'] += run.core.non_finite
        sums['unaccounted'] += run.core.unbalanced
        sums['outages'] += len(drawn)
        sums['messages'] += run.messages
    figures = [
        Figure('exceptions', sums['exceptions'], 0.0),
        Figure('numbers that are not finite', sums['non-finite'], 0.0),
        Figure('messages that are not accounted for', sums['unaccounted'], 0.0),
        Figure('motors that are not observed again', sums['not observed again'], 0.0),
        Figure('outages', sums['outages']),
        Figure('messages', sums['messages']),
    ]
    return tell('absence_campaign', options.seed, figures)


if __name__ == '__main__':
    raise SystemExit(main())
