"""What is known of the parameters at one moment: values, covariance, verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array, Parameter, bounds


class Verdict(str, Enum):
    """How far a parameter can be believed."""

    IDENTIFIED = 'identified'
    CONVERGING = 'converging'
    UNEXCITED = 'unexcited'
    FROZEN = 'frozen'
    IMPLAUSIBLE = 'implausible'
    MISFIT = 'misfit'
    NEGLIGIBLE = 'negligible'


def misfit(verdict: Verdict) -> Verdict:
    """Return what a verdict becomes where the white box does not explain the data."""
    return verdict if verdict in (Verdict.FROZEN, Verdict.IMPLAUSIBLE) else Verdict.MISFIT


COUNTS_AS_KNOWN = (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE)
"""Verdicts under which a controller may lean on a number."""


def unsettled(verdict: Verdict) -> Verdict:
    """Return what a verdict becomes while the newest samples do not bear the estimate out."""
    return Verdict.CONVERGING if verdict in COUNTS_AS_KNOWN else verdict


NOT_FINITE = 'an estimate that is not finite'
"""Why such an estimate is not given out."""


def all_finite(array: Array) -> bool:
    """Tell whether every number of a small array is finite; numpy takes longer for a dozen."""
    return all(map(math.isfinite, array.ravel().tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Estimate of every context node of a group of motors.

    Attributes:
        stamp_ns: stamp of the last sample that was learnt.
        parameters: what the columns are.
        value: shape (motor, parameter), SI units.
        covariance: shape (motor, parameter, parameter).
        verdicts: verdicts[motor][parameter].
    """

    stamp_ns: int
    parameters: tuple[Parameter, ...]
    value: Array
    covariance: Array
    verdicts: tuple[tuple[Verdict, ...], ...]

    def for_motor(self, motor: int) -> Estimate:
        """Return the estimate of one motor, with a motor axis of one."""
        one = slice(motor, motor + 1)
        return Estimate(
            self.stamp_ns,
            self.parameters,
            self.value[one],
            self.covariance[one],
            self.verdicts[one],
        )

    @property
    def std(self) -> Array:
        """Standard deviations, shape (motor, parameter)."""
        result: Array = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return result

    @property
    def is_finite(self) -> bool:
        """Whether every number in it is finite."""
        return all_finite(self.value) and all_finite(self.covariance)

    def checked(self) -> Estimate:
        """Return the estimate itself, where it may be given out.

        Raises:
            ArithmeticError: a number in it is not finite.
        """
        if not self.is_finite:
            raise ArithmeticError(NOT_FINITE)
        return self

    def bound_met(self, motor: int, parameter: int) -> str:
        """Say which bound a value stands at, for an ``implausible`` one; empty where at none."""
        if self.verdicts[motor][parameter] is not Verdict.IMPLAUSIBLE:
            return ''
        p = self.parameters[parameter]
        value = self.value[motor, parameter]

        def distance(bound: tuple[str, float]) -> float:
            return float(abs(value - bound[1]) / (abs(value) + abs(bound[1]) + 1e-300))

        nearer, limit = min(('lower', p.lower), ('upper', p.upper), key=distance)
        return f'at its {nearer} bound of {limit:g} {p.unit}'

    def with_known_parts(self, parts: Array) -> Estimate:
        """Return the estimate of whole parameters, of which a part was known.

        Args:
            parts: shape (parameter,): what was known of each; of further ones nothing.
        """
        if not np.count_nonzero(parts):
            return self
        whole = np.concatenate([parts, np.zeros(len(self.parameters) - parts.size)])
        parameters = tuple(
            replace(p, lower=p.lower + part, upper=p.upper + part, initial=p.initial + part)
            if part
            else p
            for p, part in zip(self.parameters, whole.tolist(), strict=True)
        )
        return replace(self, parameters=parameters, value=self.value + whole)

    def identified(self, motor: int) -> bool:
        """Tell whether every parameter of one motor is identified."""
        return all(verdict in COUNTS_AS_KNOWN for verdict in self.verdicts[motor])


LOG_NORMAL = 0.3
"""Relative standard deviation up to which the spread of a logarithm is as good as that of the
value."""

ABSURD_SPREAD = 1e12
"""Relative standard deviation that is none: products of such variances would soon be no numbers."""

WIDEST = 4.0
"""Standard deviation of a logarithm beyond which nothing is known either way; it also keeps the
exponential finite."""


def spread_of_values(value: Array, covariance: Array) -> Array:
    """Turn a wide spread of logarithms into that of the values, where the two differ.

    Along every principal axis of the relative covariance a log-normal of spread s reaches up to
    ``exp(s) - 1`` of the value with one standard deviation; from LOG_NORMAL on s grows as fast as
    that. What is known sharply, and sharply known combinations of vaguely known values, stay as
    they are. Without this R would be called known where K_HS happens to be guessed small: the share
    of the voltage that falls on it, and so the spread of R, would be as small.

    Args:
        value: shape (motor, parameter).
        covariance: shape (motor, parameter, parameter): linearised, in the units of the values.
    """
    wide = (covariance.diagonal(0, 1, 2) > (LOG_NORMAL * value) ** 2).any(axis=1)
    if not wide.any():
        return covariance
    wide &= np.isfinite(covariance).all(axis=(1, 2))
    if not wide.any():
        return covariance
    unit = value[wide, :, None] * value[wide, None, :]
    variance, axes = np.linalg.eigh(covariance[wide] / unit)
    spread = np.sqrt(np.maximum(variance, 0.0))
    beyond = np.clip(spread, LOG_NORMAL, WIDEST)
    spread += np.expm1(beyond) - np.expm1(LOG_NORMAL) - (beyond - LOG_NORMAL)
    wide_covariance = covariance.copy()
    wide_covariance[wide] = (axes * spread[:, None, :] ** 2) @ np.swapaxes(axes, 1, 2) * unit
    return wide_covariance


