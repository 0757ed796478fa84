"""The default rule: efficient recursive maximum likelihood with an honest covariance.

Route (docs/METHOD.md): a linear start on the integrated equation; Gauss-Newton on the prediction
error over everything remembered, repeated each time the data have doubled; in between, block by
block, a Kalman update of (state, coordinates) with exact zero-order-hold sensitivities. Repeating
the fit takes out what early linearisation had spoilt, so that the recursion stands where the batch
estimate stands; with white torque noise that is the Cramer-Rao bound.

Robust: outliers of torque are weighted out; a wrong voltage sample shows as a kick of the state and
is met by letting the state, not the parameters, go. A changed motor is detected
(:mod:`change_test`), the estimate settles on the new data; a winding that heats is given freedom to
walk (:mod:`random_walk`); a voltage held for long moves nothing else (:mod:`constant_voltage`).

:mod:`block_updater` does the work; here it is dealt out. Motors learn what each would learn alone,
from its own stream of samples; where many are due at once they take turns over the next samples, by
number of samples and never by a clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import (
    Estimate,
    VerdictSettings,
    bounded,
    spread_of_values,
)
from gray_box_observer.context_nodes.native.regular_block import LEARNT, BatchResult
from gray_box_observer.context_nodes.native.regular_estimate import RegularEstimates
from gray_box_observer.context_nodes.recursive.belief import (
    Prior,
)
from gray_box_observer.context_nodes.recursive.block_updater import WALK_AGAIN, BlockUpdater
from gray_box_observer.context_nodes.recursive.change_tracking import ChangeTracker
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import (
    EstimatorState,
    chosen,
    copied,
    put,
)
from gray_box_observer.context_nodes.recursive.normal_equations import definite
from gray_box_observer.context_nodes.recursive.sample_windows import MotorSelection
from gray_box_observer.context_nodes.recursive.saved_estimator import check, restored, saved_arrays
from gray_box_observer.context_nodes.recursive.schedule import UpdateSchedule
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES
from gray_box_observer.context_nodes.update_rule import check_parameters
from gray_box_observer.samples.order_statistics import distinct
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.flow import parameter_covariance, to_coordinates, to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox, bounds

Work = Callable[[MotorSelection, int], None]
"""A piece of work on some motors and so many of their newest samples."""


class RecursiveEstimator:
    """Context nodes learnt by recursive maximum likelihood.

    Args:
        white_box: the physics.
        initial: shape (motor, parameter): where to start, SI units.
        seed: unused; every rule takes one.
        rules: settings.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (motor, parameter): how well the initial values are known,
            relative to them; 0: as vaguely as the rules say. None: all of them.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        initial: Array,
        seed: int = 0,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
    ) -> None:
        self._white_box = white_box
        self._rules = rules or RecursiveSettings()
        self.verdict_rules = verdict_rules or VerdictSettings()
        self._lower, self._upper = bounds(white_box.parameters)
        theta = np.clip(np.asarray(initial, dtype=float), self._lower, self._upper)
        motors = theta.shape[0]
        vague = np.full(theta.shape, self._rules.prior_relative_std)
        stated_std = vague if initial_relative_std is None else initial_relative_std
        relative_std = np.where(stated_std > 0.0, stated_std, vague)
        prior = Prior.of_parameters(to_coordinates(theta), relative_std)
        self._state = EstimatorState.nothing(prior, self._rules.first_fit)
        self.replay = ReplayBuffer(
            motors,
            self._rules.replay_capacity,
            speed_measured=white_box.speed_measured,
            with_moves=motors == 1,  # of one that goes over to a rotor
        )
        self._changes = ChangeTracker(white_box.parameters, self._rules)
        self._regular = RegularEstimates(white_box.parameters, motors)
        self._updater = BlockUpdater(white_box, self._rules, self.replay, self._changes)
        self._fit_work: dict[int, Work] = {
            0: self._updater.fit,
            1: self._changes.examine,
            WALK_AGAIN: self._changes.walk_again,
        }
        self._schedule = UpdateSchedule(self._rules, self.replay)
        self._schedule.plan(self._state, slice(None))
        self._nobody = np.zeros(motors, dtype=bool)
        self._has_changed = self._nobody
        self._stamp_ns = 0
        self._is_frozen = False
        self._resumes: NDArray[np.bool_] | None = None
        self._speed = np.zeros(motors)

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        return np.clip(to_parameters(self._state.belief.p), self._lower, self._upper)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimate the last sample has changed, shape (motor,)."""
        return self._has_changed

    @property
    def noise_std_nm(self) -> Array:
        """Estimated standard deviation of the torque noise in N m, shape (motor,)."""
        return self._white_box.output(self._state.belief.noise)

    @property
    def change_count(self) -> int:
        """How often a motor was found changed."""
        return int(self._state.change_count.sum())

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """Samples left out, state kicks, changes, and drift, of one motor or of all."""
        state = self._state
        counts = {
            'torque outliers': state.outliers,
            'state kicks': state.kicks,
            'motor changes': state.change_count,
            'motors that drift': state.walk_rate > 0.0,
        }
        if motor is None:
            return {name: int(count.sum()) for name, count in counts.items()}
        return {name: int(count[motor]) for name, count in counts.items()}

    def present_since(self, motor: int) -> int:
        """Return the place from which one motor is the present one: that of its last change."""
        return self.replay.begin_of(motor)

    def is_drifting(self, motor: int) -> bool:
        """Tell whether one motor is known to drift."""
        return bool(self._state.walk_rate[motor] > 0.0)

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return one motor's voltage shares per unit of parameter, and their 3-sigma bound."""
        return self._state.share[motor], self._state.reach[motor]

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; frozen samples are not kept, a new signal history follows."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen = is_frozen
        self._resumes = None if is_frozen else np.ones_like(self._nobody)

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts, of all motors or of some."""
        belief = self._state.belief
        parameters = self._white_box.parameters
        everyone = isinstance(selection, slice) and selection == slice(None)
        motors = None if everyone else np.arange(self.replay.motors)[selection]
        values = None if self._is_frozen else self._compiled_values(motors)
        if values is not None:
            return Estimate(self._stamp_ns, parameters, *values)
        theta = to_parameters(belief.p[selection])
        posterior = (
            belief.covariance[selection, COORDINATES, COORDINATES]
            * belief.noise[selection, None, None] ** 2
        )
        covariance, theta = (
            parameter_covariance(theta, posterior),
            theta.clip(self._lower, self._upper),
        )
        covariance = spread_of_values(theta, 0.5 * (covariance + covariance.swapaxes(1, 2)))
        covariance = definite(bounded(theta, covariance), theta)
        std = np.sqrt(covariance.diagonal(0, 1, 2))
        share = self._state.share[selection]
        most = np.where(share > 0.0, theta * share + self._state.reach[selection], np.inf)
        verdicts = self.verdict_rules.judge(
            parameters, theta, std, is_frozen=self._is_frozen, most=most
        )
        return Estimate(self._stamp_ns, parameters, theta, covariance, verdicts)

    def _compiled_values(self, motors: NDArray[np.intp] | None) -> tuple[Any, ...] | None:
        """Let compiled code work out the estimate of some motors; None where it does not."""
        state = self._state
        return self._regular.estimate(
            state.belief, motors, self.verdict_rules, state.share, state.reach
        )

    def learn(self, sample: Sample) -> bool:
        """Take one sample and do what is due. Tell whether an estimate changed; see ``changed``."""
        if self._white_box.speed_measured:  # without its speed the speed before holds on
            has_speed = np.isfinite(sample.speed_rad_s)
            if sample.present is not None:
                has_speed &= sample.present
            self._speed = np.where(has_speed, sample.speed_rad_s, self._speed)
        self._stamp_ns = sample.stamp_ns
        self._has_changed = self._nobody
        if self._is_frozen:
            return False
        if self._resumes is not None:
            sample, self._resumes = sample.resuming(self._resumes)
        self.replay.append(sample, self._speed)
        if self._schedule.sleeps:
            return False
        self.replay.settle()
        self._state, batch = self._updater.learn_due(self._state, self._schedule)
        self._has_changed = batch.has_learnt
        if batch.wait:  # all blocks that were due, and nothing else
            self._schedule.sleep(batch.wait)
            return batch.motors is not None and batch.motors.size > 0
        with np.errstate(over='ignore', invalid='ignore', divide='ignore'):  # checked later
            self._finish(batch)
        return bool(self._has_changed.any())

    def _finish(self, batch: BatchResult) -> None:
        """Do what is due and has not been done, as much of it as one sample's turn allows."""
        motors = batch.motors
        status = batch.status
        if motors is None:
            motors = self._schedule.due_blocks(self._updater.batch_size)
            self._state, status = self._updater.learn_regular(self._state, motors, self._schedule)
        self._has_changed[motors] = status > 0
        self._updater.handle_flags(self._state, motors, status)
        if (flagged_motors := motors[status > LEARNT]).size:
            self._schedule.plan(self._state, flagged_motors)
        if (irregular := motors[status == 0]).size:
            irregular = self._schedule.numpy_blocks(irregular)
            samples = self._schedule.next_update_at[irregular] - self._state.position[irregular]
            self._work(irregular, samples, self._updater.update)
        while (fits := self._schedule.next_fits(self._state)) is not None:
            work = self._fit_work[fits.kind]
            self._work(fits.motors, np.full(fits.motors.size, fits.samples), work)
            if not self._schedule.is_late:
                break
        self._schedule.sleep()

    def _work(self, motors: NDArray[np.intp], samples: NDArray[np.int_], work: Work) -> None:
        """Do a piece of work for some motors, in order, by equal numbers of samples."""
        self._state.position[motors] = self._schedule.next_update_at[motors]
        counts = samples[:1] if (samples == samples[0]).all() else distinct(samples)
        for count in counts.tolist():
            alike = motors if counts.size == 1 else motors[samples == count]
            if alike.size == self.replay.motors:
                everyone = slice(None)
                work(MotorSelection(self._white_box, self.replay, everyone, self._state), count)
                if alike.size > 1:  # nothing that is written to later may be shared
                    self._state = copied(self._state)
            else:
                part = MotorSelection.select(self._white_box, self.replay, self._state, alike)
                work(part, count)
                put(self._state, part.motor_index, part.state)
        index: Any = slice(None) if motors.size == self.replay.motors else motors
        self._has_changed[index] = True
        self._schedule.plan(self._state, index)

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of one motor, as plain values and arrays with a motor axis of one."""
        selection = slice(motor, motor + 1)
        state = chosen(self._state, selection)
        received_count = int(self.replay.received[motor])
        more = received_count - int(state.position[0])
        content = self.replay.content(selection, more, with_forgotten=True)
        plain: dict[str, Any] = {
            'new': received_count - int(state.position[0]),
            'next_fit': int(state.next_fit_at[0]),
            'started': bool(state.is_started[0]),
            'stamp_ns': self._stamp_ns,
            'noise_count': int(state.noise_count[0]),
            'resumes': self._resumes is not None and bool(self._resumes[motor]),
            'parameters': [p.name for p in self._white_box.parameters],
            'anchored': int(state.anchor_position[0]) - received_count,
            'examined': int(state.examined_at[0]) - received_count,
            'gone': received_count - content.shape[2],
            'begin': int(self.replay.begin(selection)[0]),
            'asked': int(state.task_code[0]),
        }
        arrays = saved_arrays(state)
        arrays |= {'speed': self._speed[selection].copy(), 'replay': content}
        return plain, arrays

    def restore(
        self, plain: dict[str, Any], arrays: dict[str, Array], motor: int | slice = 0
    ) -> None:
        """Take back what :meth:`state` gave, for one motor, or for each of several.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        parameters = self._white_box.parameters
        selection = motor if isinstance(motor, slice) else slice(motor, motor + 1)
        check_parameters(plain, parameters)
        check(plain, arrays, len(parameters))
        content = arrays['replay']
        begin = plain['begin']
        new = plain['new']
        if new > min(content.shape[2], self.replay.capacity // 2):  # from a larger memory
            new = 0
        if content.shape[2] - new < self.replay.capacity:  # less is there than may be remembered
            begin = max(begin, plain['gone'])
        self.replay.refill(content, selection, plain['gone'], begin)
        received_count = self.replay.received[selection]
        part = restored(
            chosen(self._state, selection), {**plain, 'new': new}, arrays, received_count
        )
        put(self._state, selection, part)
        self._speed[selection] = arrays['speed']
        self._stamp_ns = max(self._stamp_ns, plain['stamp_ns'])
        if plain['resumes']:
            self._resumes = np.zeros_like(self._nobody) if self._resumes is None else self._resumes
            self._resumes[selection] = True
        self._schedule.plan(self._state, selection)
        self._schedule.wake()
