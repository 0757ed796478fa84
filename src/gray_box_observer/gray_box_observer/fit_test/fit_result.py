"""What a test of a motor's fit leaves behind, for the next tests and for checkpoints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.fit_test.assessment import FitAssessment
from gray_box_observer.fit_test.evidence import NO_EVIDENCE, Evidence
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.white_box.interface import Array

LESS = 0.5
"""Share of the samples, and of the range of the voltage, that a misfit rests on which can overrule
it."""

PASSING = 3
"""Misfits in a row that may be those of a motor that is changing: any good test overrules them."""


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a motor's newest test has left.

    Attributes:
        assessment: what is published.
        judgement: what follows for its estimate.
        theta: shape (parameter,): the values tested.
        place: in its stream of samples.
        begin: place before the oldest sample that counted.
        wait: samples to the next test.
        range_v: range of the voltage in the samples that a misfit rests on.
        misfits: tests in a row that found a misfit.
        has_fitted: whether a test in which the voltage moved has been passed without a warning,
            this one or one before.
        noise_a: standard deviation in A of the current's noise, from the newest test that told; 0
            where none did.
        evidence: what its tests have told together.
        delay_s: that was taken off its voltage.
        present_since: place in its stream from which the motor had been the present one.
        speed_is_fitted: whether the speed in its samples was that of a fit of the whole motor, and
            not the measured one.
        doubts_speed: whether the judgement holds what may be wrong of a measured speed that is
            taken for exact.
    """

    assessment: FitAssessment
    judgement: Judgement
    theta: Array
    place: int
    begin: int
    wait: int
    range_v: float
    misfits: int
    noise_a: float
    has_fitted: bool
    evidence: Evidence = NO_EVIDENCE
    delay_s: float = 0.0
    present_since: int = 0
    speed_is_fitted: bool = False
    doubts_speed: bool = False

    @property
    def is_lasting_misfit(self) -> bool:
        """Whether there were too many misfits in a row for those of a motor that is changing."""
        return self.misfits > PASSING

    def outweighs(self, count: int, range_v: float, *, speed_is_fitted: bool) -> bool:
        """Tell whether a misfit outweighs later samples that show none but tell less.

        Not where it was of the measured speed, and that of the whole motor explains its samples.

        Args:
            count: of the later samples.
            range_v: of their voltage.
            speed_is_fitted: whether their speed is that of a fit of the whole motor.
        """
        is_poorer = count < LESS * self.assessment.samples or range_v < LESS * self.range_v
        is_explained = speed_is_fitted and not self.speed_is_fitted
        return self.is_lasting_misfit and is_poorer and not is_explained

    def state(self, received_count: int) -> dict[str, Any]:
        """Return all of it as plain values; places count back from the newest sample."""
        return {
            'assessment': {**self.assessment.to_dict(), 'samples': self.assessment.samples},
            'factor': self.judgement.factor.tolist(),
            'spread': self.judgement.spread.tolist(),
            'theta': self.theta.tolist(),
            'place': self.place - received_count,
            'begin': self.begin - received_count,
            'wait': self.wait,
            'range_v': self.range_v,
            'misfits': self.misfits,
            'noise_a': self.noise_a,
            'has_fitted': self.has_fitted,
            'evidence': self.evidence.to_dict(),
            'delay_s': self.delay_s,
            'present_since': self.present_since - received_count,
            'speed_is_fitted': self.speed_is_fitted,
            'doubts_speed': self.doubts_speed,
        }

    @classmethod
    def restored(cls, plain: dict[str, Any], received_count: int) -> FitResult:
        """Take back what :meth:`state` gave, once it was checked."""
        assessment = FitAssessment.from_dict(plain['assessment'])
        arrays = [np.array(plain[name], dtype=float) for name in ('factor', 'spread', 'theta')]
        return cls(
            assessment,
            Judgement(assessment.verdict, *arrays[:2]),
            arrays[2],
            plain['place'] + received_count,
            plain['begin'] + received_count,
            plain['wait'],
            plain['range_v'],
            plain['misfits'],
            plain.get('noise_a', 0.0),  # releases before kept none
            plain.get('has_fitted', True),  # likewise
            Evidence.from_dict(plain['evidence']) if 'evidence' in plain else NO_EVIDENCE,
            plain.get('delay_s', 0.0),  # likewise
            plain.get('present_since', plain['begin']) + received_count,
            plain.get('speed_is_fitted', False),
            plain.get('doubts_speed', False),
        )
