"""Chooses by evidence, while a motor runs, what its unmeasured speed is taken for.

It is Kt i, as in the thesis, or the state of a rotor. Where the fit test rejects the form in force,
the other one is fitted to what is remembered, as a trial beside the estimate that is out. Trials
come at counts of samples, ever further apart, and are done piece by piece at the samples that
follow, so that every door leads to the same choice (docs/METHOD.md, Which speed).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import ContextUpdate, Estimate
from gray_box_observer.context_nodes.pieces import MOST_PIECES, SAVED, Pieces, WorkBudget
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import CHANGE
from gray_box_observer.observer.motor_form import MotorForm, residual_a
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    LATEST_NS,
    MOST,
    entry,
    flag,
    group,
    number_or_none,
    whole,
)
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

CATCH_UP, WORK_A_CATCH = 64, 3072
"""Samples that a form takes over in one piece of work, once it is adopted, and what that costs."""

LONGEST_BACKLOG = 4096
"""Newest samples that have come during a trial, of which the form that is adopted learns."""

FINISHED = 16 * SAVED
"""Work that is done of a trial at the end of a recording, at most: about a second's."""

_TELLING = ('inductance', 'resistance', 'inertia')


_TRIAL, _BACKLOG = 'trial', 'backlog'


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What a trial has ended with.

    Attributes:
        form: that the motor goes over to; None: it keeps its own.
        reason: why.
    """

    form: MotorForm | None
    reason: str


@dataclass(slots=True)
class _Trial:
    """The trial of a form under way.

    Attributes:
        content: shape (signal, 1, n): samples that it rests on.
        stamp_ns: of the newest of them.
        before_a: root mean square in A of the residual that the form in force leaves of them.
        backlog: shape (signal,) each: samples that have come since.
        taken_count: how many of them a form that was found has; None: none was found yet.
    """

    content: Array
    stamp_ns: int
    before_a: float
    backlog: list[Array] = field(default_factory=list)
    taken_count: int | None = None

    def keep(self, samples: Array) -> None:
        """Remember samples that have come, shape (signal, 1, n); of very many the newest."""
        self.backlog.extend(samples[:, 0].T.copy())
        excess_count = len(self.backlog) - LONGEST_BACKLOG
        if excess_count > 0 and self.taken_count is None:
            del self.backlog[:excess_count]
            self.backlog[0][INTERVAL] = 0.0  # the signal history begins here


class SpeedChoice:
    """Follows one motor, and says where its speed comes from and why.

    Args:
        source: where it comes from at first.
        reason: why, for people.
        make: makes the form of a motor by the source of its speed; None: the source is settled.

    Attributes:
        source: where the speed comes from now.
        is_idle: whether nothing is to be done until the fit is tested again.
    """

    def __init__(
        self, source: str, reason: str, make: Callable[[str], MotorForm] | None = None
    ) -> None:
        self.source = source
        self._reason = printable(reason, LONGEST_REASON)
        self._refusal = ''
        self._make = make
        self.is_idle = make is None
        self._due = self._wait = FEWEST
        self._trials = 0
        self._budget = WorkBudget()
        self._trial: _Trial | None = None
        self._work: Pieces[_Outcome] | None = None  # of the trial
        self._seen = 0  # place of the newest sample

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
        received, is_doubted = int(nodes.replay.received[0]), self._is_doubted(fit)
        new_count = max(0, received - self._seen)
        self._budget.grant(float(sample.interval_s[0]), new_count)
        self.is_idle = not is_doubted and self._trial is None
        if not is_doubted:
            self._refusal = ''
        elif not self._refusal:
            self._refusal = self._why_not_yet()
        if self._trial is not None and new_count > 0:
            self._trial.keep(nodes.replay.newest(min(new_count, nodes.replay.stored(0))))
        self._seen = received
        if self._trial is None:
            if not is_doubted or received < self._due:
                return None
            self._begin(white_box, nodes, received, sample.stamp_ns)
        if self._work is None:
            return None
        has_ended, outcome = self._budget.advance(self._work)
        if not has_ended:
            return None
        assert outcome is not None
        return self._ended(outcome, sample.stamp_ns, received, is_doubted=is_doubted)

    def finish(self, nodes: ContextUpdate, fit: FitAssessment, stamp_ns: int) -> MotorForm | None:
        """Do what is left of a trial, for no samples will come; see :meth:`step`."""
        if self._work is None:
            return None
        work_count = 0
        while work_count < FINISHED:
            try:
                work_count += next(self._work)
            except StopIteration as end:
                is_doubted = self._is_doubted(fit)
                received = int(nodes.replay.received[0])
                return self._ended(end.value, stamp_ns, received, is_doubted=is_doubted)
            self._budget.pieces += 1
        return None

    def _ended(
        self, outcome: _Outcome, stamp_ns: int, received: int, *, is_doubted: bool
    ) -> MotorForm | None:
        """Draw the consequence of a trial."""
        trial, self._trial, self._work = self._trial, None, None
        assert trial is not None
        self._budget.pieces = 0
        form = outcome.form
        if form is None or not is_doubted:
            self._due = received + self._wait
            self._refusal = outcome.reason if is_doubted else ''
            return None
        self.source = OTHER[self.source]
        self._reason, self._refusal = outcome.reason, ''
        rest = trial.backlog[trial.taken_count or 0 :]
        if rest:
            form.catch_up(_content(rest), stamp_ns)
        self._seen = int(form.context_nodes.replay.received[0])
        self._due = self._seen + self._wait
        return form

    def wake(self) -> None:
        """Take note that the fit was tested: what was idle goes on."""
        self.is_idle = self._make is None

    def _is_doubted(self, fit: FitAssessment) -> bool:
        leading = fit.suspects[0].effect if fit.suspects else ''
        if fit.verdict is FitVerdict.MISFIT:
            # a rotor that has changed: its next fit may explain the data
            return not (self.source == ROTOR and leading == CHANGE)
        return leading == ROTOR and fit.verdict is FitVerdict.WARNING

    def _begin(
        self, white_box: MotorWhiteBox, nodes: ContextUpdate, received: int, stamp_ns: int
    ) -> None:
        """Begin a trial on what is remembered, unless the voltage has hardly moved."""
        replay = nodes.replay
        count = min(replay.stored(0), replay.capacity, NEWEST)
        content = replay.newest(count).copy()
        if not _can_tell(white_box, content):
            self._due = received + FEWEST
            self._refusal = (
                f'{IN_WORDS[self.source]} does not explain the data, but the voltage has hardly '
                f'moved: {IN_WORDS[OTHER[self.source]]} cannot be told'
            )
            return
        self._trials += 1
        self._refusal = self._why_not_yet()
        self._wait = min(max(2 * self._wait, received), LONGEST_WAIT)
        self._go_on(_Trial(content, stamp_ns, residual_a(white_box, nodes, content)), white_box)

    def _go_on(self, trial: _Trial, white_box: MotorWhiteBox) -> None:
        self._trial = trial
        self._work = self._tried(trial, len(white_box.parameters))

    def _tried(self, trial: _Trial, parameters: int) -> Pieces[_Outcome]:
        """Compare the other form, and let it take over what has come since where it is better.

        Nothing is read but what is saved with the trial.
        """
        outcome = yield from self._compared(trial, parameters)
        if outcome.form is None:
            return outcome
        trial.taken_count = 0
        while len(trial.backlog) - trial.taken_count > CATCH_UP:
            part = trial.backlog[trial.taken_count : trial.taken_count + CATCH_UP]
            outcome.form.catch_up(_content(part), trial.stamp_ns)
            trial.taken_count += CATCH_UP
            yield WORK_A_CATCH
        return outcome

    def _compared(self, trial: _Trial, parameters: int) -> Pieces[_Outcome]:
        """Fit the other form; return it where it explains the data clearly better."""
        assert self._make is not None
        content, stamp_ns, before_a = trial.content, trial.stamp_ns, trial.before_a
        total = content.shape[2]
        other = self._make(OTHER[self.source])
        for look, count in enumerate([*(look for look in LOOKS if look < total), total]):
            if look > 0 and not other.can_go_on:
                other = self._make(OTHER[self.source])
            estimate = yield from other.learn_remembered(content[:, :, -count:], stamp_ns)
            fit = other.fit.assessment(0)
            if fit.verdict is FitVerdict.MISFIT:
                return _Outcome(None, self._why_not(fit, estimate))
        left_a = other.residual(content)
        gain = _gain(content, before_a, left_a, estimate, parameters)
        if _explains(fit, left_a, before_a) and _is_told(estimate) and gain > EVIDENCE:
            same = self._make(self.source)  # the form in force may be in the midst of learning
            yield from same.learn_remembered(content, stamp_ns)
            before_a = min(before_a, same.residual(content))
            gain = _gain(content, before_a, left_a, estimate, parameters)
        if not (_explains(fit, left_a, before_a) and _is_told(estimate) and gain > EVIDENCE):
            return _Outcome(None, self._why_not(fit, estimate))
        return _Outcome(
            other,
            f'{IN_WORDS[OTHER[self.source]]} explains the data: the residual of its free run is '
            f'{fit.ratio:.3g} times the noise, that of {IN_WORDS[self.source]} '
            f'{fit.ratio * before_a / left_a:.3g} times (log-likelihood {gain:.3g})',
        )

    def _why_not_yet(self) -> str:
        """Say that the other form is still to be tried."""
        here, there = IN_WORDS[self.source], IN_WORDS[OTHER[self.source]]
        return f'{here} does not explain the data, and too few samples have come to try {there}'

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
            'seen': self._seen - received,
            'is_idle': self.is_idle,
        }
        trial = self._trial
        if trial is None:
            return plain, {}
        plain['trial'] = {
            'stamp_ns': trial.stamp_ns,
            'before_a': trial.before_a if math.isfinite(trial.before_a) else None,
            'pieces': self._budget.pieces,
        }
        arrays = {_TRIAL: trial.content.copy()}
        if trial.backlog:
            arrays[_BACKLOG] = _content(trial.backlog)
        return plain, arrays

    def restore(
        self,
        plain: Mapping[str, Any],
        arrays: Mapping[str, Array],
        white_box: MotorWhiteBox,
        received: int,
    ) -> None:
        """Take back what :meth:`state` gave; a source that is settled stays as it is settled now.

        Pieces of a trial that had been done are done again.

        Args:
            plain: of a state.
            arrays: of the same.
            white_box: the physics in force.
            received: place of the newest sample.

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
        self._budget = WorkBudget.restored(plain)
        self._trial = self._work = None
        self._reason, self._refusal = reasons
        self._due, self._wait, self._trials = received + due, wait, trials
        self._seen = received
        if 'seen' in plain:  # not in files of early releases
            self._seen += whole(plain, 'seen', -MOST, 0)
            self.is_idle = flag(plain, 'is_idle') and 'trial' not in plain
        if 'trial' in plain and 'before_a' in group(plain, 'trial'):  # else of an early release
            self._resume(group(plain, 'trial'), arrays, white_box)

    def _resume(
        self, plain: Mapping[str, Any], arrays: Mapping[str, Array], white_box: MotorWhiteBox
    ) -> None:
        """Do the pieces of a saved trial again."""
        check_signals(_TRIAL, arrays.get(_TRIAL), longest=NEWEST)
        if not _can_tell(white_box, arrays[_TRIAL]):
            raise CheckpointError(f'{_TRIAL} holds samples that no trial begins with')
        before_a = number_or_none(plain, 'before_a', 0.0, LARGEST)
        stamp_ns = whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
        pieces = whole(plain, 'pieces', 0, MOST_PIECES)
        trial = _Trial(arrays[_TRIAL], stamp_ns, math.inf if before_a is None else before_a)
        if _BACKLOG in arrays:
            check_signals(_BACKLOG, arrays[_BACKLOG], longest=2 * LONGEST_BACKLOG)
            trial.backlog.extend(arrays[_BACKLOG][:, 0].T.copy())
        self._go_on(trial, white_box)
        assert self._work is not None
        self._budget.repeat(self._work, pieces)


def _content(backlog: Sequence[Array]) -> Array:
    """Put samples side by side, shape (signal, 1, n)."""
    return np.stack(backlog, axis=1)[:, None]


def _can_tell(white_box: MotorWhiteBox, content: Array) -> bool:
    """Tell whether the voltage has moved often enough to tell a rotor."""
    return Window.from_samples(white_box, content[:, 0]).moves >= FEWEST_MOVES


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
