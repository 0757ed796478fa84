"""What an update rule and a predictor may ask of any white box that is linear in its parameters.

The form is ``u = theta_0 dx/dt + sum_j theta_j phi_j(x, w)``: a drive ``u``, one state ``x`` that is measured, and
an exogenous signal ``w``. Everything the learners need follows from the basis functions ``phi_j``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""A float array; where a function is elementwise it also takes torch tensors."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown physical parameter.

    Attributes:
        name: as in topics, YAML and reports.
        unit: SI unit.
        initial: where identification starts unless the user says otherwise.
        lower: smallest plausible value; positive, because the context nodes live on a logarithmic scale.
        upper: largest plausible value.
        description: one line for documentation and parameter descriptors.
        heats: whether it follows the temperature of the winding, and so is the first suspect when the motor changes.
    """

    name: str
    unit: str
    initial: float
    lower: float
    upper: float
    description: str
    heats: bool = False

    def __hash__(self) -> int:
        return hash(self.name)


@lru_cache(maxsize=64)
def bounds(parameters: tuple[Parameter, ...]) -> tuple[Array, Array]:
    """Smallest and largest plausible values of parameters, each of shape (parameter,); not to be written to."""
    lower, upper = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
    for limits in (lower, upper):
        limits.flags.writeable = False
    return lower, upper


class WhiteBox(Protocol):
    """The contract between the physics and everything that learns from it.

    Shapes: ``motor`` is the leading axis everywhere; ``parameter`` counts :attr:`parameters`, whose first entry is
    the coefficient of the derivative (the inductance of a motor).
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown parameters, that of the derivative first."""

    @property
    def speed_measured(self) -> bool:
        """Whether the terms use a measured speed."""

    def of_motors(self, index: Any) -> WhiteBox:
        """Return the white box of the chosen motors, in the order of ``index``."""

    def state(self, torque_nm: Array) -> Array:
        """Turn the measured output into the state (torque to current). Elementwise."""

    def output(self, state: Array) -> Array:
        """Turn the state into the measured output (current to torque). Elementwise."""

    def drive(self, voltage_v: Array, state: Array, speed_rad_s: Array) -> Array:
        """Return the input less every known term, in V. Elementwise."""

    def basis(self, state: Array, speed_rad_s: Array) -> list[Any]:
        """Return ``phi_j`` for every parameter but the first, each of the shape of the state. Elementwise."""

    def basis_slope(self, state: Array, speed_rad_s: Array) -> list[Any]:
        """Return ``d phi_j / d state`` for every parameter but the first. Elementwise."""

    def drive_slope(self, state: Array, speed_rad_s: Array) -> Array:
        """Return ``d drive / d state``. Elementwise."""

    def speed(self, state: Array, measured_rad_s: Array) -> Array:
        """Return the shaft speed the terms use: measured, or that of the thesis (``w = Kt i``). Elementwise."""
