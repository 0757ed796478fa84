"""What the thesis reports: table 5.1 (page 42), and the claims of its text (pages 42 to 43)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

SOURCE = 'thesis, table 5.1, page 42'

EXCESS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        'main': (1.26, 0.021, 1.78, 0.0, 0.0, 0.207, 0.0, 0.0),
        'sees_data': (0.850, 0.042, 1.18, 0.104, 0.050, 0.365, 0.247, 0.106),
        'supervised_with_parameters': (0.0, 0.008, 0.0, 0.176, 0.129, 0.163, 0.138, 0.219),
        'supervised': (0.144, 0.0, 0.174, 0.229, 0.152, 0.0, 0.072, 0.270),
    }
)
"""By variant, set after set: error over that of the set's best variant, less one (".0 means 100 %
of lowest error")."""

BASELINE_ERROR = (428.2, 3399.9, 258.4, 4455.6, 20867.5, 8485.4, 4052.0, 3241.5)
"""The row "Baseline error": what the entries above it are relative to, so the error of the best
variant; no unit."""

FOUR = tuple(EXCESS)

Errors = Mapping[str, Sequence[float]]
"""By variant, set after set; any scale that is the same for all variants of a set."""

TIE = 0.01
"""Errors that differ by less than this fraction are of equal rank: networks that all saturate err
alike."""


def better(first: float, second: float) -> bool:
    """Whether the first error is smaller than the second by more than a tie."""
    return first < (1.0 - TIE) * second


@dataclass(frozen=True, slots=True)
class Claim:
    """One sentence of the thesis, and how to count on how many sets it holds.

    Attributes:
        text: the claim.
        columns: sets that it speaks of, by place.
        ahead: the variant, or variants, that ...
        behind: ... this one, or these, must not reach: every one ahead has a smaller error than
            every one behind.
    """

    text: str
    columns: tuple[int, ...]
    ahead: tuple[str, ...]
    behind: tuple[str, ...]

    def count(self, ratios: Errors) -> int:
        """Return on how many of its sets the claim holds."""
        return sum(
            all(better(ratios[a][j], ratios[b][j]) for a in self.ahead for b in self.behind)
            for j in self.columns
        )


EVERY = tuple(range(len(BASELINE_ERROR)))

CLAIMS = (
    Claim('main is last on the training set and the one like it', (0, 2), FOUR[1:], FOUR[:1]),
    Claim('main leads on the complex sets', (3, 4, 6, 7), FOUR[:1], FOUR[1:]),
    Claim('main beats "sees the data"', EVERY, FOUR[:1], FOUR[1:2]),
    Claim('theta as input helps the supervised one', EVERY, FOUR[2:3], FOUR[3:]),
)


def ratios() -> Errors:
    """The table as ratios to the best of each set."""
    return {name: tuple(1.0 + excess for excess in row) for name, row in EXCESS.items()}
