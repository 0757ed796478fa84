"""Chooses by evidence, while a motor runs, what its unmeasured speed is taken for.

It is Kt i, as in the thesis, or the state of a rotor. Where the fit test rejects the form in force,
the other one is fitted to what is remembered, as a trial beside the estimate that is out
(`form_trial.py`). Trials come at counts of samples, ever further apart, and are done piece by piece
at the samples that follow, so that every door leads to the same choice
(docs/METHOD.md, Which speed).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from gray_box_observer.context_nodes import ContextUpdate
from gray_box_observer.context_nodes.pieces import WorkBudget
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import CHANGE
from gray_box_observer.observer.form_trial import (
    NEWEST,
    FormTrial,
    TrialOutcome,
    TrialStart,
    can_tell,
)
from gray_box_observer.observer.motor_form import (
    IN_WORDS,
    MEASURED,
    OTHER,
    ROTOR,
    THESIS,
    MotorForm,
    residual_a,
)
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import MOST, entry, flag, group, whole
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

FEWEST = 256
"""Samples of the first trial; the next ones come when the samples have doubled."""

LONGEST_WAIT = 65536
"""Samples between two trials at last."""

LONGEST_REASON = 500
"""Characters of a reason."""


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
        self._trial: FormTrial | None = None
        self._place = 0  # of the newest sample

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
        place, is_doubted = int(nodes.replay.received[0]), self._is_doubted(fit)
        new_count = max(0, place - self._place)
        self._budget.grant(float(sample.interval_s[0]), new_count)
        self.is_idle = not is_doubted and self._trial is None
        if not is_doubted:
            self._refusal = ''
        elif not self._refusal:
            self._refusal = self._why_not_yet()
        if self._trial is not None and new_count > 0:
            self._trial.keep(nodes.replay.newest(min(new_count, nodes.replay.stored(0))))
        self._place = place
        if self._trial is None and is_doubted and place >= self._due:
            self._trial = self._begin(white_box, nodes, sample.stamp_ns)
        if self._trial is None:
            return None
        has_ended, outcome = self._budget.advance(self._trial.work)
        if not has_ended:
            return None
        assert outcome is not None
        return self._end(outcome, sample.stamp_ns, place, is_doubted=is_doubted)

    def finish(self, nodes: ContextUpdate, fit: FitAssessment, stamp_ns: int) -> MotorForm | None:
        """Do what is left of a trial, for no samples will come; see :meth:`step`."""
        if self._trial is None:
            return None
        outcome = self._trial.finish(self._budget)
        if outcome is None:
            return None
        place = int(nodes.replay.received[0])
        return self._end(outcome, stamp_ns, place, is_doubted=self._is_doubted(fit))

    def _end(
        self, outcome: TrialOutcome, stamp_ns: int, place: int, *, is_doubted: bool
    ) -> MotorForm | None:
        """Draw the consequence of a trial."""
        trial, self._trial = self._trial, None
        assert trial is not None
        self._budget.pieces = 0
        form = outcome.form
        if form is None or not is_doubted:
            self._due = place + self._wait
            self._refusal = outcome.reason if is_doubted else ''
            return None
        self.source = OTHER[self.source]
        self._reason, self._refusal = outcome.reason, ''
        trial.hand_over(form, stamp_ns)
        self._place = int(form.context_nodes.replay.received[0])
        self._due = self._place + self._wait
        return form

    def wake(self) -> None:
        """Take note that the fit was tested: what was idle goes on."""
        self.is_idle = self._make is None

    def _is_doubted(self, fit: FitAssessment) -> bool:
        likeliest = fit.suspects[0].effect if fit.suspects else ''
        if fit.verdict is FitVerdict.MISFIT:
            # a rotor that has changed: its next fit may explain the data
            return not (self.source == ROTOR and likeliest == CHANGE)
        return likeliest == ROTOR and fit.verdict is FitVerdict.WARNING

    def _begin(
        self, white_box: MotorWhiteBox, nodes: ContextUpdate, stamp_ns: int
    ) -> FormTrial | None:
        """Begin a trial on what is remembered, unless the voltage has hardly moved."""
        assert self._make is not None
        replay = nodes.replay
        count = min(replay.stored(0), replay.capacity, NEWEST)
        content = replay.newest(count).copy()
        if not can_tell(white_box, content):
            self._due = self._place + FEWEST
            self._refusal = (
                f'{IN_WORDS[self.source]} does not explain the data, but the voltage has hardly '
                f'moved: {IN_WORDS[OTHER[self.source]]} cannot be told'
            )
            return None
        self._trials += 1
        self._refusal = self._why_not_yet()
        self._wait = min(max(2 * self._wait, self._place), LONGEST_WAIT)
        before_a = residual_a(white_box, nodes, content)
        start = TrialStart(
            self.source, len(white_box.parameters), self._trials, content, stamp_ns, before_a
        )
        return FormTrial(start, self._make)

    def _why_not_yet(self) -> str:
        """Say that the other form is still to be tried."""
        here, there = IN_WORDS[self.source], IN_WORDS[OTHER[self.source]]
        return f'{here} does not explain the data, and too few samples have come to try {there}'

    def state(self, place: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays; places count back from the newest one."""
        plain = {
            'source': self.source,
            'reason': self._reason,
            'refusal': self._refusal,
            'is_open': self.is_open,
            'due': self._due - place,
            'wait': self._wait,
            'trials': self._trials,
            'credit': self._budget.credit,
            'seen': self._place - place,
            'is_idle': self.is_idle,
        }
        if self._trial is None:
            return plain, {}
        plain['trial'], arrays = self._trial.state(self._budget.pieces)
        return plain, arrays

    def restore(
        self,
        plain: Mapping[str, Any],
        arrays: Mapping[str, Array],
        white_box: MotorWhiteBox,
        place: int,
    ) -> None:
        """Take back what :meth:`state` gave; a source that is settled stays as it is settled now.

        Pieces of a trial that had been done are done again.

        Args:
            plain: of a state.
            arrays: of the same.
            white_box: the physics in force.
            place: of the newest sample.

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
        self._trial = None
        self._reason, self._refusal = reasons
        self._due, self._wait, self._trials = place + due, wait, trials
        self._place = place
        if 'seen' in plain:  # not in files of early releases
            self._place += whole(plain, 'seen', -MOST, 0)
            self.is_idle = flag(plain, 'is_idle') and 'trial' not in plain
        if 'trial' in plain and 'before_a' in group(plain, 'trial'):  # else of an early release
            assert self._make is not None
            self._trial = FormTrial.restored(
                group(plain, 'trial'), arrays, white_box, self.source, trials, self._make,
                self._budget,
            )  # fmt: skip
