"""The contract of every rule that updates the context nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array, Parameter


class ContextUpdate(Protocol):
    """Learns the context nodes of a group, one sample at a time (thesis 4.3)."""

    replay: ReplayBuffer
    """The samples it remembers."""

    verdict_rules: VerdictSettings
    """When a parameter counts as identified; may be changed at any time."""

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimate the last sample has changed, shape (motor,)."""

    def learn(self, sample: Sample) -> bool:
        """Take one sample; tell whether an estimate has changed."""

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter); positive and inside their bounds."""

    def estimate(self, selection: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts, of all motors or of some."""

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of one motor, as plain values and arrays, for a checkpoint."""

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave, for one motor."""

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """What the rule has met so far, by a name for diagnostics; of one motor or of all."""

    def present_since(self, motor: int) -> int:
        """Return the place from which one motor is the present one: that of its last change.

        Samples before it may be remembered no more; the place stays. A checkpoint that holds fewer
        samples than the memory would may move it on to the first of them.
        """

    def is_drifting(self, motor: int) -> bool:
        """Tell whether one motor is known to drift."""

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return one motor's voltage shares per unit of parameter, and their 3-sigma bound.

        Shape (parameter,) each; a share of 0 is one that is not known.
        """

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning; what was learnt stays."""


def learn_at_once(nodes: ContextUpdate, content: Array, newest: Sample) -> None:
    """Give a rule samples of the past as what it remembers, and let it learn the newest of them.

    The recursive rule then fits everything at once, which takes a fraction of the time of learning
    one sample after another.

    Args:
        nodes: the rule, which has learnt nothing yet.
        content: shape (signal, motor, n): the samples, as a replay buffer gives them.
        newest: the last of them.
    """
    plain, arrays = nodes.state()
    nodes.restore(plain, {**arrays, 'replay': content[:, :, :-1]})
    nodes.learn(newest)


def check_parameters(plain: Mapping[str, Any], parameters: Sequence[Parameter]) -> None:
    """Refuse a saved state of other parameters than those of a rule.

    Args:
        plain: the state, with the ``parameters`` that it was learnt of.
        parameters: those of the rule.

    Raises:
        ConfigurationError: they are others.
    """
    names = [parameter.name for parameter in parameters]
    if plain['parameters'] != names:
        raise ConfigurationError(
            f'the checkpoint holds {printable(plain["parameters"], 200)}, expected {names}'
        )
