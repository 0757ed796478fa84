"""Drivers that filter the current: is anything believed that is wrong?

Gear motors are drawn with the excitation of ``rotor``; the observer is told Kt and Kb. A reading is
the mean of its interval, or passes an analogue filter, or a driver publishes an exponential moving
average of the readings, so that their noise has a memory. L and R of such a motor look larger than
they are. A claim is *false* as in ``rotor``.
"""

from __future__ import annotations

from collections.abc import Sequence

from common.driver_runs import DriverCase, run_driver
from common.figures import Figure
from common.motor_study import MotorStudy, figures_by_speed, speed_in_words
from common.motor_trial import MotorTrial, counts

MOTORS = 10
FIRST_SEED = 100
DURATION_S = 20.0
QUICK_S = 3.0
RATES_HZ = (200.0, 500.0)
SPEED_NOISE = 0.01

FILTERS: dict[str, tuple[bool, float, float, bool, float]] = {
    'none': (False, 1.0, 0.0, False, 0.0),
    'mean of the interval': (True, 1.0, 0.0, False, 0.0),
    'analogue, half an interval': (False, 1.0, 0.5, False, 0.0),
    'analogue, 0.6 intervals, of noise too': (False, 1.0, 0.6, True, 0.0),
    'analogue, 1.5 intervals, of noise too': (False, 1.0, 1.5, True, 0.0),
    'moving average, newest weighs 0.85': (False, 0.85, 0.0, False, 0.0),
    'moving average, newest weighs 0.7': (False, 0.7, 0.0, False, 0.0),
    'moving average, newest weighs 0.5': (False, 0.5, 0.0, False, 0.0),
    'moving average, newest weighs 0.3': (False, 0.3, 0.0, False, 0.0),
    'moving average, newest weighs 0.3, noise behind': (False, 0.3, 0.0, False, 0.005),
}
"""Whether readings are means, weight of the newest one, analogue time constant in intervals,
whether the noise passes the analogue filter, too, and noise behind all, as a share of the spread.
"""


def cases(duration_s: float) -> dict[tuple[str, str], list[DriverCase]]:
    """Return the cases by speed and filter, one for each rate."""
    return {
        (speed_in_words(noise), name): [
            DriverCase(*settings, rate_hz, noise, duration_s, noise_behind=noise_behind)
            for rate_hz in RATES_HZ
        ]
        for noise in (None, SPEED_NOISE)
        for name, (*settings, noise_behind) in FILTERS.items()
    }


def row(speed: str, name: str, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    return [f'{speed}, filter: {name}', *counts(trials)]


def figures(trials: dict[tuple[str, str], list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run: false claims of all filters together, by speed."""
    return figures_by_speed(trials)


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    study = MotorStudy(
        'current_filters',
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
