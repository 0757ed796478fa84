"""The residual's network under training. Torch; imported when there is a residual to learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.torch_network import TorchNetwork, give_moments, moments_of
from gray_box_observer.white_box.base import Array

LENGTH = 512
"""Samples of a window. Long: the network streams without end and must not have learnt to count on a blank start."""

WARM = 64
"""Samples at its beginning that only fill the memory."""

WINDOWS = 8
"""Windows of a step."""

LEARNING_RATE = 0.01
DECAY = 1e-3
"""Pull of the weights towards zero: what data do not ask for is not said."""


class ResidualPupil:
    """A network that begins by correcting nothing.

    Args:
        inputs: number of inputs.
        hidden: number of hidden units.
        seed: of its first weights.
    """

    def __init__(self, inputs: int, hidden: int, seed: int) -> None:
        torch.set_num_threads(1)
        fresh = Weights.initial(inputs, hidden, seed)
        mute = replace(fresh, output=np.zeros_like(fresh.output), output_bias=np.zeros(1))
        self._network = TorchNetwork.of(mute)
        self._optimiser = torch.optim.AdamW(self._network.trainable(), LEARNING_RATE, weight_decay=DECAY)

    @property
    def weights(self) -> Weights:
        """What it knows now."""
        return self._network.export()

    def state(self) -> dict[str, Array]:
        """The network and the moments of Adam, as arrays."""
        return {**self.weights.arrays(), **moments_of(self._optimiser)}

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Go on from what :meth:`state` gave."""
        self._network.load(Weights.of(arrays))
        give_moments(self._optimiser, arrays)

    def learn(
        self,
        random: np.random.Generator,
        inputs: Array,
        residual: Array,
        teaching: NDArray[np.bool_],
        steps: int,
    ) -> None:
        """Take Adam steps on windows drawn from a stretch.

        Args:
            random: draws the windows.
            inputs: shape (motor, time, input).
            residual: shape (motor, time), in units of the largest correction.
            teaching: shape (time,): samples whose error counts.
            steps: number of steps.
        """
        length = min(LENGTH, inputs.shape[1])
        x, y = (torch.as_tensor(array, dtype=torch.float32) for array in (inputs, residual))
        counts = torch.as_tensor(teaching, dtype=torch.float32)
        size = float(np.mean(np.abs(residual))) + 1e-12
        for _ in range(steps):
            motor = random.integers(inputs.shape[0], size=WINDOWS)
            start = random.integers(inputs.shape[1] - length + 1, size=WINDOWS)
            index = torch.as_tensor(start[:, None] + np.arange(length))
            rows = torch.as_tensor(motor[:, None])
            error = (torch.tanh(self._network(x[rows, index])) - y[rows, index])[:, WARM:] / size
            weight = counts[index][:, WARM:]
            loss = (torch.nn.functional.smooth_l1_loss(error, torch.zeros_like(error), reduction='none') * weight).sum()
            self._optimiser.zero_grad()
            (loss / weight.sum().clamp_min(1.0)).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self._network.parameters(), 1.0)
            self._optimiser.step()
