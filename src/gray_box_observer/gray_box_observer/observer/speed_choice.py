"""Chooses by evidence, while a motor runs, what its unmeasured speed is taken for.

It is Kt i, as in the thesis, or the state of a rotor. Where the fit test rejects the form in force,
the other one is fitted to what is remembered, as a trial beside the estimate that is out. Trials
come at counts of samples, ever further apart, and are done piece by piece at the samples that
follow, so that every door leads to the same choice (docs/METHOD.md, Which speed).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate
from gray_box_observer.context_nodes.pieces import MOST_PIECES, Pieces, WorkBudget
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.observer.motor_form import MotorForm, residual_a
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import LATEST_NS, MOST, entry, flag, group, whole
from gray_box_observer.samples.replay_buffer import INTERVAL, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

THESIS, ROTOR, MEASURED = 'torque_constant', 'rotor', 'measured'

OTHER = {THESIS: ROTOR, ROTOR: THESIS}

IN_WORDS = {THESIS: 'a speed of Kt i', ROTOR: 'a rotor'}

FEWEST = 256
"""Samples of the first trial; the next ones come when the samples have doubled."""

LONGEST_WAIT = 65536
"""Samples between two trials at last."""

NEWEST = 2048
"""Samples that a trial rests on, at most."""

LOOKS = (512, 1024)
"""Newest samples of them that are tried first: what explains not even these is given up at a
fraction of the cost."""

FEWEST_MOVES = 3
"""Moves of the voltage from which a rotor can be told."""

LARGEST_STD = 0.25
"""Relative standard deviation of inductance, resistance and inertia up to which they are told."""

EVIDENCE = 50.0
"""Log-likelihood that the other form must bring. Drawn rotors bring 180 and more, and a rotor
brings nothing where there is none."""

HALF = 0.5
"""Share of the residual that the other form may leave where its own test warns."""

LONGEST_REASON = 500
"""Characters of a reason."""

_TELLING = ('inductance', 'resistance', 'inertia')


_TRIAL = 'trial'


@dataclass(slots=True)
class _Trial:
    """The trial of a form under way.

    Attributes:
        content: shape (signal, 1, n): samples that it rests on.
        place: of the newest of them.
        stamp_ns: of the same.
        pieces: how many were done before it was saved.
        work: its pieces, which end with the form that the motor goes over to, or None; None: it was
            saved and has not gone on yet.
    """

    content: Array
    place: int
    stamp_ns: int
    pieces: int = 0
    work: Pieces[MotorForm | None] | None = None


class SpeedChoice:
    """Follows one motor, and says where its speed comes from and why.

    Args:
        source: where it comes from at first.
        reason: why, for people.
        make: makes the form of a motor by the source of its speed; None: the source is settled.

    Attributes:
        source: where the speed comes from now.
    """

    def __init__(
        self, source: str, reason: str, make: Callable[[str], MotorForm] | None = None
    ) -> None:
        self.source = source
        self._reason = printable(reason, LONGEST_REASON)
        self._refusal = ''
        self._make = make
        self._due = self._wait = FEWEST
        self._trials = 0
        self._budget = WorkBudget()
        self._trial: _Trial | None = None

    @property
    def reason(self) -> str:
        """Why the speed comes from there; in doubt, why it does not come from elsewhere."""
        return self._refusal or self._reason

    @property
    def is_open(self) -> bool:
        """Whether the data may still lead to another source."""
        return self._make is not None

    def step(
        self, white_box: MotorWhiteBox, nodes: ContextUpdate, fit: FitAssessment, sample: Sample
    ) -> MotorForm | None:
        """Go on with the trial of the other form, or begin one where it is due.

        Args:
            white_box: the physics in force.
            nodes: the rule in force.
            fit: what is known of its fit.
            sample: the newest one.

        Returns:
            The other form, where the motor goes over to it.
        """
        if self._make is None:
            return None
        stamp_ns = sample.stamp_ns
        self._budget.grant(float(sample.interval_s[0]))
        is_doubted = self._is_doubted(fit)
        if not is_doubted:
            self._refusal = ''
        if self._trial is None:
            received = int(nodes.replay.received[0])
            if not is_doubted or received < self._due:
                return None
            self._trial = self._begun(white_box, nodes, received, stamp_ns)
        trial = self._trial
        if trial is None:
            return None
        if trial.work is None:
            trial.work = self._compared(white_box, nodes, trial.content, trial.stamp_ns)
            self._budget.repeat(trial.work, trial.pieces)
        has_ended, form = self._budget.advance(trial.work)
        if not has_ended:
            return None
        self._trial = None
        received = int(nodes.replay.received[0])
        if form is None or not is_doubted:
            self._due = received + self._wait
            return None
        self.source = OTHER[self.source]
        form.catch_up(_newer(nodes, received - trial.place), stamp_ns)
        self._due = int(form.context_nodes.replay.received[0]) + self._wait
        return form

    def _is_doubted(self, fit: FitAssessment) -> bool:
        if fit.verdict is FitVerdict.MISFIT:
            return True
        leads = bool(fit.suspects) and fit.suspects[0].effect == ROTOR
        return leads and fit.verdict is FitVerdict.WARNING

    def _begun(
        self, white_box: MotorWhiteBox, nodes: ContextUpdate, received: int, stamp_ns: int
    ) -> _Trial | None:
        """Begin a trial on what is remembered; None where the voltage has hardly moved."""
        replay = nodes.replay
        count = min(replay.stored(0), replay.capacity, NEWEST)
        content = replay.newest(count).copy()
        if Window.from_samples(white_box, content[:, 0]).moves < FEWEST_MOVES:
            self._due = received + FEWEST
            self._refusal = (
                f'{IN_WORDS[self.source]} does not explain the data, but the voltage has hardly '
                f'moved: {IN_WORDS[OTHER[self.source]]} cannot be told'
            )
            return None
        self._trials += 1
        self._wait = min(max(2 * self._wait, received), LONGEST_WAIT)
        return _Trial(content, received, stamp_ns)

    def _compared(
        self, white_box: MotorWhiteBox, nodes: ContextUpdate, content: Array, stamp_ns: int
    ) -> Pieces[MotorForm | None]:
        """Fit the other form; return it where it explains the data clearly better."""
        assert self._make is not None
        total = content.shape[2]
        for count in [*(look for look in LOOKS if look < total), total]:
            other = self._make(OTHER[self.source])
            estimate = yield from other.learn_remembered(content[:, :, -count:], stamp_ns)
            fit = other.fit.assessment(0)
            if fit.verdict is FitVerdict.MISFIT:
                self._refusal = self._why_not(fit, estimate)
                return None
        left_a = other.residual(content)
        before_a = residual_a(white_box, nodes, content)
        gain = _gain(content, before_a, left_a, estimate, len(white_box.parameters))
        if _explains(fit, left_a, before_a) and _is_told(estimate) and gain > EVIDENCE:
            same = self._make(self.source)  # the form in force may be in the midst of learning
            yield from same.learn_remembered(content, stamp_ns)
            before_a = min(before_a, same.residual(content))
            gain = _gain(content, before_a, left_a, estimate, len(white_box.parameters))
        if not (_explains(fit, left_a, before_a) and _is_told(estimate) and gain > EVIDENCE):
            self._refusal = self._why_not(fit, estimate)
            return None
        self._refusal = ''
        self._reason = (
            f'{IN_WORDS[OTHER[self.source]]} explains the data: the residual of its free run is '
            f'{fit.ratio:.3g} times the noise, that of {IN_WORDS[self.source]} '
            f'{fit.ratio * before_a / left_a:.3g} times (log-likelihood {gain:.3g})'
        )
        return other

    def _why_not(self, fit: FitAssessment, estimate: Estimate) -> str:
        """Say why the other form was not taken."""
        here, there = IN_WORDS[self.source], IN_WORDS[OTHER[self.source]]
        times = f'tried {self._trials} times' if self._trials > 1 else 'tried once'
        begin = f'{here} does not explain the data, and {there}, {times}, '
        if fit.verdict is FitVerdict.MISFIT:
            return f'{begin}does not either'
        if fit.verdict is FitVerdict.UNTESTED or not _is_told(estimate):
            return f'{begin}cannot be told from them'
        return f'{begin}explains them hardly better'

    def state(self, received: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays; places count back from the newest sample."""
        plain = {
            'source': self.source,
            'reason': self._reason,
            'refusal': self._refusal,
            'is_open': self.is_open,
            'due': self._due - received,
            'wait': self._wait,
            'trials': self._trials,
            'credit': self._budget.credit,
        }
        if self._trial is None:
            return plain, {}
        trial = self._trial
        plain['trial'] = {
            'place': trial.place - received,
            'stamp_ns': trial.stamp_ns,
            'pieces': trial.pieces if trial.work is None else self._budget.pieces,
        }
        return plain, {_TRIAL: trial.content.copy()}

    def restore(self, plain: Mapping[str, Any], arrays: Mapping[str, Array], received: int) -> None:
        """Take back what :meth:`state` gave; a source that is settled stays as it is settled now.

        Raises:
            CheckpointError: it is no state that a choice could have been in.
        """
        reasons = [entry(plain, name) for name in ('reason', 'refusal')]
        if not all(isinstance(r, str) and r == printable(r, LONGEST_REASON) for r in reasons):
            raise CheckpointError('speed.reason is none that could have been given')
        due, wait = whole(plain, 'due', -MOST, MOST), whole(plain, 'wait', FEWEST, LONGEST_WAIT)
        trials, was_open = whole(plain, 'trials'), flag(plain, 'is_open')
        if entry(plain, 'source') not in (THESIS, ROTOR, MEASURED):
            raise CheckpointError('speed.source is none of those that there are')
        if not (self.is_open and was_open):
            return
        trial = None
        if 'trial' in plain:
            check_signals(_TRIAL, arrays.get(_TRIAL))
            own = group(plain, 'trial')
            trial = _Trial(
                arrays[_TRIAL],
                received + whole(own, 'place', -MOST, 0),
                whole(own, 'stamp_ns', -LATEST_NS, LATEST_NS),
                whole(own, 'pieces', 0, MOST_PIECES),
            )
        self._budget = WorkBudget.restored(plain)
        self._trial = trial
        self._reason, self._refusal = reasons
        self._due, self._wait, self._trials = received + due, wait, trials