def bounded(value: Array, covariance: Array) -> Array:
    """Covariances that are finite and plausible; others keep only the values' magnitude."""
    finite = np.all(np.isfinite(covariance), axis=(1, 2))
    finite &= np.all(covariance.diagonal(0, 1, 2) <= (ABSURD_SPREAD * value) ** 2, axis=1)
    if finite.all():
        return covariance
    unknown = np.eye(value.shape[1]) * np.expm1(WIDEST) ** 2 * value[:, :, None] * value[:, None, :]
    return np.where(finite[:, None, None], covariance, unknown)


SIGN_STDS = 3.0
"""Standard deviations that a parameter must be away from zero for its sign to be known."""


@dataclass(frozen=True, slots=True)
class VerdictSettings:
    """When a parameter counts as identified.

    Attributes:
        identified_relative_std: largest standard deviation, as a fraction of the value, that may be
            called identified.
        excited_relative_std: a parameter whose standard deviation stays above this fraction has not
            been excited.
        bound_tolerance: nearness to a bound, as a fraction of it, that is called implausible.
        negligible_share: of the voltage; a parameter that takes less, at most, is as good as zero.
    """

    identified_relative_std: float = 0.02
    excited_relative_std: float = 0.3
    bound_tolerance: float = 1e-3
    negligible_share: float = 5e-3

    def judge(
        self,
        parameters: tuple[Parameter, ...],
        value: Array,
        std: Array,
        *,
        is_frozen: bool = False,
        most: Array | None = None,
    ) -> tuple[tuple[Verdict, ...], ...]:
        """Judge every parameter of every motor.

        Args:
            parameters: what the columns are.
            value: shape (motor, parameter).
            std: likewise, their standard deviations.
            is_frozen: whether nothing is learnt.
            most: likewise, the share of the voltage that each takes at most; infinite where that is
                not known.
        """
        if is_frozen:
            return tuple(tuple(Verdict.FROZEN for _ in parameters) for _ in value)
        shares = [None] * len(value) if most is None else most.tolist()
        return tuple(
            self.judge_motor(parameters, values, stds, own_shares)
            for values, stds, own_shares in zip(value.tolist(), std.tolist(), shares, strict=True)
        )

    def judge_motor(
        self,
        parameters: tuple[Parameter, ...],
        values: Sequence[float],
        stds: Sequence[float],
        most: Sequence[float] | None = None,
    ) -> tuple[Verdict, ...]:
        """Judge every parameter of one motor that learns, in plain numbers: these are few.

        Arguments are those of :meth:`judge`, of one motor.
        """
        limits = _inner_bounds(parameters, self.bound_tolerance)
        shares = [math.inf] * len(limits) if most is None else most
        columns = zip(values, stds, limits, shares, strict=True)
        return tuple(self._judge_one(*column) for column in columns)

    def _judge_one(
        self, value: float, std: float, limits: tuple[float, float], most: float
    ) -> Verdict:
        """Judge one parameter, between its limits."""
        is_inside = not (value <= limits[0] or value >= limits[1])
        is_excited = std <= self.excited_relative_std * value
        if is_inside and is_excited and std <= self.identified_relative_std * value:
            return Verdict.IDENTIFIED
        if most < self.negligible_share:
            return Verdict.NEGLIGIBLE
        if not is_inside:
            return Verdict.IMPLAUSIBLE
        return Verdict.CONVERGING if is_excited else Verdict.UNEXCITED

    def judge_signed(self, value: float, std: float, share: float) -> Verdict:
        """Judge a parameter of either sign that its logarithm's deviation would call identified.

        Args:
            value: of it, in SI units.
            std: standard deviation, likewise.
            share: of the voltage that one unit of it takes; 0: not known.

        Returns:
            ``identified`` where its sign is known, and it itself to what may be neglected of the
            voltage; ``negligible`` where it takes no more than that; else ``converging``.
        """
        size = abs(value)
        if std <= self.identified_relative_std * size:
            return Verdict.IDENTIFIED
        if (size + SIGN_STDS * std) * share < self.negligible_share and share > 0.0:
            return Verdict.NEGLIGIBLE
        is_sharp = 0.0 < std * share <= self.negligible_share
        has_sign = size > SIGN_STDS * std
        return Verdict.IDENTIFIED if is_sharp and has_sign else Verdict.CONVERGING


def verdicts_of(codes: NDArray[np.integer[Any]]) -> tuple[tuple[Verdict, ...], ...]:
    """Return verdicts by their places in :class:`Verdict`, shape (motor, parameter)."""
    return tuple([tuple(map(_VERDICTS.__getitem__, row)) for row in codes.tolist()])


_VERDICTS = tuple(Verdict)


@lru_cache(maxsize=64)
def _inner_bounds(
    parameters: tuple[Parameter, ...], tolerance: float
) -> tuple[tuple[float, float], ...]:
    """Return between which values every parameter is plausible."""
    lower, upper = bounds(parameters)
    least, most = lower * (1.0 + tolerance), upper * (1.0 - tolerance)
    return tuple(zip(least.tolist(), most.tolist(), strict=True))
