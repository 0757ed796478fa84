"""Following a motor that has changed: which change it was, and whether it goes on.

A sudden change is told from the others by the evidence of fits under each kind of it
(:mod:`change_test`), a winding that heats by the likelihood of a walk (:mod:`random_walk`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive import block_step, random_walk
from gray_box_observer.context_nodes.recursive.batch_fit import Fit, batch_fit
from gray_box_observer.context_nodes.recursive.belief import Belief, Prior
from gray_box_observer.context_nodes.recursive.change_test import (
    CHANGE_EVIDENCE,
    UNCHANGED,
    changes,
    evidence_for,
)
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import EstimatorState, copied, put
from gray_box_observer.context_nodes.recursive.sample_windows import MotorSelection
from gray_box_observer.context_nodes.recursive.statistical_inefficiency import (
    statistical_inefficiency,
    without_columns,
)
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, CURRENT, SampleWindow
from gray_box_observer.samples.order_statistics import distinct
from gray_box_observer.white_box.interface import Array, Parameter

FEWEST_BEFORE = 64
"""Samples before the newest ones that tell, at least, whether neighbours err alike."""

SOON = 1024
"""Samples after which an examination has nothing to do with the one before."""

FREE_EXAMINATIONS = 3
"""Examinations in a row, each soon after the one before, after which the next one is not put off: a
change may need a few until its samples tell which it was."""

STEADY_EXAMINATIONS = 5
"""The same up to which a winding may heat: what jumps again and again is none."""

SHORTEST_DRIFT_S = 2.0
"""Time from which a winding may be told to heat: in less noise may look like it."""

GROWTH = 4
"""Factor from one patience to the next."""

LONGEST_PATIENCE = 256
"""Blocks for which an examination is put off at most."""


def patience(in_vain: NDArray[np.int_], block: int) -> NDArray[np.int_]:
    """Samples until the next examination: more after each one that has settled nothing."""
    blocks = np.minimum(GROWTH ** np.clip(in_vain - FREE_EXAMINATIONS, 0, 8), LONGEST_PATIENCE)
    return np.where(in_vain > FREE_EXAMINATIONS, block * blocks, 0)


class ChangeTracker:
    """Examines motors that seem to have changed.

    Args:
        parameters: of the white box.
        rules: settings.
    """

    def __init__(self, parameters: tuple[Parameter, ...], rules: RecursiveSettings) -> None:
        self._rules = rules
        self._changes = changes(parameters, rules.drift_relative_std)
        self._heats = random_walk.heating(parameters)

    def examine(self, motors: MotorSelection, samples: int) -> None:
        """Fit the newest samples under every kind of change; adopt the likeliest if clear."""
        state = motors.state
        belief = motors.state.belief
        stretch = motors.newest(samples)
        before = Prior(belief.p, belief.posterior + UNCHANGED**2 * np.eye(belief.p.shape[1]))
        priors = [before.loosened(change.directions) for change in self._changes]
        baseline, *fits = self._fits_from(motors, stretch, [before, *priors])
        self._calm(state)
        soon = state.position - state.examined_at <= SOON + patience(
            state.in_vain, self._rules.block
        )
        state.in_vain = np.where(soon, state.in_vain + 1, 0)
        state.examined_at = state.position.copy()
        gain = np.array([evidence_for(stretch, baseline, fit) for fit in fits])
        penalty = np.array([change.penalty for change in self._changes])[:, None]
        evidence = gain - penalty
        seems_changed = evidence.max(axis=0) > CHANGE_EVIDENCE
        if seems_changed.any():
            evidence = gain / self._inefficiency(motors, seems_changed, samples) - penalty
        best = np.argmax(evidence, axis=0)
        has_changed = evidence.max(axis=0) > CHANGE_EVIDENCE
        state.belief = self._back_on_track(belief, baseline.belief, ~has_changed)
        if not np.any(has_changed):
            return
        may_heat = state.in_vain <= STEADY_EXAMINATIONS
        has_jumped = has_changed & ~self.drifting(motors, has_changed & may_heat, samples)
        if not np.any(has_jumped):
            return
        state.change_count = state.change_count + has_jumped
        motors.forget(samples, has_jumped)
        best_belief = fits[0].belief
        freedom = priors[0].covariance
        for j, (fit, prior) in enumerate(zip(fits, priors, strict=True)):
            best_belief = best_belief.overwritten(fit.belief, best == j)
            freedom = np.where((best == j)[:, None, None], prior.covariance, freedom)
        one = has_jumped[:, None]
        p = np.where(one, before.p, state.prior.p)
        state.prior = Prior(p, np.where(one[..., None], freedom, state.prior.covariance))
        motors.adopt(best_belief, has_jumped)
        state.share = np.where(one, 0.0, state.share)
        state.anchor_here(has_jumped)

    def _inefficiency(
        self, motors: MotorSelection, selection: NDArray[np.bool_], samples: int
    ) -> Array:
        """Return how many samples count for one, shape (motor,), by those before the newest ones.

        Parameters that are off are none of it: what they explain is taken off. A motor may have
        changed before the newest samples, too: the half that errs less alike counts.
        """
        inefficiency = np.ones(motors.state.motors)
        length = motors.remembered
        selection = selection & (length > samples + FEWEST_BEFORE)
        for all_samples in distinct(length[selection]).tolist():
            index = np.flatnonzero(selection & (length == all_samples))
            part = motors.part(index)
            stretch = part.newest(all_samples)
            belief = part.state.belief.restarted_at(stretch.state[:, 0])
            block = block_step.predict(part.white_box, belief, stretch)
            residual = np.where(block.is_inlier, block.residual, 0.0)[:, :-samples]
            jacobian = np.where(block.is_inlier[..., None], block.jacobian, 0.0)[:, :-samples]
            middle = residual.shape[1] // 2
            of_halves = [
                statistical_inefficiency(self._unexplained(residual[:, half], jacobian[:, half]))
                for half in (slice(middle), slice(middle, None))
            ]
            inefficiency[index] = np.minimum(*of_halves)
        return inefficiency

    def _unexplained(self, residual: Array, jacobian: Array) -> Array:
        """Return what neither other unknowns nor a steady climb of what heats explain."""
        time = np.linspace(-1.0, 1.0, residual.shape[1])[:, None]
        climb = jacobian[..., COORDINATES][..., self._heats > 0.0] * time
        return without_columns(residual, np.concatenate([jacobian, climb], axis=2))

    def walk_again(self, motors: MotorSelection, samples: int = 0) -> None:
        """Ask motors that drift how fast they do, by the samples since their anchor."""
        state = motors.state
        state.task_code = np.zeros_like(state.task_code)
        self.drifting(motors, np.ones_like(state.is_started))
        state.anchor_here(np.ones_like(state.is_started))

    def drifting(
        self, motors: MotorSelection, selection: NDArray[np.bool_], jumped_before: int | None = None
    ) -> NDArray[np.bool_]:
        """Find the motors that drift by the samples since the anchor; these follow a random walk.

        Args:
            motors: those motors.
            selection: shape (motor,): those that are asked about.
            jumped_before: so many samples ago they may have changed suddenly instead.
        """
        state = motors.state
        is_walking = np.zeros_like(selection)
        length = state.position - state.anchor_position + 1
        for samples in distinct(length[selection]).tolist():
            index = np.flatnonzero(selection & (length == samples))
            part = motors.part(index)
            is_walking[index] = self._walk(part, part.newest(samples), jumped_before)
            put(state, index, part.state)
        return is_walking

    def _walk(
        self, motors: MotorSelection, stretch: SampleWindow, jumped_before: int | None
    ) -> NDArray[np.bool_]:
        """The same for motors whose anchor lies equally far back."""
        state = motors.state
        jump = None
        is_long = stretch.interval_s.sum(axis=1) >= SHORTEST_DRIFT_S
        may_walk: NDArray[np.bool_] = is_long | (state.walk_rate > 0.0)
        if not may_walk.any():
            return may_walk
        if jumped_before is not None:
            freedom = self._rules.drift_relative_std * np.eye(state.belief.p.shape[1])
            jump = random_walk.Jump(stretch.restart.shape[1] - jumped_before, freedom)
        still = random_walk.Walk(self._heats, state.walk_rate)
        anchor = copied(state.anchor)  # what comes of it may be its arrays, and both are written to
        rate, after = random_walk.select_rate(
            motors.white_box, anchor, stretch, still, self._rules.block, jump
        )
        rate = np.where(may_walk, rate, 0.0)
        is_walking: NDArray[np.bool_] = rate > 0.0
        state.change_count = state.change_count + (is_walking & ~(state.walk_rate > 0.0))
        state.walk_rate = rate
        if np.any(is_walking):
            motors.adopt(after, is_walking)
            state.anchor_here(is_walking)
        return is_walking

    @staticmethod
    def _calm(state: EstimatorState) -> None:
        """Forget what has led to an examination."""
        state.task_code = 0 * state.task_code
        state.since = 0 * state.since
        state.suspicion = 0.0 * state.suspicion
        state.left_out = 0.0 * state.left_out
        state.score = np.zeros_like(state.score)
        state.information = np.zeros_like(state.information)

    @staticmethod
    def _back_on_track(belief: Belief, baseline: Belief, selection: NDArray[np.bool_]) -> Belief:
        """Go on with unchanged parameters from the state of a fit under them, for some motors."""
        usable = selection & baseline.finite
        units = (baseline.noise * baseline.current_a / (belief.noise * belief.current_a)) ** 2
        covariance = belief.covariance.copy()
        covariance[:, CURRENT, CURRENT] += np.where(
            usable, units * baseline.covariance[:, CURRENT, CURRENT], 0.0
        )
        return replace(
            belief, state=np.where(usable, baseline.state, belief.state), covariance=covariance
        )

    def _fits_from(
        self, motors: MotorSelection, stretch: SampleWindow, priors: Sequence[Prior]
    ) -> list[Fit]:
        """Fit a stretch under each of some priors.

        The motors stand side by side once for each prior, for every motor finds what it would find
        alone: arithmetic on arrays costs little more for five than for one.
        """
        state = motors.state
        count = len(motors.state.belief.p)
        index = np.tile(np.arange(count), len(priors))
        prior = Prior(
            np.concatenate([one.p for one in priors]),
            np.concatenate([one.covariance for one in priors]),
        )
        fit = batch_fit(
            motors.white_box.of_motors(index),
            stretch.select(index),
            state.belief.p[index],
            prior,
            self._rules.noise_floor,
            5,
            state.least_noise[index],
        )
        return [fit.select(rows) for rows in np.split(np.arange(index.size), len(priors))]
