"""Chooses by evidence, while a motor runs, which form its physics takes.

An unmeasured speed is Kt i, as in the thesis, or the state of a rotor. Driver and sensor may have
effects of their own: a voltage that is lost, an offset. Where the fit test rejects the form in
force, what it suspects is fitted to what is remembered, as a trial beside the estimate that is out
(`form_trial.py`). Trials come at counts of samples, ever further apart, and are done piece by piece
at the samples that follow, so that every door leads to the same choice
(docs/METHOD.md, Which speed; docs/METHOD.md, Which effects).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gray_box_observer.context_nodes import ContextUpdate
from gray_box_observer.context_nodes.pieces import WorkBudget
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import CHANGE, COLOURED_NOISE, LATE, LOAD
from gray_box_observer.fit_test.saved_test import MOST_AHEAD
from gray_box_observer.fit_test.still_speed import stands_still
from gray_box_observer.observer.motor_forms.form_candidates import FormCandidates, is_uneasy
from gray_box_observer.observer.motor_forms.form_comparison import TrialOutcome
from gray_box_observer.observer.motor_forms.form_trial import ORDER, FormTrial
from gray_box_observer.observer.motor_forms.motor_form import (
    MEASURED,
    ROTOR,
    THESIS,
    FormKind,
    MotorForm,
    residual_a,
)
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.standstill import Standstills
from gray_box_observer.observer.motor_forms.trial_memory import TrialMemory
from gray_box_observer.observer.motor_forms.trial_start import NEWEST, TrialStart, can_tell
from gray_box_observer.observer.motor_forms.voltage_path import VoltagePath
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    MOST,
    entry,
    flag,
    group,
    number,
    whole,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.motor_configuration import COASTING, VARYING_LOAD
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

FEWEST = 256
"""Samples of the first trial; the next ones come when the samples in doubt have doubled."""

LONGEST_WAIT = 65536
"""Samples between two trials at last."""

LONGEST_REASON = 500
"""Characters of a reason."""

SHARES = 2
"""Shares of work that a sample grants a trial: nothing is believed before it ends."""

LATE_SIGNS = ('', COLOURED_NOISE, *LATE)
"""What the fit test suspects first, or nothing, where the current of a rotor may lag: a filter
gives noise a memory, too."""

NOTHING_ADDED = 'nothing in the data speaks for any'
"""Why no effects are added to a form that explains the data."""


@dataclass(slots=True)
class TrialPace:
    """When the next trial of other forms is due.

    Attributes:
        due: place of the sample from which it is.
        wait: samples from the end of a trial to the next one.
        trials: how many have begun.
        doubt: place at which the newest late doubt has begun; 0: there was none.
        newest_doubt: place of the newest sample in doubt.
    """

    due: int = FEWEST
    wait: int = FEWEST
    trials: int = 0
    doubt: int = 0
    newest_doubt: int = 0

    def begin(self, place: int) -> None:
        """Note that a trial begins; the next comes when the samples in doubt have doubled.

        What came before a late doubt does not count: a motor that has stood for long, or was
        explained for long, waits no longer than one that is new.
        """
        self.trials += 1
        self.wait = min(max(2 * self.wait, place - self.doubt), LONGEST_WAIT)

    def note_doubt(self, place: int) -> None:
        """Note that a sample is in doubt; a doubt that may rest on all samples began with them.

        One that comes after as many good samples as the wait is a new one: it is asked at once.
        """
        if place > NEWEST and place - self.newest_doubt > max(self.wait, NEWEST):
            self.doubt = place
            self.wait = FEWEST
            self.due = min(self.due, place)
        self.newest_doubt = place

    def postpone(self, place: int) -> None:
        """Note that nothing could be tried."""
        self.due = place + FEWEST

    def end(self, place: int) -> None:
        """Note that a trial has ended."""
        self.due = place + self.wait


@dataclass(slots=True)
class Reasons:
    """Why the form is what it is, for people.

    Attributes:
        source: why the speed comes from there.
        effects: why these effects were added.
        refusal: in doubt, why no other form is in force; else empty.
    """

    source: str
    effects: str
    refusal: str = ''


class FormChoice:
    """Follows one motor, and says which form its physics takes, and why.

    Args:
        source: of its speed at first.
        reason: of that, for people.
        open_forms: which forms data may lead to; None: all is settled.
        effects_reason: why no effects are added, for people.

    Attributes:
        kind: of the form in force.
        is_idle: whether nothing is to be done until the fit is tested again.
    """

    def __init__(
        self,
        source: str,
        reason: str,
        open_forms: OpenForms | None = None,
        effects_reason: str = '',
    ) -> None:
        self.kind = FormKind(source)
        self._reasons = Reasons(
            printable(reason, LONGEST_REASON), printable(effects_reason, LONGEST_REASON)
        )
        self._open = open_forms if open_forms is not None and open_forms.is_choice else None
        self.is_idle = self._open is None
        self._pace = TrialPace()
        self._budget = WorkBudget()
        self._trial: FormTrial | None = None
        self._memory: TrialMemory | None = None
        self._standstills = Standstills()  # while the form in force is in doubt
        self._newest_v = self._largest_v = 0.0  # voltages; the largest of two samples in a row
        self._place = 0  # of the newest sample
        self._change_count = 0  # samples at which the motor looked like another one, less good ones

    @property
    def reason(self) -> str:
        """Why the speed comes from there; in doubt, why it does not come from elsewhere."""
        return (self._refusal if self.speed_is_open else '') or self._reasons.source

    @property
    def effects_reason(self) -> str:
        """Why these effects were added; in doubt, why no others are."""
        is_open = self._open is not None and bool(self._open.effects)
        return (self._refusal if is_open else '') or self._reasons.effects

    @property
    def _refusal(self) -> str:
        """In doubt, why no other form is in force, and what pauses tell; else empty."""
        line = self._standstills.line
        pauses = '' if line is None else f'; {line.in_words}'
        return self._reasons.refusal and self._reasons.refusal + pauses

    @property
    def is_open(self) -> bool:
        """Whether the data may still lead to another form."""
        return self._open is not None

    @property
    def speed_is_open(self) -> bool:
        """Whether the data may still lead to another source of the speed.

        From a measured one they do where its reading stands still, which nobody expects.
        """
        other = self.kind.with_other_source
        is_measured = self.kind.source == MEASURED
        return (
            self._open is not None
            and not is_measured
            and other is not None
            and (other.source in self._open.sources)
        )

    def may_take(self, kind: FormKind) -> bool:
        """Tell whether data may lead to a form."""
        return self._open is not None and self._open.contains(kind)

    def form_of(self, kind: FormKind) -> MotorForm:
        """Make a form that data have led to before, and take it for the one in force."""
        assert self._open is not None
        self.kind = kind
        return self._open.make(kind)

    def step(
        self,
        white_box: MotorWhiteBox,
        nodes: ContextUpdate,
        path: VoltagePath | None,
        fit: FitAssessment,
        sample: Sample,
    ) -> MotorForm | None:
        """Go on with the trial of other forms, or begin one where it is due.

        Args:
            white_box: the physics in force.
            nodes: the rule in force.
            path: makes of commands the voltages that it takes; None: they are the same.
            fit: what is known of its fit.
            sample: the newest one.

        Returns:
            The other form, where the motor goes over to it.
        """
        if self._open is None:
            return None
        newest_v = abs(float(sample.voltage_v[0]))
        self._largest_v = max(self._largest_v, min(newest_v, self._newest_v))
        self._newest_v = newest_v
        place = int(nodes.replay.received[0])
        new_count = max(0, place - self._place)
        self._place = place
        may_have_changed = self._may_have_changed(fit)
        if may_have_changed:
            self._change_count += min(new_count, 1)  # of those before it is not known
        elif fit.verdict is FitVerdict.OK:
            self._change_count = max(self._change_count - new_count, 0)
        is_doubted = self._is_doubted(fit)
        if is_doubted:
            self._pace.note_doubt(place)
        self._budget.grant(float(sample.interval_s[0]), SHARES * max(new_count, 1))
        is_open = is_doubted or self._has_open_lag
        self.is_idle = not (is_open or may_have_changed) and self._trial is None
        if not is_doubted:
            self._reasons.refusal = ''
        elif not self._reasons.refusal:
            self._reasons.refusal = self._why_not_yet(self._candidates(fit))
        self._keep(nodes, path, new_count, is_doubted=is_doubted)
        if is_doubted and self.kind.source != MEASURED:
            self._look_for_pauses(white_box, sample)
        if self._trial is None and is_open and place >= self._pace.due:
            self._trial = self._begin(white_box, nodes, path, fit, sample.stamp_ns)
        if self._trial is None:
            return None
        has_ended, outcome = self._budget.advance(self._trial.work)
        if not has_ended:
            return None
        assert outcome is not None
        return self._end(outcome, sample.stamp_ns, place, fit)

    def _keep(
        self, nodes: ContextUpdate, path: VoltagePath | None, new_count: int, *, is_doubted: bool
    ) -> None:
        """Remember so many samples that have come, where a trial goes on or is to come."""
        if not is_doubted or self.kind.source != THESIS:
            self._memory = None
        elif self._memory is None:
            self._memory = TrialMemory(NEWEST)
            self._memory.keep(_newest(nodes, path, NEWEST))
        elif new_count > 0:
            self._memory.keep(_newest(nodes, path, new_count))
        if self._trial is not None and new_count > 0:
            self._trial.keep(_newest(nodes, path, new_count))

    def _look_for_pauses(self, white_box: MotorWhiteBox, sample: Sample) -> None:
        """Take a sample in doubt; what pauses tell for the first time begins a trial anew."""
        is_new = self._standstills.add(
            sample.stamp_ns,
            float(sample.interval_s[0]),
            float(sample.torque_nm[0]) / float(white_box.torque_constant),
            float(sample.voltage_v[0]),
        )
        if is_new and self.may_take(FormKind(ROTOR, (VARYING_LOAD,))):
            self._trial = None
            self._budget.pieces = 0
            self._pace.due = self._place

    def finish(self, nodes: ContextUpdate, fit: FitAssessment, stamp_ns: int) -> MotorForm | None:
        """Do what is left of a trial, for no samples will come; see :meth:`step`."""
        if self._trial is None:
            return None
        outcome = self._trial.finish(self._budget)
        if outcome is None:
            return None
        place = int(nodes.replay.received[0])
        return self._end(outcome, stamp_ns, place, fit)

    def _end(
        self, outcome: TrialOutcome, stamp_ns: int, place: int, fit: FitAssessment
    ) -> MotorForm | None:
        """Draw the consequence of a trial: begun in doubt, it counts unless that has gone."""
        trial, self._trial = self._trial, None
        assert trial is not None
        self._budget.pieces = 0
        form = outcome.form
        is_other_lag = outcome.kind is not None and outcome.kind.is_same_but_for_lag(self.kind)
        is_needed = fit.verdict is FitVerdict.MISFIT or is_uneasy(self.kind, fit)
        if form is None or not (is_needed or is_other_lag):
            self._pace.end(place)
            self._reasons.refusal = outcome.reason if self._is_doubted(fit) else ''
            return None
        assert outcome.kind is not None
        if outcome.kind.source != self.kind.source:
            stands = 'the measured speed stands still; ' if self.kind.source == MEASURED else ''
            self._reasons.source = f'{stands}{outcome.reason}'
            self._reasons.effects = outcome.reason if outcome.kind.effects else NOTHING_ADDED
        else:
            self._reasons.effects = outcome.reason
        self.kind = outcome.kind
        self._memory = None
        self._standstills = Standstills()
        self._change_count = 0
        self._reasons.refusal = ''
        trial.hand_over(form, stamp_ns)
        self._place = int(form.context_nodes.replay.received[0])
        self._pace.doubt = 0  # the form counts by itself what it has received
        self._pace.newest_doubt = self._place
        self._pace.end(self._place)
        return form

    def begin_anew(self, nodes: ContextUpdate) -> None:
        """Forget what was remembered for trials, and the trial under way: samples are other ones.

        Args:
            nodes: the rule that has learnt them.
        """
        self._trial = None
        self._memory = None
        self._standstills = Standstills()
        self._budget.pieces = 0
        self._change_count = 0
        self._place = int(nodes.replay.received[0])
        self._pace = TrialPace()
        self.wake()

    def wake(self) -> None:
        """Take note that the fit was tested: what was idle goes on."""
        self.is_idle = self._open is None

    def _may_have_changed(self, fit: FitAssessment) -> bool:
        """Tell whether a rotor looks like one that has changed: its next fit may explain the data.

        So does a load that has come. Where that goes on for the samples of a trial, other forms are
        tried.
        """
        likeliest = fit.suspects[0].effect if fit.suspects else ''
        if fit.verdict is FitVerdict.MISFIT:
            return self.kind.source == ROTOR and likeliest == CHANGE
        return self.kind.source == ROTOR and likeliest == LOAD and is_uneasy(self.kind, fit)

    def _is_doubted(self, fit: FitAssessment) -> bool:
        likeliest = fit.suspects[0].effect if fit.suspects else ''
        if self._may_have_changed(fit):
            return self._change_count >= NEWEST
        if fit.verdict is FitVerdict.MISFIT:
            return True
        is_late = self.kind.source == ROTOR and likeliest in LATE_SIGNS and self.kind.lag is None
        return is_uneasy(self.kind, fit) and (likeliest in (ROTOR, COASTING) or is_late)

    @property
    def _has_open_lag(self) -> bool:
        """Whether a lag was found of which order or kind is open."""
        return self.kind.lag is not None and bool(self.kind.lag.rivals)

    def _candidates(
        self, fit: FitAssessment, *, has_no_speed: bool = False
    ) -> tuple[FormKind, ...]:
        """Return the forms to try; see :meth:`FormCandidates.instead`."""
        assert self._open is not None
        candidates = FormCandidates(self.kind, self._open, self._standstills.line)
        is_doubted = self._is_doubted(fit)
        return candidates.instead(fit, is_doubted=is_doubted, has_no_speed=has_no_speed)

    def _begin(
        self,
        white_box: MotorWhiteBox,
        nodes: ContextUpdate,
        path: VoltagePath | None,
        fit: FitAssessment,
        stamp_ns: int,
    ) -> FormTrial | None:
        """Begin a trial on what is remembered, unless the voltage has hardly moved."""
        assert self._open is not None
        is_measured = self.kind.source == MEASURED
        content = _newest(nodes, path, NEWEST)
        own_content = _newest(nodes, None, NEWEST)
        has_no_speed = is_measured and stands_still(white_box, nodes.theta, own_content)
        candidates = self._candidates(fit, has_no_speed=has_no_speed)
        if not candidates:
            self._pace.postpone(self._place)
            self._reasons.refusal = ''
            return None
        if self._memory is not None:
            content = self._memory.content()
            own_content = content if path is None else path.driven(content)
        if not can_tell(white_box, content, self._largest_v):
            self._pace.postpone(self._place)
            self._reasons.refusal = (
                f'{self.kind.in_words} does not explain the data, but the voltage has hardly '
                f'moved: {candidates[0].in_words} cannot be told'
            )
            return None
        self._pace.begin(self._place)
        if self._is_doubted(fit):
            names = ', '.join(kind.in_words for kind in candidates)
            self._reasons.refusal = (
                f'{self.kind.in_words} does not explain the data; on trial: {names}'
            )
        before_a = residual_a(white_box, nodes, own_content)
        start = TrialStart(
            self.kind,
            candidates,
            len(white_box.parameters),
            self._pace.trials,
            content,
            stamp_ns,
            before_a,
            self._standstills.line,
        )
        return FormTrial(start, self._open)

    def _why_not_yet(self, candidates: tuple[FormKind, ...]) -> str:
        """Say that another form is still to be tried."""
        if not candidates:
            return ''
        return (
            f'{self.kind.in_words} does not explain the data, and too few samples have come to try '
            f'{candidates[0].in_words}'
        )

    def state(self, place: int) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything, as plain values and arrays; places count back from the newest one."""
        plain = {
            'source': self.kind.source,
            'effects': list(self.kind.effects),
            'dead_zone_v': self.kind.dead_zone_v,
            'current_lag': None if self.kind.lag is None else self.kind.lag.state(),
            'reason': self._reasons.source,
            'effects_reason': self._reasons.effects,
            'refusal': self._reasons.refusal,
            'is_open': self.is_open,
            'has_reading': self._open is not None and MEASURED in self._open.sources,
            'due': self._pace.due - place,
            'wait': self._pace.wait,
            'trials': self._pace.trials,
            'doubt': self._pace.doubt - place,
            'newest_doubt': self._pace.newest_doubt - place,
            'credit': self._budget.credit,
            'seen': self._place - place,
            'is_idle': self.is_idle,
            'change_count': self._change_count,
            'largest_v': self._largest_v,
            'newest_v': self._newest_v,
        }
        plain['standstills'], arrays = self._standstills.state()
        if self._memory is not None:
            plain['memory'], memory_arrays = self._memory.state()
            arrays |= memory_arrays
        if self._trial is not None:
            plain['trial'], trial_arrays = self._trial.state(self._budget.pieces)
            arrays |= trial_arrays
        return plain, arrays

    def restore(
        self,
        plain: Mapping[str, Any],
        arrays: Mapping[str, Array],
        white_box: MotorWhiteBox,
        place: int,
    ) -> None:
        """Take back what :meth:`state` gave; what is settled stays as it is settled now.

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
        reasons.append(plain.get('effects_reason', self._reasons.effects))  # not of early releases
        if not all(isinstance(r, str) and r == printable(r, LONGEST_REASON) for r in reasons):
            raise CheckpointError('speed.reason is none that could have been given')
        due = whole(plain, 'due', -MOST, MOST)
        wait = whole(plain, 'wait', FEWEST, LONGEST_WAIT)
        trials = whole(plain, 'trials')
        was_open = flag(plain, 'is_open')
        if entry(plain, 'source') not in (THESIS, ROTOR, MEASURED):
            raise CheckpointError('speed.source is none of those that there are')
        if not (self.is_open and was_open):
            return
        self._budget = WorkBudget.restored(plain)
        self._trial = None
        self._reasons = Reasons(source=reasons[0], refusal=reasons[1], effects=reasons[2])
        doubt = whole(plain, 'doubt', -MOST, MOST) if 'doubt' in plain else -place
        newest_doubt = -place
        if 'newest_doubt' in plain:  # not in files of early releases
            newest_doubt = whole(plain, 'newest_doubt', -MOST, MOST)
        self._pace = TrialPace(place + due, wait, trials, place + doubt, place + newest_doubt)
        self._place = place
        if 'seen' in plain:  # not in files of early releases
            self._place += whole(plain, 'seen', -MOST, MOST_AHEAD)
            self.is_idle = flag(plain, 'is_idle') and 'trial' not in plain
        self._change_count = 0
        if 'change_count' in plain:  # not in files of early releases
            self._change_count = whole(plain, 'change_count')
        self._newest_v = self._largest_v = 0.0
        if 'largest_v' in plain:  # not in files of early releases
            self._largest_v = number(plain, 'largest_v', 0.0, LARGEST_SIGNAL)
            self._newest_v = number(plain, 'newest_v', 0.0, LARGEST_SIGNAL)
        self._memory = None
        if 'memory' in plain:
            self._memory = TrialMemory.restored(group(plain, 'memory'), arrays, NEWEST)
        self._standstills = Standstills()
        if 'standstills' in plain:  # not in files of early releases
            self._standstills = Standstills.restored(group(plain, 'standstills'), arrays)
        trial = group(plain, 'trial') if 'trial' in plain else {}
        assert self._open is not None
        is_stated = COASTING not in self._open.effects and _tries(trial, COASTING)
        if trial.get('order') == ORDER and not is_stated:  # else of an early release
            self._trial = FormTrial.restored(
                trial,
                arrays,
                white_box,
                self.kind,
                trials,
                self._open,
                self._budget,
            )


def _newest(nodes: ContextUpdate, path: VoltagePath | None, most: int) -> Array:
    """Return the newest samples of a rule, shape (signal, 1, n), with commands where there are any.

    Args:
        nodes: the rule.
        path: makes of commands its voltages; None: they are the same.
        most: how many samples, where there are as many.
    """
    replay = nodes.replay
    samples = replay.newest(min(replay.stored(0), replay.capacity, most)).copy()
    return samples if path is None else path.commanded(samples)


def _tries(trial: Mapping[str, Any], effect: str) -> bool:
    """Tell whether a saved trial has an effect among its candidates."""
    candidates = trial.get('candidates')
    return isinstance(candidates, list) and any(
        isinstance(one, list) and effect in one for one in candidates
    )
