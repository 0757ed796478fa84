"""Is a delay between voltage and torque found where there is one, and nowhere else?

Pairing and the search for the delay on the eight data sets of the thesis, 100 Hz; context nodes are
left out, they have no part in it.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dc_motor_sim.excitation import TABLE_5_1
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.delay import DelayEstimate, DelayVerdict, DelayWatch
from gray_box_observer.samples import Pairing
from gray_box_observer.white_box import MotorWhiteBox

WHITE_BOX = MotorWhiteBox(
    ('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}
)
INITIAL = np.array([[1.5, 3.0, 1.0]])
INTERVAL_S = 0.01
NOISES = (0.0, 0.01, 0.02)
DELAYS_IN_INTERVALS = (1.0, 2.0, 5.0, 30.0)
CHANGES = (
    'motor.resistance=1.3@60',
    'motor.resistance=1.0..1.3@0..120',
    'motor.inductance=0.4@60',
    'motor.hysteresis=7@60',
)


@dataclass(frozen=True)
class Course:
    """Words about one motor's delay: the last one, and whether any was flagged or suspected."""

    last: DelayEstimate
    flagged: bool
    suspected: bool


def watch(
    excitation: str,
    noise: float,
    delay_s: float,
    duration_s: float,
    seed: int,
    schedule: tuple[str, ...] = (),
) -> Course:
    """Run one motor whose voltage is stamped ``delay_s`` too early."""
    motors = {'motor': PlantParameters()}
    simulation = Simulation(
        motors, excitation, seed=seed, torque_noise_relative=noise, schedule=schedule
    )
    record = simulation.record(duration_s)
    pairing = Pairing()
    asker = DelayWatch(WHITE_BOX, INITIAL, 0.0, is_estimated=False, gap_s=0.5)
    said: set[DelayVerdict] = set()
    shift_ns = round(delay_s * 1e9)
    signals = zip(
        record.stamp_ns.tolist(),
        record.voltage_v[0].tolist(),
        record.torque_nm[0].tolist(),
        strict=True,
    )
    for stamp_ns, voltage_v, torque_nm in signals:
        samples = pairing.voltage(stamp_ns - shift_ns, voltage_v) + pairing.torque(
            stamp_ns, torque_nm
        )
        for sample in samples:
            asker.update(pairing.history, sample.stamp_ns)
        said.add(asker.estimate.verdict)
    return Course(asker.estimate, DelayVerdict.UNDECLARED in said, DelayVerdict.SUSPECTED in said)


def rows(
    hours: float, seconds: float, seeds: int
) -> Iterator[tuple[str, list[Course], list[Course], list[float], int]]:
    """Yield per data set: runs without and with delay, normalised errors, false alarms.

    The alarms are those at motors that changed.
    """
    seed = iter(range(1_000_000))  # no two runs share their noise
    for excitation in TABLE_5_1.values():
        none = [
            watch(excitation, noise, 0.0, 3600.0 * hours, next(seed))
            for noise in NOISES
            for _ in range(max(1, seeds // 4))
        ]
        found = []
        errors = []
        for k in range(seeds):
            for j, noise in enumerate(NOISES):
                delay_s = INTERVAL_S * DELAYS_IN_INTERVALS[(j + k) % len(DELAYS_IN_INTERVALS)]
                course = watch(excitation, noise, delay_s, seconds, next(seed))
                found.append(course)
                if noise > 0.0 and course.flagged:
                    errors.append((course.last.value_s - delay_s) / course.last.std_s)
        alarms = sum(
            watch(excitation, 0.01, 0.0, 180.0, next(seed), (change,)).flagged for change in CHANGES
        )
        yield excitation, none, found, errors, alarms


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--quick', action='store_true', help='minutes instead of hours without delay, fewer seeds'
    )
    quick = parser.parse_args().quick
    hours, seconds, seeds = (0.02, 60.0, 2) if quick else (1.0, 60.0, 8)
    print(
        f'{"data":<24}{"hours without":>14}{"flags":>7}{"suspected":>11}{"delays":>8}{"found":>7}'
        f'{"rms error/std":>15}'
    )
    total_hours = 0.0
    flags = suspicions = delays = hits = alarms = 0
    errors: list[float] = []
    for excitation, none, found, normalised, changed in rows(hours, seconds, seeds):
        flagged = sum(c.flagged for c in none)
        suspected = sum(c.suspected for c in none)
        hit = sum(c.flagged for c in found)
        rms = math.sqrt(float(np.mean(np.square(normalised))))
        print(
            f'{excitation:<24}{hours * len(none):>14.2f}{flagged:>7}{suspected:>11}'
            f'{len(found):>8}{hit:>7}{rms:>15.2f}',
            flush=True,
        )
        total_hours += hours * len(none)
        flags = flags + flagged
        suspicions = suspicions + suspected
        delays = delays + len(found)
        hits = hits + hit
        errors += normalised
        alarms += changed
    share = hits / delays
    rms = math.sqrt(float(np.mean(np.square(errors))))
    figures = [
        {'name': 'hours without delay', 'value': total_hours, 'goal': None, 'met': None},
        {
            'name': 'delays flagged where there is none',
            'value': flags,
            'goal': 0,
            'met': flags == 0,
        },
        {
            'name': 'delays flagged at motors that change',
            'value': alarms,
            'goal': 0,
            'met': alarms == 0,
        },
        {
            'name': 'share of 1, 2, 5, 30 intervals flagged in 60 s',
            'value': share,
            'goal': 1.0,
            'met': share == 1.0,
        },
        {
            'name': 'rms error over standard deviation',
            'value': rms,
            'goal': [0.7, 1.3],
            'met': 0.7 <= rms <= 1.3,
        },
        {'name': 'suspected once, not twice', 'value': suspicions, 'goal': None, 'met': None},
    ]
    print(json.dumps({'benchmark': 'delay', 'seeds': seeds, 'figures': figures}))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
