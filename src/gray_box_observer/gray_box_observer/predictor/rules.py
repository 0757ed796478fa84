"""Settings of the predictor and of its training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.inputs import Variant


@dataclass(frozen=True, slots=True)
class TrainingRules:
    """How the LSTM is trained.

    Attributes:
        variant: stage 2 of the thesis (thesis 5.1).
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
        replay_capacity: samples remembered for training.
    """

    variant: Variant = Variant.MAIN
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

    def __post_init__(self) -> None:
        for name in ('hidden', 'context', 'minibatch', 'steps', 'period', 'replay_capacity'):
            if getattr(self, name) < 1:
                raise ConfigurationError(f'training {name} must be at least 1, got {getattr(self, name)}')

    @property
    def length(self) -> int:
        """Samples in a training window: half as many again as the context, and these count in the loss."""
        return self.context + max(2, self.context // 2)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for another process."""
        return {**asdict(self), 'variant': self.variant.value}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainingRules:
        """Build the rules that :meth:`to_dict` described."""
        return cls(**{**values, 'variant': Variant(values['variant'])})
