"""Training of the thesis's variants: a job is a few Adam steps on windows. Needs torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.network_inputs import InputLayout
from gray_box_observer.predictor.normalisation import Normalisation, rescale_weights
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.thesis.variant_losses import Windows, stage_two_loss
from gray_box_observer.predictor.training import random_state
from gray_box_observer.predictor.training.torch_network import (
    TorchNetwork,
    give_moments,
    moments_of,
)
from gray_box_observer.predictor.training.trainer import Message
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox


class WindowTrainer:
    """Holds the network under training, its optimiser and its random state.

    Args:
        configuration: ``white_box`` (its :meth:`~MotorWhiteBox.to_dict`), ``rules`` (of
            :class:`TrainingSettings`), ``theta_reference`` and ``seed``.
    """

    def __init__(self, configuration: Mapping[str, Any]) -> None:
        self._description = configuration['white_box']
        self._rules = TrainingSettings.from_dict(configuration['rules'])
        self._seed = int(configuration['seed'])
        device = self._rules.device
        self._white_box = MotorWhiteBox.from_dict(
            self._description, lambda v: torch.as_tensor(v, dtype=torch.float32, device=device)
        )
        reference = np.asarray(configuration['theta_reference'], dtype=float)
        self._layout = InputLayout(
            reference, self._rules.variant.sees_theta, self._white_box.speed_measured
        )
        torch.set_num_threads(1)
        self._network = TorchNetwork(self._layout.width, self._rules.hidden, device)
        self._begin()

    def _begin(self) -> None:
        """Know nothing."""
        self._network.load(Weights.initial(self._layout.width, self._rules.hidden, self._seed))
        self._optimiser = torch.optim.Adam(self._network.trainable(), self._rules.learning_rate)
        self._plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimiser,
            factor=0.5,
            patience=self._rules.patience,
            min_lr=self._rules.smallest_learning_rate,
        )
        self._normalisation: Normalisation | None = None
        self._random = np.random.default_rng([self._seed, 1])

    def train(self, job: Message) -> Message:
        """Run one job.

        Args:
            job: ``voltage_v``, ``interval_s``, ``torque_nm``, ``speed_rad_s``, each of shape
                (motor, n), and ``theta``, shape (motor, parameter); ``start_*``, where training
                shall go on from a saved network.

        Returns:
            The network's arrays, its ranges, the mean ``loss`` and the ``windows`` seen; no network
            where the data held no window without a gap; ``learning_*``, from which another trainer
            goes on alike.
        """
        if 'start_ranges' in job:
            self._restore(job)
        answer = self._teach(job)
        return {**answer, **{f'learning_{name}': array for name, array in self._state().items()}}

    def _state(self) -> dict[str, Array]:
        """Everything but the network and its ranges that the next job depends on."""
        rate = self._optimiser.param_groups[0]['lr']
        plateau = self._plateau
        plain = {
            'rate': rate,
            'best': plateau.best,
            'bad': plateau.num_bad_epochs,
            'jobs': plateau.last_epoch,
        }
        state = {name: np.array(value) for name, value in plain.items()}
        return {**state, **moments_of(self._optimiser), 'random': random_state.pack(self._random)}

    def _restore(self, job: Message) -> None:
        """Go on from a saved network, and from :meth:`_state` where that was saved too."""
        self._begin()
        self._network.load(
            Weights.from_arrays(
                {name: job[f'start_{name}'] for name in Weights.__dataclass_fields__}
            )
        )
        self._normalisation = Normalisation.from_dict(job['start_ranges'])
        arrays = {
            name[15:]: array for name, array in job.items() if name.startswith('start_learning_')
        }
        if 'random' not in arrays:
            return
        give_moments(self._optimiser, arrays)
        self._optimiser.param_groups[0]['lr'] = float(arrays['rate'])
        plateau = self._plateau
        plateau.best = float(arrays['best'])
        plateau.num_bad_epochs = int(arrays['bad'])
        plateau.last_epoch = int(arrays['jobs'])
        self._random = random_state.unpack(arrays['random'])

    def _teach(self, job: Message) -> Message:
        starts = self._window_starts(job['interval_s'])
        if starts.size == 0:
            return {'windows': 0}
        self._renormalise(job)
        losses = [self._step(job, starts) for _ in range(self._rules.steps)]
        loss = float(np.mean(losses))
        self._plateau.step(loss)
        assert self._normalisation is not None
        window_count = self._rules.steps * self._rules.minibatch
        return {
            'windows': window_count,
            'loss': loss,
            'ranges': self._normalisation.to_dict(),
            **self._network.export().arrays(),
        }

    def _window_starts(self, interval_s: Array) -> Array:
        """Flat index (motor * n + start) of every window without a restart in it."""
        length = self._rules.length
        n = interval_s.shape[1]
        if n < length:
            return np.zeros(0, dtype=int)
        gaps = np.cumsum(np.pad(interval_s <= 0.0, ((0, 0), (1, 0))), axis=1)
        clean: NDArray[np.bool_] = gaps[:, length:] - gaps[:, : n - length + 1] == 0
        motor, start = np.nonzero(clean)
        flat: Array = motor * n + start
        return flat

    def _renormalise(self, job: Message) -> None:
        """Let the ranges grow with the data; the network goes on computing what it did."""
        voltage = job['voltage_v'][job['interval_s'] > 0.0]
        if self._normalisation is None:
            speed = job['speed_rad_s'] if self._white_box.speed_measured else None
            self._normalisation = Normalisation.from_data(voltage, job['torque_nm'], speed)
            return
        new = self._normalisation.extend_to(voltage, job['torque_nm'], job['speed_rad_s'])
        if new != self._normalisation:
            self._network.load(rescale_weights(self._network.export(), self._normalisation, new))
            self._normalisation = new

    def _step(self, job: Message, starts: Array) -> float:
        window_starts = self._random.choice(starts, self._rules.minibatch)
        motor, start = np.divmod(window_starts, job['interval_s'].shape[1])
        index = (motor[:, None], start[:, None] + np.arange(self._rules.length))
        signals = {
            name: job[name][index]
            for name in ('voltage_v', 'interval_s', 'torque_nm', 'speed_rad_s')
        }
        theta = job['theta'][motor]
        assert self._normalisation is not None
        columns = self._layout.columns(
            self._normalisation, signals['voltage_v'], signals['speed_rad_s'], theta
        )
        full_columns = [
            c if c.ndim == 2 else np.repeat(c[:, None], self._rules.length, axis=1) for c in columns
        ]
        single = self._network.single
        inputs = single(np.stack(full_columns, axis=-1))
        windows = Windows(
            **{name: single(value) for name, value in signals.items()}, theta=single(theta)
        )
        predicted_nm = self._normalisation.torque.denormalise(self._network(inputs))
        loss = stage_two_loss(
            self._rules.variant,
            self._white_box.of_motors(torch.as_tensor(motor, device=inputs.device)),
            windows,
            predicted_nm,
            self._rules.context,
            self._normalisation.torque.span,
            self._rules.weight_floor,
        )
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), self._rules.gradient_clip)
        self._optimiser.step()
        return float(loss.detach())
