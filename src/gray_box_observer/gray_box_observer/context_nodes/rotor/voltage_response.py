"""How the current of a motor answers small voltages that last for one interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

APART = 1e-9
"""Share by which the two time constants of a motor differ at least."""


@dataclass(frozen=True, eq=False)
class Winding:
    """What an interval does to a current that deviates by a little.

    Attributes:
        decay: shape (k,): share of it that is left.
        gain_a_v: shape (k,): what a volt over the interval brings to its end.
    """

    decay: Array
    gain_a_v: Array

    @classmethod
    def over(cls, resistance_ohm: float, winding_s: float, interval_s: Array) -> Winding:
        """Return it for intervals, shape (k,).

        Args:
            resistance_ohm: R.
            winding_s: L/R in s.
            interval_s: shape (k,).
        """
        intervals = interval_s / winding_s
        return cls(np.exp(-intervals), -np.expm1(-intervals) / resistance_ohm)


@dataclass(frozen=True, eq=False)
class VoltageResponses:
    """What a volt in one interval leaves in the samples after it, of several motors.

    That is a sum of ``size rate^j`` at the j-th one, where all intervals are as long.

    Attributes:
        rates: shape (motor, term, length): of intervals of several lengths.
        currents_a_v: shape (motor, term, length): sizes of the current.
    """

    rates: NDArray[np.complex128]
    currents_a_v: NDArray[np.complex128]

    @classmethod
    def of_values(
        cls,
        white_box: MotorWhiteBox,
        logarithms: Sequence[Array],
        interval_s: Array,
        *,
        is_held: bool,
    ) -> VoltageResponses:
        """Return those of a motor at several values.

        Args:
            white_box: of one motor; with a rotor where that is not held.
            logarithms: shape (parameter,) each.
            interval_s: shape (length,).
            is_held: whether the friction holds the rotor; else it keeps its sign.
        """
        modes_of = _modes_of_held if is_held else _modes
        modes = np.array([modes_of(white_box, at) for at in logarithms])
        poles, currents = modes.swapaxes(0, 1)[..., None]
        exponents = poles * interval_s
        return cls(np.exp(exponents), currents * np.expm1(exponents) / poles)

    @property
    def current_products(self) -> Array:
        """Sums over all samples after of the products of two currents, (motor, motor, length)."""
        sizes = self.currents_a_v
        rates = self.rates[:, None, :, None] * self.rates[None, :, None]
        terms = sizes[:, None, :, None] * sizes[None, :, None] / (1.0 - rates)
        return np.asarray(terms.sum(axis=(2, 3)).real)


def _modes(white_box: MotorWhiteBox, logarithms: Array) -> NDArray[np.complex128]:
    """Return poles in 1/s and residues of the current by voltage in A/(V s), shape (2, term)."""
    values = white_box.values(np.exp(logarithms))
    inverse_h = 1.0 / values['inductance']
    stiffness = float(white_box.torque_constant) * values['back_emf_constant']
    damping = values.get('viscous_friction', 0.0) / values['inertia']
    mean = 0.5 * (values['resistance'] * inverse_h + damping)
    product = (values['resistance'] * damping + stiffness / values['inertia']) * inverse_h
    root = np.sqrt(complex(mean * mean * (1.0 + APART) - product))
    poles = np.array([-mean - root, -product / (mean + root)])
    shares = inverse_h / (poles - poles[::-1])
    return np.array([poles, shares * (poles + damping)])


def _modes_of_held(white_box: MotorWhiteBox, logarithms: Array) -> NDArray[np.complex128]:
    """Return the same where the rotor is held: the winding alone answers."""
    values = white_box.values(np.exp(logarithms))
    inverse_h = 1.0 / values['inductance']
    pole = -values['resistance'] * inverse_h
    return np.array([[pole], [inverse_h]], dtype=complex)
