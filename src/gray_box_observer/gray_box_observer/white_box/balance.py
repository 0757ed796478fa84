"""The balance of a state and its parts: formulas with derivatives, known and unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Form:
    """A formula with derivatives, elementwise in the signals: numbers, arrays or tensors.

    Attributes:
        value: the formula, of everything that :meth:`Balance.signals` returns.
        partial: derivatives by every state and the speed.
        total_slope: derivative by the current where the speed follows it.
    """

    value: Callable[..., Any]
    partial: tuple[Callable[..., Any], ...]
    total_slope: Callable[..., Any]


def sign(x: Any) -> Any:
    """Sign of a number, an array or a tensor, by operators alone; 0 of 0."""
    return x / (abs(x) + 1e-300)


def deducted(start: Any, coefficients: Iterable[Any], parts: Iterable[Any]) -> Any:
    """Return ``start - sum_j coefficient_j part_j``, the sum behind balances and derivatives."""
    for coefficient, part in zip(coefficients, parts, strict=True):
        start = start - coefficient * part
    return start


Functions = tuple[Callable[..., Any], ...]

Effects = tuple[tuple[Any, Callable[..., Any]], ...]
"""Known effects, or their derivatives: coefficients, lined up with the signals, and functions."""


@dataclass(frozen=True)
class Balance:
    """One state's balance, elementwise: ``storage d state / dt = drive - sum of its effects``.

    Attributes:
        storage: place of the coefficient of the derivative among the parameters.
        places: places of the coefficients of the unknown effects.
        unknown_effects: these effects, for coefficients of one.
        unknown_slopes: their derivatives by every state; total where the speed follows the current.
        known_effects: the known effects.
        known_slopes: their derivatives likewise.
        drive_form: the drive; ``None``: the voltage.
        torque_constant: Kt in N m/A, lined up with the signals.
        speed_measured: whether the speed is a signal of its own.
        following_speed: the speed that follows the current; ``None``: it is measured or a state.
    """

    storage: int
    places: tuple[int, ...]
    unknown_effects: Functions
    unknown_slopes: tuple[Functions, ...]
    known_effects: Effects
    known_slopes: tuple[Effects, ...]
    drive_form: Form | None
    torque_constant: Any
    speed_measured: bool
    following_speed: Callable[..., Any] | None

    def signals(
        self, states: Sequence[Any], measured_rad_s: Any, voltage_v: Any
    ) -> tuple[Any, ...]:
        """The states, the speed where it is none of them, the constants, and the held voltage."""
        further = self.torque_constant, voltage_v
        if self.following_speed is not None:
            return *states, self.following_speed(*states, self.torque_constant), *further
        return (*states, measured_rad_s, *further) if self.speed_measured else (*states, *further)

    def drive(self, signals: tuple[Any, ...]) -> Any:
        """Drive less every known effect."""
        rest = signals[-1] if self.drive_form is None else self.drive_form.value(*signals)
        for constant, effect in self.known_effects:
            rest = rest - constant * effect(*signals)
        return rest

    def drive_slope(self, state: int, signals: tuple[Any, ...]) -> Any:
        """Derivative of :meth:`drive` by a state."""
        rest = (
            0.0 * signals[state]
            if self.drive_form is None
            else self.drive_form.partial[state](*signals)
        )
        for constant, slope in self.known_slopes[state]:
            rest = rest - constant * slope(*signals)
        return rest

    def basis(self, signals: tuple[Any, ...]) -> list[Any]:
        """Every unknown effect for a coefficient of one."""
        return [effect(*signals) for effect in self.unknown_effects]

    def basis_slope(self, state: int, signals: tuple[Any, ...]) -> list[Any]:
        """Derivatives of :meth:`basis` by a state; plain numbers where they are constant."""
        return [slope(*signals) for slope in self.unknown_slopes[state]]
