"""The rule for a motor with a rotor whose speed is a hidden state.

The free run of the current is fitted to a window of samples as soon as there are a few, again
with half as many more each, and from a full window on to one window after another. What a window
has told is kept as a Gaussian of the parameters' logarithms and joined with what the next one
tells: windows share no sample, so that nothing is counted twice. Where a window contradicts what
was known, the motor has changed, and that is forgotten (docs/METHOD.md, The whole motor).

A fit is done piece by piece at the samples that follow (:mod:`pieces`). Until its end the estimate
before stays; nothing that it reads changes meanwhile. A checkpoint holds the samples of a fit under
way and how many pieces of it were done, and these are done again where it is restored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import (
    Estimate,
    VerdictSettings,
    bounded,
    spread_of_values,
)
from gray_box_observer.context_nodes.pieces import (
    FINISHED,
    MOST_PIECES,
    Pieces,
    WorkBudget,
    completed_within,
)
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.normal_equations import definite, difference_noise
from gray_box_observer.context_nodes.rotor.effect_shares import largest_excess, voltage_shares
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.natural_scale import shares_of_scale
from gray_box_observer.context_nodes.rotor.weak_start import weak_starts
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window
from gray_box_observer.context_nodes.update_rule import check_parameters
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.safe_io.saved_state import (
    LATEST_NS,
    MOST,
    ArrayRule,
    check_arrays,
    check_covariance,
    flag,
    group,
    whole,
)
from gray_box_observer.samples.replay_buffer import VOLTAGE, ReplayBuffer, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

FIRST_FIT = 128
"""Samples of the first fit; the next ones come with half as many more each, first a quarter."""

FEW = 512
"""Samples up to which a fit costs so little that it comes more often."""

STILL = 32
"""Samples after which a voltage that was held is looked at again."""

WINDOW = 2048
"""Samples of a full window."""

AGAIN = 1024
"""Samples between two fits from then on."""

NEWS = 32
"""Samples since the last fit, at least, that are worth another one at the end of a recording."""

LONGEST_WAIT = 4096
"""The same at last, of a motor that nothing fits."""

VAGUE = 5.0
"""Standard deviation of the logarithm of a parameter of which nothing is stated."""

MEMORY = 0.98
"""Share of what is known that a full window leaves: a motor is never quite the same."""

SHARP = 0.3
"""Standard deviation of a logarithm up to which it is near enough to Gaussian to be remembered."""

FEWEST_MOVES = 3
"""Moves of the voltage from which a motor is told: of a step or two a search may end at another
motor that fits as well."""

SEARCHED = 1024
"""Newest samples that a start is looked for in."""

POOR = 1.5
"""Noise of a fit, over that of second differences, from which another start is looked for."""

HOPELESS = 4.5
"""The same from which the motor is called a misfit, and more samples are not asked."""

HELD = 0.01
"""Range of the voltage, as a share of its largest value, in which it is held: a rotor that has
settled tells its level alone, which says nothing of any parameter."""


@dataclass(frozen=True, slots=True)
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
        speed_measured: whether speed is remembered, for a rule that fits it too.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
        *,
        speed_measured: bool = False,
    ) -> None:
        if not white_box.has_rotor or initial.shape[0] != 1:
            raise ConfigurationError('the rotor rule is for one motor whose inertia is unknown')
        self._white_box = white_box
        self._rules = rules or RecursiveSettings()
        self.verdict_rules = verdict_rules or VerdictSettings()
        self._lower, self._upper = bounds(white_box.parameters)
        theta = np.clip(np.asarray(initial, dtype=float)[0], self._lower, self._upper)
        stated_std = (
            np.zeros_like(theta) if initial_relative_std is None else initial_relative_std[0]
        )
        self._is_stated = stated_std > 0.0
        std = np.where(self._is_stated, stated_std, VAGUE)
        self._data_sheet = LogPrior(np.log(theta), np.diag(std**-2.0))
        self.replay = ReplayBuffer(
            1, max(self._rules.replay_capacity, WINDOW), speed_measured=speed_measured
        )
        self._memory: LogPrior | None = None
        self._logarithms = np.log(theta)
        self._covariance = np.diag(std**2)
        self._share = np.zeros_like(theta)
        self._reach = np.zeros_like(theta)
        self._noise_a = 0.0
        self._place = 0  # of the newest sample
        self._mark = 0  # place before the first sample of the window
        self._due = FIRST_FIT
        self._begun_at = 0  # place of the newest sample of the newest fit
        self._wait = AGAIN
        self._is_settled = False
        self._has_rivals = True  # other ends that explain the samples as well
        self._counts = {'motor changes': 0, 'fits': 0, 'windows without fit': 0}
        self._stamp_ns = 0
        self._is_frozen = False
        self._resumes = False
        self._budget = WorkBudget()
        self._fit_task: _Fitting | None = None

    @property
    def theta(self) -> Array:
        """Present values, shape (1, parameter)."""
        result: Array = np.exp(self._logarithms)[None].clip(self._lower, self._upper)
        return result

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimate the last sample has changed: that of the one motor there is."""
        return np.ones(1, dtype=bool)

    @property
    def noise_a(self) -> float:
        """Standard deviation of the current's noise; 0 before the first fit."""
        return self._noise_a

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """Fits, windows that no fit was found for, and changes of the motor."""
        return dict(self._counts)

    @property
    def windows_without_fit(self) -> int:
        """Windows that no fit was found for."""
        return self._counts['windows without fit']

    def is_drifting(self, motor: int) -> bool:
        """Tell whether the motor is known to drift: this rule never asks."""
        return False

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return the voltage shares per unit of parameter, and their 3-sigma bound."""
        return self._share, self._reach

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; a new signal history follows what comes while frozen."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen, self._resumes = is_frozen, not is_frozen

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts."""
        theta = self.theta
        covariance = self._covariance[None] * theta[:, :, None] * theta[:, None, :]
        covariance = spread_of_values(theta, 0.5 * (covariance + covariance.swapaxes(1, 2)))
        covariance = definite(bounded(theta, covariance), theta)
        std = np.sqrt(covariance.diagonal(0, 1, 2))
        parameters = self._white_box.parameters
        most = np.where(self._share > 0.0, theta * self._share + self._reach, np.inf)
        verdicts = self.verdict_rules.judge(
            parameters, theta, std, is_frozen=self._is_frozen, most=most
        )
        return Estimate(self._stamp_ns, parameters, theta, covariance, verdicts)

    def learn(self, sample: Sample) -> bool:
        """Take one sample and go on with the fit that is due; tell whether it has ended.

        Then the estimate has changed.
        """
        self.remember(sample)
        if self.is_due:
            self.begin_fit()
        return bool(self.advance())

    def remember(self, sample: Sample) -> None:
        """Take one sample without a fit."""
        self._stamp_ns = sample.stamp_ns
        if self._is_frozen:
            return
        self.replay.append(sample.beginning() if self._resumes else sample)
        self._resumes = False
        self._place += 1
        self._budget.grant(float(sample.interval_s[0]))

    @property
    def is_frozen(self) -> bool:
        """Whether nothing is learnt."""
        return self._is_frozen

    @property
    def is_due(self) -> bool:
        """Whether the samples since the last fit are worth another one."""
        return self._place >= self._due and not self._is_frozen and self._fit_task is None

    @property
    def fitting(self) -> tuple[int, Array] | None:
        """Place of the newest sample of the fit under way and its samples, (signal, n)."""
        return None if self._fit_task is None else (self._fit_task.place, self._fit_task.samples)

    def begin_fit(self) -> None:
        """Begin to fit what is remembered: a window, from where the one before has ended.

        Where a motor is not explained, and more samples than a window's have come, it is the newest
        ones that tell.
        """
        place, remembered_count = self._place, int(self.replay.remembered()[0])
        mark = max(self._mark, place - remembered_count)
        if self._is_settled:
            place = min(place, mark + WINDOW)
        count = min(place - mark, WINDOW)
        samples = self.replay.newest(count, until=np.array([place]))
        self._begin(place, samples[:, 0].copy())

    def _begin(self, place: int, samples: Array) -> None:
        self._begun_at = place
        self._fit_task = _Fitting(place, samples, self._fit(place, samples))

    def advance(self) -> bool | None:
        """Go on with the fit under way; tell whether it has changed the estimate, None: goes on."""
        if self._fit_task is None or self._is_frozen:
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
        self._fit_task, self._budget.pieces = None, 0
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
        new_count, window_count = self._place - self._begun_at, self._place - self._mark
        is_enough = new_count >= NEWS and window_count >= FIRST_FIT
        return is_enough and self._memory is None and not self._is_frozen

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
            self._place = self._begun_at = count
            if count >= self._due:
                samples = self.replay.newest(min(count - self._mark, WINDOW))[:, 0].copy()
                yield from self._fit(count, samples)

    def _fit(self, place: int, samples: Array) -> Pieces[bool]:
        """Fit the samples of a window so far; tell whether that has changed the estimate.

        Nothing of this rule may change before the last piece is done.
        """
        count = samples.shape[1]
        voltage = samples[VOLTAGE, 1:]
        if np.ptp(voltage) <= HELD * np.abs(voltage).max(initial=0.0):
            self._mark = place - 1 if self._is_settled else max(self._mark, place - FIRST_FIT)
            self._due = place + STILL
            return False
        window = self._window(samples)
        fit = None
        if window.spread_a > 0.0:
            fit = yield from self._solvable(window, place)
        if fit is None:
            self._counts['windows without fit'] += 1
            self._schedule(place, count)
            return False
        self._counts['fits'] += 1
        information = fit.information
        if self._memory is not None:
            information = information + self._memory.precision
        shares = shares_of_scale(self._white_box, fit.theta, window)
        weak_precision = np.minimum(VAGUE**-2.0, shares**2)
        self._logarithms = fit.logarithms
        prior = np.where(self._is_stated, np.diagonal(self._data_sheet.precision), weak_precision)
        self._covariance = _inverse(information + np.diag(prior)) + fit.spread
        self._share = voltage_shares(self._white_box, fit.theta, window, fit.runs)
        excess = largest_excess(fit.theta, information, _inverse(information), fit.spread)
        self._reach = np.where(self._share > 0.0, excess, 0.0) * self._share
        if self._is_ambiguous(window):
            self._covariance += SHARP**2 * np.eye(prior.size)
            self._share, self._reach = np.zeros_like(prior), np.zeros_like(prior)
        self._noise_a = fit.noise_a
        self._has_rivals = bool(fit.spread.any())
        if self._is_settled and count >= WINDOW:
            self._remember(_inverse(information + np.diag(weak_precision)) + fit.spread)
            self._mark = place
        self._schedule(place, count)
        return True

    def _solvable(self, window: Window, place: int) -> Pieces[Fit | None]:
        """Fit a window; None too where samples are so absurd that nothing can be solved."""
        try:
            return (yield from self._searched(window, place))
        except np.linalg.LinAlgError:
            return None

    def _window(self, samples: Array) -> Window:
        """Cut samples, shape (signal, n), into signal histories."""
        return Window.from_samples(self._white_box, samples)

    def _fitted(
        self, window: Window, prior: LogPrior, starts: Sequence[Array]
    ) -> Pieces[Fit | None]:
        """Search from some starts for what explains a window."""
        return fit_window(self._white_box, window, prior, starts)

    def _fitted_again(self, window: Window) -> Pieces[Fit | None]:
        """Search from where the motor stands, and elsewhere where that was not the only end."""
        return fit_window(
            self._white_box,
            window,
            self._prior(),
            [self.theta[0]],
            tries_others=self._has_rivals,
        )

    def _is_ambiguous(self, window: Window) -> bool:
        """Tell whether other motors than the one found might explain the samples.

        The voltage has hardly moved, or no rotor shows, so that its back-EMF may hide in any
        resistance.
        """
        if self._memory is None and window.moves < FEWEST_MOVES:
            return True
        place = self._white_box.context_nodes.index('inertia')
        return bool(self._covariance[place, place] > SHARP**2)

    def _remember(self, covariance: Array) -> None:
        """Keep what is known of those parameters that the samples have told of."""
        sharp = np.flatnonzero(np.diagonal(covariance) < SHARP**2)
        precision = np.zeros_like(covariance)
        precision[np.ix_(sharp, sharp)] = MEMORY * _inverse(covariance[np.ix_(sharp, sharp)])
        self._memory = LogPrior(self._logarithms, precision)

    def _schedule(self, place: int, count: int) -> None:
        """Settle when the next fit is due: with half as many more, later where nothing fits."""
        in_vain = not self._is_settled and count >= AGAIN
        self._wait = min(2 * self._wait, LONGEST_WAIT) if in_vain else AGAIN
        more = min(count // (4 if count < FEW else 2), AGAIN)
        if count < WINDOW:
            more = min(more, WINDOW - count)
        self._due = place + (self._wait if in_vain else more)
        if place - self._mark >= WINDOW:  # nothing fits: go on with newer samples
            self._mark = place - WINDOW // 2

    def _prior(self) -> LogPrior:
        return self._data_sheet if self._memory is None else self._data_sheet.joined(self._memory)

    def _searched(self, window: Window, place: int) -> Pieces[Fit | None]:
        """Fit a window from where the motor stands, or from anywhere where that does not fit."""
        fit = None
        if self._is_settled:
            fit = yield from self._fitted_again(window)
            if fit is not None and not self._is_poor(fit) and not self._contradicts(fit):
                return fit
        other = yield from self._searched_anywhere(window)
        if self._is_settled and self._memory is not None and other is not None:
            self._counts['motor changes'] += 1
            self._memory = None
            self.replay.forget(window.current_a.size + self._place - place)
        self._is_settled = other is not None and not self._is_poor(other)
        return other

    def _searched_anywhere(self, window: Window) -> Pieces[Fit | None]:
        """Fit without regard to what was known, from every start there is."""
        newest = window.tail(SEARCHED) if window.current_a.size > SEARCHED else window
        starts = [self.theta[0], *weak_starts(self._white_box, newest)]
        fit = yield from self._fitted(newest, self._data_sheet, starts)
        if fit is None or newest is window or self._is_hopeless(fit):
            return fit
        return (yield from self._fitted(window, self._data_sheet, [fit.theta]))

    def _is_poor(self, fit: Fit) -> bool:
        """Tell whether the residual is larger than the noise."""
        return fit.noise_a > POOR * max(difference_noise(fit.runs.residual_a), fit.least_noise_a)

    def _is_hopeless(self, fit: Fit) -> bool:
        """Tell whether the newest samples alone are so badly explained that more are no help."""
        return fit.noise_a > HOPELESS * max(
            difference_noise(fit.runs.residual_a), fit.least_noise_a
        )

    def _contradicts(self, fit: Fit) -> bool:
        """Tell whether a window says other than what was known before it."""
        if self._memory is None:
            return False
        apart = fit.logarithms - self._memory.mean
        gradient = self._memory.precision @ apart
        chi_square = float(
            apart @ gradient + gradient @ np.linalg.lstsq(fit.information, gradient, rcond=1e-12)[0]
        )
        return not chi_square < self._rules.drift_threshold

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        received_count = self._place
        content = self.replay.content(with_forgotten=True)
        plain = {
            'parameters': [p.name for p in self._white_box.parameters],
            'stamp_ns': self._stamp_ns,
            'mark': self._mark - received_count,
            'due': self._due - received_count,
            'begun': self._begun_at - received_count,
            'wait': self._wait,
            'gone': received_count - content.shape[2],
            'begin': int(self.replay.begin()[0]),
            'settled': self._is_settled,
            'resumes': self._resumes,
            'rivals': self._has_rivals,
            'remembers': self._memory is not None,
            'credit': self._budget.credit,
        }
        memory = self._memory or self._data_sheet
        arrays = {
            'logarithms': self._logarithms.copy(),
            'covariance': self._covariance.copy(),
            'noise': np.array([self._noise_a]),
            'memory_mean': memory.mean.copy(),
            'memory_precision': memory.precision.copy(),
            'share': self._share.copy(),
            'reach': self._reach.copy(),
            'replay': content,
        }
        if self._fit_task is not None:
            plain['fitting'] = {
                'place': self._fit_task.place - received_count,
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
        self.replay.refill(arrays['replay'], dropped_count=plain['gone'], begin=plain['begin'])
        self._place = received_count = int(self.replay.received[0])
        self._mark = max(received_count + plain['mark'], 0)
        self._due = received_count + plain['due']
        self._begun_at = received_count + plain.get('begun', 0)
        self._wait = plain['wait']
        self._stamp_ns = max(self._stamp_ns, plain['stamp_ns'])
        self._is_settled = plain['settled']
        self._resumes = plain['resumes']
        self._logarithms, self._covariance = arrays['logarithms'], arrays['covariance']
        self._noise_a = float(arrays['noise'][0])
        self._share, self._reach = arrays['share'], arrays['reach']
        self._memory = None
        if plain['remembers']:
            self._memory = LogPrior(arrays['memory_mean'], arrays['memory_precision'])
        self._has_rivals = plain.get('rivals', True)
        self._budget = WorkBudget.restored(plain)
        self._fit_task = None
        if 'fitting' in plain:
            self._resume(group(plain, 'fitting'), arrays)

    def _resume(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Do the pieces again of a fit that was under way."""
        check_signals('fitting', arrays.get('fitting'), longest=WINDOW)
        earliest = arrays['fitting'].shape[2] - self._place
        place = self._place + whole(plain, 'place', min(earliest, 0), 0)
        self._begin(place, arrays['fitting'][:, 0])
        assert self._fit_task is not None
        with np.errstate(all='ignore'):
            self._budget.repeat(self._fit_task.work, whole(plain, 'pieces', 0, MOST_PIECES))

    def _check(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Refuse a saved state that could not have been learnt.

        Raises:
            CheckpointError: something is missing, or no state of this rule.
        """
        n = self._logarithms.size
        rules = {
            'logarithms': ArrayRule((n,), -100.0, 100.0),
            'covariance': ArrayRule((n, n)),
            'noise': ArrayRule((1,), 0.0),
            'memory_mean': ArrayRule((n,), -100.0, 100.0),
            'memory_precision': ArrayRule((n, n)),
            'share': ArrayRule((n,), 0.0),
            'reach': ArrayRule((n,), 0.0, endless=True),
        }
        check_arrays(arrays, rules)
        check_covariance('covariance', arrays['covariance'])
        check_covariance('memory_precision', arrays['memory_precision'])
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


def _ended(result: bool) -> Pieces[bool]:
    """Work of which nothing is left but its result."""
    yield from ()
    return result


def _inverse(matrix: Array) -> Array:
    """Inverse of a symmetric matrix in its own units, symmetric again."""
    unit = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    correlations = matrix / unit[:, None] / unit
    result = np.linalg.pinv(0.5 * (correlations + correlations.T), rcond=1e-13, hermitian=True)
    return np.asarray(result / unit[:, None] / unit, dtype=float)
