"""The rotor's parameters that are published beside the electrical ones, as far as one may."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.estimate import Estimate, VerdictSettings, misfit, unsettled
from gray_box_observer.context_nodes.measured_speed.mechanics import (
    DEFAULT_MECHANICS,
    Mechanics,
    limited,
)
from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.rotor.load_walk import WIDEST, load_spread
from gray_box_observer.safe_io.saved_state import MOST, ArrayRule, check_arrays, whole
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Array, Parameter
from gray_box_observer.white_box.motor import MotorWhiteBox

FEWEST_EXPLAINED = 1024
"""Explained samples from which anything of the rotor may be called identified."""

REMAINDER = 0.7
"""Share of what a varying load may have done that is left after a window with a constant load."""

LEAST_SPREAD = 1e-3
"""The least of it that counts."""

_SPREAD = 'measured_speed.load_spread'


class PublishedMechanics:
    """What is published of the rotor of one motor whose speed is measured.

    Args:
        white_box: the electrical half.
        mechanics: the rotor's parameters to publish, with what is known of them beforehand; None:
            none.

    Attributes:
        explained_count: samples in the largest window that was explained; -1: the newest was not.
        spread: by how much a load that varies may have moved the parameters, relative.
    """

    def __init__(self, white_box: MotorWhiteBox, mechanics: Mechanics | None) -> None:
        self._white_box = white_box
        self._mechanics = mechanics
        self._nodes = slice(0, len(white_box.context_nodes))
        self.explained_count = 0
        self.spread: Array = np.zeros(len((mechanics or DEFAULT_MECHANICS).nodes))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return what :meth:`added_to` publishes."""
        rotor = () if self._mechanics is None else self._mechanics.nodes
        return (*self._white_box.parameters, *(TERMS[name].parameter for name in rotor))

    @property
    def known_parts(self) -> Array:
        """What is known of each of them beside its estimate, shape (published parameter,)."""
        if self._mechanics is None:
            return self._white_box.known_parts
        parts = [self._mechanics.known_parts.get(name, 0.0) for name in self._mechanics.nodes]
        return np.concatenate([self._white_box.known_parts, parts])

    def added_to(
        self,
        estimate: Estimate,
        both: Estimate,
        rules: VerdictSettings,
        *,
        is_believed: bool,
        is_unexplained: bool,
    ) -> Estimate:
        """Add the rotor's parameters to an estimate of the electrical ones.

        They come from the fit of both outputs. Where that does not explain the data, or the voltage
        balance does not, they are a misfit. The electrical ones stay as they are. Correlations
        between both are left out: L and R are known by far the best.

        Args:
            estimate: of this motor, as far as it may be believed.
            both: of all parameters, by the fit of both outputs.
            rules: what a verdict asks for.
            is_believed: whether its voltage balance explains the data.
            is_unexplained: whether the fit of both outputs does not explain the newest samples.
        """
        if self._mechanics is None:
            return estimate
        rotor = slice(self._nodes.stop, None)
        own = Estimate(
            both.stamp_ns,
            both.parameters[rotor],
            both.value[:, rotor],
            both.covariance[:, rotor, rotor],
            (both.verdicts[0][rotor],),
        )
        is_settled = self.explained_count >= FEWEST_EXPLAINED
        own = limited(own, self.spread, rules, is_settled=is_settled)
        count = len(self.parameters)
        covariance = np.zeros((1, count, count))
        covariance[:, self._nodes, self._nodes] = estimate.covariance
        covariance[:, rotor, rotor] = own.covariance
        verdicts = own.verdicts[0]
        if is_unexplained:
            verdicts = tuple(map(unsettled, verdicts))
        if not (is_believed and self.explained_count >= 0):
            verdicts = tuple(map(misfit, verdicts))
        return Estimate(
            estimate.stamp_ns,
            self.parameters,
            np.concatenate([estimate.value, own.value], axis=1),
            covariance,
            (estimate.verdicts[0] + verdicts,),
        )

    def note_fit(self, fit: OutputFit, count: int) -> None:
        """Note how many samples a fit explains, and what its load leaves of the mechanics."""
        if self._mechanics is None:
            return
        is_explained = fit.explains_rotor
        self.explained_count = max(self.explained_count, count) if is_explained else -1
        nodes = self._mechanics.nodes
        values = self._mechanics.values(fit.fit.theta)
        torque_constant = float(self._white_box.torque_constant)
        now = load_spread(nodes, values, fit.fit.runs, torque_constant)
        self.spread = np.maximum(now, REMAINDER * self.spread)
        self.spread[self.spread < LEAST_SPREAD] = 0.0

    def note_failure(self) -> None:
        """Note that the newest window is not explained."""
        self.explained_count = -1

    def state(self) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        arrays = {} if self._mechanics is None else {_SPREAD: self.spread.copy()}
        return {'explained': self.explained_count}, arrays

    def restore(self, plain: Mapping[str, Any], arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that could have been learnt.
        """
        if self._mechanics is None:
            return
        self.explained_count = whole(plain, 'explained', -1, MOST)
        check_arrays(arrays, {_SPREAD: ArrayRule(self.spread.shape, 0.0, WIDEST)})
        self.spread = arrays[_SPREAD]
