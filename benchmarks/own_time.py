"""Drivers that keep their own time, or act late: is the motor known, and is anything false?

Gear motors are drawn with the excitation of ``rotor``; the observer is told Kt and Kb. Either the
voltage moves between two samples of the current, and its stamps say so. Or it acts later than it
is stamped, and the observer is to estimate by how much. A claim is *false* as in ``rotor``.
"""

from __future__ import annotations

from collections.abc import Sequence

from common.driver_runs import DriverCase, run_driver
from common.figures import Figure
from common.motor_study import MotorStudy, figures_by_speed, speed_in_words
from common.motor_trial import MotorTrial, counts

MOTORS = 10
FIRST_SEED = 300
DURATION_S = 20.0
QUICK_S = 3.0
RATES_HZ = (250.0, 1000.0)
SPEED_NOISE = 0.01

DRIVERS: dict[str, tuple[float, float, float | str]] = {
    'moves at the samples': (0.0, 0.0, 0.0),
    'moves 0.3 intervals after them': (0.3, 0.0, 0.0),
    'moves 0.6 intervals after them': (0.6, 0.0, 0.0),
    'punctual, delay estimated': (0.0, 0.0, 'estimate'),
    'late by 0.4 intervals, estimated': (0.0, 0.4, 'estimate'),
    'late by 3.3 intervals, estimated': (0.0, 3.3, 'estimate'),
    'late by 20 intervals, estimated': (0.0, 20.0, 'estimate'),
    'late by 3.3 intervals, untold': (0.0, 3.3, 0.0),
}
"""How long after a sample the voltage moves as its stamp says, how late it acts, both in sample
intervals, and what the observer is told of the delay."""

UNTOLD = 'untold'
"""Ends the name of a driver of which nothing can be known."""


def cases(duration_s: float) -> dict[tuple[str, str], list[DriverCase]]:
    """Return the cases by speed and driver, one for each rate."""
    return {
        (speed_in_words(noise), name): [
            DriverCase(
                False, 1.0, 0.0, False, rate_hz, noise, duration_s, late, phase=phase, delay=delay
            )
            for rate_hz in RATES_HZ
        ]
        for noise in (None, SPEED_NOISE)
        for name, (phase, late, delay) in DRIVERS.items()
    }


def row(speed: str, name: str, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    return [f'{speed}, {name}', *counts(trials)]


def figures(trials: dict[tuple[str, str], list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run, by speed: R of drivers whose time is told, and false claims."""
    return figures_by_speed(trials, lambda name: not name.endswith(UNTOLD))


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    study = MotorStudy(
        'own_time',
        __doc__ or '',
        'motors',
        MOTORS,
        FIRST_SEED,
        run_driver,
        lambda key, trials: row(*key, trials),
        figures,
    )
    return study.main(lambda is_quick: cases(QUICK_S if is_quick else DURATION_S))


if __name__ == '__main__':
    raise SystemExit(main())
