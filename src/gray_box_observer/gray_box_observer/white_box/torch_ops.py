"""Functions under numpy's names for tensors, so that one formula serves both. Needs torch."""

from __future__ import annotations

from typing import Any

import torch


class TorchOps:
    """Torch's functions where they behave like numpy's, the others in numpy's manner.

    Args:
        device: torch's, where tensors are made.
    """

    def __init__(self, device: str) -> None:
        self.device = torch.device(device)

    def __getattr__(self, name: str) -> Any:
        return getattr(torch, name)

    def tensor(self, values: Any) -> torch.Tensor:
        """Return a copy of an array, or a number, on the device."""
        return torch.tensor(values, device=self.device)

    def taken(self, signal: Any) -> torch.Tensor:
        """Return a signal on the device, where it may be already."""
        return signal if isinstance(signal, torch.Tensor) else self.tensor(signal)

    def where(self, condition: torch.Tensor, then: Any, otherwise: Any) -> torch.Tensor:
        """Choose entry by entry; of two numbers in double precision."""
        if not isinstance(then, torch.Tensor) and not isinstance(otherwise, torch.Tensor):
            then = torch.tensor(then, dtype=torch.float64, device=self.device)
        return torch.where(condition, then, otherwise)

    @staticmethod
    def max(
        values: torch.Tensor, axis: int | None = None, initial: float | None = None
    ) -> torch.Tensor:
        """Largest value, not a number where one is none; at least ``initial``."""
        largest = values.amax() if axis is None else values.amax(axis)
        return largest if initial is None else largest.clamp_min(initial)

    @staticmethod
    def maximum(values: torch.Tensor, other: Any) -> torch.Tensor:
        """Entry by entry the larger one, of a tensor and a tensor or a number."""
        return (
            torch.maximum(values, other)
            if isinstance(other, torch.Tensor)
            else values.clamp_min(other)
        )

    @staticmethod
    def minimum(values: torch.Tensor, other: Any) -> torch.Tensor:
        """Entry by entry the smaller one, likewise."""
        return (
            torch.minimum(values, other)
            if isinstance(other, torch.Tensor)
            else values.clamp_max(other)
        )

    @staticmethod
    def flatnonzero(values: torch.Tensor) -> torch.Tensor:
        """Places of what is true, shape (place,)."""
        return values.nonzero()[:, 0]

    @staticmethod
    def array_equal(a: Any, b: Any) -> bool:
        """Tell whether two tensors, or lists of them, are equal throughout."""
        pairs = [(a, b)] if isinstance(a, torch.Tensor) else list(zip(a, b, strict=True))
        return all(torch.equal(one, other) for one, other in pairs)
