"""The predictor: forecasts each torque before it is measured, and has itself trained in the background.

Predict, then learn: :meth:`Predictor.predict` changes nothing; scores use what it said.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.inputs import InputLayout
from gray_box_observer.predictor.network import Memory, Weights, step
from gray_box_observer.predictor.normalisation import Normalisation
from gray_box_observer.predictor.rules import TrainingRules
from gray_box_observer.predictor.scores import Scores
from gray_box_observer.predictor.training import Training
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.base import Array, WhiteBox
from gray_box_observer.white_box.dynamics import advance, decay_rate


@dataclass(frozen=True, slots=True)
class Prediction:
    """What is expected of the next torque sample, with what has to be remembered if it comes.

    Attributes:
        torque_nm: shape (motor,): the predictor's forecast; NaN before the first training and while it warms up.
        white_box_torque_nm: shape (motor,): the white box's rollout from voltages alone.
        memory: the network's memory after this step; None before the first training.
    """

    torque_nm: Array
    white_box_torque_nm: Array
    memory: Memory | None


class Predictor:
    """Streams the network over the samples of a group of motors.

    Args:
        white_box: the physics, for the rollout that prediction is compared with.
        motors: number of motors.
        theta_reference: shape (parameter,): see :class:`InputLayout`.
        rules: settings.
        training: where jobs run.
    """

    def __init__(
        self, white_box: WhiteBox, motors: int, theta_reference: Array, rules: TrainingRules, training: Training,
        *, speed_measured: bool,
    ) -> None:  # fmt: skip
        self._white_box = white_box
        self._rules = rules
        self._training = training
        self._layout = InputLayout(theta_reference, rules.variant.sees_theta, speed_measured)
        self._motors = motors
        self._weights: Weights | None = None
        self._normalisation: Normalisation | None = None
        self._memory: Memory | None = None
        self._warm = np.zeros(motors, dtype=int)
        self._rollout = np.full(motors, np.nan)
        self._previous_torque = np.full(motors, np.nan)
        self._previous_speed = np.full(motors, np.nan)
        self.replay = ReplayBuffer(motors, rules.replay_capacity)
        self.scores = Scores(motors)
        self.jobs_done = 0
        self.jobs_late = 0
        self.loss: float | None = None
        self._start_from: dict[str, Any] = {}
        self._fastest_decay: float | None = None

    def predict(self, interval_s: Array, voltage_v: Array, theta: Array) -> Prediction:
        """Forecast the torque at the end of an interval; changes nothing.

        Measured speed comes with the torque, so the forecast holds on to that of the sample before.

        Args:
            interval_s: shape (motor,): length of the interval; 0 where the history starts anew.
            voltage_v: shape (motor,): mean voltage over it.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
        """
        blank, speed = np.full(self._motors, np.nan), self._previous_speed
        continues = interval_s > 0.0
        known = continues & np.isfinite(self._rollout)
        rollout = blank
        if np.any(known):
            held = np.where(known, voltage_v, 0.0)
            state = self._white_box.state(np.where(known, self._rollout, 0.0))
            end = advance(self._white_box, theta, state, held, speed, speed, interval_s, self._fastest_decay)
            rollout = np.where(known, self._white_box.output(end), np.nan)
        if self._weights is None or self._normalisation is None or self._memory is None:
            return Prediction(blank, rollout, None)
        held = np.where(continues, voltage_v, 0.0)
        columns = self._layout.columns(self._normalisation, held, speed, theta)
        output, memory = step(self._weights, self._memory, np.stack(columns, axis=-1))
        torque = self._normalisation.torque.denormalise(output)
        usable = continues & (self._warm >= self._rules.context)
        return Prediction(np.where(usable, torque, np.nan), rollout, memory)

    def learn(self, sample: Sample, prediction: Prediction, theta: Array) -> None:
        """Score what was predicted, remember the sample, and start or finish a training job when one is due."""
        rivals = {
            'predictor': prediction.torque_nm,
            'persistence': np.where(sample.interval_s > 0.0, self._previous_torque, np.nan),
            'white_box': prediction.white_box_torque_nm,
        }
        self.scores.add(sample.torque_nm, rivals)
        anew = sample.interval_s <= 0.0
        if prediction.memory is not None:
            kept = [np.where(anew[:, None], 0.0, part) for part in (prediction.memory.hidden, prediction.memory.cell)]
            self._memory = Memory(*kept)
        self._warm = np.where(anew, 0, self._warm + 1)
        started = np.isfinite(prediction.white_box_torque_nm) & ~anew
        self._rollout = np.where(started, prediction.white_box_torque_nm, sample.torque_nm)
        self._previous_torque = sample.torque_nm
        # a torque message without its speed must not put NaN into the network's memory or into a training window
        self._previous_speed = np.where(np.isfinite(sample.speed_rad_s), sample.speed_rad_s, self._previous_speed)
        self.replay.append(sample, self._previous_speed)
        if self.replay.total % self._rules.period == 0:
            self._train(theta)

    def state(self) -> dict[str, Array]:
        """The network and its ranges as arrays; empty before the first training."""
        if self._weights is None or self._normalisation is None:
            return {}
        ranges = {f'range_{name}': np.array(bounds) for name, bounds in self._normalisation.to_dict().items()}
        return {**self._weights.arrays(), **ranges}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave; training goes on from there."""
        if not arrays:
            return
        weights = Weights(**{name: arrays[name] for name in Weights.__dataclass_fields__})
        if weights.input.shape != (4 * self._rules.hidden, self._layout.width):
            raise ConfigurationError(
                f'the checkpoint holds a network of {weights.hidden} hidden units and {weights.input.shape[1]} inputs, '
                f'expected {self._rules.hidden} and {self._layout.width}'
            )
        ranges = {name[6:]: bounds.tolist() for name, bounds in arrays.items() if name.startswith('range_')}
        self._weights, self._normalisation = weights, Normalisation.from_dict(ranges)
        self._memory = Memory.blank(self._motors, weights.hidden)
        self._warm = np.zeros(self._motors, dtype=int)
        self._start_from = {f'start_{name}': array for name, array in weights.arrays().items()}
        self._start_from['start_ranges'] = ranges

    def close(self) -> None:
        """Stop training."""
        self._training.close()

    @property
    def failure(self) -> str | None:
        """Why training has ended for good, if it has."""
        return getattr(self._training, 'failure', None)

    def _train(self, theta: Array) -> None:
        """Adopt the finished job's network and hand the next one over; a job that is late is waited for next time."""
        largest = self._white_box.state(np.max(np.abs(self.replay.torque_nm()), axis=1))
        fastest = np.max(np.abs(self.replay.speed_rad_s()), axis=1)
        decay = 1.5 * np.max(np.abs(decay_rate(self._white_box, theta, largest, fastest)))
        self._fastest_decay = float(decay) if np.isfinite(decay) else None
        if self._training.busy:
            result = self._training.collect()
            if result is None:
                self.jobs_late += 1
                return
            self._adopt(result)
        if len(self.replay) >= self._rules.length:
            self._training.submit(
                {
                    'voltage_v': self.replay.voltage_v(),
                    'interval_s': self.replay.interval_s(),
                    'torque_nm': self.replay.torque_nm(),
                    'speed_rad_s': self.replay.speed_rad_s(),
                    'theta': theta,
                    **self._start_from,
                }
            )
            self._start_from = {}

    def _adopt(self, result: dict[str, Any]) -> None:
        self.jobs_done += 1
        if result['windows'] == 0:
            return
        self.loss = result['loss']
        arrays = {name: result[name] for name in Weights.__dataclass_fields__}
        self._weights = Weights(**arrays)
        self._normalisation = Normalisation.from_dict(result['ranges'])
        if self._memory is None:
            self._memory = Memory.blank(self._motors, self._weights.hidden)
            self._warm = np.zeros(self._motors, dtype=int)
