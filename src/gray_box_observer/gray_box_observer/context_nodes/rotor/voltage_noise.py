"""Noise of a measured voltage, which the current of the motor does not answer.

The current of the model answers it. Least squares make this answer small, so they make the
inductance large, up to a hundred times: the bias of errors in variables. How large the noise is,
its products with the residual tell. What it adds to sums of squares follows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.noise_filter import NUDGE, variances_of_intervals
from gray_box_observer.context_nodes.rotor.voltage_response import VoltageResponses, Winding
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

STEP = 5.0
"""Standard deviations of a signal's second differences beyond which they are steps, no noise."""

SURE = 3.0
"""Standard errors of what the current tells of a noise. What a driver really applies the current
answers, and what a shaft really does."""

LAGS = (0, -1, 1)
"""Intervals by which readings are compared with the innovation: its own, those before and after."""

FEWEST = 64
"""Samples from which that is asked."""

OWN_SHARE = 1e-6
"""Share of a residual's variance that is the current's own noise, at least."""


def unanswered_variance(
    difference: Array, answer_a: Array, gain: Array, is_sound: NDArray[np.bool_]
) -> tuple[float, float] | None:
    """Return the variance of a signal's noise by its products with the residual, and its error.

    Args:
        difference: shape (n,): of readings from those beside them.
        answer_a: shape (n,): what the residual does.
        gain: shape (n,): what it does less by a noise of one unit.
        is_sound: shape (n,): which readings count.

    Returns:
        The variance and its standard error; None where too few readings tell it.
    """
    most = STEP * MAD_TO_STD * float(median(np.abs(difference)))
    is_noise = is_sound & (np.abs(difference) <= most)
    power = float(gain[is_noise] @ gain[is_noise])
    if not (most > 0.0 and np.count_nonzero(is_noise) >= FEWEST and power > 0.0):
        return None
    most_a = STEP * MAD_TO_STD * float(median(np.abs(answer_a[is_noise])))
    products = -np.clip(answer_a, -most_a, most_a) * difference * gain
    total = float(products[is_noise].sum())
    scatter = np.where(is_noise, products - total / np.count_nonzero(is_noise), 0.0)
    # products that share a reading depend on each other
    own, *neighbours = (float(scatter[lag:] @ scatter[: scatter.size - lag]) for lag in range(3))
    return total / power, math.sqrt(own + max(0.0, 2.0 * sum(neighbours))) / power


Readings = tuple[Array, Array, Array, NDArray[np.bool_]]
"""What :func:`unanswered_variance` asks for."""


def lagged_readings(
    voltage_v: Array,
    innovation_a: Array,
    gain_a_v: Array,
    is_sound: NDArray[np.bool_],
    after_a_v: tuple[float, float] = (0.0, 0.0),
) -> list[Readings]:
    """Return what noise of a voltage is told by, once a lag of :data:`LAGS`.

    Let ``d`` be what a voltage differs by from the mean of its neighbours, and ``b`` what one volt
    brings to the end of its interval. The innovation there has the mean product ``-b s^2`` with
    ``d``, and half as much, of the other sign, with those beside it. A rotor that answers adds to
    the next two innovations, too.

    Args:
        voltage_v: shape (k,): of every interval.
        innovation_a: shape (k,): what an interval adds to the residual.
        gain_a_v: shape (k,): b.
        is_sound: shape (k,): which intervals count.
        after_a_v: what a volt adds to the next two innovations.
    """
    difference_v = -0.5 * np.diff(voltage_v, 2)
    is_sound = is_sound[:-2] & is_sound[1:-1] & is_sound[2:]
    answer_a = innovation_a[1:-1]
    gain_a_v = gain_a_v[1:-1]
    next_a_v, last_a_v = after_a_v
    gains = {
        0: gain_a_v - 0.5 * next_a_v,
        -1: next_a_v - 0.5 * (gain_a_v + last_a_v),
        1: -0.5 * gain_a_v,
    }
    count = difference_v.size
    result: list[Readings] = []
    for lag in LAGS:
        own = slice(max(-lag, 0), count - max(lag, 0))
        other = slice(max(lag, 0), count - max(-lag, 0))
        both = is_sound[own] & is_sound[other]
        result.append((difference_v[other], answer_a[own], gains[lag][own], both))
    return result


def believed_variance(histories: Sequence[Sequence[Readings]]) -> float:
    """Return the variance of a voltage's noise in V2; 0 where none is believed.

    Noise is no answer to anything, so all lags tell the same. A controller answers the noise of a
    reading of the current by a later voltage, and a voltage that acts late is answered by a later
    current: then they do not.

    Args:
        histories: what :func:`lagged_readings` gives of every history.
    """
    own_parts, *other_parts = zip(*histories, strict=True)
    own = _variance_of_all(own_parts)
    if own is None or not own[0] > SURE * own[1]:  # the usual case: the others are not asked
        return 0.0
    variance, error = own
    for parts in other_parts:
        other = _variance_of_all(parts)
        if other is None or not abs(variance - other[0]) < SURE * math.hypot(error, other[1]):
            return 0.0
    return variance


