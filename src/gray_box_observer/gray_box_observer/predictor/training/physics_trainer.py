"""Training of variant ``physics`` on drawn sequences; a network runs only if it is better.

The physics needs no recorded torque, so recorded samples are all held out: they judge, they never
teach.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from gray_box_observer.predictor.initial_network import first_network
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.operating_range import OperatingRange
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.training import random_state
from gray_box_observer.predictor.training.histories import histories, newest_history
from gray_box_observer.predictor.training.physics_batches import (
    TrainingBatch,
    exact_run,
    free_run,
    free_run_error,
    training_batch,
)
from gray_box_observer.predictor.training.residual_trainer import ResidualTrainer
from gray_box_observer.predictor.training.synthetic_sequences import (
    Sequences,
    draw_around,
    draw_family,
)
from gray_box_observer.predictor.training.trainer import Message
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # torch is imported when there is something to learn, not before
    from gray_box_observer.predictor.training.teaching import TrainableNetwork

LENGTH = 24
"""Intervals of a drawn sequence."""

HELD_OUT = 48
"""Held-out sequences of either kind."""

ENOUGH = 5e-4
"""Mean error of the free run, in units of the spread, below which no motor is known well enough to
gain from more."""

BETTER = 0.98
"""Factor by which a new network's error must fall short of the running one's."""

FORGETS = 1.05
"""Largest factor by which its error on the whole family may rise: what was learnt of other regimes
stays."""


class PhysicsTrainer:
    """Holds the network that runs, the one under training, and what both are judged by.

    Args:
        configuration: that of :func:`~.trainer_choice.make_trainer`.
    """

    def __init__(self, configuration: Mapping[str, Any]) -> None:
        self._group = MotorWhiteBox.from_dict(configuration['white_box'], _constant)
        self._white_box = self._group
        self._rules = TrainingSettings.from_dict(configuration['rules'])
        self._seed = int(configuration['seed'])
        self._random = np.random.default_rng([self._seed, 1])
        self._current_network = first_network(self._rules, self._seed)
        self._trainable: TrainableNetwork | None = None
        self._refusal_count = 0
        self._residual = ResidualTrainer(self._seed, self._rules.device)
        self._family = _HeldOut(
            draw_family(np.random.default_rng([self._seed, 2]), HELD_OUT, LENGTH)
        )

    def train(self, job: Message) -> Message:
        """Run one job; see :meth:`~gray_box_observer.predictor.training.trainer.Trainer.train`.

        Raises:
            ImportError: there is something to learn, and no torch to learn it with.
        """
        if 'motor' in job:
            motor = int(job['motor'])
            self._white_box = self._group.of_motors(slice(motor, motor + 1))
        answer = self._teach(job)
        if job.get('residual_anew'):
            self._residual = ResidualTrainer(self._seed, self._rules.device)
        if job.get('residual'):
            answer |= self._residual.learn(self._current_network, histories(self._white_box, job))
        return {**answer, **{f'learning_{name}': array for name, array in self._state().items()}}

    def _teach(self, job: Message) -> Message:
        """Teach the physics; say what came of it."""
        if 'start_input' in job:
            self._current_network = Weights(
                **{name: job[f'start_{name}'] for name in Weights.__dataclass_fields__}
            )
            self._restore(
                {
                    name[15:]: array
                    for name, array in job.items()
                    if name.startswith('start_learning_')
                }
            )
        range_seen = OperatingRange.from_dict(job['seen'])
        if not range_seen.tells(self._white_box.speed_measured):
            return {'windows': 0, 'settled': False}
        own = _HeldOut(
            self._draw(np.random.default_rng([self._seed, 3]), job, range_seen, HELD_OUT)
        )
        now = own.error(self._current_network)
        if now <= ENOUGH:
            return {'windows': 0, 'settled': True, 'error': now}
        if self._trainable is None:
            self._trainable = self._start_training()
        losses = [
            self._trainable.learn(self._training_batch(job, range_seen))
            for _ in range(self._rules.steps)
        ]
        answer: Message = {
            'windows': 2 * self._rules.steps * self._rules.minibatch,
            'loss': float(np.mean(losses)),
        }
        candidate = self._trainable.weights
        if self._better(candidate, own, now, job):
            self._current_network = candidate
            self._refusal_count = 0
            answer |= self._current_network.arrays()
        else:
            self._refusal_count += 1
        is_settled = self._refusal_count >= self._rules.patience
        if is_settled:
            self._trainable = None
            self._refusal_count = 0
        return {**answer, 'settled': is_settled, 'error': own.error(self._current_network)}

    def _state(self) -> dict[str, Array]:
        """Everything but the running network that the next job depends on."""
        trainable = (
            {}
            if self._trainable is None
            else {f'pupil_{k}': v for k, v in self._trainable.state().items()}
        )
        residual = {f'residual_{k}': v for k, v in self._residual.state().items()}
        return {
            **trainable,
            **residual,
            'refused': np.array(self._refusal_count),
            'random': random_state.pack(self._random),
        }

    def _restore(self, arrays: dict[str, Array]) -> None:
        """Take back what :meth:`_state` gave; start over where that was not saved."""
        self._trainable = None
        self._residual = ResidualTrainer(self._seed, self._rules.device)
        if 'random' not in arrays:
            return
        self._random = random_state.unpack(arrays['random'])
        self._refusal_count = int(arrays['refused'])
        self._residual.restore(
            {name[9:]: array for name, array in arrays.items() if name.startswith('residual_')}
        )
        trainable = {name[6:]: array for name, array in arrays.items() if name.startswith('pupil_')}
        if trainable:
            from gray_box_observer.predictor.training.teaching import TrainableNetwork

            rules = self._rules
            self._trainable = TrainableNetwork.from_arrays(
                trainable, rules.learning_rate, rules.gradient_clip, rules.device
            )

    def _start_training(self) -> TrainableNetwork:
        from gray_box_observer.predictor.training.teaching import TrainableNetwork

        rules = self._rules
        return TrainableNetwork(
            self._current_network, rules.learning_rate, rules.gradient_clip, rules.device
        )

    def _draw(
        self, random: np.random.Generator, job: Message, range_seen: OperatingRange, count: int
    ) -> Sequences:
        limits_v = range_seen.voltages(self._rules.voltage_limits_v)
        return draw_around(
            random,
            self._white_box,
            job['theta'],
            job['covariance'],
            range_seen,
            limits_v,
            self._rules.horizon_s,
            count,
            LENGTH,
        )

    def _training_batch(self, job: Message, range_seen: OperatingRange) -> TrainingBatch:
        """Half of the lessons are of these motors, half of all: no regime is forgotten."""
        assert self._trainable is not None
        weights = self._trainable.weights
        count = self._rules.minibatch
        sequence_sets = [
            self._draw(self._random, job, range_seen, count),
            draw_family(self._random, count, LENGTH),
        ]
        return TrainingBatch.concatenate(
            [training_batch(weights, sequences) for sequences in sequence_sets]
        )

    def _better(self, candidate: Weights, own: _HeldOut, now: float, job: Message) -> bool:
        """Whether a network beats the running one on drawn data and is no worse on measured."""
        if not own.error(candidate) <= BETTER * now:
            return False
        if not self._family.error(candidate) <= FORGETS * self._family.error(self._current_network):
            return False
        history = newest_history(self._white_box, job)
        if history is None:
            return True
        predictions = [
            free_run(weights, history.sequences)[0]
            for weights in (candidate, self._current_network)
        ]
        errors = [np.abs(predicted_a - history.current_a) for predicted_a in predictions]
        worse = errors[0] - errors[1]
        return bool(worse.mean() <= worse.std() / np.sqrt(worse.size))


class _HeldOut:
    """Sequences that never teach, with where the white box itself goes in them."""

    def __init__(self, sequences: Sequences) -> None:
        self._sequences = sequences
        self._exact_a = exact_run(sequences)

    def error(self, weights: Weights) -> float:
        return free_run_error(weights, self._sequences, self._exact_a)


def _constant(value: Any) -> Any:
    """A scalar stays a plain number; one entry a motor becomes an array."""
    array = np.asarray(value, dtype=float)
    return float(array) if array.ndim == 0 else array
