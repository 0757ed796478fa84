"""One step of teaching: the physics' defect along the network's prediction, and Adam."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import torch

from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.steady_state import Relaxation, exponent
from gray_box_observer.predictor.training.physics_batches import TrainingBatch
from gray_box_observer.predictor.training.torch_network import (
    TorchNetwork,
    give_moments,
    moments_of,
)
from gray_box_observer.settings.device import CPU
from gray_box_observer.white_box.interface import Array

SHORTEST = 1e-3
"""Shortest interval, in time constants, whose defect counts in full."""


def defect_loss(training_batch: TrainingBatch, readout: torch.Tensor) -> torch.Tensor:
    """Mean of ``|i1 - Phi_h(i0)|``, the ODE's defect in exact-time form (thesis 4.2.4).

    It is in units of each sequence's spread.

    Defects of a free run die down at the pace of the motor, so a steady defect ``e`` adds up to
    ``e / (1 - exp(-h c))``: that is what is minimised, and short intervals weigh as much as long
    ones.

    Args:
        training_batch: intervals along the network's own prediction; they are held while the
            weights are changed.
        readout: shape (sequence, time): the network's answers.
    """
    interval = Relaxation(
        **{
            f.name: _like(readout, getattr(training_batch.intervals, f.name))
            for f in fields(Relaxation)
        }
    )
    movement = interval.distance * torch.expm1(-exponent(torch, interval, readout))
    defect = movement - _like(readout, training_batch.targets)
    adds_up = -torch.expm1(-interval.duration.clamp_min(SHORTEST))
    loss: torch.Tensor = (defect.abs() / adds_up).mean()
    return loss


def _like(tensor: torch.Tensor, array: Array) -> torch.Tensor:
    """Return an array in single precision, on the device of a tensor."""
    return torch.as_tensor(array, dtype=torch.float32, device=tensor.device)


class TrainableNetwork:
    """A network under training with its optimiser.

    Args:
        weights: where it begins.
        learning_rate: of Adam.
        gradient_clip: largest norm of a gradient.
        device: torch's, on which it is taught.
    """

    def __init__(
        self, weights: Weights, learning_rate: float, gradient_clip: float, device: str = CPU
    ) -> None:
        torch.set_num_threads(1)  # several cost more than so small a network needs in all
        self._network = TorchNetwork.from_weights(weights, device)
        self._clip = gradient_clip
        self.optimiser = torch.optim.Adam(self._network.trainable(), learning_rate)

    @property
    def weights(self) -> Weights:
        """What it knows now."""
        return self._network.export()

    def state(self) -> dict[str, Array]:
        """The network and the moments of Adam, as arrays."""
        return {**self.weights.arrays(), **moments_of(self.optimiser)}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, Array], learning_rate: float, gradient_clip: float,
        device: str = CPU
    ) -> TrainableNetwork:  # fmt: skip
        """Return the pupil that goes on from what :meth:`state` gave."""
        trainable = cls(Weights.from_arrays(arrays), learning_rate, gradient_clip, device)
        give_moments(trainable.optimiser, arrays)
        return trainable

    def learn(self, training_batch: TrainingBatch) -> float:
        """Take one Adam step; return the loss before it."""
        readout = self._network(self._network.single(training_batch.inputs))
        loss = defect_loss(training_batch, readout)
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), self._clip)
        self.optimiser.step()
        return float(loss.detach())
