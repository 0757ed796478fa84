"""Which parameters of a rotor with a measured speed are fitted, and what is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gray_box_observer.context_nodes.estimate import (
    COUNTS_AS_KNOWN,
    Estimate,
    Verdict,
    VerdictSettings,
)
from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.rotor.history_unknowns import LOADS
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import TERMS, State
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


def load_spread(mechanics: Mechanics, fit: OutputFit, torque_constant: float) -> Array:
    """Return by how much a load that varies may have moved the rotor's parameters, relative.

    A load is told from inertia and friction by its course alone, and how it goes is an assumption.
    So every parameter is known no better than if all that varies were its own.

    Args:
        mechanics: what is fitted.
        fit: of both outputs.
        torque_constant: Kt in N m/A.

    Returns:
        Shape (node,); 0 where the load is constant.
    """
    spread = np.zeros(len(mechanics.nodes))
    loads = [start[LOADS] for start in fit.fit.starts if start[LOADS].size]
    if not fit.walk > 0.0 or not loads:
        return spread
    load = float(np.sqrt(np.mean(np.concatenate(loads) ** 2)))
    values = _values(mechanics, fit)
    runs = zip(fit.window.histories, fit.fit.runs.runs, strict=True)
    accelerations = [np.diff(run.states[:, State.SPEED]) / one.interval_s for one, run in runs]
    current, speed = np.concatenate([run.states for run in fit.fit.runs.runs]).T
    for place, name in enumerate(mechanics.nodes):
        if TERMS[name].formula:
            effect = forms.EFFECTS[name].value(current, speed, torque_constant, 0.0)
            own = values[name] / values['inertia'] * np.broadcast_to(effect, current.shape)
        else:
            own = np.concatenate(accelerations)
        spread[place] = load / max(float(np.sqrt(np.mean(own**2))), 1e-300)
    return np.asarray(np.minimum(spread, WIDEST))


def _values(mechanics: Mechanics, fit: OutputFit) -> dict[str, float]:
    """Return the rotor's parameters by name."""
    values = fit.fit.theta[-len(mechanics.nodes) :].tolist()
    return {**mechanics.known_values, **dict(zip(mechanics.nodes, values, strict=True))}


def limited(
    estimate: Estimate, spread: Array, rules: VerdictSettings, *, is_settled: bool
) -> Estimate:
    """Return an estimate of the rotor as far as its load lets it be believed.

    Args:
        estimate: shape (1, node) in its value.
        spread: shape (node,): of :func:`load_spread`.
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
    at_most = tuple(
        Verdict.CONVERGING if verdict in COUNTS_AS_KNOWN else verdict for verdict in verdicts[0]
    )
    return replace(estimate, covariance=covariance, verdicts=(at_most,))


WIDEST = 100.0
"""Relative spread that is told at most."""

_DEFAULT_NODES = ('inertia', 'viscous_friction', 'coulomb_friction')

DEFAULT_MECHANICS = Mechanics(
    _DEFAULT_NODES,
    [TERMS[name].parameter.initial for name in _DEFAULT_NODES],
    [0.0 for _ in _DEFAULT_NODES],
)
"""What is fitted beside the electrical parameters where nobody asks for the rotor's."""
