"""A plain LSTM from voltage (and speed) to torque: what the gray box has to beat on real motors.

It gets every fair chance: inputs and output normalised by the recording, the learning rate chosen
among several, and early stopping on the same blocks of the recording that judge the residual of the
gray box.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from common.motion import FloatArray
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.training.torch_network import TorchNetwork

LEARNING_RATES = (0.003, 0.01, 0.03)
WINDOWS = 8
LENGTH = 512
CHECK = 50
"""Steps between two looks at the blocks that judge."""

Columns = Sequence[FloatArray]
"""One array a recording, shape (time, input) or (time,)."""


class BlackBox:
    """The best network found in training.

    Args:
        inputs: one array a recording, shape (time, input).
        torque_nm: one array a recording, shape (time,).
        judging: one array a recording, shape (time,): samples that only judge.
        hidden: hidden units.
        steps: training steps of every learning rate.
        seed: of weights and windows.
    """

    def __init__(
        self,
        inputs: Columns,
        torque_nm: Columns,
        judging: Columns,
        *,
        hidden: int,
        steps: int,
        seed: int,
    ) -> None:
        torch.set_num_threads(1)
        taught = np.concatenate(
            [x[~np.asarray(j, bool)] for x, j in zip(inputs, judging, strict=True)]
        )
        torque = np.concatenate(
            [y[~np.asarray(j, bool)] for y, j in zip(torque_nm, judging, strict=True)]
        )
        self._mean = taught.mean(axis=0)
        self._size = taught.std(axis=0) + 1e-12
        self._torque_mean, self._torque_size = float(torque.mean()), float(torque.std()) + 1e-12
        self._x = [self._tensor(x) for x in inputs]
        self._y = [
            torch.as_tensor((y - self._torque_mean) / self._torque_size, dtype=torch.float32)
            for y in torque_nm
        ]
        self._judging = [torch.as_tensor(np.asarray(j, dtype=bool)) for j in judging]
        found = [self._taught(hidden, steps, rate, seed) for rate in LEARNING_RATES]
        self.error, weights, self.learning_rate = min(found, key=lambda one: one[0])
        self._network = TorchNetwork.from_weights(weights)

    def predict(self, inputs: FloatArray) -> FloatArray:
        """Predict the torque in N m along a recording from its first sample on, shape (time,)."""
        with torch.no_grad():
            said = self._network(self._tensor(inputs)[None])[0].numpy().astype(float)
        torque: FloatArray = self._torque_mean + self._torque_size * said
        return torque

    @property
    def learnt(self) -> int:
        """How many weights were learnt."""
        return sum(weight.numel() for weight in self._network.trainable())

    def _tensor(self, inputs: FloatArray) -> torch.Tensor:
        return torch.as_tensor((inputs - self._mean) / self._size, dtype=torch.float32)

    def _taught(
        self, hidden: int, steps: int, rate: float, seed: int
    ) -> tuple[float, Weights, float]:
        """Return the lowest judged error so far, the network that had it, and the learning rate."""
        random = np.random.default_rng([seed, hidden])
        network = TorchNetwork.from_weights(Weights.initial(self._x[0].shape[1], hidden, seed))
        optimiser = torch.optim.AdamW(network.trainable(), rate, weight_decay=1e-3)
        best = (self._judged(network), network.export(), rate)
        for k in range(steps):
            x, y, counts = self._windows(random)
            loss = torch.nn.functional.smooth_l1_loss(network(x), y, reduction='none', beta=0.1)
            optimiser.zero_grad()
            ((loss * counts).sum() / counts.sum().clamp_min(1.0)).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            if (k + 1) % CHECK == 0 or k + 1 == steps:
                best = min(
                    best, (self._judged(network), network.export(), rate), key=lambda one: one[0]
                )
        return best

    def _windows(
        self, random: np.random.Generator
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Draw the windows of a step; short recordings are padded with samples of no weight."""
        lengths = np.array([len(y) for y in self._y])
        drawn = []
        for which in random.choice(lengths.size, WINDOWS, p=lengths / lengths.sum()):
            start = int(
                np.clip(
                    random.integers(lengths[which]) - LENGTH // 2,
                    0,
                    max(0, lengths[which] - LENGTH),
                )
            )
            cut = slice(start, start + LENGTH)
            drawn.append(
                (self._x[which][cut], self._y[which][cut], (~self._judging[which][cut]).float())
            )
        x, y, counts = (
            torch.nn.utils.rnn.pad_sequence(list(part), True) for part in zip(*drawn, strict=True)
        )
        return x, y, counts

    def _judged(self, network: TorchNetwork) -> float:
        """Mean absolute error of the free run over the judged samples, in spreads of the torque."""
        with torch.no_grad():
            missed = [
                (network(x[None])[0] - y)[j].abs()
                for x, y, j in zip(self._x, self._y, self._judging, strict=True)
            ]
        return float(torch.cat(missed).mean())
