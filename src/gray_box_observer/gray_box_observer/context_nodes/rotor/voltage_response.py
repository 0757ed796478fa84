"""How the current of a motor with a rotor answers small voltages that last for one interval."""

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
    """What a volt in one interval leaves in the current of the samples after it, of several motors.

    That is a sum of ``size rate^j`` at the j-th one, where all intervals are as long.

    Attributes:
        rates: shape (motor, term, length): of intervals of several lengths.
        sizes_a_v: shape (motor, term, length).
    """

    rates: NDArray[np.complex128]
    sizes_a_v: NDArray[np.complex128]

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
            white_box: of one motor with a rotor.
            logarithms: shape (parameter,) each.
            interval_s: shape (length,).
            is_held: whether the friction holds the rotor; else it keeps its sign.
        """
        modes_of = _modes_of_held if is_held else _modes
        modes = np.array([modes_of(white_box, at) for at in logarithms])
        poles = modes[:, 0, :, None]
        residues = modes[:, 1, :, None]
        exponents = poles * interval_s
        return cls(np.exp(exponents), residues / poles * np.expm1(exponents))

    @property
    def products(self) -> Array:
        """Sums of the products of two of them over all samples after, (motor, motor, length)."""
        sizes = self.sizes_a_v[:, None, :, None] * self.sizes_a_v[None, :, None]
        rates = self.rates[:, None, :, None] * self.rates[None, :, None]
        return np.asarray((sizes / (1.0 - rates)).sum(axis=(2, 3)).real)


def _modes(white_box: MotorWhiteBox, logarithms: Array) -> NDArray[np.complex128]:
    """Return poles in 1/s and residues in A/(V s) of current by voltage, shape (2, term)."""
    values = white_box.values(np.exp(logarithms))
    inverse_h = 1.0 / values['inductance']
    stiffness = float(white_box.torque_constant) * values['back_emf_constant']
    damping = values.get('viscous_friction', 0.0) / values['inertia']
    mean = 0.5 * (values['resistance'] * inverse_h + damping)
    product = (values['resistance'] * damping + stiffness / values['inertia']) * inverse_h
    root = np.sqrt(complex(mean * mean * (1.0 + APART) - product))
    poles = np.array([-mean - root, -product / (mean + root)])
    return np.array([poles, inverse_h * (poles + damping) / (poles - poles[::-1])])


def _modes_of_held(white_box: MotorWhiteBox, logarithms: Array) -> NDArray[np.complex128]:
    """Return the same where the rotor is held: the winding alone answers."""
    values = white_box.values(np.exp(logarithms))
    inverse_h = 1.0 / values['inductance']
    return np.array([[-values['resistance'] * inverse_h], [inverse_h]], dtype=complex)
