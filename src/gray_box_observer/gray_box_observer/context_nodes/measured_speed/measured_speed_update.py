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

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings, misfit, unsettled
from gray_box_observer.context_nodes.measured_speed.exact_speed import (
    exact_residual,
    log_likelihood_ratio,
    whiteness,
)
from gray_box_observer.context_nodes.measured_speed.mechanics import (
    DEFAULT_MECHANICS,
    WIDEST,
    Mechanics,
    limited,
    load_spread,
)
from gray_box_observer.context_nodes.measured_speed.output_fit import HOPELESS, OutputFit
from gray_box_observer.context_nodes.measured_speed.output_update import OutputUpdate
from gray_box_observer.context_nodes.measured_speed.whole_motor_samples import (
    remembering,
    with_motor_speed,
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
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import (
    INTERVAL,
    SPEED,
    TORQUE,
    VOLTAGE,
    ReplayBuffer,
    check_signals,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Array, Parameter
from gray_box_observer.white_box.motor import MotorWhiteBox

COLOURED = 3.0
"""Whiteness of the recursive rule's residual from which the other rule is asked; white noise of
1,000 samples passes 2.2 once in 10,000."""

EVIDENCE = 30.0
"""Log-likelihood by which the current must be likelier with the speed of the whole motor, beside
what as many unknowns explain of mere noise."""

LESS_LIKELY, SHARP = 0.05, 0.05
"""Log-likelihood a sample by which the current may be less likely with the speed of the whole motor
than with the measured one: a residual larger by so much. Beyond it the whole motor is believed only
where its lag is known to this share of a sample interval. Else a few samples fit a lag that is not
there, to a tenth of an interval at best; a filter of the sensor is known to a thirtieth."""

LATE, LATE_STDS = 0.1, 5.0
"""Sample intervals, and standard deviations, from which the speed is late: the recursive rule takes
a lag for resistance, and its residual stays white."""

APART = 25.0
"""Squared distance of both rules in their standard deviations from which a lag matters."""

RAREST = 32768
"""Samples, at most, after which the lag is asked for though the residual is white: first with the
first samples, then each time they have doubled."""

FULL = 1024
"""Samples that tell for good that the whole motor does not explain them: then it is not asked for
twice as many, and for twice as many again each time, up to RAREST. Nor is it asked for as long as
the search has taken, after the next failure for twice as long, and so on."""

MOST_FAILURES = 3
"""Windows in a row that the whole motor does not explain before it is given up; one, where it was
believed for less than FULL samples."""

FORGOTTEN, LEAST_SPREAD = 0.7, 1e-3
"""Share of what a varying load may have done that is left after a window whose load is constant,
and the least of it that counts."""

STILL = 1e-6
"""Range of the speed in rad/s in which a rotor stands still, or its sensor does."""

_CHANGED, _UNCHANGED = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
_PREFIX = 'outputs.'
_SAMPLES, _SHARES = 'measured_speed.samples', 'measured_speed.shares'
_SPREAD = 'measured_speed.load_spread'


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
    ) -> None:
        self._white_box = white_box
        self._mechanics = mechanics
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
        )
        self._samples = ReplayBuffer(1, 1)
        self._shares = np.zeros((2, len(white_box.context_nodes)))
        self._nodes = slice(0, len(white_box.context_nodes))
        self._is_noisy = False
        self._failures = 0
        self._explained_count = 0  # samples in the largest window explained; -1: the newest was not
        self._load_spread = np.zeros(len(rotor.nodes))
        self._evidence = 0.0
        self._ask_at = self._rest_until = 0
        self._noisy_from = 0  # place before the first sample whose speed was found noisy
        self._change_flags = np.zeros(1, dtype=bool)

    @property
    def is_noisy(self) -> bool:
        """Whether the measured speed is taken for an output with noise and lag."""
        return self._is_noisy

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
        counts['evidence for that, log-likelihood'] = int(min(self._evidence, 1e9))
        counts['lag of the speed, us'] = self._lag_us()
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

    @property
    def published_parameters(self) -> tuple[Parameter, ...]:
        """Return what :meth:`with_mechanics` publishes."""
        rotor = () if self._mechanics is None else self._mechanics.nodes
        return (*self._white_box.parameters, *(TERMS[name].parameter for name in rotor))

    @property
    def published_known_parts(self) -> Array:
        """What is known of each of them beside its estimate, shape (published parameter,)."""
        if self._mechanics is None:
            return self._white_box.known_parts
        parts = [self._mechanics.known_parts.get(name, 0.0) for name in self._mechanics.nodes]
        return np.concatenate([self._white_box.known_parts, parts])

    def with_mechanics(self, estimate: Estimate, *, is_believed: bool) -> Estimate:
        """Add the rotor's parameters to an estimate of the electrical ones.

        They come from the fit of both outputs. Where that does not explain the data, or the voltage
        balance does not, they are a misfit. The electrical ones stay as they are. Correlations
        between both are left out: L and R are known by far the best.

        Args:
            estimate: of this motor, as far as it may be believed.
            is_believed: whether its voltage balance explains the data.
        """
        if self._mechanics is None:
            return estimate
        both = self._outputs.estimate()
        rotor = slice(self._nodes.stop, None)
        own = Estimate(
            both.stamp_ns,
            both.parameters[rotor],
            both.value[:, rotor],
            both.covariance[:, rotor, rotor],
            (both.verdicts[0][rotor],),
        )
        is_settled = self._explained_count >= FULL
        own = limited(own, self._load_spread, self.verdict_rules, is_settled=is_settled)
        count = len(self.published_parameters)
        covariance = np.zeros((1, count, count))
        covariance[:, self._nodes, self._nodes] = estimate.covariance
        covariance[:, rotor, rotor] = own.covariance
        verdicts = own.verdicts[0]
        if self._is_unexplained:
            verdicts = tuple(map(unsettled, verdicts))
        if not (is_believed and self._explained_count >= 0):
            verdicts = tuple(map(misfit, verdicts))
        return Estimate(
            estimate.stamp_ns,
            self.published_parameters,
            np.concatenate([estimate.value, own.value], axis=1),
            covariance,
            (estimate.verdicts[0] + verdicts,),
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
        before, fits = (self._is_noisy, self._is_unexplained), self._outputs.counters()
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
        fit_window, missed_count = self._outputs.fitting, self._outputs.windows_without_fit
        has_changed = go_on()
        is_missed = self._outputs.windows_without_fit > missed_count
        if fit_window is None or not (
            has_changed or is_missed
        ):  # a voltage that is held tells nothing
            return False
        place, samples = fit_window
        fit = self._outputs.output_fit
        if fit is None or not (fit.explains or self._is_nearly_late(fit)):
            self._failures += 1
            self._explained_count = -1
            if fit is not None and self._is_noisy:
                newest = samples[:, -fit.window.current_a.size :]
                self._compare_speeds(newest, fit)
                self._is_noisy = not self._is_contradicted(newest, fit)
            is_full = self._samples.stored(0) >= FULL  # few samples may mislead
            self._is_noisy &= self._failures < (MOST_FAILURES if is_full else 1)
            count, now = samples.shape[1], int(self._outputs.replay.received[0])
            rest = FULL << min(self._failures, 8) if count >= FULL else count
            rest = max(rest, 2 * self._failures * (now - place))
            self._rest_until = now + min(rest, RAREST)
            return False
        self._failures = 0
        if fit.explains:
            self._take_mechanics(fit, samples.shape[1])
        else:
            self._explained_count = -1
            samples = samples[:, -fit.window.current_a.size :]  # the newest alone were fitted
        is_late = self._is_late(fit)
        if not (self._is_noisy or fit.shows_noise or is_late):
            return False
        self._compare_speeds(samples, fit)
        if self._is_contradicted(samples, fit):
            self._is_noisy = False
            return False
        if not (self._is_noisy or is_late or (fit.shows_noise and self._is_clear(fit))):
            return False
        if not self._is_noisy:
            self._is_noisy, self._noisy_from = True, place - samples.shape[1]
        samples = with_motor_speed(samples, fit)
        self._samples = remembering(samples, place, self.present_since(motor=0))
        self._shares = self._measured_shares(samples, fit)
        return True

    def _take_mechanics(self, fit: OutputFit, count: int) -> None:
        """Note how many samples a fit explains, and what its load leaves of the mechanics."""
        if self._mechanics is None:
            return
        is_explained = fit.explains_rotor
        self._explained_count = max(self._explained_count, count) if is_explained else -1
        now = load_spread(self._mechanics, fit, float(self._white_box.torque_constant))
        self._load_spread = np.maximum(now, FORGOTTEN * self._load_spread)
        self._load_spread[self._load_spread < LEAST_SPREAD] = 0.0

    def _is_worth_asking(self, samples: Array) -> bool:
        """Tell whether the recursive rule leaves a residual, or has not been asked for long."""
        place = int(self._outputs.replay.received[0])
        if place < self._rest_until or np.ptp(samples[SPEED]) <= STILL:
            return False
        if self._mechanics is not None:
            return True
        residual = exact_residual(self._white_box, self._exact.theta[0], samples)
        if not whiteness(residual) < COLOURED:
            return True
        if place < self._ask_at:
            return False
        self._ask_at = place + min(place, RAREST)
        return True

    def _is_late(self, fit: OutputFit) -> bool:
        """Tell whether the speed is late, and that matters to the parameters."""
        interval_s = _interval_s(fit)
        lag_s, std_s = fit.lag()
        if abs(lag_s) < max(LATE * interval_s, LATE_STDS * std_s):
            return False
        exact, outputs = self._exact.estimate(), self._outputs.estimate()
        apart = exact.value[0] / outputs.value[0, self._nodes] - 1.0
        variance = (exact.std[0] / exact.value[0]) ** 2
        variance += (outputs.std[0] / outputs.value[0])[self._nodes] ** 2
        return bool(np.max(apart**2 / variance) > APART)

    def _is_nearly_late(self, fit: OutputFit) -> bool:
        """Tell whether the speed is late by a fit that is not hopeless.

        A filter of the sensor is nearly a lag. What the lag leaves of it colours the residual. The
        recursive rule would take the lag for resistance, and see no fault.
        """
        return fit.is_within(HOPELESS) and fit.lag()[0] > 0.0 and self._is_late(fit)

    def _compare_speeds(self, samples: Array, fit: OutputFit) -> None:
        """Find how much likelier the current is with the speed of the whole motor.

        The measured speed is tried at the values of either rule, and before it is doubted for the
        first time at those that suit it best: that the recursive rule has not settled is no
        evidence.
        """
        self._evidence = min(
            self._evidence_against(theta, samples, fit)
            for theta in (self._exact.theta[0], self._outputs.theta[0, self._nodes])
        )
        if not self._is_noisy and not self._is_contradicted(samples, fit):
            theta = self._refitted(samples)
            self._evidence = min(self._evidence, self._evidence_against(theta, samples, fit))

    def _is_clear(self, fit: OutputFit) -> bool:
        """Tell whether the current is clearly likelier with the speed of the whole motor."""
        return self._evidence > EVIDENCE + 0.5 * fit.unknowns

    def _evidence_against(self, theta: Array, samples: Array, fit: OutputFit) -> float:
        """Return how much likelier the current is by a fit than by the measured speed."""
        residual = exact_residual(self._white_box, theta, samples)
        return log_likelihood_ratio(residual, fit.noise.current_a)

    def _refitted(self, samples: Array) -> Array:
        """Return the values, shape (parameter,), that suit samples best by their measured speed."""
        rule = RecursiveEstimator(self._white_box, self._exact.theta)
        signals = (float(samples[row, -1]) for row in (INTERVAL, VOLTAGE, TORQUE, SPEED))
        learn_at_once(rule, samples[:, None], Sample.of_one_motor(0, *signals))
        theta: Array = rule.theta[0]
        return theta

    def _is_contradicted(self, samples: Array, fit: OutputFit) -> bool:
        """Tell whether the current is clearly less likely with the speed of the whole motor.

        Where the speed is clearly late that is no contradiction: the recursive rule takes the lag
        for resistance, and leaves as little.
        """
        lag_s, std_s = fit.lag()
        interval_s = _interval_s(fit)
        is_clearly_late = abs(lag_s) >= LATE * interval_s and std_s < SHARP * interval_s
        return not is_clearly_late and self._evidence < -LESS_LIKELY * samples.shape[1]

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        plain, arrays = self._exact.state()
        outputs, output_arrays = self._outputs.state()
        newest_place = int(self._outputs.replay.received[0])
        plain['measured_speed'] = {
            'noisy': self._is_noisy,
            'failures': self._failures,
            'explained': self._explained_count,
            'evidence': float(np.clip(self._evidence, -LARGEST, LARGEST)),
            'ask_at': self._ask_at - newest_place,
            'rest_until': self._rest_until - newest_place,
            'noisy_from': self._noisy_from - newest_place,
            'place': int(self._samples.received[0]) - newest_place,
            'outputs': outputs,
        }
        arrays |= {f'{_PREFIX}{name}': array for name, array in output_arrays.items()}
        if self._mechanics is not None:
            arrays[_SPREAD] = self._load_spread.copy()
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
        if self._mechanics is not None:
            self._explained_count = whole(own, 'explained', -1, MOST)
            check_arrays(arrays, {_SPREAD: ArrayRule(self._load_spread.shape, 0.0, WIDEST)})
            self._load_spread = arrays[_SPREAD]
        self._evidence = number(own, 'evidence', -LARGEST, LARGEST)
        self._ask_at = newest_place + whole(own, 'ask_at', -MOST, RAREST)
        self._rest_until = newest_place + whole(own, 'rest_until', -MOST, RAREST)
        self._noisy_from = max(newest_place + whole(own, 'noisy_from', -MOST, 0), 0)
        self._is_noisy = flag(own, 'noisy')
        if not self._is_noisy:
            return
        check_signals(_SAMPLES, arrays.get(_SAMPLES), longest=WINDOW)
        check_arrays(arrays, {_SHARES: ArrayRule(self._shares.shape, 0.0, endless=True)})
        self._shares = arrays[_SHARES]
        samples = arrays[_SAMPLES][:, 0]
        place = newest_place + whole(own, 'place', samples.shape[1] - newest_place, 0)
        self._samples = remembering(samples, place, self.present_since(motor=0))


def _interval_s(fit: OutputFit) -> float:
    """Return the usual time between the samples of a fit."""
    return float(median(fit.window.histories[-1].interval_s))


def published_known_parts(nodes: ContextUpdate, white_box: MotorWhiteBox) -> Array:
    """Return what is known of every published parameter beside its estimate, shape (parameter,).

    Args:
        nodes: the rule that has learnt one motor, perhaps with others.
        white_box: of the motor.
    """
    if isinstance(nodes, MeasuredSpeedUpdate):
        return nodes.published_known_parts
    return white_box.known_parts
