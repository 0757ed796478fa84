"""Which parameters of a rotor with a measured speed are fitted, and what is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gray_box_observer.context_nodes.estimate import (
    Estimate,
    Verdict,
    VerdictSettings,
    unsettled,
)
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Array


@dataclass(frozen=True)
class Mechanics:
    """The mechanical half of one motor.

    Attributes:
        nodes: parameters that are fitted, the inertia among them.
        initial: where to start, SI units, one a node, without known parts.
        initial_relative_std: how well that is known, one a node; 0: nothing is stated.
        known_values: parameters that are known instead, by name.
        known_parts: what is known of nodes that may have either sign, by name.
    """

    nodes: tuple[str, ...]
    initial: Sequence[float]
    initial_relative_std: Sequence[float]
    known_values: Mapping[str, float] = field(default_factory=dict)
    known_parts: Mapping[str, float] = field(default_factory=dict)

    def values(self, theta: Array) -> dict[str, float]:
        """Return the rotor's parameters by name.

        Args:
            theta: shape (parameter,): of the whole motor, those of the rotor last.
        """
        nodes = zip(self.nodes, theta[-len(self.nodes) :].tolist(), strict=True)
        return {**self.known_values, **dict(nodes)}


def limited(
    estimate: Estimate, spread: Array, rules: VerdictSettings, *, is_settled: bool
) -> Estimate:
    """Return an estimate of the rotor as far as its load lets it be believed.

    Args:
        estimate: shape (1, node) in its value.
        spread: shape (node,): of :func:`~.rotor.load_walk.load_spread`.
        rules: what a verdict asks for.
        is_settled: whether enough samples were explained to call anything identified.
    """
    is_constant = not spread.any()
    if is_constant and is_settled:
        return estimate
    size = spread * estimate.value[0]
    covariance = estimate.covariance + np.diag(size**2)
    verdicts = estimate.verdicts
    if not is_constant and Verdict.FROZEN not in verdicts[0]:
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        verdicts = rules.judge(estimate.parameters, estimate.value, std)
    at_most = tuple(map(unsettled, verdicts[0]))
    return replace(estimate, covariance=covariance, verdicts=(at_most,))


_DEFAULT_NODES = ('inertia', 'viscous_friction', 'coulomb_friction')

DEFAULT_MECHANICS = Mechanics(
    _DEFAULT_NODES,
    [TERMS[name].parameter.initial for name in _DEFAULT_NODES],
    [0.0 for _ in _DEFAULT_NODES],
)
"""What is fitted beside the electrical parameters where nobody asks for the rotor's."""