def _variance_of_all(parts: Sequence[Readings]) -> tuple[float, float] | None:
    """Return what the readings of all histories tell; see :func:`unanswered_variance`."""
    return unanswered_variance(*(np.concatenate(one) for one in zip(*parts, strict=True)))


@dataclass(frozen=True)
class VoltageNoise:
    """White noise of a window's voltages.

    Attributes:
        variance_v2: of every reading; 0: there is none that shows.
        held_share: share of the samples at which friction holds the rotor.
    """

    variance_v2: float = 0.0
    held_share: float = 0.0

    def power_a2(self, white_box: MotorWhiteBox, logarithms: Array, interval_s: Array) -> float:
        """Return the mean square of what the noise adds to a residual.

        Args:
            white_box: of one motor.
            logarithms: shape (parameter,): its values.
            interval_s: shape (k,): of the samples.
        """
        if self.variance_v2 == 0.0:
            return 0.0
        return float(self._products(white_box, [logarithms], interval_s)[0, 0])

    def products(
        self, white_box: MotorWhiteBox, logarithms: Array, interval_s: Array
    ) -> tuple[Array, Array]:
        """Return the mean products that the noise makes, of a sample's slopes.

        Args:
            white_box: of one motor.
            logarithms: shape (parameter,): its values.
            interval_s: shape (k,): of the samples.

        Returns:
            With what it adds to the residual, shape (parameter,), and among each other, shape
            (parameter, parameter).
        """
        nudges = NUDGE * np.eye(logarithms.size)
        values = [logarithms, *(logarithms + nudges), *(logarithms - nudges)]
        products = self._products(white_box, values, interval_s)
        nothing = np.zeros((logarithms.size, 1))
        differences = np.hstack([nothing, nudges, -nudges]) / (2.0 * NUDGE**2)
        return -differences @ products[:, 0], differences @ products @ differences.T

    def stds_v(self, interval_s: Array, usual_s: float) -> Array:
        """Return standard deviations as :func:`variances_of_intervals` has them, shape (k,)."""
        return np.sqrt(variances_of_intervals(self.variance_v2, interval_s, usual_s))

    def innovation(
        self, residual_a: Array, winding: Winding, is_whole: NDArray[np.bool_], power_a2: float
    ) -> Array:
        """Return what a residual has beyond the memory that the noise gives it, shape (k + 1,).

        It is that of a Kalman filter of the winding alone, in its steady state.

        Args:
            residual_a: shape (k + 1,).
            winding: what every interval does.
            is_whole: shape (k,): over which intervals the run goes on.
            power_a2: mean square of what the noise adds to the residual.
        """
        size_a2 = (MAD_TO_STD * float(median(np.abs(residual_a)))) ** 2
        own_a2 = max(size_a2 - power_a2, OWN_SHARE * size_a2)
        if not (is_whole.any() and size_a2 > 0.0):
            return residual_a
        decay = np.where(is_whole, winding.decay, 0.0)
        memory = self._memory(
            float(median(winding.decay[is_whole])),
            float(median(winding.gain_a_v[is_whole])),
            own_a2,
        )
        inputs = residual_a[1:] - decay * residual_a[:-1]
        memories = np.where(is_whole, memory, 0.0)
        result = recurrence(memories[None], inputs[None, None], residual_a[None, :1])
        return np.asarray(result[0, 0])

    def _memory(self, decay: float, gain_a_v: float, own_a2: float) -> float:
        """Return what an innovation leaves in the next one.

        Args:
            decay: share of a deviation that an interval leaves.
            gain_a_v: what a volt over it brings to its end.
            own_a2: variance of the current's own noise.
        """
        added_a2 = gain_a_v * gain_a_v * self.variance_v2
        half = 0.5 * (added_a2 - (1.0 - decay * decay) * own_a2)
        predicted_a2 = half + math.sqrt(half * half + added_a2 * own_a2)
        return decay * own_a2 / (predicted_a2 + own_a2)

    def _products(self, white_box: MotorWhiteBox, values: list[Array], interval_s: Array) -> Array:
        """Return mean products of what the noise adds at two values each, (value, value), in A2."""
        lengths_s, variances_v2 = self._by_length(interval_s)
        result = np.zeros((len(values), len(values)))
        for is_held, share in ((False, 1.0 - self.held_share), (True, self.held_share)):
            if share > 0.0:
                responses = VoltageResponses.of_values(
                    white_box, values, lengths_s, is_held=is_held
                )
                result += share * responses.current_products @ variances_v2
        return result

    def _by_length(self, interval_s: Array) -> tuple[Array, Array]:
        """Return the lengths of intervals in s, and variances in V2 by their shares.

        Merged samples go into octaves. Their voltage is a mean, whose noise is smaller.
        """
        interval_s = interval_s[interval_s > 0.0]
        usual_s = float(median(interval_s))
        octaves = np.round(np.log2(np.maximum(interval_s / usual_s, 1.0)))
        _, places, counts = np.unique(octaves, return_inverse=True, return_counts=True)
        mean_s = np.bincount(places, interval_s) / counts
        merged_counts = np.maximum(mean_s / usual_s, 1.0)
        return mean_s, self.variance_v2 * counts / interval_s.size / merged_counts


NO_NOISE = VoltageNoise()
