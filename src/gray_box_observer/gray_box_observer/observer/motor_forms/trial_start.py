"""What a trial of other forms begins with, and how it is saved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_learner import FEWEST_MOVES
from gray_box_observer.errors import CheckpointError
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, FormKind
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.standstill import StandstillLine
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    LATEST_NS,
    entry,
    number_or_none,
    whole,
)
from gray_box_observer.samples.replay_buffer import check_signals, with_moves
from gray_box_observer.settings.sensor_lag import LONGEST_MEMORY, CurrentLag, FilterKind
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

NEWEST = 2048
"""Samples that a trial rests on, at most."""

FEW_CANDIDATES = 4
"""Forms that one trial compares, at most, beside one with a load that varies."""

MOST_CANDIDATES = FEW_CANDIDATES + 1

_KINDS = [*FilterKind]

_TRIAL = 'trial'


@dataclass(frozen=True, slots=True, eq=False)
class TrialStart:
    """What a trial begins with.

    Attributes:
        kind: of the form in force.
        candidates: the forms that are tried, one after another.
        parameters: how many the form in force has.
        number: of the trial, counted from 1.
        content: shape (signal, 1, n): samples that it rests on.
        stamp_ns: of the newest of them.
        before_a: root mean square in A of the residual that the form in force leaves of them.
        standstill: what pauses of the motor have told; None: nothing.
    """

    kind: FormKind
    candidates: tuple[FormKind, ...]
    parameters: int
    number: int
    content: Array
    stamp_ns: int
    before_a: float
    standstill: StandstillLine | None = None

    @property
    def sample_count(self) -> int:
        """How many samples there are."""
        return int(self.content.shape[2])

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything that is not saved elsewhere, as plain values and arrays."""
        plain = {
            'stamp_ns': self.stamp_ns,
            'before_a': self.before_a if math.isfinite(self.before_a) else None,
            'standstill': None if self.standstill is None else self.standstill.state(),
            'candidates': [
                [kind.source, *kind.effects, *_numbers_of(kind)] for kind in self.candidates
            ],
        }
        return plain, {_TRIAL: self.content.copy()}

    @classmethod
    def restored(
        cls,
        plain: Mapping[str, Any],
        arrays: Mapping[str, Array],
        white_box: MotorWhiteBox,
        kind: FormKind,
        number: int,
        open_forms: OpenForms,
    ) -> TrialStart:
        """Return what :meth:`state` gave.

        Args:
            plain: of a state.
            arrays: of the same.
            white_box: the physics in force.
            kind: of that form.
            number: of the trial, counted from 1.
            open_forms: that the motor may take.

        Raises:
            CheckpointError: it is no state that a trial could have begun with.
        """
        check_signals(_TRIAL, arrays.get(_TRIAL), longest=NEWEST)
        if not Window.from_samples(white_box, arrays[_TRIAL][:, 0]).moves:
            raise CheckpointError(f'{_TRIAL} holds samples that no trial begins with')
        before_a = number_or_none(plain, 'before_a', 0.0, LARGEST)
        standstill = None
        if entry(plain, 'standstill') is not None:
            standstill = StandstillLine.restored(plain, 'standstill')
        return cls(
            kind,
            _saved_candidates(plain, kind, open_forms),
            len(white_box.parameters),
            number,
            with_moves(arrays[_TRIAL]),
            whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS),
            math.inf if before_a is None else before_a,
            standstill,
        )


def can_tell(white_box: MotorWhiteBox, content: Array, largest_v: float) -> bool:
    """Tell whether the voltage has moved often enough to tell a rotor, or an effect.

    Args:
        white_box: of the motor.
        content: shape (signal, 1, n): samples.
        largest_v: voltage that has driven the motor before.
    """
    window = Window.from_samples(white_box, content[:, 0])
    return replace(window, voltage_elsewhere_v=largest_v).moves >= FEWEST_MOVES


def _saved_candidates(
    plain: Mapping[str, Any], kind: FormKind, open_forms: OpenForms
) -> tuple[FormKind, ...]:
    """Return the candidates of a saved trial.

    Raises:
        CheckpointError: they are none that could be tried.
    """
    entries = entry(plain, 'candidates')
    if isinstance(entries, list) and 0 < len(entries) <= MOST_CANDIDATES:
        kinds = tuple(_kind_of(one) for one in entries if isinstance(one, list) and one)
        if (
            len(kinds) == len(entries)
            and (kind not in kinds or kind.source == ROTOR)
            and all(map(open_forms.contains, kinds))
        ):
            return kinds
    raise CheckpointError('speed.trial.candidates are no forms that could be tried')


def _numbers_of(kind: FormKind) -> list[float]:
    """Return what is saved of a form behind the names of its effects."""
    if kind.lag is not None:
        lag = kind.lag
        place = float(_KINDS.index(lag.filter_kind))
        return [kind.dead_zone_v, lag.lag_s, lag.winding_s, lag.memory, place]
    return [kind.dead_zone_v] if kind.dead_zone_v else []


def _kind_of(entries: list[Any]) -> FormKind:
    """Return the form that was saved, whatever it is."""
    names = [one for one in entries if not isinstance(one, float)]
    zone_v, *numbers = [one for one in entries if isinstance(one, float)] or [0.0]
    lag = None
    if numbers:
        if len(numbers) not in (2, 4):
            return FormKind('')
        lag_s, winding_s, memory, place = [*numbers, 0.0, 0.0][:4]  # early releases: two
        if place not in range(len(_KINDS)) or not abs(memory) <= LONGEST_MEMORY:
            return FormKind('')
        lag = CurrentLag(lag_s, winding_s, (), memory, _KINDS[int(place)])
    return FormKind(names[0] if names else '', tuple(names[1:]), zone_v, lag)
