"""The default rule: recursive maximum likelihood, statistically efficient, with an honest covariance.

Route (docs/METHOD.md): a linear start on the integrated equation; Gauss-Newton on the prediction error over everything
remembered, repeated each time the data have doubled; in between, block by block, a Kalman update of (state,
coordinates) with exact zero-order-hold sensitivities. Repeating the fit takes out what early linearisation had spoilt,
so that the recursion stands where the batch estimate stands; with white torque noise that is the Cramer-Rao bound.

Robust: outliers of torque are weighted out; a wrong voltage sample shows as a kick of the state and is met by letting
the state, not the parameters, go. A changed motor is detected (:mod:`drift`), the estimate settles on the new data; a
winding that heats is given freedom to walk (:mod:`walk`); a voltage held for long moves nothing else (:mod:`holds`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import blocks, walk
from gray_box_observer.context_nodes.batch_fit import RAMP_EVIDENCE, Fit, batch_fit
from gray_box_observer.context_nodes.belief import Belief, Prior
from gray_box_observer.context_nodes.blocks import Block
from gray_box_observer.context_nodes.drift import (
    CHANGE_EVIDENCE,
    LEFT_OUT,
    LEFT_OUT_MEMORY,
    MEMORIES_BLOCKS,
    SUSPICIOUS_BLOCKS,
    UNCHANGED,
    DriftTest,
    changes,
    evidence_for,
)
from gray_box_observer.context_nodes.estimate import Estimate, VerdictRules
from gray_box_observer.context_nodes.holds import Holds
from gray_box_observer.context_nodes.linear_start import linear_start
from gray_box_observer.context_nodes.trajectory import Stretch
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.base import Array, WhiteBox
from gray_box_observer.white_box.flow import parameter_jacobian, to_coordinates, to_parameters


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
        long_hold_s: in a longer hold of the voltage the winding warms, and its level moves only what heats.
    """

    block: int = 32
    first_fit: int = 40
    replay_capacity: int = 4096
    prior_relative_std: float = 2.0
    drift_relative_std: float = 0.4
    drift_threshold: float = 60.0
    noise_floor: float = 1e-5
    noise_memory: int = 3000
    long_hold_s: float = 60.0


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
        parameters = white_box.parameters
        self._lower = np.array([p.lower for p in parameters])
        self._upper = np.array([p.upper for p in parameters])
        theta = np.clip(np.asarray(initial, dtype=float), self._lower, self._upper)
        motors, n = theta.shape
        self._prior = Prior.vague(to_coordinates(theta), self._rules.prior_relative_std)
        self._belief = Belief.before_data(self._prior)
        self._noise_count = 0
        self._suspicion = np.zeros(motors)
        self._since = np.zeros(motors, dtype=int)
        self._left_out = np.zeros(motors)
        self.replay = ReplayBuffer(motors, self._rules.replay_capacity)
        self._drift = DriftTest(motors, n, self._rules.drift_threshold)
        self._walk = walk.Walk.still(parameters, motors)
        self._anchor, self._anchored = self._belief, 0
        measured = white_box.speed_measured
        self._holds = Holds(parameters, motors, self._rules.long_hold_s, speed_measured=measured)
        self._new = 0
        self._next_fit = self._rules.first_fit
        self._started = False
        self._stamp_ns = 0
        self._frozen = False
        self._resumes = False
        self._speed = np.zeros(motors)
        self.alarms = 0
        self.outliers = np.zeros(motors, dtype=int)
        self.kicks = np.zeros(motors, dtype=int)

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        return np.clip(to_parameters(self._belief.p), self._lower, self._upper)

    @property
    def noise_std_nm(self) -> Array:
        """Estimated standard deviation of the torque noise in N m, shape (motor,)."""
        return self._white_box.output(self._belief.noise)

    def counters(self) -> dict[str, int]:
        """Samples left out, kicks of the state, changes of the motor, and whether it drifts."""
        return {
            'torque outliers': int(self.outliers.sum()),
            'state kicks': int(self.kicks.sum()),
            'motor changes': self.alarms,
            'motors that drift': int(np.sum(self._walk.rate > 0.0)),
        }

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning; what comes while frozen is not remembered, a new signal history follows it."""
        if frozen == self._frozen:
            return
        self._frozen = frozen
        self._resumes = not frozen

    def estimate(self) -> Estimate:
        """Return the present values with covariance and verdicts."""
        theta, p = self.theta, self._belief.p
        by_relative = parameter_jacobian(p) * p[:, None, :]
        covariance = by_relative @ self._belief.posterior @ np.swapaxes(by_relative, 1, 2)
        covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        verdicts = self._verdict_rules.judge(self._white_box.parameters, theta, std, frozen=self._frozen)
        return Estimate(self._stamp_ns, self._white_box.parameters, theta, covariance, verdicts)

    def learn(self, sample: Sample) -> bool:
        """Take one sample; update when a block is full. Tell whether the estimate has changed."""
        if self._white_box.speed_measured:  # a torque that came without its speed: the speed before holds on
            self._speed = np.where(np.isfinite(sample.speed_rad_s), sample.speed_rad_s, self._speed)
        self._stamp_ns = sample.stamp_ns
        if self._frozen:
            return False
        self.replay.append(sample.beginning() if self._resumes else sample, self._speed)
        self._resumes = False
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
        start = self._belief.p
        if not self._started:
            start = linear_start(self._white_box, self._prior.p, stretch, min(20, len(self.replay) // 4))
        fit = batch_fit(self._white_box, stretch, start, self._prior, self._rules.noise_floor)
        self._started = True
        everyone = np.ones(self._suspicion.size, dtype=bool)
        self._take(fit.belief, everyone)
        self._anchor, self._anchored = self._open(fit.belief, stretch), self.replay.total - stretch.restart.shape[1]
        if np.any(drifting := fit.ramp > RAMP_EVIDENCE):
            self._drifts(drifting)
        self._belief = self._holds.cut(self._belief)

    def _open(self, found: Belief, stretch: Stretch) -> Belief:
        """What could be believed at the beginning of a stretch that has been fitted, were it not for the stretch."""
        loose = walk.START_RELATIVE_STD**2 * np.eye(found.p.shape[1])
        covariance = np.zeros_like(found.covariance)
        covariance[:, 1:, 1:] = np.minimum(self._prior.covariance, loose) / found.noise[:, None, None] ** 2
        return replace(found, covariance=covariance).restarted_at(stretch.state[:, 0])

    def _take(self, found: Belief, which: NDArray[np.bool_]) -> None:
        """Go on from a fit of everything remembered, for some of the motors; never from one that is not finite."""
        self._belief = self._belief.overwritten(found, which & found.finite)
        self._noise_count = len(self.replay)
        self._next_fit = 2 * len(self.replay)
        self._drift.reset()

    def _update(self, samples: int) -> None:
        """Learn one block of samples."""
        stretch = Stretch.newest(self._white_box, self.replay, samples + 1)
        block = blocks.predict(self._white_box, self._belief, stretch)
        self.outliers += np.sum(block.valid & ~block.kept, axis=1)
        self.kicks += block.kicked
        if self._changed(block):
            return
        walked = self._walk.spread(np.sum(stretch.interval_s, axis=1))
        self._belief = blocks.learn(self._white_box, self._belief, block, walked)
        self._follow_noise(block)
        self._belief = self._holds.take(self._belief, block.stretch, block.path.factor)
        if self.replay.total - self._anchored < self._anchor_samples:
            return
        if self._walk.walking:  # does it still walk, and how fast?
            self._drifts(self._walk.rate > 0.0)
        self._anchor_here()

    def _anchor_here(self) -> None:
        """Reckon the likelihood of a drift from the present belief on."""
        self._anchor, self._anchored = self._belief, self.replay.total

    @property
    def _anchor_samples(self) -> int:
        """After so many samples the likelihood of a drift is reckoned from the present belief on."""
        return self._rules.replay_capacity // (2 if self._walk.walking else 1)

    def _changed(self, block: Block) -> bool:
        """Whether the motor has changed; then start over from the newest samples, from where we stand."""
        belief, valid = self._belief, block.valid
        size = belief.current_a[:, None]
        reached = block.jacobian[:, -1, 1:] + block.path.by_start[:, -1:] * (belief.sensitivity * size)
        self._belief = replace(belief, sensitivity=reached / size)
        alarm, memory = self._drift.take(*blocks.surprise(belief, block))
        lost = np.mean(block.kept, axis=1) < 0.5 * np.mean(valid, axis=1)
        self._suspicion = np.where(lost, self._suspicion + 1.0, 0.0)
        fresh = np.where(self._suspicion == 1.0, np.sum(np.cumsum(~block.kept & valid, axis=1) > 0, axis=1), 0)
        self._since = np.where(lost, self._since + np.where(fresh > 0, fresh, valid.shape[1]), 0)
        sudden: NDArray[np.bool_] = self._suspicion >= SUSPICIOUS_BLOCKS
        self._left_out = LEFT_OUT_MEMORY * self._left_out + np.mean(valid & ~block.kept, axis=1)
        # outliers by the dozen, in a fit that goes on between them: transitions, perhaps, of another inductance
        misfit = (self._left_out > LEFT_OUT) & ~lost
        suspects = alarm | sudden | misfit
        if not np.any(suspects):
            return False
        if np.any(sudden):
            samples = int(np.max(self._since[sudden]))
        else:
            blocks_back = np.max(np.where(alarm, memory, MEMORIES_BLOCKS[0]))
            samples = max(self._rules.first_fit, int(blocks_back * self._rules.block))
        return self._start_over(samples, suspects)

    def _start_over(self, samples: int, suspects: NDArray[np.bool_]) -> bool:
        """Fit the newest samples under every kind of change, and follow the likeliest, if any is likely enough."""
        belief = self._belief
        stretch = Stretch.newest(self._white_box, self.replay, min(samples, len(self.replay)))
        known = Prior(belief.p, belief.posterior + UNCHANGED**2 * np.eye(belief.p.shape[1]))
        held = self._fit_from(stretch, known)
        self._suspicion, self._since, self._left_out = 0.0 * self._suspicion, 0 * self._since, 0.0 * self._left_out
        self._drift.reset()
        found = []
        for change in changes(self._white_box.parameters, self._rules.drift_relative_std):
            prior = known.loosened(change.directions)
            found.append((prior, self._fit_from(stretch, prior), change.penalty))
        evidence = np.array([evidence_for(stretch, held, fit) - penalty for _, fit, penalty in found])
        best = np.argmax(np.max(np.where(suspects, evidence, -np.inf), axis=1))
        changed = suspects & (evidence[best] > CHANGE_EVIDENCE)
        if not np.any(changed):
            usable = suspects & held.belief.finite
            units = (held.belief.noise * held.belief.current_a / (belief.noise * belief.current_a)) ** 2
            covariance = belief.covariance.copy()
            covariance[:, 0, 0] += np.where(usable, units * held.belief.covariance[:, 0, 0], 0.0)
            state = np.where(usable, held.belief.state, belief.state)
            self._belief = replace(self._belief, state=state, covariance=covariance)
            return True
        if self._drifts(changed, samples):
            return True
        self.alarms += int(np.sum(changed))
        self.replay.forget(samples)
        prior, fit, _ = found[best]
        self._prior = Prior(known.p, np.where(changed[:, None, None], prior.covariance, 2.0 * known.covariance))
        self._take(fit.belief, changed)
        self._anchor_here()
        return True

    def _fit_from(self, stretch: Stretch, prior: Prior) -> Fit:
        return batch_fit(self._white_box, stretch, self._belief.p, prior, self._rules.noise_floor, trusting=5)

    def _drifts(self, which: NDArray[np.bool_], jumped_before: int | None = None) -> bool:
        """Whether motors drift, by the samples since the anchor; then go on as is likeliest, and walk.

        Args:
            which: shape (motor,): motors that are asked about.
            jumped_before: so many samples ago they may have changed suddenly instead.
        """
        stretch = Stretch.newest(self._white_box, self.replay, self.replay.total - self._anchored + 1)
        jump = None
        if jumped_before is not None:
            freedom = self._rules.drift_relative_std * np.eye(self._belief.p.shape[1])
            jump = walk.Jump(stretch.restart.shape[1] - jumped_before, freedom)
        rate, after = walk.likeliest(self._white_box, self._anchor, stretch, self._walk, self._rules.block, jump)
        before = self._walk.rate > 0.0
        self._walk = replace(self._walk, rate=np.where(which, rate, self._walk.rate))
        walking = which & (rate > 0.0)
        self.alarms += int(np.sum(walking & ~before))
        if np.any(walking):
            self._take(after, walking)
            self._anchor_here()
        return bool(np.any(walking))

    def _follow_noise(self, block: Block) -> None:
        count = block.residual.shape[1]
        self._noise_count = min(self._noise_count + count, self._rules.noise_memory)
        seen = np.sum(block.kept * (block.residual / block.spread) ** 2, axis=1)
        seen = seen / np.maximum(np.sum(block.kept, axis=1), 1)
        share = np.where(np.any(block.kept, axis=1), count / self._noise_count, 0.0)
        before = self._belief.noise
        variance = before**2 + share * (seen - before**2)
        noise = np.maximum(np.sqrt(variance), self._rules.noise_floor * self._belief.current_a)
        self._belief = replace(self._belief, noise=np.where(np.isfinite(noise), noise, before))

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays."""
        plain = {name: getattr(self, f'_{name}') for name in _PLAIN}
        plain['parameters'] = [p.name for p in self._white_box.parameters]
        plain['anchored'] = self._anchored - self.replay.total  # a buffer that is refilled counts anew
        arrays = {name: getattr(self, f'_{name}') for name in _ARRAYS}
        arrays |= {'prior_p': self._prior.p, 'prior_covariance': self._prior.covariance}
        arrays |= {'drift_score': self._drift.score, 'drift_information': self._drift.information}
        arrays |= {'walk_rate': self._walk.rate, 'replay': self.replay.content()}
        parts = {'belief': self._belief.arrays(), 'anchor': self._anchor.arrays(), 'holds': self._holds.state()}
        return plain, arrays | {f'{part}.{k}': v for part, named in parts.items() for k, v in named.items()}

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            ConfigurationError: it was learnt of other parameters or another number of motors.
        """
        names = [p.name for p in self._white_box.parameters]
        if plain['parameters'] != names or arrays['belief.p'].shape != self._belief.p.shape:
            raise ConfigurationError(f'the checkpoint holds {plain["parameters"]}, expected {names}')
        for name in _PLAIN:
            setattr(self, f'_{name}', plain[name])
        for name in _ARRAYS:
            setattr(self, f'_{name}', arrays[name])
        self._prior = Prior(arrays['prior_p'], arrays['prior_covariance'])
        self._drift.score, self._drift.information = arrays['drift_score'], arrays['drift_information']
        self._walk = replace(self._walk, rate=arrays['walk_rate'])
        self.replay.refill(arrays['replay'])
        self._anchored = plain['anchored'] + self.replay.total
        self._belief, self._anchor = Belief(**_below('belief', arrays)), Belief(**_below('anchor', arrays))
        self._holds.restore(_below('holds', arrays))


def _below(part: str, arrays: dict[str, Array]) -> dict[str, Array]:
    return {name[len(part) + 1 :]: array for name, array in arrays.items() if name.startswith(f'{part}.')}


_PLAIN = ('new', 'next_fit', 'started', 'stamp_ns', 'noise_count', 'resumes')
_ARRAYS = ('suspicion', 'since', 'left_out', 'speed')
