"""The voltage balance of a motor with measured speed, fitted by least squares with Kb free.

``int V dt = L di + R int i dt + ... + Kb int w dt``, summed over windows and never differentiated
(docs/METHOD.md, Residual analysis). Its values tell a wrong sign, unit or Kb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.settings.motor_configuration import BACK_EMF
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array

DEFAULT_KB = float(next(spec.default for spec in MOTOR_PARAMETERS if spec.name == BACK_EMF))

WINDOWS = 1000
"""That samples are summed over, at most; each is at least SHORTEST_WINDOW samples long."""

SHORTEST_WINDOW = 4

FEWEST_WINDOWS = 20

NORMAL_MEDIAN = 0.6745
"""Median of the magnitude of a normal variable, in standard deviations."""

DISTINCT = 0.1
"""Share of the speed that no other regressor explains (standard deviation), below which Kb cannot
be told from R."""

ABOVE_NOISE = 5.0
"""By how much that share has to exceed the noise of current and speed: where ``w = Kt i``, noise
alone is distinct."""

SURE = 10.0
"""Standard deviations between a fitted and a configured Kb that count; the residual of a misfit is
not white."""

MATTERS = 0.05
"""Share of the voltage that a wrong Kb has to move."""

EXPLAINS = 0.5
"""Share of the sum of squared residuals that a free Kb may leave where another was stated."""

EXPLAINS_DEFAULT = 0.8
"""The same where Kb has its default: logs whose command leads the current leave more."""

UNEXPLAINED = 0.05
"""Share of the squared voltage that may be left where a sign is told: a wrong one leaves nothing,
and what the white box lacks may turn R negative too."""


@dataclass(frozen=True)
class BackEmfFit:
    """The voltage balance fitted with Kb free.

    Attributes:
        kb: back-EMF constant in V s/rad.
        resistance: R in ohm; NaN where it is not among what is identified.
        resistance_std: standard deviation of ``resistance``.
        std: standard deviation of ``kb``.
        voltage_v: root mean square of the voltage.
        speed_rad_s: root mean square of the speed.
        gain: sum of squared residuals that is left, over that with the configured Kb.
        residual_share: sum of squared residuals, over that of the voltage.
        windows: how many it rests on.
    """

    kb: float
    resistance: float
    resistance_std: float
    std: float
    voltage_v: float
    speed_rad_s: float
    gain: float
    residual_share: float
    windows: int

    @property
    def evidence(self) -> float:
        """Log-likelihood that a free Kb brings."""
        return 0.5 * self.windows * -math.log(max(self.gain, 1e-300))

    @property
    def has_negative_resistance(self) -> bool:
        """Tell whether the data are those of a motor with one sign wrong: R is surely negative."""
        surely = self.resistance < -SURE * self.resistance_std
        return surely and self.residual_share < UNEXPLAINED

    @property
    def has_sure_resistance(self) -> bool:
        """Tell whether the balance closes with a resistance that is surely positive."""
        surely = self.resistance > SURE * self.resistance_std
        return surely and self.residual_share < UNEXPLAINED

    def contradicts(self, kb: float) -> bool:
        """Tell whether another Kb is ruled out, with an effect that the parameters would show."""
        away = abs(self.kb - kb)
        explains = EXPLAINS_DEFAULT if kb == DEFAULT_KB else EXPLAINS
        surely = away > SURE * self.std and self.gain < explains
        return surely and away * self.speed_rad_s > MATTERS * self.voltage_v


def fit_back_emf(white_box: MotorWhiteBox, samples: Array) -> BackEmfFit | None:
    """Fit the integrated voltage balance with Kb free; None where Kb cannot be separated.

    Args:
        white_box: physics of one motor whose speed is measured, its constants plain numbers.
        samples: shape (signal, n), as in :func:`~gray_box_observer.fit_test.data_doubts.doubts`.
    """
    sums = _window_sums(_with_free_kb(white_box), samples)
    if sums is None:
        return None
    columns, target, speed, noise = sums
    scale = np.linalg.norm(columns, axis=0)
    if not (scale > 0.0).all():
        return None
    columns = columns / scale
    others = np.delete(columns, -1, axis=1)
    back_emf = columns[:, -1]
    distinct = back_emf - others @ np.linalg.lstsq(others, back_emf, rcond=None)[0]
    spread = float(distinct @ distinct)
    if not spread > max(DISTINCT, ABOVE_NOISE * noise) ** 2 * float(back_emf @ back_emf):
        return None
    weights = np.linalg.lstsq(columns, target, rcond=None)[0]
    remainder = target - columns @ weights
    theta = weights / scale
    base_target = target - float(white_box.known.get(BACK_EMF, 0.0)) * scale[-1] * back_emf
    base_remainder = base_target - others @ np.linalg.lstsq(others, base_target, rcond=None)[0]
    squares = float(remainder @ remainder)
    variance = squares / max(target.size - theta.size, 1)
    names = _with_free_kb(white_box).context_nodes
    resistance, resistance_std = math.nan, math.nan
    if 'resistance' in names:
        place = names.index('resistance')
        resistance = float(theta[place])
        covariance = variance * np.linalg.pinv(columns.T @ columns)
        resistance_std = math.sqrt(max(float(covariance[place, place]), 0.0)) / float(scale[place])
    return BackEmfFit(
        kb=float(theta[-1]),
        resistance=resistance,
        resistance_std=resistance_std,
        std=math.sqrt(variance / spread) / float(scale[-1]),
        voltage_v=float(np.sqrt(np.mean(target**2))),
        speed_rad_s=speed,
        gain=squares / max(float(base_remainder @ base_remainder), 1e-300),
        residual_share=squares / max(float(target @ target), 1e-300),
        windows=target.size,
    )


def _with_free_kb(white_box: MotorWhiteBox) -> MotorWhiteBox:
    """Return the white box with Kb last among what is unknown."""
    nodes = (*(name for name in white_box.context_nodes if name != BACK_EMF), BACK_EMF)
    return replace(white_box, context_nodes=nodes)


def _window_sums(
    white_box: MotorWhiteBox, samples: Array
) -> tuple[Array, Array, float, float] | None:
    """Sum the integrated balance over windows, divided by their lengths; none spans a restart.

    Returns:
        Regressors, shape (window, parameter), target, shape (window,), both as means in V, the root
        mean square of the speed, and the share of noise in a window's mean; None where there are
        too few windows, or no speed.
    """
    interval_s = samples[INTERVAL, 1:]
    length = max(SHORTEST_WINDOW, interval_s.size // WINDOWS)
    count = interval_s.size // length
    if count < FEWEST_WINDOWS or not np.any(samples[SPEED]):
        return None
    state = white_box.state(samples[TORQUE])
    columns, target = integrated_regressors(
        white_box, samples[VOLTAGE, 1:], state, samples[SPEED], interval_s
    )
    cut = slice(0, count * length)
    duration_s = interval_s[cut].reshape(count, length)
    whole = (duration_s > 0.0).all(axis=1)
    if np.count_nonzero(whole) < FEWEST_WINDOWS:
        return None
    length_s = duration_s[whole].sum(axis=1)
    means = columns[cut].reshape(count, length, -1)[whole].sum(axis=1) / length_s[:, None]
    means_v = target[cut].reshape(count, length)[whole].sum(axis=1) / length_s
    noise = max(noise_share(state), noise_share(samples[SPEED])) / math.sqrt(length)
    return means, means_v, float(np.sqrt(np.mean(samples[SPEED] ** 2))), noise


def noise_share(signal: Array) -> float:
    """Return the share of white noise in a signal, from robust second differences."""
    size = float(np.sqrt(np.mean(signal**2)))
    noise = float(median(np.abs(np.diff(signal, 2)))) / (NORMAL_MEDIAN * math.sqrt(6.0))
    return noise / max(size, 1e-300)
