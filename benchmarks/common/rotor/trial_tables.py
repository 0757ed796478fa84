"""What the trials of one figure have in common, and their tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from common.figures import number, table
from common.rotor.choices import Choice
from common.rotor.records import NODES
from common.rotor.runs import Trial
from common.rotor.thesis_sets import ThesisTrial

CONFIDENCE = 0.95
WITHIN_STDS = 3.0


def over_bound(trials: Sequence[Trial]) -> np.ndarray:
    """Return the root mean square of the errors over their bounds, shape (parameter,)."""
    over = np.array([trial.error / trial.bound for trial in trials])
    made: np.ndarray = np.sqrt(np.mean(over**2, axis=0))
    return made


def nees_band(values: int) -> tuple[float, float]:
    """Return between what the mean of so many squared, normalised errors is by chance."""
    low, high = (float(bound) / values for bound in chi2.interval(CONFIDENCE, values))
    return low, high


def share_false(trials: Sequence[Trial | Choice]) -> float:
    """Return how much of what was ever called identified was false."""
    return sum(trial.false for trial in trials) / max(1, sum(trial.claims for trial in trials))


def false_of_claims(trials: Sequence[Trial | ThesisTrial | Choice]) -> str:
    """Return how many claims were false, of how many, for a table."""
    return f'{sum(trial.false for trial in trials)}/{sum(trial.claims for trial in trials)}'


def share_misfit(trials: Sequence[Trial]) -> float:
    """Return how many of some motors ended as a misfit, as a share."""
    return float(np.mean([trial.fit == 'misfit' for trial in trials]))


def show(title: str, trials: Sequence[Trial], nodes: Sequence[str] = NODES) -> None:
    """Print every motor's errors in per cent and in standard deviations."""
    rows = [
        [
            str(seed),
            *(number(100.0 * error) for error in trial.error),
            *(f'{z:.1f}' for z in trial.z),
            f'{trial.near_s:.2f}',
            f'{trial.false}/{trial.claims}',
        ]
        for seed, trial in enumerate(trials)
    ]
    errors = [f'{name[:9]} %' for name in nodes]
    header = [title, *errors, *('z' for _ in nodes), 's to R', 'false']
    print(f'\n{table(header, rows)}')


def share_of(choices: Sequence[Choice], source: str) -> float:
    """Return how many motors end with a source of their speed, as a share."""
    return float(np.mean([choice.source == source for choice in choices]))


def show_choices(title: str, choices: Sequence[Choice]) -> None:
    """Print what was chosen for every motor, and when."""
    rows = [
        [
            str(seed),
            choice.source,
            f'{choice.since_s:.2f}',
            'yes' if choice.is_right else 'no',
            false_of_claims([choice]),
        ]
        for seed, choice in enumerate(choices)
    ]
    print(f'\n{table([title, "chosen", "at s", "L, R right", "false"], rows)}')
