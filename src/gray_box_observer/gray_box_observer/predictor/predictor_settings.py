"""Settings of the predictor and of its training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.settings.device import CPU

RECENT = 500
"""Samples on which variant ``physics`` compares a new network with the running one."""


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """How the LSTM is trained.

    Attributes:
        variant: what the network is taught on.
        hidden: hidden units (thesis: 2).
        context: past samples the network warms up on before its output counts (thesis: 64).
        minibatch: windows a step.
        steps: Adam steps a job.
        period: samples between two jobs.
        learning_rate: of Adam (thesis: 0.001; online there are no 800 epochs to wait for).
        smallest_learning_rate: where plateau cuts end.
        patience: jobs without a better loss before the learning rate is halved.
        gradient_clip: largest norm of a gradient.
        weight_floor: constant added to the transition weights (thesis: 0.07).
        replay_capacity: newest samples remembered for training.
        segments: segments of older samples remembered beside them, of regimes that were left
            (variant ``physics``).
        core_share: share of one core that training in the background may use.
        start: ``shipped``: variant ``physics`` begins with the network that comes with the package;
            ``fresh``: with one that has learnt nothing.
        residual: learn what the physics does not explain, where held-out samples bear it out
            (variant ``physics``).
        horizon_s: longest forecast wanted of variant ``physics``, in s; 0: none beyond a sample
            interval.
        device: torch's, on which the network is taught; its training process then takes memory of
            the device.
        voltage_limits_v: lowest and highest voltage to be ready for; equal: learnt from what was
            seen.
    """

    variant: Variant = Variant.PHYSICS
    hidden: int = 12
    context: int = 64
    minibatch: int = 12
    steps: int = 7
    period: int = 100
    learning_rate: float = 0.005
    smallest_learning_rate: float = 2e-4
    patience: int = 15
    gradient_clip: float = 1.0
    weight_floor: float = 0.07
    replay_capacity: int = 6000
    segments: int = 12
    core_share: float = 0.1
    start: str = 'shipped'
    residual: bool = True
    horizon_s: float = 0.0
    voltage_limits_v: tuple[float, float] = (0.0, 0.0)
    device: str = CPU

    def __post_init__(self) -> None:
        for name in ('hidden', 'context', 'minibatch', 'steps', 'period', 'replay_capacity'):
            if getattr(self, name) < 1:
                raise ConfigurationError(
                    f'training {name} must be at least 1, got {getattr(self, name)}'
                )
        if self.segments < 0:
            raise ConfigurationError(f'training segments must not be negative, got {self.segments}')

    @property
    def length(self) -> int:
        """Samples in a training window: context and half as many again, which make the loss."""
        return self.context + max(2, self.context // 2)

    @property
    def job_samples(self) -> int:
        """Newest samples that a job carries: all for the thesis's windows, else few to judge."""
        return (
            min(RECENT, self.replay_capacity)
            if self.variant is Variant.PHYSICS
            else self.replay_capacity
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for another process."""
        return {
            **asdict(self),
            'variant': self.variant.value,
            'voltage_limits_v': list(self.voltage_limits_v),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainingSettings:
        """Build the rules that :meth:`to_dict` described."""
        low_v, high_v = values['voltage_limits_v']
        return cls(
            **{**values, 'variant': Variant(values['variant']), 'voltage_limits_v': (low_v, high_v)}
        )
