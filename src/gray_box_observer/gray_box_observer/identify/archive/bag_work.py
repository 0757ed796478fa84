"""One bag of an archive: identified by itself, and whatever happens told as a value."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gray_box_observer.bag.embedded_parameters import carried_by
from gray_box_observer.bag.limits import ReadLimits
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.identify import offline_run
from gray_box_observer.identify.options import configure
from gray_box_observer.identify.result import describe, warnings_of
from gray_box_observer.observer.builder import TrainingFactory


@dataclass(frozen=True)
class BagResult:
    """What one bag has given: plain values, so that it may cross from process to process.

    Attributes:
        bag: absolute path of the bag.
        error: why it gave nothing; None where it was read.
        warnings: what the user should know of it, such as how much of a truncated bag was lost.
        digest: SHA-256 over every estimate in order; None where it gave nothing.
        motors: by name, as ``identify --json`` says it.
        start_ns: stamp of the first sample, by motor.
    """

    bag: str
    error: str | None = None
    warnings: tuple[str, ...] = ()
    digest: str | None = None
    motors: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    start_ns: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Write down paths that are no UTF-8 as text that any file can hold."""
        object.__setattr__(self, 'bag', _as_text(self.bag))
        object.__setattr__(self, 'error', None if self.error is None else _as_text(self.error))
        object.__setattr__(self, 'warnings', tuple(map(_as_text, self.warnings)))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``identify --each --json`` says of a bag."""
        return {
            'bag': self.bag,
            'error': self.error,
            'warnings': list(self.warnings),
            'start_ns': dict(self.start_ns),
            'motors': dict(self.motors),
            'digest': self.digest,
        }


@dataclass(frozen=True)
class BagWork:
    """Identifies bags, each with an observer of its own; keeps nothing from one to the next.

    What a bag carries of parameters, such as the torque constant it was made with, is the
    observer's, as where a bag is identified alone.

    Attributes:
        parameter_values: parameters by their dotted names, as the parameter file gives them.
        training: makes the predictor's trainer; None: no predictor.
        limits: how much of a bag may be held in memory at one time.
    """

    parameter_values: Mapping[str, Any]
    training: TrainingFactory | None = None
    limits: ReadLimits = field(default_factory=ReadLimits)

    def __call__(self, bag: Path) -> BagResult:
        """Identify one bag; never raises what a bag or a defect of this package can cause."""
        try:
            configuration = configure(self.parameter_values, carried_by([bag]), 'the bag')
            outcome = offline_run.run([bag], configuration, self.training, limits=self.limits)
            description = describe(outcome)
        except GrayBoxError as error:
            return BagResult(str(bag), error=' '.join(str(error).split()))
        except Exception as error:  # one bag must not cost the results of thousands
            return BagResult(
                str(bag), error=f'a defect of identify, please report it: {_place_of(error)}'
            )
        return BagResult(
            str(bag),
            warnings=tuple(warnings_of(outcome)),
            digest=description['digest'],
            motors=description['motors'],
            start_ns={name: course.first_ns for name, course in outcome.courses.items()},
        )


def _as_text(text: str) -> str:
    return text.encode('utf-8', 'backslashreplace').decode('utf-8')


def _place_of(error: Exception) -> str:
    """Say what went wrong and where, in one line."""
    error_text = ' '.join(f'{type(error).__name__}: {error}'.split())
    frames = traceback.extract_tb(error.__traceback__)
    return (
        f'{error_text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})'
        if frames
        else error_text
    )
