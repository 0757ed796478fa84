"""The thesis's rule: stage 1, gradient steps on the L1 loss of differences (thesis 4.2, 4.3.2).

What is kept: one trainable number a parameter, the L1 norm, Adam, weights by the rate of change
plus a small constant, learning-rate cuts on plateaus, a bounded replay of past data. What is
mended: the thesis compares a difference with one forward Euler step and so reads L a tenth too low;
here the equation is integrated over the window between two samples, exactly in time. Parameters
live on a logarithmic scale, so they are positive by construction (thesis 4.3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings
from gray_box_observer.context_nodes.gradient_descent import GradientDescent
from gray_box_observer.context_nodes.update_rule import check_parameters
from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import (
    LATEST_NS,
    MOST,
    ArrayRule,
    check_arrays,
    check_covariance,
    check_generator,
    counts,
    entry,
    whole,
)
from gray_box_observer.samples.replay_buffer import ReplayBuffer, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array, WhiteBox


@dataclass(frozen=True)
class GradientSettings:
    """Settings of the gradient rule; defaults suit tens to hundreds of samples per L/R.

    Attributes:
        batch_size: new samples between two updates.
        steps: Adam steps an update.
        minibatch: windows drawn from the replay buffer for an update.
        window: samples between the two ends of a difference; longer ones see less of the sensor's
            noise.
        learning_rate: of Adam, on the logarithm of the parameters (thesis: 0.01).
        smallest_learning_rate: where plateau cuts end.
        weight_floor: constant added to the transition weights, so that steady state is not lost
            (thesis: 0.07).
        patience: updates without a better loss before the learning rate is halved.
        drift_ratio: loss on the newest data over its usual level that is taken for a changed motor.
        drift_floor: and it must be at least this fraction of the current: below, it is the
            quadrature's own error.
        replay_capacity: samples remembered.
    """

    batch_size: int = 25
    steps: int = 8
    minibatch: int = 128
    window: int = 10
    learning_rate: float = 0.02
    smallest_learning_rate: float = 1e-5
    weight_floor: float = 0.07
    patience: int = 6
    drift_ratio: float = 4.0
    drift_floor: float = 5e-3
    replay_capacity: int = 6000


ROUNDING = 1e-9
"""Of the logarithms of parameters at their bounds."""

_DESCENT = ('z', 'first', 'second', 'adam_steps', 'rate', 'loss', 'best', 'stale')


class GradientUpdate:
    """Context nodes learnt by the thesis's gradient rule.

    Args:
        white_box: the physics.
        initial: shape (motor, parameter): where to start, SI units.
        seed: of the draws from the replay buffer.
        rules: settings.
        verdict_rules: when a parameter counts as identified.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        initial: Array,
        seed: int = 0,
        rules: GradientSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
    ) -> None:
        self._white_box = white_box
        self._rules = rules or GradientSettings()
        self.verdict_rules = verdict_rules or VerdictSettings()
        self._random = np.random.default_rng(seed)
        self._lower = np.log([p.lower for p in white_box.parameters])
        self._upper = np.log([p.upper for p in white_box.parameters])
        self._descent = GradientDescent(
            np.log(np.asarray(initial, dtype=float)),
            (self._lower, self._upper),
            self._rules.learning_rate,
            self._rules.smallest_learning_rate,
            self._rules.patience,
        )
        self.replay = ReplayBuffer(self._descent.z.shape[0], self._rules.replay_capacity)
        self._covariance = self._prior_covariance()
        self._new = 0
        self._stamp_ns = 0
        self._is_frozen = False
        self._resumes = False

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        theta: Array = np.exp(self._descent.z)
        return theta

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Every update changes the estimate of every motor; they are updated together."""
        return np.ones(self._descent.z.shape[0], dtype=bool)

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """The gradient rule keeps no count."""
        return {}

    def present_since(self, motor: int) -> int:
        """Return the place from which one motor is the present one: that of its last change."""
        return self.replay.begin_of(motor)

    def is_drifting(self, motor: int) -> bool:
        """Tell whether one motor is known to drift: this rule never asks."""
        return False

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return that no share of the voltage is known: the rule calls nothing negligible."""
        nothing = np.zeros(len(self._white_box.parameters))
        return nothing, nothing

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; frozen samples are not kept, a new signal history follows."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen = is_frozen
        self._resumes = not is_frozen

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts, of all motors or of some."""
        theta = self.theta[selection]
        covariance = self._covariance[selection]
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        verdicts = self.verdict_rules.judge(
            self._white_box.parameters, theta, std, is_frozen=self._is_frozen
        )
        return Estimate(self._stamp_ns, self._white_box.parameters, theta, covariance, verdicts)

    def learn(self, sample: Sample) -> bool:
        """Remember one sample; update on every full batch. Tell whether the estimate changed."""
        self._stamp_ns = sample.stamp_ns
        if self._is_frozen:
            return False
        self.replay.append(sample.beginning() if self._resumes else sample)
        self._resumes = False
        self._new += 1
        rules = self._rules
        if self._new < rules.batch_size or len(self.replay) < 2 * (rules.window + 1):
            return False
        self._new = 0
        newest = np.arange(len(self.replay) - rules.batch_size, len(self.replay))
        fresh = self._weighted_loss(*self._weigh(self._windows(newest)))[0]
        self._follow_drift(fresh)
        ends = self._random.integers(rules.window, len(self.replay), size=rules.minibatch)
        minibatch = self._weigh(self._windows(np.sort(ends)))
        for _ in range(rules.steps):
            self._descent.step(*self._weighted_loss(*minibatch))
        self._descent.cut_on_plateau(fresh)
        self._covariance = self._sandwich()
        return True

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays; this rule's motors are kept singly."""
        plain = {
            'random': self._random.bit_generator.state,
            'new': self._new,
            'stamp_ns': self._stamp_ns,
            'parameters': [p.name for p in self._white_box.parameters],
        }
        arrays = {name: getattr(self._descent, name) for name in _DESCENT}
        return plain, {**arrays, 'covariance': self._covariance, 'replay': self.replay.content()}

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        check_parameters(plain, self._white_box.parameters)
        self._check(plain, arrays)
        self._random.bit_generator.state = plain['random']
        self._new = int(plain['new'])
        self._stamp_ns = int(plain['stamp_ns'])
        self._covariance = arrays['covariance']
        for name in _DESCENT:
            setattr(self._descent, name, arrays[name])
        self.replay.refill(arrays['replay'])

    def _check(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Refuse a saved state that could not have been learnt.

        Raises:
            CheckpointError: something is missing, or no state of this rule.
        """
        motors, n = self._descent.z.shape
        rules = {
            'z': ArrayRule((motors, n)),
            'first': ArrayRule((motors, n), -1.0, 1.0),
            'second': ArrayRule((motors, n), 0.0, 1.0),
            'adam_steps': ArrayRule((motors, 1), 0.0, MOST),
            'rate': ArrayRule((motors, 1), self._rules.smallest_learning_rate * 1e-6, 1.0),
            'loss': ArrayRule((motors, 1), 0.0, blank=True),
            'best': ArrayRule((motors, 1), 0.0, endless=True),
            'stale': counts(motors, 1),
            'covariance': ArrayRule((motors, n, n)),
        }
        check_arrays(arrays, rules)
        if (arrays['z'] < self._lower - ROUNDING).any() or (
            arrays['z'] > self._upper + ROUNDING
        ).any():
            raise CheckpointError('z lies outside the bounds of the parameters')
        check_covariance('covariance', arrays['covariance'])
        check_signals('replay', arrays.get('replay'), motors)
        check_generator(entry(plain, 'random'))
        whole(plain, 'new')
        whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)

    def _windows(self, ends: NDArray[np.intp]) -> tuple[Array, Array, Array]:
        """Regressors (motor, window, parameter), targets and validity of the newest windows."""
        n = self._rules.window
        index = np.maximum(ends, n)[:, None] + np.arange(-n, 1)
        intervals = self.replay.interval_s()[:, index[:, 1:]]
        voltage = np.where(intervals > 0.0, self.replay.voltage_v()[:, index[:, 1:]], 0.0)
        speed = self.replay.speed_rad_s()[:, index]
        current = self._white_box.state(self.replay.torque_nm()[:, index])
        phi, target = integrated_regressors(self._white_box, voltage, current, speed, intervals)
        phi = phi.sum(axis=2)
        target = target.sum(axis=2)
        valid = (
            np.all(intervals > 0.0, axis=2) & np.isfinite(target) & np.all(np.isfinite(phi), axis=2)
        )
        return np.where(valid[..., None], phi, 0.0), np.where(valid, target, 0.0), valid

    def _residual(self, phi: Array, target: Array) -> tuple[Array, Array]:
        """First-difference residual in A and its derivative by log theta."""
        theta = self.theta
        storage = theta[:, None, 0]
        gap = (target - (phi @ theta[:, :, None])[..., 0]) / storage
        slope = -phi * theta[:, None, :] / storage[..., None]
        slope[..., 0] -= gap
        return gap, slope

    def _weigh(self, windows: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Replace validity by transition weights: scaled |change| plus floor, sum one.

        The change is scaled to 0..1 (thesis 4.3.2).
        """
        phi, target, valid = windows
        change = np.abs(phi[..., 0]) * valid
        largest = np.maximum(change.max(axis=1, keepdims=True), 1e-300)
        weights = (change / largest + self._rules.weight_floor) * valid
        return phi, target, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)

    def _weighted_loss(self, phi: Array, target: Array, weights: Array) -> tuple[Array, Array]:
        """L1 loss, shape (motor, 1), and its gradient by log theta, shape (motor, parameter)."""
        gap, slope = self._residual(phi, target)
        loss = np.sum(weights * np.abs(gap), axis=1, keepdims=True)
        gradient = ((weights * np.sign(gap))[:, None, :] @ slope)[:, 0, :]
        return loss, gradient

    def _follow_drift(self, fresh: Array) -> None:
        """Start over from the present values when the newest data no longer fit."""
        newest = self._white_box.state(self.replay.torque_nm(self._rules.batch_size))
        floor = self._rules.drift_floor * np.abs(newest).mean(axis=1, keepdims=True)
        least = np.maximum(self._rules.drift_ratio * self._descent.loss, floor)
        has_drifted = self._descent.is_settled & (fresh > least)
        if not np.any(has_drifted):
            return
        self.replay.forget(
            2 * max(self._rules.batch_size, self._rules.window + 1)
        )  # what an update needs
        self._descent.begin_anew(has_drifted, fresh)

    def _prior_covariance(self) -> Array:
        theta = self.theta
        prior: Array = np.einsum('mp,pq->mpq', theta**2, np.eye(theta.shape[1]))
        return prior

    def _sandwich(self) -> Array:
        """Covariance from curvature and scatter of the remembered windows, plus the distance left.

        Windows that do not overlap are nearly independent. The last term is one Newton step of
        least squares from the present values: what has not converged yet is not certain yet.
        """
        n = self._rules.window
        phi, target, valid = self._windows(np.arange(n, len(self.replay), n))
        gap, slope = self._residual(phi, target)
        weights = valid.astype(float)
        freedom = np.maximum(weights.sum(axis=1) - phi.shape[-1], 1.0)
        variance = np.sum(weights * gap**2, axis=1) / freedom
        information = np.einsum('mw,mwp,mwq->mpq', weights, slope, slope)
        information += (
            1e-9 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(phi.shape[-1])
        )
        information += 1e-300 * np.eye(phi.shape[-1])
        inverse = np.linalg.pinv(information, hermitian=True)
        newton = -np.einsum('mpq,mw,mwq,mw->mp', inverse, weights, slope, gap)
        newton = np.clip(newton, -1.0, 1.0)
        floor = (
            1e-18 * np.trace(information, axis1=1, axis2=2) / np.maximum(weights.sum(axis=1), 1.0)
            + 1e-300
        )
        precision = information / np.maximum(variance, floor)[:, None, None]
        in_log = np.linalg.inv(
            precision + np.eye(phi.shape[-1])
        )  # nothing is vaguer than the prior
        in_log = 0.5 * (in_log + np.swapaxes(in_log, 1, 2)) + np.einsum(
            'mp,mq->mpq', newton, newton
        )
        theta = self.theta
        covariance: Array = in_log * theta[:, :, None] * theta[:, None, :]
        return covariance
