"""The default rule: recursive maximum likelihood, statistically efficient, with an honest covariance.

Route (METHOD 4): a linear start on the integrated equation; Gauss-Newton on the prediction error over everything
remembered, repeated each time the data have doubled; in between, block by block, a Kalman update of (state,
coordinates) with exact zero-order-hold sensitivities. Repeating the fit takes out what early linearisation had spoilt,
so that the recursion stands where the batch estimate stands; with white torque noise that is the Cramer-Rao bound.

Robust: outliers of torque are weighted out; a wrong voltage sample shows as a kick of the state and is met by letting
the state, not the parameters, go. A changed motor is detected (:mod:`drift`), the estimate settles on the new data; a
parameter that changes again and again is given freedom to walk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.batch_fit import CREDIBLE, Fit, Prior, batch_fit
from gray_box_observer.context_nodes.drift import (
    CHANGE_EVIDENCE,
    SUSPICIOUS_BLOCKS,
    UNCHANGED,
    DriftTest,
    Walk,
    changes,
    evidence_for,
)
from gray_box_observer.context_nodes.estimate import Estimate, VerdictRules
from gray_box_observer.context_nodes.linear_start import linear_start
from gray_box_observer.context_nodes.normal_equations import OUTLIER, Frame, semidefinite, weighted
from gray_box_observer.context_nodes.trajectory import (
    Stretch,
    Trajectory,
    find_kicks,
    follow,
    left_of_restarts,
    linearise,
)
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.base import Array, WhiteBox
from gray_box_observer.white_box.flow import parameter_jacobian, to_coordinates, to_parameters, within_bounds


@dataclass(frozen=True, slots=True)
class RecursiveRules:
    """Settings of the recursive rule.

    Attributes:
        block: samples between two updates.
        first_fit: samples before the first fit.
        replay_capacity: samples remembered for repeated fits; beyond, linearisation errors no longer matter.
        prior_relative_std: of the initial guess, in every coordinate.
        drift_relative_std: how far a coordinate may have gone when the motor has changed.
        drift_threshold: of the chi-square statistic; 60 is passed by chance once in 1e11 for four parameters.
        noise_floor: smallest noise of the current that is believed, as a fraction of its size.
        noise_memory: samples over which the noise level is followed.
    """

    block: int = 32
    first_fit: int = 40
    replay_capacity: int = 4096
    prior_relative_std: float = 2.0
    drift_relative_std: float = 0.4
    drift_threshold: float = 60.0
    noise_floor: float = 1e-5
    noise_memory: int = 3000


class RecursiveUpdate:
    """Context nodes learnt by recursive maximum likelihood.

    Args:
        white_box: the physics.
        initial: shape (motor, parameter): where to start, SI units.
        seed: unused; every rule takes one.
        rules: settings.
        verdict_rules: when a parameter counts as identified.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        initial: Array,
        seed: int = 0,
        rules: RecursiveRules | None = None,
        verdict_rules: VerdictRules | None = None,
    ) -> None:
        self._white_box = white_box
        self._rules = rules or RecursiveRules()
        self._verdict_rules = verdict_rules or VerdictRules()
        bounds = [(p.lower, p.upper) for p in white_box.parameters]
        self._lower, self._upper = np.array(bounds).T
        theta = np.clip(np.asarray(initial, dtype=float), self._lower, self._upper)
        self._prior = Prior.vague(to_coordinates(theta), self._rules.prior_relative_std)
        motors, n = theta.shape
        self._frame = Frame(np.ones(motors), self._prior.p)
        self._state = np.zeros(motors)
        self._covariance = np.tile(np.eye(n + 1), (motors, 1, 1))
        self._noise = np.full(motors, self._rules.prior_relative_std)
        self._noise_count = 0
        self._gain = np.zeros(motors)
        self._sensitivity = np.zeros((motors, n))
        self._suspicion = np.zeros(motors)
        self._since = np.zeros(motors, dtype=int)
        self.replay = ReplayBuffer(motors, self._rules.replay_capacity)
        self._drift = DriftTest(motors, n, self._rules.drift_threshold)
        self._walk = Walk(motors, n)
        self._new = 0
        self._next_fit = self._rules.first_fit
        self._started = False
        self._stamp_ns = 0
        self._frozen = False
        self._speed = np.zeros(motors)
        self.alarms = 0
        self.outliers = np.zeros(motors, dtype=int)
        self.kicks = np.zeros(motors, dtype=int)

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        return np.clip(to_parameters(self._frame.p), self._lower, self._upper)

    @property
    def noise_std_nm(self) -> Array:
        """Estimated standard deviation of the torque noise in N m, shape (motor,)."""
        return self._white_box.output(self._noise)

    def counters(self) -> dict[str, int]:
        """Samples left out, kicks of the state, and changes of the motor."""
        return {
            'torque outliers': int(self.outliers.sum()),
            'state kicks': int(self.kicks.sum()),
            'motor changes': self.alarms,
        }

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning; samples are remembered all the same, and learning resumes where they stand."""
        if frozen == self._frozen:
            return
        if not frozen and len(self.replay):
            self._state = self._white_box.state(self.replay.torque_nm(1)[:, -1])
            self._covariance[:, 0, :] = self._covariance[:, :, 0] = 0.0
            self._covariance[:, 0, 0] = self._frame.current_a**-2.0
            self._sensitivity = np.zeros_like(self._sensitivity)
        self._frozen = frozen
        self._new = 0

    def estimate(self) -> Estimate:
        """Return the present values with covariance and verdicts."""
        theta = self.theta
        by_relative = parameter_jacobian(self._frame.p) * self._frame.p[:, None, :]
        coordinates = self._covariance[:, 1:, 1:] * (self._noise**2)[:, None, None]
        covariance = by_relative @ coordinates @ np.swapaxes(by_relative, 1, 2)
        covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        verdicts = self._verdict_rules.judge(self._white_box.parameters, theta, std, frozen=self._frozen)
        return Estimate(self._stamp_ns, self._white_box.parameters, theta, covariance, verdicts)

    def learn(self, sample: Sample) -> bool:
        """Take one sample; update when a block is full. Tell whether the estimate has changed."""
        if self._white_box.speed_measured:  # a torque that came without its speed: the speed before holds on
            self._speed = np.where(np.isfinite(sample.speed_rad_s), sample.speed_rad_s, self._speed)
        self.replay.append(sample, self._speed)
        self._stamp_ns = sample.stamp_ns
        if self._frozen:
            return False
        self._new += 1
        fit = len(self.replay) >= self._next_fit and self._next_fit <= self._rules.replay_capacity
        fit = fit and not self._walk.walking  # a fit takes the parameters for constant
        if not fit and (not self._started or self._new < self._rules.block):
            return False
        with np.errstate(over='ignore', invalid='ignore', divide='ignore'):  # absurd samples; results are checked
            if fit:
                self._fit()
            else:
                self._update(self._new)
        self._new = 0
        return True

    def _fit(self) -> None:
        """Fit everything remembered; the next time when it has doubled."""
        stretch = Stretch.newest(self._white_box, self.replay, len(self.replay))
        start = self._frame.p
        if not self._started:
            start = linear_start(self._white_box, self._prior.p, stretch, min(20, len(self.replay) // 4))
        fit = batch_fit(self._white_box, stretch, start, self._prior, self._rules.noise_floor)
        self._started = True
        self._take(fit, np.ones(self._state.size, dtype=bool))

    def _take(self, fit: Fit, which: NDArray[np.bool_]) -> None:
        """Go on from a fit of everything remembered, for some of the motors; never from one that is not finite."""
        which = which & np.isfinite(fit.state) & np.isfinite(fit.noise_std)
        which = which & np.all(np.isfinite(fit.covariance), axis=(1, 2)) & np.all(np.isfinite(fit.frame.p), axis=1)
        column, matrix = which[:, None], which[:, None, None]
        self._frame = Frame(
            np.where(which, fit.frame.current_a, self._frame.current_a), np.where(column, fit.frame.p, self._frame.p)
        )
        self._state = np.where(which, fit.state, self._state)
        self._covariance = np.where(matrix, fit.covariance, self._covariance)
        self._noise = np.where(which, fit.noise_std, self._noise)
        self._gain = np.where(which, fit.gain, self._gain)
        self._sensitivity = np.where(column, fit.sensitivity, self._sensitivity)
        self._noise_count = len(self.replay)
        self._next_fit = 2 * len(self.replay)
        self._drift.reset()

    def _update(self, samples: int) -> None:
        """Kalman update with one block of samples."""
        stretch = Stretch.newest(self._white_box, self.replay, samples + 1)
        reach = CREDIBLE * self._frame.current_a[:, None]  # nothing is linearised about an absurd sample
        about = np.concatenate([self._state[:, None], np.clip(stretch.state[:, 1:], -reach, reach)], axis=1)
        path, residual, jacobian, spread = self._predict(stretch, about, self._gain[:, None] * np.ones(samples + 1))
        limit = OUTLIER * self._noise[:, None] * spread
        kicked = np.zeros(self._state.size, dtype=bool)
        if np.any(np.abs(residual) > limit):
            kicks = find_kicks(path, residual, ~stretch.restart, self._noise)
            kicked = np.any(kicks, axis=1)
            stretch = stretch.restarted(kicks)
            trust = self._gain[:, None] * (np.abs(residual) <= limit)
            path, residual, jacobian, spread = self._predict(stretch, about, trust)
            limit = OUTLIER * self._noise[:, None] * spread
        valid = ~stretch.restart
        kept: NDArray[np.bool_] = valid & (np.abs(residual) <= limit)[:, 1:]
        self.outliers += np.sum(valid & ~kept, axis=1)
        self.kicks += kicked
        block = _Block(path, residual[:, 1:], jacobian[:, 1:], spread[:, 1:], kept)
        if not self._changed(block, valid, kicked):
            self._kalman(block, stretch)
            self._follow_noise(block)

    def _predict(self, stretch: Stretch, about: Array, gain: Array) -> tuple[Trajectory, Array, Array, Array]:
        """Trajectory, residuals, their derivatives by the unknowns, and their spread in units of the noise."""
        path = follow(linearise(self._white_box, self._frame.p, stretch, about), stretch, self._state, gain)
        jacobian = self._frame.jacobian(path)
        residual = stretch.state - path.state
        residual[:, 0] = 0.0  # the first sample belongs to the block before
        variance = np.sum((jacobian @ self._covariance) * jacobian, axis=2)
        return path, residual, jacobian, np.sqrt(1.0 + np.maximum(variance, 0.0))

    def _kalman(self, block: _Block, stretch: Stretch) -> None:
        """Turn a block's residuals into new coordinates, state and covariance."""
        n = self._frame.p.shape[1]
        information, right = weighted(block.jacobian, block.kept.astype(float), block.residual)
        posterior = np.linalg.solve(np.eye(n + 1) + self._covariance @ information, self._covariance)
        posterior = 0.5 * (posterior + np.swapaxes(posterior, 1, 2))
        step = (posterior @ right[..., None])[..., 0]
        step[:, 1:] = np.clip(step[:, 1:], -0.5, 1.0)
        p = within_bounds(self._white_box, self._frame.p * (1.0 + step[:, 1:]))
        transfer = self._frame.transfer(block.path)
        moved = transfer @ posterior @ np.swapaxes(transfer, 1, 2)
        if np.any(stretch.restart):
            moved[:, 0, 0] += left_of_restarts(block.path, stretch) / self._frame.current_a**2
        state = block.path.state[:, -1] + (transfer @ step[..., None])[:, 0, 0] * self._frame.current_a
        moved[:, 1:, 1:] += self._walk.spread(block.kept.shape[1]) / (self._noise**2)[:, None, None]
        frame = Frame(self._frame.current_a, p)
        covariance = self._frame.moved(moved, frame)
        finite = np.isfinite(state) & np.all(np.isfinite(covariance), axis=(1, 2)) & np.all(np.isfinite(p), axis=1)
        self._state = np.where(finite, state, stretch.state[:, -1])
        self._covariance = np.where(finite[:, None, None], covariance, self._covariance)
        self._frame = Frame(self._frame.current_a, np.where(finite[:, None], p, self._frame.p))

    def _changed(self, block: _Block, valid: NDArray[np.bool_], kicked: NDArray[np.bool_]) -> bool:
        """Whether the motor has changed; then start over from the newest samples, from where we stand."""
        before = self._sensitivity * self._frame.current_a[:, None]
        total = block.jacobian[..., 1:] + block.path.by_start[:, 1:, None] * before[:, None, :]
        self._sensitivity = total[:, -1] / self._frame.current_a[:, None]
        alarm, memory = self._drift.take(*self._whitened(block, total, kicked))
        lost = np.mean(block.kept, axis=1) < 0.5 * np.mean(valid, axis=1)
        self._suspicion = np.where(lost, self._suspicion + 1.0, 0.0)
        fresh = np.where(self._suspicion == 1.0, np.sum(np.cumsum(~block.kept & valid, axis=1) > 0, axis=1), 0)
        self._since = np.where(lost, self._since + np.where(fresh > 0, fresh, valid.shape[1]), 0)
        sudden: NDArray[np.bool_] = self._suspicion >= SUSPICIOUS_BLOCKS
        suspects = alarm | sudden
        if not np.any(suspects):
            return False
        if np.any(sudden):
            samples = int(np.max(self._since[sudden]))
        else:
            samples = max(self._rules.first_fit, int(np.max(memory[alarm]) * self._rules.block))
        return self._start_over(samples, suspects)

    def _whitened(self, block: _Block, total: Array, kicked: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Sensitivities and innovations of a block, made white and of unit variance; zero where not to be used."""
        use: NDArray[np.bool_] = block.kept & ~kicked[:, None]
        jacobian = block.jacobian * use[..., None]
        spread = jacobian @ self._covariance @ np.swapaxes(jacobian, 1, 2) + np.eye(use.shape[1])
        try:
            root = np.linalg.cholesky(spread)
        except np.linalg.LinAlgError:  # rounding has made the covariance indefinite: mend it
            self._covariance = semidefinite(self._covariance)
            spread = jacobian @ self._covariance @ np.swapaxes(jacobian, 1, 2) + np.eye(use.shape[1])
            if not np.all(np.linalg.eigvalsh(np.nan_to_num(spread)) > 0.0):
                return 0.0 * total, 0.0 * block.residual  # no test with this block
            root = np.linalg.cholesky(spread)
        stacked = np.concatenate([total, block.residual[..., None]], axis=2) * use[..., None]
        white = np.linalg.solve(root, stacked) / self._noise[:, None, None]
        return white[..., :-1], white[..., -1]

    def _start_over(self, samples: int, suspects: NDArray[np.bool_]) -> bool:
        """Fit the newest samples under every kind of change, and follow the likeliest, if any is likely enough."""
        stretch = Stretch.newest(self._white_box, self.replay, min(samples, len(self.replay)))
        known = Prior(self._frame.p, self._posterior + UNCHANGED**2 * np.eye(self._frame.p.shape[1]))
        held = self._fit_from(stretch, known)
        self._suspicion, self._since = 0.0 * self._suspicion, 0 * self._since
        self._drift.reset()
        found = []
        for change in changes(self._white_box.parameters, self._rules.drift_relative_std):
            prior = known.loosened(change.directions)
            found.append((change, prior, self._fit_from(stretch, prior)))
        evidence = np.array([evidence_for(stretch, held, fit) - change.penalty for change, _, fit in found])
        best = np.argmax(np.max(np.where(suspects, evidence, -np.inf), axis=1))
        changed = suspects & (evidence[best] > CHANGE_EVIDENCE)
        if not np.any(changed):
            usable = suspects & np.isfinite(held.state) & np.isfinite(held.covariance[:, 0, 0])
            self._state = np.where(usable, held.state, self._state)
            self._covariance[:, 0, 0] += np.where(usable, held.covariance[:, 0, 0], 0.0)
            return True
        self.alarms += int(np.sum(changed))
        self.replay.forget(samples)
        change, prior, fit = found[best]
        self._prior = Prior(known.p, np.where(changed[:, None, None], prior.covariance, 2.0 * known.covariance))
        self._take(fit, changed)
        self._walk.changed(self._frame.p, change, changed)
        return True

    def _fit_from(self, stretch: Stretch, prior: Prior) -> Fit:
        return batch_fit(self._white_box, stretch, self._frame.p, prior, self._rules.noise_floor)

    @property
    def _posterior(self) -> Array:
        """Covariance of the coordinates' logarithms."""
        posterior: Array = self._covariance[:, 1:, 1:] * self._noise[:, None, None] ** 2
        return posterior

    def _follow_noise(self, block: _Block) -> None:
        count = block.residual.shape[1]
        self._noise_count = min(self._noise_count + count, self._rules.noise_memory)
        seen = np.sum(block.kept * (block.residual / block.spread) ** 2, axis=1)
        seen = seen / np.maximum(np.sum(block.kept, axis=1), 1)
        share = np.where(np.any(block.kept, axis=1), count / self._noise_count, 0.0)
        variance = self._noise**2 + share * (seen - self._noise**2)
        noise = np.maximum(np.sqrt(variance), self._rules.noise_floor * self._frame.current_a)
        self._noise = np.where(np.isfinite(noise), noise, self._noise)

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays."""
        plain = {name: getattr(self, f'_{name}') for name in _PLAIN}
        plain['parameters'] = [p.name for p in self._white_box.parameters]
        arrays = {name: getattr(self, f'_{name}') for name in _ARRAYS}
        arrays |= {'p': self._frame.p, 'current_a': self._frame.current_a}
        arrays |= {'prior_p': self._prior.p, 'prior_covariance': self._prior.covariance}
        arrays |= {'drift_score': self._drift.score, 'drift_information': self._drift.information}
        arrays |= {f'walk_{name}': array for name, array in self._walk.state().items()}
        return plain, {**arrays, 'replay': self.replay.content()}

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            ConfigurationError: it was learnt of other parameters or another number of motors.
        """
        names = [p.name for p in self._white_box.parameters]
        if plain['parameters'] != names or arrays['p'].shape != self._frame.p.shape:
            raise ConfigurationError(f'the checkpoint holds {plain["parameters"]}, expected {names}')
        for name in _PLAIN:
            setattr(self, f'_{name}', plain[name])
        for name in _ARRAYS:
            setattr(self, f'_{name}', arrays[name])
        self._frame = Frame(arrays['current_a'], arrays['p'])
        self._prior = Prior(arrays['prior_p'], arrays['prior_covariance'])
        self._drift.score, self._drift.information = arrays['drift_score'], arrays['drift_information']
        self._walk.restore({name[5:]: array for name, array in arrays.items() if name.startswith('walk_')})
        self.replay.refill(arrays['replay'])


@dataclass(frozen=True, slots=True)
class _Block:
    """One block of samples, predicted: arrays of shape (motor, k), the Jacobian of (motor, k, unknown)."""

    path: Trajectory
    residual: Array
    jacobian: Array
    spread: Array
    kept: NDArray[np.bool_]


_PLAIN = ('new', 'next_fit', 'started', 'stamp_ns', 'noise_count')
_ARRAYS = ('state', 'covariance', 'noise', 'gain', 'sensitivity', 'suspicion', 'since', 'speed')
