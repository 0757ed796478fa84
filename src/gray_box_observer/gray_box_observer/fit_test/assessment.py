"""Result of one motor's residual analysis: verdict, figures, and likely missing effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

MILD = 1.5
"""Residual over noise floor up to which it is small."""

CONTRADICTIONS = {
    'coarse_stamps': 'The stamps seem to be rounded to coarse steps',
    'units_of_time': 'The stamps seem to be in another unit than s',
    'units_of_voltage': 'The voltage seems to be in another unit than V',
    'units_of_current': 'Current or torque seems to be in another unit than stated',
    'units_of_speed': 'The speed seems to be in another unit than rad/s',
    'angle_for_speed': 'The speed seems to be an angle',
    'voltage_sign': 'The voltage seems to have the wrong sign',
    'torque_sign': 'Current and torque seem to have the wrong sign',
    'speed_sign': 'The speed seems to have the wrong sign',
    'data_sheet': 'The data contradict the data sheet',
    'back_emf_constant': 'The data contradict the back-EMF constant',
    'saturation': 'The current reaches the end of the range of its sensor',
    'delay': 'The voltage acts at another time than its stamps say',
}
"""Suspects that are no missing effect but a contradiction between the data and what is stated of
them: what each says. They may leave a residual as small as the noise."""


class FitVerdict(str, Enum):
    """Whether the white box explains the data."""

    UNTESTED = 'untested'
    OK = 'ok'
    WARNING = 'warning'
    MISFIT = 'misfit'


@dataclass(frozen=True)
class Suspect:
    """An effect that the white box leaves out and that would explain the residual.

    Attributes:
        effect: its name, a key of :data:`~gray_box_observer.fit_test.effects.REMEDIES`, or a doubt
            about the data.
        evidence: log-likelihood that it brings, discounted by the residual's own correlation.
        remedy: what to do about it; where parameters help, a line of a parameter file that can be
            pasted, with the reason as its comment.
    """

    effect: str
    evidence: float
    remedy: str


@dataclass(frozen=True)
class Withheld:
    """Parameters that are not identified beside what a fit leaves, though it explains the data.

    Attributes:
        names: of the parameters.
        cause: what may leave it, and the remedy.
    """

    names: tuple[str, ...]
    cause: str


@dataclass(frozen=True)
class FitAssessment:
    """Residual analysis of the free run at the published values (Ljung 1999, chapter 16).

    Attributes:
        verdict: what follows for the parameters: nothing of a misfit may be believed.
        ratio: root mean square of the residual over the noise floor; about 1 where the white box
            holds.
        whiteness: Ljung-Box statistic over its degrees of freedom; about 1 for white noise.
        suspects: what is likely left out, or contradicts the data, the likeliest first.
        samples: how many it rests on.
        withheld: what is not identified beside what is left; None: everything may be.
    """

    verdict: FitVerdict = FitVerdict.UNTESTED
    ratio: float = math.nan
    whiteness: float = math.nan
    suspects: tuple[Suspect, ...] = ()
    samples: int = 0
    withheld: Withheld | None = None

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
            'withheld': [] if self.withheld is None else [*self.withheld.names],
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
    def has_advice(self) -> bool:
        """Whether the sentence about it says something to be done."""
        is_usual = self.verdict in (FitVerdict.UNTESTED, FitVerdict.OK)
        return not is_usual or self.withheld is not None

    @property
    def sentence(self) -> str:
        """Say in one sentence whether the white box explains the data, for people."""
        if self.verdict is FitVerdict.UNTESTED:
            return (
                'It is not tested whether the white box explains the data: samples are too few, or '
                'the voltage hardly varies.'
            )
        size = 'the residual of the free run is no number'
        if math.isfinite(self.ratio):
            size = f'the residual of the free run is {self.ratio:.3g} times the noise'
        open_part = self._open_part
        if self.verdict is FitVerdict.OK:
            return f'The white box explains the data: {size}{open_part}.'
        if self.verdict is FitVerdict.WARNING:
            return f'The white box explains the data nearly: {size}; {self._guess}{open_part}.'
        first = self.suspects[0].effect if self.suspects else ''
        finding = f'The white box does not explain the data: {size}'
        if self.ratio <= MILD:
            few = f'only {self.ratio:.3g} times the noise'
            finding = (
                f'{CONTRADICTIONS[first]}, though the residual of the free run is {few}'
                if first in CONTRADICTIONS
                else f'{finding}, but has a pattern'
            )
        return f'{finding}; {self._guess}. Believe none of the parameters.'

    @property
    def _open_part(self) -> str:
        """Name what is not identified beside what is left; the cause where none is known."""
        if self.withheld is None:
            return ''
        names = ', '.join(self.withheld.names)
        cause = '' if self.suspects else f'. The cause may be {self.withheld.cause}'
        return f'. So much leaves open: {names}{cause}'

    @property
    def _guess(self) -> str:
        """Name the likeliest suspect with its remedy."""
        if not self.suspects:
            return 'nothing known explains the rest'
        suspect = self.suspects[0]
        kind = 'cause' if suspect.effect in CONTRADICTIONS else 'left out'
        return f'likely {kind}: {suspect.effect} ({suspect.remedy})'
