"""The belief about a group at one sample: state, coordinates, covariance and noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import Scaling
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, CURRENT, STATES
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    ArrayRule,
    check_array,
    check_arrays,
    check_covariance,
    positive,
)
from gray_box_observer.white_box.interface import Array

LARGEST_OF_UNIT_NOISE = LARGEST**3
"""Covariance for unit noise beyond which none is; of noise that is tiny it is huge."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is believed before the data: every coordinate log-normal.

    Attributes:
        p: shape (motor, coordinate): medians.
        covariance: shape (motor, coordinate, coordinate): of the coordinates' logarithms.
    """

    p: Array
    covariance: Array

    @classmethod
    def vague(cls, p: Array, relative_std: float) -> Prior:
        """Return a prior of independent coordinates, all known as well."""
        return cls(p, np.tile(relative_std**2 * np.eye(p.shape[1]), (p.shape[0], 1, 1)))

    def select(self, index: NDArray[np.intp]) -> Prior:
        """Return the prior of the chosen motors."""
        return Prior(self.p[index], self.covariance[index])

    @classmethod
    def of_parameters(cls, p: Array, relative_std: Array) -> Prior:
        """Return a prior of independent parameters, each known as well as is said.

        With ``log p = M log theta`` (``p_0 = 1 / theta_0``, ``p_j = theta_j / theta_0``) the
        covariance is ``M diag(std^2) M'``.

        Args:
            p: shape (motor, coordinate): medians.
            relative_std: shape (motor, parameter): standard deviations of the parameters'
                logarithms.
        """
        n = p.shape[1]
        map_ = np.eye(n)
        map_[:, 0] = -1.0
        return cls(p, np.einsum('pi,mi,qi->mpq', map_, relative_std**2, map_))

    def loosened(self, directions: Array) -> Prior:
        """Return the prior with freedom added along directions, shape (coordinate[, k])."""
        spread = directions.reshape(self.p.shape[1], -1)
        return replace(self, covariance=self.covariance + spread @ spread.T)


@dataclass(frozen=True, eq=False)
class Belief:
    """State and coordinates at a sample; what a fit gives and the recursion carries on.

    Attributes:
        current_a: shape (motor,): size of the current, the unit of the state.
        p: shape (motor, coordinate): the coordinates of :mod:`gray_box_observer.white_box.flow`.
        state: shape (motor,): current in A.
        covariance: shape (motor, unknown, unknown): of (state, coordinates) in the frame, for unit
            noise.
        noise: shape (motor,): standard deviation of the prediction error of the current, in A.
        gain: shape (motor,): share of a prediction error that is taken for a disturbance.
        sensitivity: shape (motor, coordinate): derivative of the state by the coordinates, in the
            frame.
    """

    current_a: Array
    p: Array
    state: Array
    covariance: Array
    noise: Array
    gain: Array
    sensitivity: Array

    @classmethod
    def before_data(cls, prior: Prior) -> Belief:
        """Return what is believed when nothing has been seen: the prior alone."""
        motors, n = prior.p.shape
        covariance = np.zeros((motors, n + STATES, n + STATES))
        covariance[:, CURRENT, CURRENT] = 1.0
        covariance[:, COORDINATES, COORDINATES] = prior.covariance
        ones = np.ones(motors)
        return cls(ones, prior.p, 0.0 * ones, covariance, ones, 0.0 * ones, np.zeros((motors, n)))

    def select(self, index: NDArray[np.intp]) -> Belief:
        """Return what is believed of the chosen motors."""
        return Belief(*(array[index] for array in self.arrays().values()))

    @property
    def frame(self) -> Scaling:
        """Units of the unknowns."""
        return Scaling(self.current_a, self.p)

    @property
    def posterior(self) -> Array:
        """Covariance of the coordinates' logarithms, shape (motor, coordinate, coordinate)."""
        posterior: Array = (
            self.covariance[:, COORDINATES, COORDINATES] * self.noise[:, None, None] ** 2
        )
        return posterior

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Whether everything is a finite number, shape (motor,)."""
        motors = self.state.size
        rows = np.concatenate([getattr(self, name).reshape(motors, -1) for name in _ARRAYS], axis=1)
        finite: NDArray[np.bool_] = np.isfinite(rows).all(axis=1)
        return finite

    def overwritten(self, other: Belief, selection: NDArray[np.bool_]) -> Belief:
        """Return this belief with that of another for some of the motors."""
        if selection.all():
            return other
        arrays = {
            name: np.where(
                selection.reshape((-1,) + (1,) * (old.ndim - 1)), getattr(other, name), old
            )
            for name, old in self.arrays().items()
        }
        return Belief(**arrays)

    def loosened(self, directions: Array) -> Belief:
        """Return the belief with freedom added to the log-coordinates, shape (coordinate, k)."""
        covariance = self.covariance.copy()
        covariance[:, COORDINATES, COORDINATES] += (
            directions @ directions.T / self.noise[:, None, None] ** 2
        )
        return replace(self, covariance=covariance)

    def restarted_at(self, state: Array) -> Belief:
        """Return the belief with a state just measured, as uncertain as one sample leaves it."""
        covariance = self.covariance.copy()
        covariance[:, CURRENT, :] = covariance[:, :, CURRENT] = 0.0
        covariance[:, CURRENT, CURRENT] = self.current_a**-2.0
        return replace(
            self, state=state, covariance=covariance, sensitivity=np.zeros_like(self.sensitivity)
        )

    def arrays(self) -> dict[str, Array]:
        """Every array by its name, for a checkpoint."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


_ARRAYS = tuple(field.name for field in fields(Belief))


def check_belief(name: str, arrays: Mapping[str, Array], coordinates: int) -> None:
    """Refuse a saved belief that is none.

    Args:
        name: that its arrays' names begin with, before a dot.
        arrays: its arrays among others.
        coordinates: how many there are.

    Raises:
        CheckpointError: an array is missing, of another shape or out of range.
    """
    n = coordinates
    shape = (1, n + STATES, n + STATES)
    rules = {
        'current_a': positive(1),
        'p': positive(1, n),
        'state': ArrayRule((1,)),
        'covariance': ArrayRule(shape, -LARGEST_OF_UNIT_NOISE, LARGEST_OF_UNIT_NOISE),
        'noise': positive(1),
        'gain': ArrayRule((1,), 0.0, 1.0),
        'sensitivity': ArrayRule((1, n)),
    }
    check_arrays(arrays, rules, f'{name}.')
    covariance = arrays[f'{name}.covariance']
    noise = arrays[f'{name}.noise']
    check_array(f'{name}.covariance, times the noise', covariance * noise**2, ArrayRule(shape))
    check_covariance(f'{name}.covariance', covariance)


def check_prior(arrays: Mapping[str, Array], coordinates: int) -> None:
    """Refuse a saved prior that is none.

    Raises:
        CheckpointError: an array is missing, of another shape or out of range.
    """
    n = coordinates
    check_arrays(arrays, {'prior_p': positive(1, n), 'prior_covariance': ArrayRule((1, n, n))})
    check_covariance('prior_covariance', arrays['prior_covariance'], certain=False)
