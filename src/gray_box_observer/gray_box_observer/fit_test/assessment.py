"""Result of one motor's residual analysis: verdict, figures, and likely missing effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any


class FitVerdict(str, Enum):
    """Whether the white box explains the data."""

    UNTESTED = 'untested'
    OK = 'ok'
    WARNING = 'warning'
    MISFIT = 'misfit'


@dataclass(frozen=True, slots=True)
class Suspect:
    """An effect that the white box leaves out and that would explain the residual.

    Attributes:
        effect: its name, a key of :data:`~gray_box_observer.fit_test.effects.REMEDIES`, or a doubt
            about the data.
        evidence: log-likelihood that it brings, discounted by the residual's own correlation.
        remedy: what to do about it, as a line that can be pasted.
    """

    effect: str
    evidence: float
    remedy: str


@dataclass(frozen=True, slots=True)
class FitAssessment:
    """Residual analysis of the free run at the published values (Ljung 1999, chapter 16).

    Attributes:
        verdict: what follows for the parameters: nothing of a misfit may be believed.
        ratio: root mean square of the residual over the noise floor; about 1 where the white box
            holds.
        whiteness: Ljung-Box statistic over its degrees of freedom; about 1 for white noise.
        suspects: what is likely left out, the likeliest first.
        samples: how many it rests on.
    """

    verdict: FitVerdict = FitVerdict.UNTESTED
    ratio: float = math.nan
    whiteness: float = math.nan
    suspects: tuple[Suspect, ...] = ()
    samples: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Return the assessment as plain values for JSON; ``None`` for non-finite numbers."""
        return {
            'verdict': self.verdict.value,
            'ratio': self.ratio if math.isfinite(self.ratio) else None,
            'whiteness': self.whiteness if math.isfinite(self.whiteness) else None,
            'suspects': [
                {'effect': suspect.effect, 'evidence': suspect.evidence, 'remedy': suspect.remedy}
                for suspect in self.suspects
            ],
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> FitAssessment:
        """Return what :meth:`to_dict` gave, with ``samples`` beside it."""
        ratio, whiteness = (
            math.nan if plain[name] is None else float(plain[name])
            for name in ('ratio', 'whiteness')
        )
        suspects = tuple(Suspect(**suspect) for suspect in plain['suspects'])
        return cls(FitVerdict(plain['verdict']), ratio, whiteness, suspects, int(plain['samples']))

    @property
    def sentence(self) -> str:
        """Say in one sentence whether the white box explains the data, for people."""
        if self.verdict is FitVerdict.UNTESTED:
            return 'It is not tested yet whether the white box explains the data.'
        size = f'the residual of the free run is {self.ratio:.3g} times the noise'
        if self.verdict is FitVerdict.OK:
            return f'The white box explains the data: {size}.'
        guess = (
            f'; likely left out: {self.suspects[0].effect} ({self.suspects[0].remedy})'
            if self.suspects
            else '; nothing known explains the rest'
        )
        if self.verdict is FitVerdict.WARNING:
            return f'The white box explains the data nearly: {size}{guess}.'
        return (
            f'The white box does not explain the data: {size}{guess}. Believe none of the '
            'parameters.'
        )
