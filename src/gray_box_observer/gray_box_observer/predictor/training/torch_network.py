"""The network of :mod:`network` in torch, for training. Imported by the trainers only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from gray_box_observer.predictor.network import Weights
from gray_box_observer.settings.device import CPU
from gray_box_observer.white_box.interface import Array


def moments_of(optimiser: torch.optim.Optimizer) -> dict[str, Array]:
    """Return what Adam remembers of every weight, as arrays by ``adam_<place>_<name>``."""
    return {
        f'adam_{place}_{name}': value.cpu().numpy().copy()
        for place, of_one in optimiser.state_dict()['state'].items()
        for name, value in of_one.items()
    }


def give_moments(optimiser: torch.optim.Optimizer, arrays: Mapping[str, Array]) -> None:
    """Let Adam go on from what :func:`moments_of` gave."""
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, array in arrays.items():
        if key.startswith('adam_'):
            _, place, name = key.split('_', 2)
            moments.setdefault(int(place), {})[name] = torch.from_numpy(array.copy())
    optimiser.load_state_dict({**optimiser.state_dict(), 'state': moments})


class TorchNetwork(torch.nn.Module):
    """One LSTM layer and a linear output; its second bias, which torch has to spare, stays zero.

    Whatever device it is taught on, plain arrays go in and come out.

    Args:
        inputs: number of inputs.
        hidden: number of hidden units.
        device: torch's.
    """

    def __init__(self, inputs: int, hidden: int, device: str = CPU) -> None:
        super().__init__()
        self.lstm = torch.nn.LSTM(inputs, hidden, batch_first=True)
        self.readout = torch.nn.Linear(hidden, 1)
        spare = self.lstm.get_parameter('bias_hh_l0')
        spare.requires_grad_(False)
        spare.zero_()
        self.to(device)

    @classmethod
    def from_weights(cls, weights: Weights, device: str = CPU) -> TorchNetwork:
        """Return the network with these weights."""
        network = cls(weights.input.shape[1], weights.hidden, device)
        network.load(weights)
        return network

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Outputs (sequence, time) for inputs (sequence, time, input), each from blank memory."""
        return self.readout(self.lstm(inputs)[0])[..., 0]  # type: ignore[no-any-return]

    def load(self, weights: Weights) -> None:
        """Take over plain arrays."""
        targets = self._tensors()
        for name, array in weights.arrays().items():
            targets[name].data.copy_(
                torch.as_tensor(array, dtype=torch.float32).reshape(targets[name].shape)
            )

    def export(self) -> Weights:
        """Return the weights as plain arrays."""
        arrays = {
            name: tensor.detach().cpu().numpy().astype(float)
            for name, tensor in self._tensors().items()
        }
        arrays['output'] = arrays['output'].reshape(-1)
        return Weights(**arrays)

    def single(self, array: Any) -> torch.Tensor:
        """Return an array in single precision, where the network is."""
        return torch.as_tensor(array, dtype=torch.float32, device=self.readout.weight.device)

    def trainable(self) -> list[torch.nn.Parameter]:
        """Return what an optimiser may change."""
        return [p for p in self.parameters() if p.requires_grad]

    def _tensors(self) -> dict[str, torch.nn.Parameter]:
        lstm = self.lstm
        return {
            'input': lstm.get_parameter('weight_ih_l0'),
            'recurrent': lstm.get_parameter('weight_hh_l0'),
            'bias': lstm.get_parameter('bias_ih_l0'),
            'output': self.readout.get_parameter('weight'),
            'output_bias': self.readout.get_parameter('bias'),
        }
