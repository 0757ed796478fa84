"""The rule for a motor with a rotor whose speed is a hidden state.

The free run of the current is fitted to a window of samples as soon as there are a few, again
with half as many more each, and from a full window on to one window after another
(`window_schedule.py`). What a window tells joins what was known (`window_learner.py`;
docs/METHOD.md, The whole motor).

A fit is done piece by piece at the samples that follow (:mod:`pieces`). Until its end the estimate
before stays; nothing that it reads changes meanwhile. A checkpoint holds the samples of a fit under
way and how many pieces of it were done, and these are done again where it is restored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import (
    COUNTS_AS_KNOWN,
    Estimate,
    Verdict,
    VerdictSettings,
    bounded,
    spread_of_values,
    unsettled,
)
from gray_box_observer.context_nodes.pieces import (
    FINISHED,
    MOST_PIECES,
    Pieces,
    WorkBudget,
    completed_within,
)
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.normal_equations import definite
from gray_box_observer.context_nodes.rotor.loaded_learner import LoadedLearner
from gray_box_observer.context_nodes.rotor.rest import is_at_rest
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.context_nodes.rotor.window_learner import WindowLearner
from gray_box_observer.context_nodes.rotor.window_schedule import (
    AGAIN,
    FEW,
    FIRST_FIT,
    LONGEST_WAIT,
    WINDOW,
    WindowSchedule,
)
from gray_box_observer.context_nodes.update_rule import check_parameters
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.safe_io.saved_state import LATEST_NS, MOST, flag, group, whole
from gray_box_observer.samples.replay_buffer import VOLTAGE, ReplayBuffer, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.samples.sample_merger import SampleMerger
from gray_box_observer.samples.voltage_level import HELD
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox


@dataclass(frozen=True, eq=False)
class _Fitting:
    """A fit under way.

    Attributes:
        place: of its newest sample.
        samples: shape (signal, n).
        work: its pieces; they end with whether the estimate has changed.
    """

    place: int
    samples: Array
    work: Pieces[bool]


class RotorUpdate:
    """Context nodes of one motor with a rotor, learnt window by window.

    Args:
        white_box: the physics, with the inertia among its context nodes.
        initial: shape (1, parameter): where to start, SI units.
        rules: settings; of them the capacity of the memory and the threshold of the change test.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (1, parameter): how well the initial values are known; 0:
            nothing is stated. None: of none of them.
        merges_held: whether fewer samples are kept while the voltage is held. Not where that is
            made of commands, which are remembered sample by sample.
        noise_memory: of the current (:mod:`~gray_box_observer.context_nodes.rotor.noise_memory`).
        replay: remembers motors that are sampled together, and is filled by others; None: one of
            its own.
        motor: its place there.

    Attributes:
        fitted_count: samples of the newest fit; 1 before the first one.
    """

    _learner_type: type[WindowLearner] = WindowLearner

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
        *,
        merges_held: bool = True,
        noise_memory: float = 0.0,
        replay: ReplayBuffer | None = None,
        motor: int = 0,
    ) -> None:
        self._white_box = white_box
        self._motor = motor
        self._one = slice(motor, motor + 1)
        self._rules = rules or RecursiveSettings()
        self.verdict_rules = verdict_rules or VerdictSettings()
        learner_type = self._learner_type
        if white_box.load_varies:
            if learner_type is not WindowLearner:
                raise ConfigurationError('beside a measured speed a load varies as it is')
            learner_type = LoadedLearner
        self._learner = learner_type(
            white_box, initial, initial_relative_std, self._rules.drift_threshold
        )
        self._learner.noise_memory = noise_memory
        speed_measured = self._learner.speed_measured
        self._is_one_of_many = replay is not None
        if replay is None:
            replay = replay_of_rotors(1, self._rules, speed_measured=speed_measured)
        self.replay = replay
        merges = merges_held and not self._learner.speed_measured
        self._merger = SampleMerger() if merges else None
        self._schedule = WindowSchedule()
        self._stamp_ns = 0
        self._is_frozen = False
        self._resumes = False
        self._budget = WorkBudget()
        self._fit_task: _Fitting | None = None
        self.fitted_count = 1

    @property
    def theta(self) -> Array:
        """Present values, shape (1, parameter)."""
        return self._learner.theta[None]

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimate the last sample has changed: that of the one motor there is."""
        return np.ones(1, dtype=bool)

    @property
    def knows_voltage_noise(self) -> bool:
        """Whether the newest fit has taken off what noise of the voltage does."""
        return self._learner.voltage_noise is not NO_NOISE

    @property
    def noise_memory(self) -> float:
        """Memory of the current's noise."""
        return self._learner.noise_memory

    @property
    def noise_a(self) -> float:
        """Standard deviation of the current's noise; 0 before the first fit."""
        return self._learner.noise_a

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """Fits, windows that no fit was found for, and changes of the motor."""
        return dict(self._learner.counts)

    @property
    def windows_without_fit(self) -> int:
        """Windows that no fit was found for."""
        return self._learner.counts['windows without fit']

    def present_since(self, motor: int) -> int:
        """Return the place from which one motor is the present one: that of its last change."""
        return self.replay.begin_of(self._motor)

    def is_drifting(self, motor: int) -> bool:
        """Tell whether the motor is known to drift: this rule never asks."""
        return False

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return the voltage shares per unit of parameter, and their 3-sigma bound."""
        return self._learner.share, self._learner.reach

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; a new signal history follows what comes while frozen."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen = is_frozen
        self._resumes = not is_frozen

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts."""
        theta = self.theta
        covariance = self._learner.covariance[None] * theta[:, :, None] * theta[:, None, :]
        covariance = spread_of_values(theta, 0.5 * (covariance + covariance.swapaxes(1, 2)))
        covariance = definite(bounded(theta, covariance), theta)
        std = np.sqrt(covariance.diagonal(0, 1, 2))
        parameters = self._white_box.parameters
        share, reach = self.voltage_shares(0)
        most = np.where(share > 0.0, theta * share + reach, np.inf)
        verdicts = self.verdict_rules.judge(
            parameters, theta, std, is_frozen=self._is_frozen, most=most
        )
        if self._white_box.load_varies:
            verdicts = (self._as_far_as_loaded(verdicts[0]),)
        return Estimate(self._stamp_ns, parameters, theta, covariance, verdicts)

    def _as_far_as_loaded(self, verdicts: tuple[Verdict, ...]) -> tuple[Verdict, ...]:
        """Return verdicts of a motor whose load varies: of its rotor nothing is known for good.

        Where R is open the load may have taken anything, and what the current does at once, too.
        """
        own_verdicts = dict(zip(self._white_box.context_nodes, verdicts, strict=True))
        resistance = own_verdicts.get('resistance', Verdict.IDENTIFIED)  # one that is stated
        is_open = resistance not in COUNTS_AS_KNOWN
        return tuple(
            unsettled(verdict) if is_open or TERMS[name].state is State.SPEED else verdict
            for name, verdict in own_verdicts.items()
        )

    def learn(self, sample: Sample) -> bool:
        """Take one sample and go on with the fit that is due; tell whether it has ended.

        Then the estimate has changed.
        """
        self.remember(sample)
        if self.is_due:
            self.begin_fit()
        return bool(self.advance())

    def go_on_at(self, place: int, stamp_ns: int, credit: int) -> tuple[bool, int]:
        """Go on with a fit that is due or under way, where others remember the samples.

        Args:
            place: of the newest sample.
            stamp_ns: its stamp.
            credit: work that is granted.

        Returns:
            Whether the estimate has changed, and the credit that is left.
        """
        self.note(place, stamp_ns, credit)
        if self.is_due:
            self.begin_fit()
        has_changed = bool(self.advance())
        return has_changed, self._budget.credit

    def note(self, place: int, stamp_ns: int, credit: int) -> None:
        """Take note of samples that others remember; see :meth:`go_on_at`."""
        self._schedule.place = place
        self._stamp_ns = stamp_ns
        self._budget.credit = credit

    def remember(self, sample: Sample) -> None:
        """Take one sample without a fit."""
        self._stamp_ns = sample.stamp_ns
        if self._is_frozen:
            return
        if self._resumes:
            sample = sample.beginning()
        self._resumes = False
        samples = (sample,) if self._merger is None else self._merger.step(sample)
        for one in samples:
            self.replay.append(one)
        self._schedule.place += len(samples)
        self._budget.grant(float(sample.interval_s[0]))

    @property
    def is_frozen(self) -> bool:
        """Whether nothing is learnt."""
        return self._is_frozen

    @property
    def due(self) -> int:
        """Place of the sample with which the next fit is due."""
        return self._schedule.due

    @property
    def begun_at(self) -> int:
        """Place of the newest sample of the newest fit."""
        return self._schedule.begun_at

    @property
    def credit(self) -> int:
        """Work that is granted and not done."""
        return self._budget.credit

    @property
    def is_due(self) -> bool:
        """Whether the samples since the last fit are worth another one."""
        is_due = self._schedule.place >= self._schedule.due
        return is_due and not self._is_frozen and self._fit_task is None

    @property
    def fitting(self) -> tuple[int, Array] | None:
        """Place of the newest sample of the fit under way and its samples, (signal, n)."""
        return None if self._fit_task is None else (self._fit_task.place, self._fit_task.samples)

    def begin_fit(self) -> None:
        """Begin to fit what is remembered: a window, from where the one before has ended.

        The first window of one of many is short: a search from anywhere takes long.
        """
        remembered_count = int(self.replay.remembered(self._one)[0])
        is_settled = self._learner.is_settled
        most = FEW if self._is_one_of_many and self._schedule.begun_at == 0 else WINDOW
        place, count = self._schedule.next_window(
            remembered_count, is_settled=is_settled, most=most
        )
        samples = self.replay.newest(count, self._one, until=np.array([place]))
        self._begin(place, samples[:, 0].copy())

    def _begin(self, place: int, samples: Array) -> None:
        self._schedule.begun_at = place
        self.fitted_count = samples.shape[1]
        self._fit_task = _Fitting(place, samples, self._fit(place, samples))

    def advance(self) -> bool | None:
        """Go on with the fit under way; tell whether it has changed the estimate, None: goes on."""
        if self._fit_task is None or self._is_frozen or self._budget.credit <= 0:
            return None
        with np.errstate(all='ignore'):  # absurd samples; results are checked
            has_ended, has_changed = self._budget.advance(self._fit_task.work)
        if not has_ended:
            return None
        self._fit_task = None
        return bool(has_changed)

    def work_off(self) -> Pieces[None]:
        """Do the fit under way piece by piece; :meth:`complete` then tells what came of it."""
        task = self._fit_task
        if task is not None:
            result = yield from task.work
            self._fit_task = replace(task, work=_ended(result))

    def complete(self) -> bool:
        """Do what is left of the fit under way, within bounds.

        Returns:
            Whether the estimate has changed.
        """
        if self._fit_task is None or self._is_frozen:
            return False
        with np.errstate(all='ignore'):
            has_changed = completed_within(self._fit_task.work, FINISHED // 2)
        self._fit_task = None
        self._budget.pieces = 0
        return bool(has_changed)

    def finish(self) -> bool:
        """Do what is left of a fit, for no samples will come; before a full window another one.

        Returns:
            Whether the estimate has changed.
        """
        has_changed = self.complete()
        if self.has_news:
            self.begin_fit()
            has_changed |= self.complete()
        return has_changed

    @property
    def has_news(self) -> bool:
        """Whether enough samples have come since the last fit, before the first full window.

        Beside a full window a few samples tell next to nothing, and might seem to tell a change.
        """
        is_before = self._learner.memory is None and not self._is_frozen
        return is_before and self._schedule.has_news

    @property
    def is_sketchy(self) -> bool:
        """Whether the motor is explained, by less than a full window."""
        return self._learner.is_settled and self._learner.memory is None

    def begin_at(self, theta: Array, *, searches_elsewhere: bool = True) -> None:
        """Begin where nearly the same white box has explained the same samples.

        Args:
            theta: shape (1, parameter): there.
            searches_elsewhere: whether the first fit looks for other ends, too.
        """
        self._learner.begin_at(theta[0], searches_elsewhere=searches_elsewhere)

    def recall(self, beliefs: Mapping[str, tuple[float, float]]) -> None:
        """Begin with what the motor has told before any window; its load has to vary.

        Args:
            beliefs: value and relative standard deviation, by context node; others are left out.
        """
        assert isinstance(self._learner, LoadedLearner)
        self._learner.recall(beliefs)

    def learn_remembered(self, content: Array, stamp_ns: int) -> Pieces[None]:
        """Learn samples of the past with few fits; nothing else may have been learnt before.

        What fewer of the same samples have told is where the search begins.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            stamp_ns: of the newest of them.
        """
        self._stamp_ns = stamp_ns
        for count in sorted({min(WINDOW, content.shape[2]), content.shape[2]}):
            self.replay.refill(content[:, :, :count])
            self._schedule.place = self._schedule.begun_at = count
            if count >= self._schedule.due:
                samples = self.replay.newest(min(count - self._schedule.mark, WINDOW))[:, 0].copy()
                yield from self._fit(count, samples)

    def _fit(self, place: int, samples: Array) -> Pieces[bool]:
        """Fit the samples of a window so far; tell whether that has changed the estimate.

        Nothing of this rule may change before the last piece is done.
        """
        count = samples.shape[1]
        schedule = self._schedule
        learner = self._learner
        voltage = samples[VOLTAGE, 1:]
        if np.ptp(voltage) <= HELD * np.abs(voltage).max(initial=0.0) or is_at_rest(samples):
            # a rotor that has settled tells its level alone
            schedule.skip(place, is_settled=learner.is_settled)
            return False
        if learner.memory is not None and count < FIRST_FIT:  # chance would be another motor
            schedule.due = place + FIRST_FIT - count
            return False
        window = learner.window(samples)
        has_fit = yield from learner.learn(window, is_full=count >= WINDOW)
        if learner.is_new_motor:
            self.replay.forget(window.current_a.size + schedule.place - place, self._one)
        if has_fit and learner.is_settled and count >= WINDOW:
            schedule.mark = place
        schedule.plan(place, count, is_settled=learner.is_settled)
        return has_fit

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        content = self.replay.content(self._one, with_forgotten=True)
        plain = {
            'parameters': [p.name for p in self._white_box.parameters],
            'stamp_ns': self._stamp_ns,
            **self._schedule.state(),
            'gone': self._schedule.place - content.shape[2],
            'begin': self.replay.begin_of(self._motor),
            'settled': self._learner.is_settled,
            'resumes': self._resumes,
            'rivals': self._learner.has_rivals,
            'remembers': self._learner.memory is not None,
            'credit': self._budget.credit,
        }
        if self._merger is not None:
            plain['merger'] = self._merger.state()
        arrays = self._learner.arrays() | {'replay': content}
        if self._fit_task is not None:
            plain['fitting'] = {
                'place': self._fit_task.place - self._schedule.place,
                'pieces': self._budget.pieces,
            }
            arrays['fitting'] = self._fit_task.samples[:, None].copy()
        return plain, arrays

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        check_parameters(plain, self._white_box.parameters)
        self._check(plain, arrays)
        self.replay.refill(
            arrays['replay'], self._one, dropped_count=plain['gone'], begin=plain['begin']
        )
        self._schedule = WindowSchedule.restored(plain, self.replay.received_of(self._motor))
        self._stamp_ns = max(self._stamp_ns, plain['stamp_ns'])
        self._resumes = plain['resumes']
        self._learner.restore(plain, arrays)
        self._budget = WorkBudget.restored(plain)
        if self._merger is not None and 'merger' in plain:  # not in files of early releases
            self._merger = SampleMerger.restored(group(plain, 'merger'))
        self._fit_task = None
        if 'fitting' in plain:
            self._resume(group(plain, 'fitting'), arrays)

    def _resume(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Do the pieces again of a fit that was under way."""
        check_signals('fitting', arrays.get('fitting'), longest=WINDOW)
        earliest = arrays['fitting'].shape[2] - self._schedule.place
        place = self._schedule.place + whole(plain, 'place', min(earliest, 0), 0)
        self._begin(place, arrays['fitting'][:, 0])
        assert self._fit_task is not None
        with np.errstate(all='ignore'):
            self._budget.repeat(self._fit_task.work, whole(plain, 'pieces', 0, MOST_PIECES))

    def _check(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Refuse a saved state that could not have been learnt.

        Raises:
            CheckpointError: something is missing, or no state of this rule.
        """
        self._learner.check(arrays)
        check_signals('replay', arrays.get('replay'))
        whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
        dropped_count = whole(plain, 'gone')
        whole(plain, 'mark', -dropped_count - arrays['replay'].shape[2], 0)
        whole(plain, 'due', -MOST, LONGEST_WAIT)
        whole(plain, 'wait', AGAIN, LONGEST_WAIT)
        whole(plain, 'begin', 0, dropped_count + arrays['replay'].shape[2])
        if 'begun' in plain:  # not in files of releases that did not ask
            whole(plain, 'begun', -MOST, 0)
        for name in ('settled', 'resumes', 'remembers'):
            flag(plain, name)
        if 'rivals' in plain:  # not in files of releases that did not remember it
            flag(plain, 'rivals')


def replay_of_rotors(
    motors: int, rules: RecursiveSettings, *, speed_measured: bool = False
) -> ReplayBuffer:
    """Return an empty memory for the samples of rotors."""
    capacity = max(rules.replay_capacity, WINDOW)
    return ReplayBuffer(motors, capacity, speed_measured=speed_measured, with_moves=True)


def _ended(result: bool) -> Pieces[bool]:
    """Work of which nothing is left but its result."""
    yield from ()
    return result
