"""What the recursive rule does with motors that are due: fit everything, or learn a block.

Every motor of the group goes its own way: which of its samples are read is settled by its place in
its own stream (``Learnt.at``), and nothing that is decided for one depends on another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native.regular_block import (
    ANCHOR_DUE,
    LEARNT,
    LONG_HOLD,
    RegularBlocks,
    Turn,
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
    DriftTest,
)
from gray_box_observer.context_nodes.recursive.change_tracking import (
    FREE_EXAMINATIONS,
    Following,
    patience,
)
from gray_box_observer.context_nodes.recursive.constant_voltage import Holds
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import Learnt, chosen, copied, put
from gray_box_observer.context_nodes.recursive.linear_start import linear_start
from gray_box_observer.context_nodes.recursive.negligible import SIGMAS, voltage_shares
from gray_box_observer.context_nodes.recursive.normal_equations import solved
from gray_box_observer.context_nodes.recursive.sample_windows import Motors
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, Stretch
from gray_box_observer.samples.noise_floor import STEP_TO_STD, STILL, WITHIN_STEP, quantisation_step
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.settings.device import DEVICE_FROM, DEVICE_TURN
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

if TYPE_CHECKING:  # needs torch
    from gray_box_observer.context_nodes.recursive.device_blocks import DeviceBlocks

UPDATES = 1024
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


class Learner:
    """The recursion.

    Args:
        white_box: of all motors.
        rules: settings.
        replay: samples of all motors.
        following: examines those that seem to have changed.
        device: torch's, that learns the regular blocks of very many motors; None: compiled code
            learns them all.

    Attributes:
        turn: motors whose regular blocks are learnt at one sample of the group.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        rules: RecursiveSettings,
        replay: ReplayBuffer,
        following: Following,
        device: str | None = None,
    ) -> None:
        self._rules = rules
        self._replay = replay
        self._following = following
        self._holds = Holds(
            white_box.parameters, rules.long_hold_s, speed_measured=white_box.speed_measured
        )
        self._drift = DriftTest(rules.drift_threshold)
        self._heats = random_walk.heating(white_box.parameters)
        self._ordinary = RegularBlocks(white_box, rules, replay)
        self._on_device: DeviceBlocks | None = None
        self.turn = max(UPDATES, replay.motors // 16)
        if (
            device is not None
            and replay.motors >= DEVICE_FROM
            and isinstance(white_box, MotorWhiteBox)
        ):
            from gray_box_observer.context_nodes.recursive.device_blocks import DeviceBlocks

            self._on_device = DeviceBlocks(white_box, rules, replay, device)
            self.turn = max(DEVICE_TURN, replay.motors // 16)

    def fit(self, motors: Motors, samples: int) -> None:
        """Fit everything remembered, so many samples; the next time when that has doubled."""
        waits = self._wait_for_current(motors, motors.newest(samples))
        if not waits.any():
            self._fit(motors, samples)
        elif not waits.all():
            index = np.flatnonzero(~waits)
            part = motors.part(index)
            self._fit(part, samples)
            put(motors.learnt, index, part.learnt)

    def _wait_for_current(self, motors: Motors, stretch: Stretch) -> NDArray[np.bool_]:
        """Read the step of the current; hold back and name motors whose current moved no further.

        Nothing follows from a current that does not move: noise of the voltage would be taken for
        what moves it not.
        """
        known, step = motors.learnt, quantisation_step(stretch.state)
        known.least_noise = np.where(step > 0.0, STEP_TO_STD * step, known.least_noise)
        waits: NDArray[np.bool_] = ~known.started & (
            np.ptp(stretch.state, axis=1) <= WITHIN_STEP * step
        )
        if waits.any():
            motors.forget(AT_REST * self._rules.first_fit, waits)
            known.next_fit = np.where(
                waits, motors.remembered + self._rules.first_fit, known.next_fit
            )
        return waits

    def _fit(self, motors: Motors, samples: int) -> None:
        known = motors.learnt
        stretch, start = motors.newest(samples), known.belief.p
        fresh = ~known.started
        if np.any(fresh):
            start = np.where(
                fresh[:, None], self._first_guess(motors, known.prior, stretch, samples), start
            )
        fit = self._fitted(motors, stretch, start, known.prior)
        if (refuted := self._refuted(known.prior, fit.belief)).size:
            fit = self._fit_without(motors, samples, fit, refuted)
        known.started = np.ones_like(known.started)
        motors.take(fit.belief, np.ones_like(fresh))
        known.share = voltage_shares(motors.white_box, stretch)
        known.reach = SIGMAS * np.where(known.share > 0.0, fit.linear_std, 0.0) * known.share
        known.anchor = copied(self._open(fit.belief, known.prior, stretch))
        known.anchored = known.at - stretch.restart.shape[1]
        known.belief = self._holds.without_excitation(
            known.hold, known.belief, known.prior, stretch
        )
        known.hold = self._holds.fitted(known.hold, known.belief, stretch)
        settles = known.in_vain <= FREE_EXAMINATIONS
        if np.any(drifting := (fit.ramp > RAMP_EVIDENCE) & known.hold.begun & settles):
            self._following.drifting(motors, drifting)
        known.belief = self._holds.cut(known.hold, known.belief)

    def _fitted(self, motors: Motors, stretch: Stretch, start: Array, prior: Prior) -> Fit:
        least_noise = motors.learnt.least_noise
        return batch_fit(
            motors.white_box,
            stretch,
            start,
            prior,
            self._rules.noise_floor,
            least_noise=least_noise,
        )

    @staticmethod
    def _first_guess(motors: Motors, prior: Prior, stretch: Stretch, samples: int) -> Array:
        """Where a search begins that has nothing to go on but the samples."""
        return linear_start(motors.white_box, prior.p, stretch, min(LINEAR_WINDOW, samples // 4))

    def _vague(self, prior: Prior) -> Prior:
        """What is believed of motors of which nobody told anything but where to begin."""
        return Prior.of_parameters(prior.p, np.full(prior.p.shape, self._rules.prior_relative_std))

    def _refuted(self, prior: Prior, found: Belief) -> NDArray[np.intp]:
        """Places of motors whose data contradict what was stated about them."""
        away = np.log(found.p / prior.p)
        distance = (away * solved(prior.covariance, away[..., None])[..., 0]).sum(axis=1)
        sharp = prior.covariance.diagonal(0, 1, 2) < 0.5 * self._vague(prior).covariance.diagonal(
            0, 1, 2
        )
        return np.flatnonzero(found.finite & (distance > REFUTED) & sharp.any(axis=1))

    def _fit_without(self, motors: Motors, samples: int, fit: Fit, index: NDArray[np.intp]) -> Fit:
        """Fit some motors anew with a vague prior; adopt the fit where it fits better.

        A wrong value that is told as certain bends the others until the search ends where it should
        not.
        """
        part = motors.part(index)
        stretch, prior = part.newest(samples), self._vague(part.learnt.prior)
        start = self._first_guess(part, prior, stretch, samples)
        again = self._fitted(part, stretch, start, prior)
        gain = samples * np.log(fit.belief.noise[index] / again.belief.noise)
        better = again.belief.finite & (gain > FREE)
        if not better.any():
            return fit
        places, made = index[better], copied(fit)
        put(made, places, chosen(again, better))
        told = copied(motors.learnt.prior)
        put(told, places, chosen(prior, better))
        motors.learnt.prior = told
        return made

    @staticmethod
    def _open(found: Belief, prior: Prior, stretch: Stretch) -> Belief:
        """Belief at the beginning of a fitted window, had the window not been seen."""
        loose = random_walk.START_RELATIVE_STD**2 * np.eye(found.p.shape[1])
        covariance = np.zeros_like(found.covariance)
        covariance[:, COORDINATES, COORDINATES] = (
            np.minimum(prior.covariance, loose) / found.noise[:, None, None] ** 2
        )
        return replace(found, covariance=covariance).restarted_at(stretch.state[:, 0])

    def learn_due(
        self, known: Learnt, due: NDArray[np.int_], plain: NDArray[np.bool_]
    ) -> tuple[Learnt, Turn]:  # fmt: skip
        """As :meth:`RegularBlocks.learn_due`; a device for very many motors leaves all to do."""
        if self._on_device is not None:
            return known, Turn.left(due.size)
        return self._ordinary.learn_due(known, due, plain, self.turn)

    def learn_ordinary(
        self, known: Learnt, motors: NDArray[np.intp], due: NDArray[np.int_],
        plain: NDArray[np.bool_]
    ) -> tuple[Learnt, NDArray[np.uint8]]:  # fmt: skip
        """As :meth:`RegularBlocks.learn`, of very many on the device."""
        many = None if motors.size < DEVICE_FROM else self._on_device
        return (many or self._ordinary).learn(known, motors, due, plain)

    def attend(self, known: Learnt, motors: NDArray[np.intp], told: NDArray[np.uint8]) -> None:
        """Finish regular blocks; only those told as LEARNT need no new reckoning of what is due."""
        if not (told > LEARNT).any():
            return
        if (long := motors[told & LONG_HOLD > 0]).size:
            put(
                known.belief,
                long,
                self._holds.cut(chosen(known.hold, long), chosen(known.belief, long)),
            )
        if (far := motors[told & ANCHOR_DUE > 0]).size:
            self._move_anchors(known, far)

    def update(self, motors: Motors, samples: int) -> None:
        """Learn one block of samples; request an examination where the motor seems changed."""
        known = motors.learnt
        stretch, fresh, expected = motors.newest(samples + 1), ~known.hold.begun, known.belief
        if fresh.any():  # what is vague must not make everything seem possible
            expected = replace(
                expected, covariance=np.where(fresh[:, None, None], 0.0, expected.covariance)
            )
        block = block_step.predict(motors.white_box, expected, stretch)
        still = np.ptp(stretch.state, axis=1) <= STILL * known.least_noise
        if (silent := fresh | (still & (known.least_noise > 0.0))).any():
            block = block.silenced(silent)
        known.outliers = known.outliers + (block.samples - block.used)
        known.kicks = known.kicks + block.kicked
        known.asked = self._suspects(known, block)
        if fresh.any():
            self._look_at_rest(motors, fresh, block)
        calm = known.asked == 0
        if calm.all():
            self._learn(motors, block)
        elif calm.any():
            index = np.flatnonzero(calm)
            part = motors.part(index)
            self._learn(part, block.of(index))
            put(known, index, part.learnt)
        if (begun := fresh & known.hold.begun).any():
            self._begin_again(motors, begun, AT_REST * self._rules.first_fit, self._rules.first_fit)

    def _look_at_rest(self, motors: Motors, fresh: NDArray[np.bool_], block: Block) -> None:
        """Ask whether motors only ever at rest now rest elsewhere, at the same voltage."""
        known = motors.learnt
        sudden = fresh & (known.suspicion >= SUSPICIOUS_BLOCKS)
        if np.any(elsewhere := sudden & self._holds.same(known.hold, block.stretch)):
            known.alarms = known.alarms + elsewhere
            self._begin_again(motors, elsewhere, self._rules.first_fit, 0)
        known.asked = np.where(fresh, 0, known.asked)

    def _begin_again(self, motors: Motors, which: NDArray[np.bool_], keep: int, more: int) -> None:
        """Restart some motors from their newest samples, with a fit of these and so many more.

        A motor that has only been at rest is too far from what it will prove to be for the
        recursion to get there.
        """
        known = motors.learnt
        motors.forget(keep, which)
        known.started = known.started & ~which
        known.next_fit = np.where(which, motors.remembered + more, known.next_fit)
        known.suspicion, known.left_out = (
            np.where(which, 0.0, known.suspicion),
            np.where(which, 0.0, known.left_out),
        )

    def _suspects(self, known: Learnt, block: Block) -> NDArray[np.int_]:
        """How many of the newest samples to examine where the motor seems changed; 0 elsewhere."""
        belief = known.belief
        size = belief.current_a[:, None]
        reached = block.jacobian[:, -1, COORDINATES] + block.path.by_start[:, -1:] * (
            belief.sensitivity * size
        )
        scores, alarm, memory = self._drift.take(
            (known.score, known.information), *block_step.surprise(belief, block)
        )
        known.score, known.information = scores
        known.belief = replace(belief, sensitivity=reached / size)
        lost = (block.used < 0.5 * block.samples) | (block.kicked & ~known.hold.begun)
        known.suspicion, known.since = self._suspicion(known, block, lost)
        sudden = known.suspicion >= SUSPICIOUS_BLOCKS
        known.left_out = (
            LEFT_OUT_MEMORY * known.left_out + (block.samples - block.used) / block.kept.shape[1]
        )
        # outliers by the dozen, in a fit that goes on between them: transitions, perhaps, of
        # another inductance
        misfit = (known.left_out > LEFT_OUT) & ~lost
        if not (alarm | sudden | misfit).any():
            return np.zeros_like(known.asked)
        blocks_back = np.where(alarm, memory, MEMORIES_BLOCKS[0])
        samples = np.maximum(self._rules.first_fit, (blocks_back * self._rules.block).astype(int))
        asked: NDArray[np.int_] = np.where(
            alarm | sudden | misfit, np.where(sudden, known.since, samples), 0
        )
        put_off = (asked > 0) & (
            known.at - known.examined < patience(known.in_vain, self._rules.block)
        )
        if not put_off.any():
            return asked
        known.score = np.where(put_off[:, None, None], 0.0, known.score)
        known.information = np.where(put_off[:, None, None, None], 0.0, known.information)
        return np.where(put_off, 0, asked)

    @staticmethod
    def _suspicion(
        known: Learnt, block: Block, lost: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.int_]]:
        """Count blocks in a row that mostly misfit, and the samples since the first of them."""
        if not lost.any():
            return 0.0 * known.suspicion, 0 * known.since
        suspicion = np.where(lost, known.suspicion + 1.0, 0.0)
        unfit = block.valid & ~block.kept
        fresh = np.where(suspicion == 1.0, np.sum(np.cumsum(unfit, axis=1) > 0, axis=1), 0)
        return suspicion, np.where(
            lost, known.since + np.where(fresh > 0, fresh, unfit.shape[1]), 0
        )

    def _learn(self, motors: Motors, block: Block) -> None:
        """Learn a block in which nothing is suspicious."""
        known = motors.learnt
        walking = known.walk_rate > 0.0
        passed_s, walked = block.stretch.interval_s.sum(axis=1), None
        if walking.any():
            walked = random_walk.Walk(self._heats, known.walk_rate).spread(passed_s)
        known.belief = block_step.learn(motors.white_box, known.belief, block, walked)
        self._follow_noise(known, block)
        known.hold, known.belief = self._holds.take(
            known.hold, known.belief, block.stretch, block.path.factor
        )
        self._move_anchors(known, slice(None))

    def _move_anchors(self, known: Learnt, which: Any) -> None:
        """Where a motor's anchor is about to be forgotten, test for drift or drop a new anchor."""
        walking = known.walk_rate[which] > 0.0
        due = known.at[which] - known.anchored[which] >= self._rules.replay_capacity // np.where(
            walking, 2, 1
        )
        if not due.any():
            return
        everyone = np.zeros(known.motors, dtype=bool)
        everyone[which] = due & walking
        known.asked = np.where(everyone, WALK_AGAIN, known.asked)
        everyone[which] = due & ~walking
        known.anchor_here(everyone)

    def _follow_noise(self, known: Learnt, block: Block) -> None:
        count = block.residual.shape[1]
        known.noise_count = np.minimum(known.noise_count + count, self._rules.noise_memory)
        seen = (np.where(block.kept, block.residual / block.spread, 0.0) ** 2).sum(axis=1)
        seen = seen / np.maximum(block.used, 1)
        share = np.where(block.used > 0, count / known.noise_count, 0.0)
        before = known.belief.noise
        variance = before**2 + share * (seen - before**2)
        noise = np.maximum(np.sqrt(variance), self._rules.noise_floor * known.belief.current_a)
        noise = np.maximum(noise, known.least_noise)
        followed = known.hold.begun & np.isfinite(noise)  # what fits leave vague is in its units
        known.belief = replace(known.belief, noise=np.where(followed, noise, before))
