"""Training while motors run: what network and correction are taught, when, with what result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.predictor.forecaster import RunningNetwork
from gray_box_observer.predictor.lag_features import LONGEST
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.operating_range import OperatingRange, saved_range
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.residual_model import ResidualForecaster
from gray_box_observer.predictor.training.residual_schedule import (
    ResidualSchedule,
    have_moved,
    newest,
)
from gray_box_observer.predictor.training.saved_training import check_job, check_learning
from gray_box_observer.predictor.training.segments import SEGMENT, SIGNALS
from gray_box_observer.predictor.training.training_backend import Training
from gray_box_observer.safe_io.saved_state import MOST, check_array, counts, positive
from gray_box_observer.samples.replay_buffer import ReplayBuffer, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array


class OnlineTraining:
    """Remembers samples, hands them over as jobs, one at a time, and runs the results.

    Nothing of a motor is learnt twice: what is settled rests until the motor or its range moves.

    Args:
        motors: number of motors; they take turns, a job is of one motor.
        rules: settings.
        training: where jobs run.
        network: that runs.
        residual: runs the correction, which is learnt of a single motor only.
        speed_measured: whether speed is a signal; else whoever predicts sees none, and nobody must
            be taught with it.

    Attributes:
        replay: samples that jobs are made of.
        jobs_done: jobs whose result was taken.
        jobs_late: how often a job was not done when the next one was due.
        loss: of the newest job; None before the first.
    """

    def __init__(
        self, motors: int, rules: TrainingSettings, training: Training, network: RunningNetwork,
        residual: ResidualForecaster, *, speed_measured: bool,
    ) -> None:  # fmt: skip
        self._motors = motors
        self._rules = rules
        self._training = training
        self._network = network
        self._residual = residual
        self._no_speed = None if speed_measured else np.full(motors, np.nan)
        self._schedule = ResidualSchedule(motors, rules)
        # of a group no residual is learnt, and a job carries its newest samples only
        self.replay = ReplayBuffer(
            motors, rules.replay_capacity if motors == 1 else rules.job_samples
        )
        self.jobs_done = 0
        self.jobs_late = 0
        self.loss: float | None = None
        self._is_frozen = False
        self._resumes: NDArray[np.bool_] | None = None  # whose history begins anew
        self._range_seen = OperatingRange()
        self._start_from: dict[str, Any] = {}
        self._settled_states: dict[int, tuple[Array, OperatingRange]] = {}
        self._turn = 0
        self._job: dict[str, Any] = {}
        self._trainer_state: dict[str, Array] = {}

    def update(
        self,
        sample: Sample,
        speed_rad_s: Array,
        physics_nm: Array,
        theta: Array,
        covariance: Array | None = None,
    ) -> None:
        """Remember a sample, and start or finish a job when one is due.

        Args:
            sample: what came.
            speed_rad_s: shape (motor,): speed at its stamp, the one before where none came.
            physics_nm: shape (motor,): what the physics had said of it; NaN where nothing.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
            covariance: shape (motor, parameter, parameter): how uncertain they are; None: not at
                all.
        """
        if self._is_frozen:
            return
        speed_rad_s = speed_rad_s if self._no_speed is None else self._no_speed
        if self._resumes is not None:
            sample, self._resumes = sample.resuming(self._resumes)
        self.replay.append(sample, speed_rad_s)
        self._schedule.follow(self.replay, physics_nm)
        if self.replay.total % self._rules.period == 0:
            self._train(
                theta,
                np.zeros((*theta.shape, theta.shape[1])) if covariance is None else covariance,
            )

    @property
    def due_next(self) -> bool:
        """Whether a job may start or finish with the next sample."""
        return not self._is_frozen and (self.replay.total + 1) % self._rules.period == 0

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume; frozen samples are not kept, and a new signal history follows."""
        if is_frozen == self._is_frozen:
            return
        self._is_frozen = is_frozen
        self._resumes = None if is_frozen else np.ones(self._motors, dtype=bool)

    def refill(self, content: Array) -> None:
        """Remember these samples instead, paired anew; drops what was learnt beside the physics.

        Args:
            content: shape (signal, motor, n), see :meth:`ReplayBuffer.content`.
        """
        if self._no_speed is not None:
            content = content.copy()
            content[SIGNALS.index('speed_rad_s')] = np.nan
        self.replay.refill(content)
        self._begin_residual_anew(from_number=self.replay.total - len(self.replay))

    def share(self, core_share: float) -> None:
        """Change the share of a core that jobs in the background may use."""
        self._training.share = core_share

    def close(self) -> None:
        """Stop for good."""
        self._training.close()

    @property
    def failure(self) -> str | None:
        """Why training has ended for good, if it has."""
        return self._training.failure

    def state(self, motor: int = 0) -> dict[str, Array]:
        """Operating ranges and all that one motor's training depends on but the running network.

        A job whose result is still to come is saved as it was handed over: it is run again.
        """
        common = {
            **_prefixed('seen', self._range_seen.to_dict()),
            'replay': self.replay.content(slice(motor, motor + 1)),
            'total': np.array(self.replay.total),
        }
        if motor in self._settled_states:
            theta, range_seen = self._settled_states[motor]
            common |= {'settled_theta': theta, **_prefixed('settled_seen', range_seen.to_dict())}
        if self._motors > 1:  # training goes on from the network, whichever motor's turn it was
            return common
        return {
            **common,
            **{f'schedule_{name}': array for name, array in self._schedule.state().items()},
            **self._trainer_state,
            **{
                f'job_{name}': np.asarray(value)
                for name, value in self._job.items()
                if name != 'seen'
            },
            **_prefixed('job_seen', self._job.get('seen', {})),
        }

    def restore(self, arrays: Mapping[str, Array], motor: int = 0) -> None:
        """Restore one motor's part of :meth:`state`, after its network; training goes on.

        Raises:
            CheckpointError: it is no state that could have been.
        """
        self._check(arrays)
        if 'replay' in arrays:  # a network alone may be taken over too
            self.replay.refill(arrays['replay'], slice(motor, motor + 1))
        self._settled_states.pop(motor, None)
        if 'settled_theta' in arrays:
            self._settled_states[motor] = (
                arrays['settled_theta'].copy(),
                saved_range(arrays, 'settled_seen'),
            )
        if self._motors > 1:
            self._range_seen = self._range_seen.union(saved_range(arrays, 'seen'))
            self._start_from = self._network.start()
            return
        self._range_seen = saved_range(arrays, 'seen')
        if 'schedule_theta' in arrays:  # neither a network alone nor a motor of a group brings one
            self.replay.total = int(arrays['total'])
            self._schedule.restore(
                {name[9:]: array for name, array in arrays.items() if name.startswith('schedule_')}
            )
        self._trainer_state = {
            name: array for name, array in arrays.items() if name.startswith('learning_')
        }
        self._start_from = {
            **self._network.start(),
            **{f'start_{name}': array for name, array in self._trainer_state.items()},
        }
        job = {name[4:]: array.copy() for name, array in arrays.items() if name.startswith('job_')}
        if job:
            job_arrays = {
                name: array for name, array in job.items() if not name.startswith('seen_')
            }
            residual = bool(job['residual'])
            self._submit(
                {**job_arrays, 'residual': residual, 'seen': saved_range(job, 'seen').to_dict()}
            )

    def _check(self, arrays: Mapping[str, Array]) -> None:
        """Refuse a saved state that could not have been.

        Raises:
            CheckpointError: an array is missing, of another shape or out of range.
        """
        if 'replay' in arrays:
            check_signals('replay', arrays['replay'])
        if 'settled_theta' in arrays:
            check_array('settled_theta', arrays['settled_theta'], positive(1, None))
        check_learning(arrays, self._rules.variant)
        check_job(arrays)
        if 'schedule_theta' in arrays:
            check_array('total', arrays.get('total'), counts())
            total = int(arrays['total'])
            for name in ('schedule_asked', 'schedule_from'):
                check_array(name, arrays.get(name), counts(low=-MOST, high=total))
            if 'schedule_first' in arrays:
                check_array(
                    'schedule_first',
                    arrays['schedule_first'],
                    counts(None, low=-MOST, high=total - SEGMENT),
                )

    def _train(self, theta: Array, covariance: Array) -> None:
        """Adopt the finished job's network and hand over the next; never wait for a late job."""
        signals = (self.replay.voltage_v, self.replay.interval_s, self.replay.speed_rad_s)
        self._range_seen = self._range_seen.extend_to(
            *(signal(self._rules.period) for signal in signals)
        )
        if self._training.busy:
            result = self._training.collect()
            if result is None:
                self.jobs_late += 1
                return
            self._adopt(result)
        if self._schedule.has_moved(
            theta, covariance
        ):  # what was learnt of other parameters is worth nothing now
            self._begin_residual_anew(from_number=self.replay.total)
        residual = self._schedule.is_due(self.replay)
        turn = self._turn
        motor_slice = slice(self._turn, self._turn + 1)
        self._turn = (self._turn + 1) % self._motors
        idle = (
            self._nothing_to_gain(turn, theta[motor_slice], covariance[motor_slice])
            and not residual
        )
        remembered_count = int(self.replay.remembered(motor_slice)[0])
        if self._training.is_resting or idle or remembered_count < self._rules.length:
            return
        anew = residual and self._schedule.anew
        count = min(remembered_count, self._rules.job_samples)
        samples = (
            self._schedule.job(self.replay) if residual else newest(self.replay, count, motor_slice)
        )
        self._submit(
            {
                **samples,
                'theta': theta[motor_slice].copy(),
                'covariance': covariance[motor_slice].copy(),
                'seen': self._range_seen.to_dict(),
                'residual': residual,
                'residual_anew': anew,
                'motor': turn,
            }
        )

    def _begin_residual_anew(self, from_number: int) -> None:
        self._schedule.begin_anew(from_number)
        self._residual.correction = None

    def _submit(self, job: dict[str, Any]) -> None:
        self._job = job
        self._training.submit({**job, **self._start_from})
        self._start_from = {}

    def _nothing_to_gain(self, motor: int, theta: Array, covariance: Array) -> bool:
        if motor not in self._settled_states:
            return False
        settled_theta, settled_range = self._settled_states[motor]
        return settled_range == self._range_seen and not have_moved(
            theta, settled_theta, covariance
        )

    def _adopt(self, result: dict[str, Any]) -> None:
        self.jobs_done += 1
        job, self._job = self._job, {}
        motor = int(job['motor'])
        if (
            'input' in result and not Weights.from_arrays(result).finite
        ):  # the trainer begins anew from the network that runs
            self._trainer_state = {}
            self._start_from = self._network.start()
            return
        self._trainer_state = {
            name: array for name, array in result.items() if name.startswith('learning_')
        }
        self._settled_states.pop(motor, None)
        if result.get('settled'):
            # for what the job was of: the motor and its range may have moved while it ran
            self._settled_states[motor] = job['theta'], OperatingRange.from_dict(job['seen'])
        self.loss = result.get('loss', self.loss)
        if not self._schedule.anew:  # else it was learnt of parameters that are no more
            self._residual.adopt(result, newest(self.replay, LONGEST))
        if 'input' in result:
            self._network.adopt(result)


def _prefixed(prefix: str, bounds: Mapping[str, Any]) -> dict[str, Array]:
    """Name the entries of an operating range as arrays."""
    return {f'{prefix}_{name}': np.array(pair) for name, pair in bounds.items()}