def _newer(nodes: ContextUpdate, count: int) -> Array:
    """Return so many of the newest samples, (signal, 1, n), or as many as there are."""
    content = nodes.replay.newest(min(count, nodes.replay.stored(0))).copy()
    if 0 < content.shape[2] < count:
        content[INTERVAL, :, 0] = 0.0  # what came before is gone: the signal history begins here
    return content


def _explains(fit: FitAssessment, left_a: float, before_a: float) -> bool:
    """Tell whether a form explains the data: its test is passed, or nearly and by far better."""
    if fit.verdict is FitVerdict.WARNING:
        return left_a < HALF * before_a
    return fit.verdict is FitVerdict.OK


def _is_told(estimate: Estimate) -> bool:
    """Tell whether the data tell what a form stands on."""
    return all(
        estimate.std[0, j] < LARGEST_STD * estimate.value[0, j]
        for j, parameter in enumerate(estimate.parameters)
        if parameter.name in _TELLING
    )


def _gain(
    content: Array, before_a: float, left_a: float, estimate: Estimate, parameters: int
) -> float:
    """Return the log-likelihood that a form brings, less what its parameters cost (BIC)."""
    count = content.shape[2]
    if not (left_a > 0.0 and np.isfinite(before_a)):
        return 0.0 if left_a > 0.0 else -math.inf
    cost = 0.5 * (len(estimate.parameters) - parameters) * math.log(count)
    return float(count * math.log(max(before_a, 1e-300) / left_a) - cost)
