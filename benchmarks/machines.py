"""Machines as they are built: is what is claimed of L and R right where no form knows the machine?

Gear motors are drawn, each with one thing that no form of the observer knows or that data have to
add: ripple, cogging, a gear that gives or has play, a payload, a restless load, a driver that
coasts, or one whose current flows one way alone. Motors with nothing odd are also driven as most
robots are: their voltage is held for seconds while samples come fast. The observer is told Kt and
Kb. A claim is *false* as in ``rotor``; R is judged against its mean over a turn.
"""

from __future__ import annotations

from collections.abc import Sequence

from common.figures import Figure
from common.machines.drawn_machines import EFFECTS
from common.machines.machine_runs import (
    CRUISE,
    LONG_STEPS,
    SPEED_LOOP,
    STEPS,
    MachineCase,
    run_machine,
)
from common.motor_study import MotorStudy, false_share, known_share, speed_in_words
from common.motor_trial import MotorTrial, counts

MOTORS = 4
FIRST_SEED = 100
RATES_HZ = (1000.0, 250.0)
SAMPLES = {1000.0: 10_000, 250.0: 5_000}
QUICK_SAMPLES = 600
SPEED_NOISES = (None, 0.01)

FOUND = (95.0, 100.0)
"""Goal for R of healthy motors, in % of them."""

HELD = 'nothing, voltage held for seconds'
HELD_RATE_HZ = 1000.0
HELD_SAMPLES = 30_000

Key = tuple[str, float | None]
"""Effect, or :data:`HELD`, and noise of the measured speed."""


def cases(samples: int | None = None) -> dict[Key, list[MachineCase]]:
    """Return the cases, of so many samples each; None: of as many as a rate takes."""
    held_s = (samples or HELD_SAMPLES) / HELD_RATE_HZ
    held = {
        (HELD, noise): [
            MachineCase('nothing', drive, HELD_RATE_HZ, noise, held_s)
            for drive in (LONG_STEPS, CRUISE)
        ]
        for noise in SPEED_NOISES
    }
    odd = {
        (effect, noise): [
            MachineCase(effect, drive, rate_hz, noise, (samples or SAMPLES[rate_hz]) / rate_hz)
            for drive in (STEPS, SPEED_LOOP)
            for rate_hz in RATES_HZ
        ]
        for effect in EFFECTS
        for noise in SPEED_NOISES
    }
    return odd | held


def row(key: Key, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the machines of a case, as a row of the table."""
    effect, noise = key
    return [f'{effect}, {speed_in_words(noise)}', *counts(trials)]


def figures(trials: dict[Key, list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run: false claims by speed, and R of two kinds of motors."""
    made = []
    for noise in dict.fromkeys(noise for _, noise in trials):
        own = {effect: some for (effect, other), some in trials.items() if other == noise}
        every = [one for some in own.values() for one in some]
        made.append(Figure(f'{speed_in_words(noise)}: false claims, in %', false_share(every), 2.0))
        for effect, goal in (('nothing', FOUND), (HELD, FOUND), ('coasting driver', None)):
            name = f'  {effect}: R identified and right, in % of motors'
            made.append(Figure(name, known_share(own.get(effect, [])), goal))
    return made


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    study = MotorStudy(
        'machines', __doc__ or '', 'machines', MOTORS, FIRST_SEED, run_machine, row, figures
    )
    return study.main(lambda is_quick: cases(QUICK_SAMPLES if is_quick else None))


if __name__ == '__main__':
    raise SystemExit(main())
