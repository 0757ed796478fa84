"""Looks for noise of the voltage in the free runs of a window, and for that of the readings beside.

What every interval adds to a residual, its innovation, tells both. Read voltage_noise.py first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.rotor.free_runs import FreeRuns
from gray_box_observer.context_nodes.rotor.history_unknowns import LAG
from gray_box_observer.context_nodes.rotor.noise_filter import (
    MERGED,
    ReadingNoise,
    interval_motion,
    rests,
    rotor_jacobian,
)
from gray_box_observer.context_nodes.rotor.voltage_noise import (
    NO_NOISE,
    SURE,
    VoltageNoise,
    believed_variance,
    lagged_readings,
)
from gray_box_observer.context_nodes.rotor.voltage_response import Winding
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array

TOO_MUCH = 1.2
"""Times the power of innovations that the voltage's noise makes of it, at most, to be believed."""

LEAST_OWN = 0.01
"""Power of the readings' noise over what the voltage's makes of an innovation, at least."""

MAD_ERROR = 2.33
"""Standard error of a variance by the median, times the root of the samples, as a share of it."""

LATE = 0.5
"""Intervals of lag up to which the speed is read at the samples."""


@dataclass(frozen=True, eq=False)
class WindowNoise:
    """Noise in the free runs of a window.

    Attributes:
        runs: these.
        rates: shape (state, state): derivatives of the rates of a rotor that turns, by the states.
        windings: what the intervals of every history do.
        innovations_a: shape (k,) each: what these add to the residual.
        is_plain: shape (k,) each: which are none of merged samples.
    """

    runs: FreeRuns
    rates: Array
    windings: tuple[Winding, ...]
    innovations_a: tuple[Array, ...]
    is_plain: tuple[NDArray[np.bool_], ...]

    @classmethod
    def from_runs(cls, runs: FreeRuns) -> WindowNoise:
        """Take the innovations of free runs, of one history at least."""
        rates = rotor_jacobian(runs.p, runs.torque_constant, runs.mean_speed_rad_s)
        decay_1_s = -float(rates[State.CURRENT, State.CURRENT])
        inductance_h = runs.winding_s * runs.resistance_ohm
        windings = []
        innovations_a = []
        for history, path in zip(runs.window.histories, runs.runs, strict=True):
            winding = Winding.over(decay_1_s * inductance_h, 1.0 / decay_1_s, history.interval_s)
            residual_a = history.current_a - path.states[:, State.CURRENT]
            innovations_a.append(residual_a[1:] - winding.decay * residual_a[:-1])
            windings.append(winding)
        longest_s = MERGED * runs.window.interval_s
        is_plain = tuple(history.interval_s < longest_s for history in runs.window.histories)
        return cls(runs, rates, tuple(windings), tuple(innovations_a), is_plain)

    def of_voltage(self) -> VoltageNoise:
        """Return the noise that the current does not answer; see :func:`believed_variance`.

        Returns:
            :data:`NO_NOISE` where there is none, or so much that nobody would believe it.
        """
        held_share = float(np.mean(rests(self.runs.speed_rad_s)))
        after_a_v = self._answers_of_rotor(held_share)
        histories = self.runs.window.histories
        parts = zip(histories, self.windings, self.innovations_a, self.is_plain, strict=True)
        variance_v2 = believed_variance(
            [
                lagged_readings(history.voltage_v, own_a, winding.gain_a_v, is_plain, after_a_v)
                for history, winding, own_a, is_plain in parts
            ]
        )
        if not variance_v2:
            return NO_NOISE
        if self._answered_a2(variance_v2) > TOO_MUCH * self._innovation_a2:
            return NO_NOISE
        return VoltageNoise(variance_v2, held_share)

    def beside_readings(self, voltage: VoltageNoise, *, is_rough: bool) -> ReadingNoise:
        """Return the noise of the voltage together with that of the readings.

        Args:
            voltage: what was found.
            is_rough: whether what the noise does to the rotor may stay, where the speed does not
                show it: to take it off makes searches long.
        """
        window = self.runs.window
        variance_a2 = self._reading_a2(voltage)
        follows_speed = False
        if window.speed_output is not None:
            shown_a2 = window.speed_output.unit_a_s**2 * self.powers(voltage)[State.SPEED]
            is_late = bool(np.abs(self.runs.starts[:, LAG]).max() > LATE * window.interval_s)
            follows_speed = not is_late and (not is_rough or shown_a2 > variance_a2)
        return ReadingNoise(
            voltage.variance_v2,
            math.sqrt(variance_a2),
            window.interval_s,
            turns_rotor=follows_speed or not is_rough,
            follows_speed=follows_speed,
        )

    def powers(self, voltage: VoltageNoise) -> Array:
        """Return mean squares of what noise of the voltage would add to residuals, (state,).

        Args:
            voltage: in A2 and (rad/s)^2.
        """
        result = np.zeros(len(State))
        for is_held, share in ((False, 1.0 - voltage.held_share), (True, voltage.held_share)):
            motion, drive = self._motion(is_held=is_held)
            left = np.eye(drive.size**2) - np.kron(motion, motion)
            covariance = np.linalg.lstsq(left, np.outer(drive, drive).ravel(), rcond=None)[0]
            result += share * np.diagonal(covariance.reshape(motion.shape))
        return np.maximum(result, 0.0) * voltage.variance_v2

    def _reading_a2(self, voltage: VoltageNoise) -> float:
        """Return the variance of the readings of the current.

        Their second differences tell it where the current hardly moves from sample to sample. Where
        that is clearly more than what innovations have beside the noise of the voltage, these do.
        """
        answered_a2 = self._answered_a2(voltage.variance_v2)
        decay = self._plain([winding.decay for winding in self.windings])
        both_sides = 1.0 + float(np.mean(decay**2))
        left_a2 = (self._innovation_a2 - answered_a2) / both_sides
        error_a2 = MAD_ERROR * self._innovation_a2 / math.sqrt(decay.size) / both_sides
        window = self.runs.window
        shown_a2 = window.reading_noise_a**2
        own_a2 = left_a2 if shown_a2 > left_a2 + SURE * error_a2 else shown_a2
        return max(own_a2, LEAST_OWN * answered_a2, window.quantisation_std_a**2)

    @cached_property
    def _innovation_a2(self) -> float:
        """Power of the innovations, outliers cut."""
        size_a = MAD_TO_STD * float(median(np.abs(self._plain(self.innovations_a))))
        return size_a * size_a

    def _answered_a2(self, variance_v2: float) -> float:
        """Return what noise of the voltage makes of that."""
        gain_a_v = self._plain([winding.gain_a_v for winding in self.windings])
        return variance_v2 * float(np.mean(gain_a_v**2))

    def _plain(self, parts: tuple[Array, ...] | list[Array]) -> Array:
        """Join what there is of every interval, those of merged samples left out."""
        return np.concatenate(
            [own[is_plain] for own, is_plain in zip(parts, self.is_plain, strict=True)]
        )

    def _answers_of_rotor(self, held_share: float) -> tuple[float, float]:
        """Return what a volt adds to the next two innovations, in A, by way of the rotor.

        Args:
            held_share: share of the samples at which friction holds the rotor.
        """
        motion, drive = self._motion()
        decay = math.exp(self.rates[State.CURRENT, State.CURRENT] * self.runs.window.interval_s)
        responses = [drive, motion @ drive, motion @ motion @ drive]
        currents_a = [float(response[State.CURRENT]) for response in responses]
        next_a, last_a = (after - decay * before for before, after in pairwise(currents_a))
        return (1.0 - held_share) * next_a, (1.0 - held_share) * last_a

    def _motion(self, *, is_held: bool = False) -> tuple[Array, Array]:
        """Return what an interval as usual does; see :func:`interval_motion`."""
        inverse_h = 1.0 / (self.runs.winding_s * self.runs.resistance_ohm)
        interval_s = self.runs.window.interval_s
        return interval_motion(self.rates, inverse_h, interval_s, is_held=is_held)


def voltage_noise_of(runs: FreeRuns) -> VoltageNoise:
    """Return the noise of the voltage in free runs; none behind a current sensor that lags."""
    noise = _noise_in(runs)
    return NO_NOISE if noise is None else noise.of_voltage()


def noise_of(runs: FreeRuns, *, is_rough: bool) -> tuple[VoltageNoise, ReadingNoise | None]:
    """Return the noise of the voltage in free runs, and with that of the readings, if there is any.

    Args:
        runs: the free runs.
        is_rough: see :meth:`WindowNoise.beside_readings`.
    """
    noise = _noise_in(runs)
    voltage = NO_NOISE if noise is None else noise.of_voltage()
    if noise is None or voltage is NO_NOISE:
        return NO_NOISE, None
    return voltage, noise.beside_readings(voltage, is_rough=is_rough)


def _noise_in(runs: FreeRuns) -> WindowNoise | None:
    """Return what tells of noise in free runs; None where it is not asked for."""
    unknowns = runs.window.unknowns
    if not runs.runs or unknowns.current_sensor is not None or unknowns.memory:
        return None
    return WindowNoise.from_runs(runs)
