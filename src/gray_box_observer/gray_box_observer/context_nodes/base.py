"""The contract of every rule that updates the context nodes."""

from __future__ import annotations

from typing import Any, Protocol

from gray_box_observer.context_nodes.estimate import Estimate, VerdictRules
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.base import Array


class ContextUpdate(Protocol):
    """Learns the context nodes of a group of motors, one sample at a time (thesis: parameter context nodes, 4.3)."""

    replay: ReplayBuffer
    """The samples it remembers."""

    verdict_rules: VerdictRules
    """When a parameter counts as identified; may be changed at any time."""

    def learn(self, sample: Sample) -> bool:
        """Take one sample; tell whether the estimate has changed."""

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter); positive and inside their bounds."""

    def estimate(self) -> Estimate:
        """Return the present values with covariance and verdicts."""

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave."""

    def counters(self) -> dict[str, int]:
        """What the rule has met so far, by a name for diagnostics."""

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning; what was learnt stays."""
