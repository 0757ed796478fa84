"""Slow samples: is R known where L/R is far below a sample interval, and is it right?

Gear motors are drawn with the excitation of ``rotor``; the observer is told Kt and Kb, and nothing
of the stamps. A voltage may act anywhere in its interval, so L stays open there. Some drivers are
late by a part of an interval. A claim is *false* as in ``rotor``.
"""

from __future__ import annotations

from collections.abc import Sequence

from common.driver_runs import DriverCase, run_driver
from common.figures import Figure
from common.motor_study import MotorStudy, false_share, known_share, speed_in_words
from common.motor_trial import MotorTrial, counts

MOTORS = 12
FIRST_SEED = 200
SAMPLES = 4000
QUICK_SAMPLES = 1000
RATES_HZ = (200.0, 100.0, 50.0)
SPEED_NOISES = (None, 0.01)
LATE = (0.0, 0.3, 0.5)
"""Sample intervals by which the voltage acts after its stamp."""

Key = tuple[float | None, float, float]
"""Noise of the measured speed, rate in Hz, and how late the voltage is."""


def cases(samples: int) -> dict[Key, DriverCase]:
    """Return the cases of records of so many samples."""
    return {
        (noise, rate_hz, late): DriverCase(
            False, 1.0, 0.0, False, rate_hz, noise, samples / rate_hz, late
        )
        for noise in SPEED_NOISES
        for rate_hz in RATES_HZ
        for late in LATE
    }


def row(key: Key, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    noise, rate_hz, late = key
    return [f'{speed_in_words(noise)}, {rate_hz:g} Hz, late by {late:g}', *counts(trials)]


def figures(trials: dict[Key, list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run, by speed: R of punctual drivers, and false claims of all."""
    by_speed = []
    for noise in dict.fromkeys(key[0] for key in trials):
        own = {key: some for key, some in trials.items() if key[0] == noise}
        punctual = [one for key, some in own.items() if key[2] == 0.0 for one in some]
        every = [one for some in own.values() for one in some]
        name = f'{speed_in_words(noise)}, punctual: R identified and right, in % of motors'
        by_speed += [
            Figure(name, known_share(punctual), (90.0, 100.0)),
            Figure('  false claims, in %', false_share(every), 2.0),
        ]
    return by_speed


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    study = MotorStudy(
        'slow_samples', __doc__ or '', 'motors', MOTORS, FIRST_SEED, run_driver, row, figures
    )

    def lists(is_quick: bool) -> dict[Key, list[DriverCase]]:
        chosen_cases = cases(QUICK_SAMPLES if is_quick else SAMPLES)
        return {key: [case] for key, case in chosen_cases.items()}

    return study.main(lists)


if __name__ == '__main__':
    raise SystemExit(main())
