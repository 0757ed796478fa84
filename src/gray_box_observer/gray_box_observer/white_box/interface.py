"""What an update rule and a predictor may ask of any white box that is linear in its parameters.

Every state ``x`` has a balance ``theta_0 dx/dt = u - sum_j theta_j phi_j``: a drive ``u``, and
effects ``phi_j`` of the signals, which are the states and what is measured beside them. Everything
the learners need follows from these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gray_box_observer.white_box.balance import Balance

Array = NDArray[np.float64]
"""A float array; where a function is elementwise it also takes torch tensors."""


@dataclass(frozen=True)
class Parameter:
    """One unknown physical parameter.

    Attributes:
        name: as in topics, YAML and reports.
        unit: SI unit.
        initial: where identification starts unless the user says otherwise.
        lower: smallest plausible value; positive, because the context nodes live on a logarithmic
            scale.
        upper: largest plausible value.
        description: one line for documentation and parameter descriptors.
        heats: whether it follows the temperature of the winding, and so is the first suspect when
            the motor changes.
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
    """Smallest and largest plausible parameters, each of shape (parameter,); read-only."""
    lower, upper = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
    for limits in (lower, upper):
        limits.flags.writeable = False
    return lower, upper


class WhiteBox(Protocol):
    """The contract between the physics and everything that learns from it.

    Shapes: ``motor`` is the leading axis everywhere; ``parameter`` counts :attr:`parameters`, whose
    first entry is the coefficient of the measured state's derivative (the inductance of a motor).
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknown parameters, that of the derivative first."""

    @property
    def known_parts(self) -> Array:
        """What is known of every unknown parameter, shape (parameter,): 0 of nearly all."""

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the terms whose values are known, or known in part."""

    @property
    def states(self) -> tuple[int, ...]:
        """Numbers of the states that it has."""

    @property
    def speed_measured(self) -> bool:
        """Whether the effects use a measured speed."""

    @property
    def has_rotor(self) -> bool:
        """Whether the speed is a state of its own, which nobody measures."""

    @property
    def holds_current(self) -> bool:
        """Whether brushes may hold its current, beside a measured speed."""

    @property
    def load_varies(self) -> bool:
        """Whether a load acts on the rotor that no term describes."""

    def of_motors(self, index: Any) -> WhiteBox:
        """Return the white box of the chosen motors, in the order of ``index``."""

    def state(self, torque_nm: Array) -> Array:
        """Turn the measured output into the state (torque to current). Elementwise."""

    def output(self, state: Array) -> Array:
        """Turn the state into the measured output (current to torque). Elementwise."""

    def speed(self, state: Any, measured_rad_s: Any) -> Any:
        """Return the shaft speed the effects use: measured, or that of the thesis. Elementwise."""

    def balances(self, signal: Any) -> tuple[Balance, ...]:
        """Return each state's balance, in order, for signals with as many axes as this."""

    def drive(self, voltage_v: Any, state: Any, speed_rad_s: Any) -> Any:
        """Return the drive of the measured state less every known effect, in V. Elementwise."""

    def basis(self, voltage_v: Any, state: Any, speed_rad_s: Any) -> list[Any]:
        """Return ``phi_j`` of the measured state for every parameter but the first. Elementwise."""
