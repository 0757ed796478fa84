"""What the recursive rule does with motors that are due: fit everything, or learn a block.

Every motor of the group goes its own way: which of its samples are read is settled by its place in
its own stream (``EstimatorState.at``), and nothing that is decided for one depends on another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native.regular_block import (
    ANCHOR_DUE,
    LEARNT,
    LONG_HOLD,
    BatchResult,
    RegularBlocks,
)
from gray_box_observer.context_nodes.recursive import block_step, random_walk
from gray_box_observer.context_nodes.recursive.batch_fit import RAMP_EVIDENCE, Fit, batch_fit
from gray_box_observer.context_nodes.recursive.belief import Belief, Prior
from gray_box_observer.context_nodes.recursive.block_step import Block
from gray_box_observer.context_nodes.recursive.change_test import (
    LEFT_OUT,
    LEFT_OUT_MEMORY,
    MEMORIES_BLOCKS,
    SUSPICIOUS_BLOCKS,
    ChangeTest,
)
from gray_box_observer.context_nodes.recursive.change_tracking import (
    STEADY_EXAMINATIONS,
    ChangeTracker,
    patience,
)
from gray_box_observer.context_nodes.recursive.constant_voltage import ConstantVoltage
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import (
    EstimatorState,
    chosen,
    copied,
    put,
)
from gray_box_observer.context_nodes.recursive.linear_start import linear_start
from gray_box_observer.context_nodes.recursive.negligible import SIGMAS, voltage_shares
from gray_box_observer.context_nodes.recursive.normal_equations import solved
from gray_box_observer.context_nodes.recursive.sample_windows import MotorSelection
from gray_box_observer.context_nodes.recursive.schedule import UpdateSchedule
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, SampleWindow
from gray_box_observer.samples.noise_floor import STEP_TO_STD, STILL, WITHIN_STEP, quantisation_step
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box.interface import Array, WhiteBox

BLOCKS_PER_STEP = 1024
"""Motors, at least, whose blocks compiled code looks at at one sample of the group; of many motors
a sixteenth."""

WALK_AGAIN = -1
"""Asked of a motor that drifts: does it still, and how fast? What is above 0 asks to examine so
many samples."""

AT_REST = 4
"""Times a first fit's, samples at most that are kept when a motor first moves: more of a level tell
nothing."""

REFUTED = 40.0
"""Square of the distance, in standard deviations, between data and what was told, from which it
cannot be true: of five unknowns once in ten million by chance."""

FREE = 10.0
"""Log-likelihood that a fit without it must bring."""

LINEAR_WINDOW = 20
"""Samples between the two ends of a difference where the search for a first estimate starts."""


class BlockUpdater:
    """The recursion.

    Args:
        white_box: of all motors.
        rules: settings.
        replay: samples of all motors.
        changes: examines those that seem to have changed.

    Attributes:
        batch_size: motors whose regular blocks are learnt at one sample of the group.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        rules: RecursiveSettings,
        replay: ReplayBuffer,
        changes: ChangeTracker,
    ) -> None:
        self._rules = rules
        self._replay = replay
        self._changes = changes
        self._holds = ConstantVoltage(
            white_box.parameters, rules.long_hold_s, speed_measured=white_box.speed_measured
        )
        self._drift = ChangeTest(rules.drift_threshold)
        self._heats = random_walk.heating(white_box.parameters)
        self._regular = RegularBlocks(white_box, rules, replay)
        self.batch_size = max(BLOCKS_PER_STEP, replay.motors // 16)

    def fit(self, motors: MotorSelection, samples: int) -> None:
        """Fit everything remembered, so many samples; the next time when that has doubled."""
        waits = self._wait_for_current(motors, motors.newest(samples))
        if not waits.any():
            self._fit(motors, samples)
        elif not waits.all():
            index = np.flatnonzero(~waits)
            part = motors.part(index)
            self._fit(part, samples)
            put(motors.state, index, part.state)

    def _wait_for_current(self, motors: MotorSelection, stretch: SampleWindow) -> NDArray[np.bool_]:
        """Read the step of the current; hold back and name motors whose current moved no further.

        Nothing follows from a current that does not move: noise of the voltage would be taken for
        what moves it not.
        """
        state = motors.state
        step = quantisation_step(stretch.state)
        state.least_noise = np.where(step > 0.0, STEP_TO_STD * step, state.least_noise)
        waits: NDArray[np.bool_] = ~state.is_started & (
            np.ptp(stretch.state, axis=1) <= WITHIN_STEP * step
        )
        if waits.any():
            motors.forget(AT_REST * self._rules.first_fit, waits)
            state.next_fit_at = np.where(
                waits, motors.remembered + self._rules.first_fit, state.next_fit_at
            )
        return waits

    def _fit(self, motors: MotorSelection, samples: int) -> None:
        state = motors.state
        stretch = motors.newest(samples)
        start = state.belief.p
        fresh = ~state.is_started
        if np.any(fresh):
            start = np.where(
                fresh[:, None], self._first_guess(motors, state.prior, stretch, samples), start
            )
        fit = self._fitted(motors, stretch, start, state.prior)
        if (refuted_motors := self._refuted(state.prior, fit.belief)).size:
            fit = self._fit_without(motors, samples, fit, refuted_motors)
        state.is_started = np.ones_like(state.is_started)
        motors.adopt(fit.belief, np.ones_like(fresh))
        state.share = voltage_shares(motors.white_box, stretch)
        state.reach = SIGMAS * np.where(state.share > 0.0, fit.linear_std, 0.0) * state.share
        state.anchor = copied(self._open(fit.belief, state.prior, stretch))
        state.anchor_position = state.position - stretch.restart.shape[1]
        state.belief = self._holds.without_excitation(
            state.hold, state.belief, state.prior, stretch
        )
        state.hold = self._holds.fitted(state.hold, state.belief, stretch)
        may_heat = state.in_vain <= STEADY_EXAMINATIONS
        if np.any(has_ramp := (fit.ramp > RAMP_EVIDENCE) & state.hold.begun & may_heat):
            self._changes.drifting(motors, has_ramp)
        state.belief = self._holds.cut(state.hold, state.belief)

    def _fitted(
        self, motors: MotorSelection, stretch: SampleWindow, start: Array, prior: Prior
    ) -> Fit:
        least_noise = motors.state.least_noise
        return batch_fit(
            motors.white_box,
            stretch,
            start,
            prior,
            self._rules.noise_floor,
            least_noise=least_noise,
        )

    @staticmethod
    def _first_guess(
        motors: MotorSelection, prior: Prior, stretch: SampleWindow, samples: int
    ) -> Array:
        """Where a search begins that has nothing to go on but the samples."""
        return linear_start(motors.white_box, prior.p, stretch, min(LINEAR_WINDOW, samples // 4))

    def _vague(self, prior: Prior) -> Prior:
        """What is believed of motors of which nobody told anything but where to begin."""
        return Prior.of_parameters(prior.p, np.full(prior.p.shape, self._rules.prior_relative_std))

    def _refuted(self, prior: Prior, belief: Belief) -> NDArray[np.intp]:
        """Places of motors whose data contradict what was stated about them."""
        away = np.log(belief.p / prior.p)
        distance = (away * solved(prior.covariance, away[..., None])[..., 0]).sum(axis=1)
        sharp = prior.covariance.diagonal(0, 1, 2) < 0.5 * self._vague(prior).covariance.diagonal(
            0, 1, 2
        )
        return np.flatnonzero(belief.finite & (distance > REFUTED) & sharp.any(axis=1))

    def _fit_without(
        self, motors: MotorSelection, samples: int, fit: Fit, index: NDArray[np.intp]
    ) -> Fit:
        """Fit some motors anew with a vague prior; adopt the fit where it fits better.

        A wrong value that is told as certain bends the others until the search ends where it should
        not.
        """
        part = motors.part(index)
        stretch = part.newest(samples)
        prior = self._vague(part.state.prior)
        start = self._first_guess(part, prior, stretch, samples)
        again = self._fitted(part, stretch, start, prior)
        gain = samples * np.log(fit.belief.noise[index] / again.belief.noise)
        better = again.belief.finite & (gain > FREE)
        if not better.any():
            return fit
        places = index[better]
        result = copied(fit)
        put(result, places, chosen(again, better))
        vague_prior = copied(motors.state.prior)
        put(vague_prior, places, chosen(prior, better))
        motors.state.prior = vague_prior
        return result

    @staticmethod
    def _open(belief: Belief, prior: Prior, stretch: SampleWindow) -> Belief:
        """Belief at the beginning of a fitted window, had the window not been seen.

        Coordinates are independent there, and none is less known than the walk starts from.
        """
        loose = random_walk.START_RELATIVE_STD**2
        variance = np.minimum(prior.covariance.diagonal(0, 1, 2), loose)
        covariance = np.zeros_like(belief.covariance)
        covariance[:, COORDINATES, COORDINATES] = (
            variance[:, None] * np.eye(belief.p.shape[1]) / belief.noise[:, None, None] ** 2
        )
        return replace(belief, covariance=covariance).restarted_at(stretch.state[:, 0])

    def learn_due(
        self, state: EstimatorState, schedule: UpdateSchedule
    ) -> tuple[EstimatorState, BatchResult]:
        """Learn the regular blocks that are due, as :meth:`RegularBlocks.learn_due`."""
        arrays = schedule.next_update_at, schedule.is_block_update
        return self._regular.learn_due(state, *arrays, self.batch_size)

    def learn_regular(
        self, state: EstimatorState, motors: NDArray[np.intp], schedule: UpdateSchedule
    ) -> tuple[EstimatorState, NDArray[np.uint8]]:
        """Learn the regular blocks of some motors, as :meth:`RegularBlocks.learn`."""
        arrays = schedule.next_update_at, schedule.is_block_update
        return self._regular.learn(state, motors, *arrays)

    def handle_flags(
        self, state: EstimatorState, motors: NDArray[np.intp], status: NDArray[np.uint8]
    ) -> None:
        """Finish regular blocks whose status says that there is more to do than to learn them."""
        if not (status > LEARNT).any():
            return
        if (in_hold := motors[status & LONG_HOLD > 0]).size:
            hold = chosen(state.hold, in_hold)
            belief = chosen(state.belief, in_hold)
            put(state.belief, in_hold, self._holds.cut(hold, belief))
        if (far := motors[status & ANCHOR_DUE > 0]).size:
            self._move_anchors(state, far)

    def update(self, motors: MotorSelection, samples: int) -> None:
        """Learn one block of samples; request an examination where the motor seems changed."""
        state = motors.state
        stretch = motors.newest(samples + 1)
        fresh = ~state.hold.begun
        expected_belief = state.belief
        if fresh.any():  # what is vague must not make everything seem possible
            expected_belief = replace(
                expected_belief,
                covariance=np.where(fresh[:, None, None], 0.0, expected_belief.covariance),
            )
        block = block_step.predict(motors.white_box, expected_belief, stretch)
        still = np.ptp(stretch.state, axis=1) <= STILL * state.least_noise
        if (silent := fresh | (still & (state.least_noise > 0.0))).any():
            block = block.silenced(silent)
        state.outliers = state.outliers + (block.samples - block.inlier_count)
        state.kicks = state.kicks + block.has_kick
        state.task_code = self._suspects(state, block)
        if fresh.any():
            self._look_at_rest(motors, fresh, block)
        calm = state.task_code == 0
        if calm.all():
            self._learn(motors, block)
        elif calm.any():
            index = np.flatnonzero(calm)
            part = motors.part(index)
            self._learn(part, block.select(index))
            put(state, index, part.state)
        if (has_begun := fresh & state.hold.begun).any():
            self._begin_again(
                motors, has_begun, AT_REST * self._rules.first_fit, self._rules.first_fit
            )

    def _look_at_rest(self, motors: MotorSelection, fresh: NDArray[np.bool_], block: Block) -> None:
        """Ask whether motors only ever at rest now rest elsewhere, at the same voltage."""
        state = motors.state
        sudden = fresh & (state.suspicion >= SUSPICIOUS_BLOCKS)
        if np.any(elsewhere := sudden & self._holds.same(state.hold, block.stretch)):
            state.change_count = state.change_count + elsewhere
            self._begin_again(motors, elsewhere, self._rules.first_fit, 0)
        state.task_code = np.where(fresh, 0, state.task_code)

    def _begin_again(
        self, motors: MotorSelection, selection: NDArray[np.bool_], keep: int, more: int
    ) -> None:
        """Restart some motors from their newest samples, with a fit of these and so many more.

        A motor that has only been at rest is too far from what it will prove to be for the
        recursion to get there.
        """
        state = motors.state
        motors.forget(keep, selection)
        state.is_started = state.is_started & ~selection
        state.next_fit_at = np.where(selection, motors.remembered + more, state.next_fit_at)
        state.suspicion = np.where(selection, 0.0, state.suspicion)
        state.left_out = np.where(selection, 0.0, state.left_out)

    def _suspects(self, state: EstimatorState, block: Block) -> NDArray[np.int_]:
        """How many of the newest samples to examine where the motor seems changed; 0 elsewhere."""
        belief = state.belief
        size = belief.current_a[:, None]
        total_sensitivity = block.jacobian[:, -1, COORDINATES] + block.path.by_start[:, -1:] * (
            belief.sensitivity * size
        )
        scores, alarm, memory = self._drift.update(
            (state.score, state.information), *block_step.surprise(belief, block)
        )
        state.score, state.information = scores
        state.belief = replace(belief, sensitivity=total_sensitivity / size)
        is_lost = (block.inlier_count < 0.5 * block.samples) | (block.has_kick & ~state.hold.begun)
        state.suspicion, state.since = self._suspicion(state, block, is_lost)
        sudden = state.suspicion >= SUSPICIOUS_BLOCKS
        state.left_out = (
            LEFT_OUT_MEMORY * state.left_out
            + (block.samples - block.inlier_count) / block.is_inlier.shape[1]
        )
        # outliers by the dozen, in a fit that goes on between them: transitions, perhaps, of
        # another inductance
        misfit = (state.left_out > LEFT_OUT) & ~is_lost
        if not (alarm | sudden | misfit).any():
            return np.zeros_like(state.task_code)
        blocks_back = np.where(alarm, memory, MEMORIES_BLOCKS[0])
        samples = np.maximum(self._rules.first_fit, (blocks_back * self._rules.block).astype(int))
        examination_samples: NDArray[np.int_] = np.where(
            alarm | sudden | misfit, np.where(sudden, state.since, samples), 0
        )
        put_off = (examination_samples > 0) & (
            state.position - state.examined_at < patience(state.in_vain, self._rules.block)
        )
        if not put_off.any():
            return examination_samples
        state.score = np.where(put_off[:, None, None], 0.0, state.score)
        state.information = np.where(put_off[:, None, None, None], 0.0, state.information)
        return np.where(put_off, 0, examination_samples)

    @staticmethod
    def _suspicion(
        state: EstimatorState, block: Block, is_lost: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.int_]]:
        """Count blocks in a row that mostly misfit, and the samples since the first of them."""
        if not is_lost.any():
            return 0.0 * state.suspicion, 0 * state.since
        suspicion = np.where(is_lost, state.suspicion + 1.0, 0.0)
        unfit = block.valid & ~block.is_inlier
        fresh = np.where(suspicion == 1.0, np.sum(np.cumsum(unfit, axis=1) > 0, axis=1), 0)
        return suspicion, np.where(
            is_lost, state.since + np.where(fresh > 0, fresh, unfit.shape[1]), 0
        )

    def _learn(self, motors: MotorSelection, block: Block) -> None:
        """Learn a block in which nothing is suspicious."""
        state = motors.state
        is_walking = state.walk_rate > 0.0
        passed_s = block.stretch.interval_s.sum(axis=1)
        walk_spread = None
        if is_walking.any():
            walk_spread = random_walk.Walk(self._heats, state.walk_rate).spread(passed_s)
        state.belief = block_step.learn(motors.white_box, state.belief, block, walk_spread)
        self._follow_noise(state, block)
        state.hold, state.belief = self._holds.update(
            state.hold, state.belief, block.stretch, block.path.factor
        )
        self._move_anchors(state, slice(None))

    def _move_anchors(self, state: EstimatorState, selection: Any) -> None:
        """Where a motor's anchor is about to be forgotten, test for drift or drop a new anchor."""
        is_walking = state.walk_rate[selection] > 0.0
        due = state.position[selection] - state.anchor_position[
            selection
        ] >= self._rules.replay_capacity // np.where(is_walking, 2, 1)
        if not due.any():
            return
        everyone = np.zeros(state.motors, dtype=bool)
        everyone[selection] = due & is_walking
        state.task_code = np.where(everyone, WALK_AGAIN, state.task_code)
        everyone[selection] = due & ~is_walking
        state.anchor_here(everyone)

    def _follow_noise(self, state: EstimatorState, block: Block) -> None:
        count = block.residual.shape[1]
        state.noise_count = np.minimum(state.noise_count + count, self._rules.noise_memory)
        mean_square = (np.where(block.is_inlier, block.residual / block.spread, 0.0) ** 2).sum(
            axis=1
        )
        mean_square = mean_square / np.maximum(block.inlier_count, 1)
        share = np.where(block.inlier_count > 0, count / state.noise_count, 0.0)
        before = state.belief.noise
        variance = before**2 + share * (mean_square - before**2)
        noise = np.maximum(np.sqrt(variance), self._rules.noise_floor * state.belief.current_a)
        noise = np.maximum(noise, state.least_noise)
        is_followed = state.hold.begun & np.isfinite(noise)  # what fits leave vague is in its units
        state.belief = replace(state.belief, noise=np.where(is_followed, noise, before))
