"""Motors of a wide range, driven as robots drive them: are they known, and is it right?

Motors are drawn from a wheel's of 0.05 ohm to a servo's of 30 ohm, with mechanical times of 8 ms to
2 s, at 5 to 48 V and 50 to 2,000 samples a second. Eight drives move them, from steps to a position
controller. The observer is told Kt and Kb alone. A claim is *false* as in ``rotor``.
"""

from __future__ import annotations

from collections.abc import Sequence

from common.figures import Figure
from common.motor_study import MotorStudy, false_share, known_share
from common.motor_trial import MotorTrial, counts
from common.wide.drives import DRIVES
from common.wide.wide_runs import MOST, WideCase, run_wide

MOTORS = 6
FIRST_SEED = 500
QUICK_SAMPLES = 600

Key = tuple[str, bool, bool]
"""Drive, whether the speed is measured, and whether the voltage is."""


def cases(most: int) -> dict[Key, list[WideCase]]:
    """Return the cases, of records of so many samples at most."""
    return {
        (drive, speed, voltage): [WideCase(drive, speed, voltage, most)]
        for speed in (False, True)
        for voltage in (False, True)
        for drive in DRIVES
    }


def row(key: Key, trials: Sequence[MotorTrial]) -> list[str]:
    """Return what came of the motors of a case, as a row of the table."""
    drive, speed, voltage = key
    return [f'{drive}, {_in_words(speed=speed, voltage=voltage)}', *counts(trials)]


def figures(trials: dict[Key, list[MotorTrial]]) -> list[Figure]:
    """Return the figures of a run, by what is measured: false claims, and motors that are known."""
    made = []
    for speed, voltage in dict.fromkeys((key[1], key[2]) for key in trials):
        every = [one for key, some in trials.items() if key[1:] == (speed, voltage) for one in some]
        name = _in_words(speed=speed, voltage=voltage)
        made += [
            Figure(f'{name}: false claims, in %', false_share(every), 2.0),
            Figure('  R identified and right, in % of motors', known_share(every), None),
        ]
    return made


def _in_words(*, speed: bool, voltage: bool) -> str:
    """Say what is measured."""
    speed_text = 'speed with noise' if speed else 'no speed'
    return f'{speed_text}, {"measured voltage" if voltage else "command"}'


def main() -> int:
    """Print the table, the figures, and one line of JSON."""
    study = MotorStudy(
        'wide_range', __doc__ or '', 'motors', MOTORS, FIRST_SEED, run_wide, row, figures
    )
    return study.main(lambda is_quick: cases(QUICK_SAMPLES if is_quick else MOST))


if __name__ == '__main__':
    raise SystemExit(main())
