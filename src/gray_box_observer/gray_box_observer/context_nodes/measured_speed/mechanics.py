"""Which parameters of a rotor with a measured speed are fitted, and what is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gray_box_observer.white_box.declaration import TERMS


@dataclass(frozen=True, slots=True)
class Mechanics:
    """The mechanical half of one motor.

    Attributes:
        nodes: parameters that are fitted, the inertia among them.
        initial: where to start, SI units, one a node.
        initial_relative_std: how well that is known, one a node; 0: nothing is stated.
        known: parameters that are known instead, by name.
    """

    nodes: tuple[str, ...]
    initial: Sequence[float]
    initial_relative_std: Sequence[float]
    known: Mapping[str, float] = field(default_factory=dict)


_DEFAULT_NODES = ('inertia', 'viscous_friction', 'coulomb_friction')

DEFAULT_MECHANICS = Mechanics(
    _DEFAULT_NODES,
    [TERMS[name].parameter.initial for name in _DEFAULT_NODES],
    [0.0 for _ in _DEFAULT_NODES],
)
"""What is fitted beside the electrical parameters where nobody asks for the rotor's."""
