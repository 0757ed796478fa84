"""The rule for one motor whose speed is measured: exact as long as the data bear it out.

Two rules see every sample. The recursive one takes the measured speed for exact. The other one
takes it for an output of the whole motor, with noise and lag. It is fitted only where the first
one leaves a residual that is not white. It is believed where it explains both outputs and the
current is clearly likelier with its speed than with the measured one at the same values
(docs/METHOD.md, Measured speed).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings, unsettled
from gray_box_observer.context_nodes.measured_speed.exact_speed import (
    exact_residual,
    whiteness,
)
from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.context_nodes.measured_speed.mechanics import (
    DEFAULT_MECHANICS,
    Mechanics,
)
from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.measured_speed.output_update import OutputUpdate
from gray_box_observer.context_nodes.measured_speed.published_mechanics import PublishedMechanics
from gray_box_observer.context_nodes.measured_speed.speed_comparison import SpeedComparison
from gray_box_observer.context_nodes.measured_speed.whole_motor_samples import (
    as_of_motor,
    remembering,
)
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.recursive.estimator import RecursiveEstimator
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.negligible import SIGMAS, voltage_shares
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.context_nodes.rotor.window_schedule import WINDOW
from gray_box_observer.context_nodes.update_rule import ContextUpdate, learn_at_once
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    MOST,
    ArrayRule,
    check_arrays,
    flag,
    group,
    number,
    whole,
)
from gray_box_observer.samples.order_statistics import distinct
from gray_box_observer.samples.replay_buffer import (
    SPEED,
    ReplayBuffer,
    check_signals,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

COLOURED = 3.0
"""Whiteness of the recursive rule's residual from which the other rule is asked; white noise of
1,000 samples passes 2.2 once in 10,000."""

RAREST = 32768
"""Samples, at most, after which the lag is asked for though the residual is white: first with the
first samples, then each time they have doubled."""

FULL = 1024
"""Samples that tell for good that the whole motor does not explain them: then it is not asked for
twice as many, and for twice as many again each time, up to RAREST. Nor is it asked for as long as
the search has taken, after the next failure for twice as long, and so on."""

FEWEST_ASKED = 512
"""Samples from which it is an answer, too, that the whole motor does not explain them, or that the
noise of their speed is not clearly noise: of fewer the next fit may tell more."""

MOST_FAILURES = 3
"""Windows in a row that the whole motor does not explain before it is given up; one, where it was
believed for less than FULL samples."""

FEWEST_LEVELS = 3
"""Levels that the readings of a speed have met, from which fewer than FULL samples are asked. A few
counts of an encoder are explained as well by a motor whose R is a fifth smaller. Counts over
intervals that differ are as many levels, and are asked."""

STILL = 1e-6
"""Range of the speed in rad/s in which a rotor stands still, or its sensor does."""

_CHANGED = np.ones(1, dtype=bool)
_UNCHANGED = np.zeros(1, dtype=bool)
_PREFIX = 'outputs.'
_SAMPLES = 'measured_speed.samples'
_SHARES = 'measured_speed.shares'


def can_be_output(white_box: MotorWhiteBox) -> bool:
    """Tell whether the speed of a motor can be fitted as an output: speed measured, Kb known."""
    constant = white_box.known.get('back_emf_constant', 0.0)
    return bool(white_box.speed_measured and np.ndim(constant) == 0 and constant > 0.0)


class MeasuredSpeedUpdate:
    """Context nodes of one motor whose measured speed may be noisy or late.

    Args:
        white_box: the physics of one motor; see :func:`can_be_output`.
        initial: shape (1, parameter): where to start, SI units.
        seed: unused; every rule takes one.
        rules: settings of the recursive rule.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (1, parameter): how well the initial values are known; 0:
            nothing is stated.
        mechanics: the rotor's parameters to publish, with what is known of them beforehand; None:
            none, and the whole motor is fitted only where the speed gives a reason.
        finds_lag: whether a lag of the current sensor is looked for.
    """

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        seed: int,
        rules: RecursiveSettings,
        verdict_rules: VerdictSettings,
        initial_relative_std: Array,
        mechanics: Mechanics | None = None,
        *,
        finds_lag: bool = True,
    ) -> None:
        self._white_box = white_box
        self._mechanics = mechanics
        self._finds_lag = finds_lag
        rotor = mechanics or DEFAULT_MECHANICS
        self._exact = RecursiveEstimator(
            white_box, initial, seed, rules, verdict_rules, initial_relative_std
        )
        whole_box = MotorWhiteBox(
            (*white_box.context_nodes, *rotor.nodes),
            white_box.torque_constant,
            {**white_box.known, **rotor.known_values, **rotor.known_parts},
        )
        self._outputs = OutputUpdate(
            whole_box,
            np.concatenate([initial, [rotor.initial]], axis=1),
            rules,
            verdict_rules,
            np.concatenate([initial_relative_std, [rotor.initial_relative_std]], axis=1),
            finds_lag=finds_lag,
        )
        self.published_mechanics = PublishedMechanics(white_box, mechanics)
        self._comparison = SpeedComparison(white_box, self._exact, self._outputs)
        self._samples = ReplayBuffer(1, 1, with_moves=True)
        self._shares = np.zeros((2, len(white_box.context_nodes)))
        self._nodes = slice(0, len(white_box.context_nodes))
        self._is_noisy = False
        self._is_asked = False  # whether noise or lag of the speed were asked for, with an answer
        self._failures = 0
        self._ask_at = self._rest_until = 0
        self._noisy_from = 0  # place before the first sample whose speed was found noisy
        self._change_flags = np.zeros(1, dtype=bool)
        self._asked_fit: OutputFit | None = None
        self._late_instant: LateInstant | None = None  # of that fit
        self._current_lag_s = self._smoothing_weight = 0.0  # of the samples that are remembered
        self._has_noisy_voltage = False  # likewise

    @property
    def is_noisy(self) -> bool:
        """Whether the measured speed is taken for an output with noise and lag."""
        return self._is_noisy

    @property
    def is_asked(self) -> bool:
        """Whether it was asked if the speed is noisy or late, and that was answered."""
        return self._is_asked

    @property
    def current_lag_s(self) -> float:
        """Lag of the current sensor in s, where that is believed; 0: it does not lag."""
        return self._current_lag_s if self._is_noisy else 0.0

    @property
    def smoothing_weight(self) -> float:
        """Weight of the newest value in the moving average that the current is; 0: it is none."""
        return self._smoothing_weight if self._is_noisy else 0.0

    @property
    def knows_voltage_noise(self) -> bool:
        """Whether what noise of the voltage does was taken off the values."""
        return self._is_noisy and self._has_noisy_voltage

    def late_instant(self) -> LateInstant | None:
        """Return what a voltage late by a part of an interval does to the newest fit, or None.

        None where that fit explains nothing, or has a lag of the current.
        """
        fit = self._outputs.output_fit
        if fit is not self._asked_fit:
            self._asked_fit = fit
            is_usable = fit is not None and fit.current_lag_s <= 0.0 and fit.explains
            self._late_instant = LateInstant.from_fit(fit) if fit and is_usable else None
        return self._late_instant

    @property
    def _is_unexplained(self) -> bool:
        """Whether the fit of both outputs does not explain the newest samples."""
        return self._failures > 0 or self._outputs.is_in_doubt

    @property
    def verdict_rules(self) -> VerdictSettings:
        """When a parameter counts as identified; may be changed at any time."""
        return self._exact.verdict_rules

    @verdict_rules.setter
    def verdict_rules(self, rules: VerdictSettings) -> None:
        self._exact.verdict_rules = self._outputs.verdict_rules = rules

    @property
    def replay(self) -> ReplayBuffer:
        """The samples remembered; with the speed of the whole motor where that is believed."""
        return self._samples if self._is_noisy else self._exact.replay

    @replay.setter
    def replay(self, replay: ReplayBuffer) -> None:
        raise AttributeError('the samples are those of the rule that is believed')

    def speed_readings(self, count: int) -> Array | None:
        """Return readings of the speed at the newest samples of :attr:`replay`, shape (count,).

        Where they are remembered no more, the speed of the whole motor. None where that is not
        believed: the samples hold the readings.
        """
        if not self._is_noisy:
            return None
        speed: Array = self._samples.newest(count)[SPEED, 0].copy()
        raw = self._outputs.replay
        later_count = raw.received_of(0) - self._samples.received_of(0)
        raw_count = min(later_count + count, raw.stored(0))
        readings = raw.newest(raw_count)[SPEED, 0, : max(raw_count - later_count, 0)]
        speed[count - readings.size :] = readings
        return speed

    @property
    def theta(self) -> Array:
        """Present values, shape (1, parameter)."""
        return self._outputs.theta[:, self._nodes] if self._is_noisy else self._exact.theta

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whether the last sample has changed the estimate, shape (1,)."""
        return self._change_flags

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """What both rules have met, whether speed is taken for noisy, why, and how late it is."""
        counts = self._exact.counters(motor)
        if self._is_noisy:
            counts['motor changes'] = self._outputs.counters()['motor changes']
        counts['speed is noisy or late'] = int(self._is_noisy)
        counts['evidence for that, log-likelihood'] = int(min(self._comparison.evidence, 1e9))
        counts['lag of the speed, us'] = self._lag_us()
        counts['lag of the current, us'] = round(1e6 * self.current_lag_s)
        return counts

    def _lag_us(self) -> int:
        fit = self._outputs.output_fit
        return round(1e6 * fit.lag()[0]) if fit is not None and self._is_noisy else 0

    def present_since(self, motor: int) -> int:
        """Return the place from which the motor is the present one, by the rule that is believed.

        A speed that is doubted makes another motor of it: the estimate is of other samples.
        """
        if not self._is_noisy:
            return self._exact.present_since(motor)
        return max(self._noisy_from, self._outputs.present_since(motor))

    def is_drifting(self, motor: int) -> bool:
        """Tell whether the motor is known to drift; of an output with noise that is not asked."""
        return not self._is_noisy and self._exact.is_drifting(motor)

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return the voltage shares per unit of parameter, and their 3-sigma bound."""
        if not self._is_noisy:
            return self._exact.voltage_shares(motor)
        share, reach = self._shares
        return share, reach

    def _measured_shares(self, samples: Array, fit: OutputFit) -> Array:
        """Return the voltage shares and their 3-sigma bound by a fit, shape (2, parameter)."""
        stretch = SampleWindow.of_content(self._white_box, samples[:, None])
        share = voltage_shares(self._white_box, stretch)[0]
        covariance = np.linalg.pinv(fit.fit.information, rcond=1e-12, hermitian=True)
        std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) * fit.fit.theta
        return np.stack([share, SIGMAS * std[self._nodes] * share])

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; what was learnt stays."""
        self._exact.freeze(is_frozen)
        self._outputs.freeze(is_frozen)

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts."""
        if not self._is_noisy:
            return self._exact.estimate(selection)
        both = self._outputs.estimate()
        value = both.value[:, self._nodes]
        covariance = both.covariance[:, self._nodes, self._nodes]
        share, reach = self.voltage_shares(0)
        most = np.where(share > 0.0, value[0] * share + reach, np.inf)[None]
        parameters = self._white_box.parameters
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        is_frozen = self._outputs.is_frozen
        verdicts = self.verdict_rules.judge(parameters, value, std, is_frozen=is_frozen, most=most)
        if self._is_unexplained:
            verdicts = tuple(tuple(map(unsettled, own)) for own in verdicts)
        return Estimate(both.stamp_ns, parameters, value, covariance, verdicts)

    def with_mechanics(self, estimate: Estimate, *, is_believed: bool) -> Estimate:
        """Add the rotor's parameters to an estimate of the electrical ones, as far as one may.

        Args:
            estimate: of this motor, as far as it may be believed.
            is_believed: whether its voltage balance explains the data.
        """
        return self.published_mechanics.added_to(
            estimate,
            self._outputs.estimate(),
            self.verdict_rules,
            is_believed=is_believed,
            is_unexplained=self._is_unexplained,
        )

    def learn(self, sample: Sample) -> bool:
        """Take one sample by both rules; tell whether the estimate has changed."""
        has_changed = self._exact.learn(sample)
        self._outputs.remember(sample)
        if self._outputs.is_due:
            self._ask()
        return self._went_on(self._outputs.advance, has_changed=has_changed)

    def learn_remembered(self, content: Array, sample: Sample, *, asks_speed: bool) -> Pieces[None]:
        """Learn samples of the past; nothing else may have been learnt before.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            sample: the newest of them.
            asks_speed: whether to ask now if the speed is noisy or late, by a fit of both outputs.
        """
        learn_at_once(self._exact, content, sample)
        self._outputs.begin_with(content, sample.stamp_ns)
        if asks_speed and self._is_worth_asking(self._outputs.unfitted):
            self._outputs.begin_fit()
            yield from self._outputs.work_off()
            self._went_on(self._outputs.complete, has_changed=True)

    def finish(self) -> bool:
        """Do what is left of a fit of both outputs, for no samples will come.

        Where its results are made known, what has come since is fitted too.

        Returns:
            Whether the estimate has changed.
        """
        has_changed = self._went_on(self._outputs.complete, has_changed=False)
        if (self._is_noisy or self._mechanics is not None) and self._outputs.has_news:
            self._outputs.begin_fit()
            has_changed |= self._went_on(self._outputs.complete, has_changed=False)
        return has_changed

    def _went_on(self, go_on: Callable[[], bool | None], *, has_changed: bool) -> bool:
        """Go on with the fit of both outputs; tell whether the estimate has changed.

        Args:
            go_on: goes on with it.
            has_changed: whether the recursive rule has changed its own.
        """
        before = (self._is_noisy, self._is_unexplained)
        fits = self._outputs.counters()
        has_fitted = self._has_fitted(go_on)
        if self._is_noisy or before[0]:
            has_changed = has_fitted or (self._is_noisy, self._is_unexplained) != before
        if self._mechanics is not None:
            has_changed |= self._outputs.counters() != fits or self._is_unexplained != before[1]
        self._change_flags = _CHANGED if has_changed else _UNCHANGED
        return has_changed

    def _ask(self) -> None:
        """Begin to fit both outputs where there is reason to."""
        if self._is_noisy or self._is_worth_asking(self._outputs.unfitted):
            self._outputs.begin_fit()
        else:
            self._outputs.postpone()

    def _has_fitted(self, go_on: Callable[[], bool | None]) -> bool:
        """Go on with the fit of both outputs; tell whether it has ended and is believed."""
        fit_window = self._outputs.fitting
        missed_count = self._outputs.windows_without_fit
        has_changed = go_on()
        is_missed = self._outputs.windows_without_fit > missed_count
        if fit_window is None or not (
            has_changed or is_missed
        ):  # a voltage that is held tells nothing
            return False
        place, samples = fit_window
        fit = self._outputs.output_fit
        count = samples.shape[1]
        self._is_asked |= count >= FEWEST_ASKED or (fit is not None and fit.shows_exact_speed)
        if fit is None or not (fit.explains or self._comparison.is_nearly_late(fit)):
            self._failures += 1
            self.published_mechanics.note_failure()
            if fit is not None and self._is_noisy:
                newest = samples[:, -fit.window.count :]
                self._comparison.compare(newest, fit, is_noisy=True)
                self._is_noisy = not self._comparison.is_contradicted(newest, fit)
            is_full = self._samples.stored(0) >= FULL  # few samples may mislead
            self._is_noisy &= self._failures < (MOST_FAILURES if is_full else 1)
            now = int(self._outputs.replay.received[0])
            rest = FULL << min(self._failures, 8) if count >= FULL else count
            rest = max(rest, 2 * self._failures * (now - place))
            self._rest_until = now + min(rest, RAREST)
            return False
        self._failures = 0
        samples = samples[:, -fit.window.count :]  # the newest alone may have been fitted
        if fit.explains:
            self.published_mechanics.note_fit(fit, samples.shape[1])
        else:
            self.published_mechanics.note_failure()
        is_late = self._comparison.is_late(fit)
        is_lagging = fit.current_lag_s > 0.0
        has_noisy_voltage = fit.explains and fit.shows_voltage_noise
        if not (self._is_noisy or fit.shows_noise or is_late or is_lagging or has_noisy_voltage):
            return False
        self._comparison.compare(samples, fit, is_noisy=self._is_noisy)
        if self._comparison.is_contradicted(samples, fit) and not has_noisy_voltage:
            self._is_noisy = False
            return False
        is_likelier = (fit.shows_noise or is_lagging) and self._comparison.is_clear(fit)
        if not (self._is_noisy or is_late or is_likelier or has_noisy_voltage):
            return False
        self._has_noisy_voltage = has_noisy_voltage
        self._is_asked = True
        if not self._is_noisy:
            self._is_noisy, self._noisy_from = True, place - samples.shape[1]
        samples = as_of_motor(self._white_box, samples, fit)
        self._current_lag_s = fit.current_lag_s
        self._smoothing_weight = fit.smoothing_weight
        self._samples = remembering(samples, place, self.present_since(motor=0))
        self._shares = self._measured_shares(samples, fit)
        return True

    def _is_worth_asking(self, samples: Array) -> bool:
        """Tell whether the recursive rule leaves a residual, or has not been asked for long."""
        place = int(self._outputs.replay.received[0])
        if place < self._rest_until or np.ptp(samples[SPEED]) <= STILL:
            return False
        if samples.shape[1] < FULL and distinct(samples[SPEED]).size < FEWEST_LEVELS:
            return False
        if self._mechanics is not None:
            return True
        residual = exact_residual(self._white_box, self._exact.theta[0], samples)
        if not whiteness(residual) < COLOURED:
            return True
        if place < self._ask_at and self._is_asked:
            return False
        self._ask_at = place + min(place, RAREST)
        return True

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        plain, arrays = self._exact.state()
        outputs, output_arrays = self._outputs.state()
        mechanics, mechanics_arrays = self.published_mechanics.state()
        newest_place = int(self._outputs.replay.received[0])
        plain['measured_speed'] = {
            'noisy': self._is_noisy,
            'asked': self._is_asked,
            'failures': self._failures,
            **mechanics,
            'evidence': float(np.clip(self._comparison.evidence, -LARGEST, LARGEST)),
            'ask_at': self._ask_at - newest_place,
            'rest_until': self._rest_until - newest_place,
            'noisy_from': self._noisy_from - newest_place,
            'place': int(self._samples.received[0]) - newest_place,
            'current_lag_s': self._current_lag_s,
            'smoothing_weight': self._smoothing_weight,
            'noisy_voltage': self._has_noisy_voltage,
            'outputs': outputs,
        }
        arrays |= {f'{_PREFIX}{name}': array for name, array in output_arrays.items()}
        arrays |= mechanics_arrays
        if self._is_noisy:
            arrays[_SAMPLES] = self._samples.newest(self._samples.stored(0)).copy()
            arrays[_SHARES] = self._shares.copy()
        return plain, arrays

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave; of a motor that was in a group, what there is.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        self._exact.restore(plain, arrays, motor)
        if 'measured_speed' not in plain:
            return
        own = group(plain, 'measured_speed')
        output_arrays = {
            name.removeprefix(_PREFIX): array
            for name, array in arrays.items()
            if name.startswith(_PREFIX)
        }
        self._outputs.restore(dict(group(own, 'outputs')), output_arrays)
        newest_place = int(self._outputs.replay.received[0])
        self._failures = whole(own, 'failures', 0, MOST)
        self.published_mechanics.restore(own, arrays)
        self._comparison.evidence = number(own, 'evidence', -LARGEST, LARGEST)
        self._ask_at = newest_place + whole(own, 'ask_at', -MOST, RAREST)
        self._rest_until = newest_place + whole(own, 'rest_until', -MOST, RAREST)
        self._noisy_from = max(newest_place + whole(own, 'noisy_from', -MOST, 0), 0)
        self._is_noisy = flag(own, 'noisy')
        self._is_asked = flag(own, 'asked') if 'asked' in own else self._is_noisy
        self._current_lag_s = self._smoothing_weight = 0.0
        if self._finds_lag and 'current_lag_s' in own:  # not in files of early releases
            self._current_lag_s = number(own, 'current_lag_s', 0.0, LARGEST)
            self._smoothing_weight = number(own, 'smoothing_weight', 0.0, 1.0)
        self._has_noisy_voltage = 'noisy_voltage' in own and flag(own, 'noisy_voltage')
        if not self._is_noisy:
            return
        check_signals(_SAMPLES, arrays.get(_SAMPLES), longest=WINDOW)
        check_arrays(arrays, {_SHARES: ArrayRule(self._shares.shape, 0.0, endless=True)})
        self._shares = arrays[_SHARES]
        samples = arrays[_SAMPLES][:, 0]
        place = newest_place + whole(own, 'place', samples.shape[1] - newest_place, 0)
        self._samples = remembering(samples, place, self.present_since(motor=0))


def published_known_parts(nodes: ContextUpdate, white_box: MotorWhiteBox) -> Array:
    """Return what is known of every published parameter beside its estimate, shape (parameter,).

    Args:
        nodes: the rule that has learnt one motor, perhaps with others.
        white_box: of the motor.
    """
    if isinstance(nodes, MeasuredSpeedUpdate):
        return nodes.published_mechanics.known_parts
    return white_box.known_parts


def speed_readings(nodes: ContextUpdate, count: int) -> Array | None:
    """Return readings of the speed at the newest samples of a rule, shape (count,).

    None where the samples themselves hold them, or there are none.

    Args:
        nodes: the rule that has learnt one motor, perhaps with others.
        count: how many samples.
    """
    return nodes.speed_readings(count) if isinstance(nodes, MeasuredSpeedUpdate) else None
