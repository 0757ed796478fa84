"""The thesis's training: epochs over windows of one recording (thesis 4.2.4, 5.1).

Losses, network, ranges and the rule of the context nodes are the package's; only the loop over
epochs is here, because the package trains on a stream that never ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from common.table_5_1.recordings import Recordings, Series
from common.table_5_1.settings import Setting
from gray_box_observer.context_nodes import GradientSettings, GradientUpdate
from gray_box_observer.predictor import TrainingSettings, Variant
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.network_inputs import InputLayout
from gray_box_observer.predictor.normalisation import Normalisation
from gray_box_observer.predictor.thesis.variant_losses import Windows, stage_two_loss
from gray_box_observer.predictor.training.torch_network import TorchNetwork
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

BLOCK = 33
"""Consecutive predictions in one term of the loss: 32 first differences."""

BLOCKS_A_STEP = 8

THETA_EPOCHS = 20
"""Epochs in which stage 1 learns; by then its own plateau cuts have ended it."""

PATIENCE = 20
"""Epochs without a better validation loss before the learning rate is halved."""

SMALLEST_RATE = 1e-5
"""Where the cuts end."""


@dataclass(frozen=True, slots=True)
class Trained:
    """What training leaves behind.

    Attributes:
        theta: shape (parameter,): the context nodes.
        predicted_nm: shape (set, sample): forecasts of the test sets; NaN where there are no 64
            voltages yet.
        validation: shape (epoch,): validation loss.
    """

    theta: Array
    predicted_nm: Array
    validation: Array


class EpochTraining:
    """One variant on one training recording.

    Args:
        setting: sizes and rates.
        variant: whose loss.
        recordings: what it may learn from.
        seed: of the first weights, the order of the blocks and the draws of stage 1.
    """

    def __init__(
        self, setting: Setting, variant: Variant, recordings: Recordings, seed: int
    ) -> None:
        configuration = setting.configuration(variant.value)
        motor = configuration.motors['motor']
        sizes = {
            name: configuration[f'training.{name}']
            for name in ('hidden', 'context', 'learning_rate')
        }
        self._rules = TrainingSettings(variant=variant, **sizes)
        self._white_box: MotorWhiteBox = motor.white_box(speed_measured=False)
        initial = np.array([motor.initial()])
        self._nodes = GradientUpdate(
            self._white_box, initial, seed, GradientSettings(**configuration.group('gradient'))
        )
        self._layout = InputLayout(initial[0], variant.sees_theta, sees_speed=False)
        self._network = TorchNetwork(self._layout.width, self._rules.hidden)
        self._network.load(Weights.initial(self._layout.width, self._rules.hidden, seed))
        trainable = [p for p in self._network.parameters() if p.requires_grad]
        self._optimiser = torch.optim.Adam(trainable, self._rules.learning_rate)
        self._plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self._optimiser, factor=0.5, patience=PATIENCE, min_lr=SMALLEST_RATE
        )
        self._random = np.random.default_rng([seed, 1])
        self._recordings = recordings
        training = recordings.training
        self._ranges = Normalisation.from_data(training.voltage_v, training.torque_nm, None)

    def train(self, epochs: int) -> Trained:
        """Run the epochs, then forecast the test sets."""
        validation = np.empty(epochs)
        samples = _samples(self._recordings.training)
        for epoch in range(epochs):
            starts = self._random.permutation(
                _block_starts(self._recordings.training, self._rules.context, epoch)
            )
            steps = max(1, starts.size // BLOCKS_A_STEP)
            for blocks, part in zip(
                np.array_split(starts, steps), _split(samples, steps), strict=True
            ):
                if epoch < THETA_EPOCHS:
                    for sample in part:
                        self._nodes.learn(sample)
                self._step(blocks)
            validation[epoch] = self._validation_loss()
            self._plateau.step(validation[epoch])
        return Trained(self._nodes.theta[0], self.predict(self._recordings.tests), validation)

    def predict(self, series: Series) -> Array:
        """Forecast every sample from the 64 voltages before it; shape (set, sample)."""
        context = self._rules.context
        predicted = np.full(series.torque_nm.shape, np.nan)
        with torch.no_grad():
            for j, voltage in enumerate(series.voltage_v):
                output = self._outputs(
                    np.lib.stride_tricks.sliding_window_view(voltage, context)[1:]
                )
                predicted[j, context:] = output.numpy()
        return predicted

    def _outputs(self, voltage_v: Array) -> torch.Tensor:
        """Torque in N m, shape (window,), at the end of voltage windows, shape (window, time)."""
        theta = np.broadcast_to(self._nodes.theta, (len(voltage_v), self._nodes.theta.shape[1]))
        columns = self._layout.columns(self._ranges, voltage_v, None, theta)
        shaped = [
            c if c.ndim == 2 else np.repeat(c[:, None], voltage_v.shape[1], axis=1) for c in columns
        ]
        inputs = torch.as_tensor(np.stack(shaped, axis=-1), dtype=torch.float32)
        output: torch.Tensor = self._ranges.torque.denormalise(self._network(inputs)[:, -1])
        return output

    def _loss(self, series: Series, starts: NDArray[np.intp]) -> torch.Tensor:
        """Loss of the variant on blocks of consecutive predictions that begin at these samples."""
        context = self._rules.context
        count = len(starts)
        index = starts[:, None] + np.arange(BLOCK)
        windows = np.lib.stride_tricks.sliding_window_view(series.voltage_v[0], context)
        predicted = self._outputs(windows[index.ravel() - context + 1]).reshape(count, BLOCK)
        theta = np.broadcast_to(self._nodes.theta, (count, self._nodes.theta.shape[1]))
        voltage = series.voltage_v[0][index]
        torque = series.torque_nm[0][index]
        interval = np.full(index.shape, series.interval_s)
        signals = (voltage, interval, torque, np.zeros(index.shape), theta)
        return stage_two_loss(
            self._rules.variant,
            self._white_box,
            Windows(*(torch.as_tensor(signal.copy(), dtype=torch.float32) for signal in signals)),
            predicted,
            0,
            self._ranges.torque.span,
            self._rules.weight_floor,
        )

    def _step(self, starts: NDArray[np.intp]) -> None:
        loss = self._loss(self._recordings.training, starts)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), self._rules.gradient_clip)
        self._optimiser.step()

    def _validation_loss(self) -> float:
        series = self._recordings.validation
        with torch.no_grad():
            return float(self._loss(series, _block_starts(series, self._rules.context, 0)))


def _block_starts(series: Series, context: int, shift: int) -> NDArray[np.intp]:
    """First samples of adjacent blocks, shifted so that every difference gets its turn."""
    return np.arange(context + shift % BLOCK, series.torque_nm.shape[1] - BLOCK + 1, BLOCK)


def _samples(series: Series) -> list[Sample]:
    """The recording as the observer's samples; the first starts a signal history."""
    intervals = np.full(series.stamp_ns.size, series.interval_s)
    intervals[0] = 0.0
    columns = (series.stamp_ns, intervals, series.voltage_v[0], series.torque_nm[0])
    return [
        Sample.of_one_motor(int(t), float(h), float(v), float(y))
        for t, h, v, y in zip(*columns, strict=True)
    ]


def _split(samples: list[Sample], parts: int) -> list[list[Sample]]:
    edges = np.linspace(0, len(samples), parts + 1).astype(int)
    return [samples[a:b] for a, b in pairwise(edges)]
