"""Doubts about the data: a unit that is not SI, a wrong sign or Kb, a saturated sensor.

A white box fits a current in mA as well as one in A: only what a motor can be tells them apart.
Magnitudes tell the units. A least-squares fit of the integrated voltage balance (docs/METHOD.md,
Residual analysis) with Kb free tells the back-EMF: ``int V dt = L di + R int i dt + ... + Kb int w
dt``, summed over windows and never differentiated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.samples.noise_floor import quantisation_step
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.settings.configuration import MotorConfiguration
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.dynamics import integrated_regressors
from gray_box_observer.white_box.interface import Array

KB = 'back_emf_constant'

DEFAULT_KB = float(next(spec.default for spec in MOTOR_PARAMETERS if spec.name == KB))

LOWEST_RESISTANCE_OHM = 0.02
"""No armature of a small motor has less, wires and driver in it."""

LARGE_CURRENT_A = 50.0
"""Peak current below which a small resistance is believed."""

LARGEST_VOLTAGE_V = 1000.0
"""No DC motor is driven by more."""

LONGEST_INTERVAL_S = 0.5
"""Between two samples; the electrical time constant of no motor is told by longer ones."""

SHORTEST_INTERVAL_S = 2e-6
"""No current sensor of a drive is sampled faster."""

THOUSAND = (300.0, 3000.0)
"""Ratios that are taken for a thousand, which a prefix of a unit makes."""

FEWEST_SAMPLES = 50
"""That are judged."""

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

FAR = 2.0
"""Ratio of a fitted to a stated Kb that is doubted: speed sensors and magnets are better than that.
"""

FAR_FROM_DEFAULT = 1.25
"""The same where Kb has its default, which says nothing of this motor."""

CLIPPED = 0.01
"""Share of the readings that stand at their largest value where a sensor is at the end of its
range."""

SEVERAL_STEPS = 2.0
"""Steps of the readings that the noise must reach: what toggles between two levels looks like 1.2
steps of it."""

NOISELESS = 1e-4
"""Noise, as a share of the current's spread, of a simulation without any."""

FEWEST_CLIPPED = 30
"""Readings that these are at least: noise brings a step's worth of readings to the largest value by
chance."""


@dataclass(frozen=True, slots=True)
class _Balance:
    """The voltage balance fitted with Kb free.

    Attributes:
        kb: back-EMF constant in V s/rad.
        resistance: R in ohm.
        std: standard deviation of ``kb``.
        voltage_v: root mean square of the voltage.
        speed_rad_s: root mean square of the speed.
        gain: sum of squared residuals that is left, over that with the configured Kb.
        windows: how many it rests on.
    """

    kb: float
    resistance: float
    std: float
    voltage_v: float
    speed_rad_s: float
    gain: float
    windows: int

    @property
    def evidence(self) -> float:
        """Log-likelihood that a free Kb brings."""
        return 0.5 * self.windows * -math.log(max(self.gain, 1e-300))

    def contradicts(self, kb: float) -> bool:
        """Tell whether another Kb is ruled out, with an effect that the parameters would show."""
        away = abs(self.kb - kb)
        explains = EXPLAINS_DEFAULT if kb == DEFAULT_KB else EXPLAINS
        surely = away > SURE * self.std and self.gain < explains
        return surely and away * self.speed_rad_s > MATTERS * self.voltage_v


def doubts(
    white_box: MotorWhiteBox, samples: Array, theta: Array, motor: MotorConfiguration
) -> tuple[Suspect, ...]:
    """Return likely errors in one motor's data or declarations, the surest first.

    A doubt stands before every other suspect, and with one nothing of the motor may be called
    identified: wrong units leave no residual.

    Args:
        white_box: physics of this motor alone, its constants plain numbers.
        samples: shape (signal, n): interval in s, voltage in V, torque in N m and speed in rad/s,
            as :meth:`~gray_box_observer.samples.ReplayBuffer.newest` returns them of one motor.
        theta: shape (parameter,): the published values.
        motor: as configured.
    """
    needed = samples if white_box.speed_measured else samples[:SPEED]
    samples = samples[:, np.isfinite(needed).all(axis=0)]
    if samples.shape[1] < FEWEST_SAMPLES:
        return ()
    time = _doubt_of_time(samples, motor)
    balance = _balance(white_box, samples) if white_box.speed_measured else None
    voltage = _doubt_of_voltage(samples, balance, motor)
    current = None if voltage else _doubt_of_current(white_box, samples, balance, theta, motor)
    findings = [suspect for suspect in (time, voltage, current) if suspect is not None]
    if balance is None or voltage is not None:  # with the voltage in mV, Kb follows from it
        return tuple(findings)
    return (*findings, *_doubts_of_back_emf(white_box, balance, motor))


def doubt_of_range(current_a: Array, noise_a: float) -> Suspect | None:
    """Doubt the sensor's range: noisy readings that end at one and the same largest value.

    Args:
        current_a: shape (n,): readings.
        noise_a: standard deviation of their noise; of a step of the readings or less nothing can be
            told.
    """
    step_a = float(quantisation_step(current_a[None])[0])
    if noise_a < SEVERAL_STEPS * step_a or noise_a <= NOISELESS * float(np.std(current_a)):
        return None
    for limit_a in (float(current_a.max()), float(current_a.min())):
        share = float(np.mean(current_a == limit_a))
        if share >= CLIPPED and share * current_a.size >= FEWEST_CLIPPED:
            text = (
                'widen the range of the current sensor, or drive the motor less: '
                f'{100.0 * share:.2g} % of the '
                f'readings stand at {limit_a:.4g} A'
            )
            return Suspect('saturation', share * current_a.size, text)
    return None


def _doubt_of_time(samples: Array, motor: MotorConfiguration) -> Suspect | None:
    """Doubt the unit of the stamps; never against an L from a data sheet, which would show it."""
    interval_s = samples[INTERVAL]
    follows = interval_s > 0.0
    if motor.values['initial_relative_std.inductance'] > 0.0 and follows.any():
        return None
    if np.mean(follows) < 0.5:  # most samples begin a history anew
        text = (
            'no two samples are near enough in time: if the stamps are in ms, write '
            'time=NAME*1e-3 among --columns; '
            'if they are right, set gap_s to more than the interval'
        )
        return Suspect('units_of_time', float(samples.shape[1]), text)
    typical_s = float(np.median(interval_s[follows]))
    if SHORTEST_INTERVAL_S <= typical_s <= LONGEST_INTERVAL_S:
        return None
    limit_s = LONGEST_INTERVAL_S if typical_s > LONGEST_INTERVAL_S else SHORTEST_INTERVAL_S
    factor = '1e-3' if typical_s > LONGEST_INTERVAL_S else '1e3'
    text = (
        f'an interval of {typical_s:.3g} s between samples: if the stamps are not in s, write '
        f'time=NAME*{factor} '
        'among --columns; if they are right, say what the data sheet says with '
        'initial_relative_std.inductance'
    )
    return Suspect('units_of_time', _evidence(typical_s / limit_s, samples.shape[1]), text)


def _doubt_of_voltage(
    samples: Array, balance: _Balance | None, motor: MotorConfiguration
) -> Suspect | None:
    """Doubt the unit of the voltage, by its size or by a Kb a thousand times the stated one."""
    peak_v = float(np.percentile(np.abs(samples[VOLTAGE]), 99.0))
    kb = float(motor.values[KB])
    by_kb = (
        balance is not None
        and kb > 0.0
        and kb != DEFAULT_KB
        and balance.contradicts(kb)
        and _is_thousand(balance.kb / kb)
        and balance.resistance > 1.0 / LOWEST_RESISTANCE_OHM
    )
    if peak_v <= LARGEST_VOLTAGE_V and not by_kb:
        return None
    text = (
        f'{peak_v:.3g} V: if that is in mV, set voltage.scale: 0.001, or voltage=NAME*1e-3 among '
        '--columns'
    )
    return Suspect(
        'units_of_voltage', _evidence(peak_v / LARGEST_VOLTAGE_V, samples.shape[1]), text
    )


def _doubt_of_current(
    white_box: MotorWhiteBox,
    samples: Array,
    balance: _Balance | None,
    theta: Array,
    motor: MotorConfiguration,
) -> Suspect | None:
    """Doubt the unit of current or torque, unless a data sheet states so small a resistance."""
    if (
        motor.values['initial_relative_std.resistance'] > 0.0
        or motor.values['known.resistance'] > 0.0
    ):
        return None
    current_a = white_box.state(samples[TORQUE])
    peak_a = float(np.percentile(np.abs(current_a), 99.0))
    resistance_ohm = _smallest_resistance(white_box, samples, current_a, balance, theta)
    if peak_a < LARGE_CURRENT_A or resistance_ohm >= LOWEST_RESISTANCE_OHM:
        return None
    text = (
        f'{peak_a:.3g} A at {resistance_ohm:.2g} ohm: if the current is in mA or the torque in mN '
        'm, set torque.scale '
        'to a thousandth, or current=NAME*1e-3 among --columns; if the torque is a current in A, '
        'set torque.quantity: current; if they are right, say so with '
        f'{motor.name}.initial_relative_std.resistance'
    )
    ratio = LOWEST_RESISTANCE_OHM / max(resistance_ohm, 1e-9)
    return Suspect('units_of_current', _evidence(ratio, samples.shape[1]), text)


def _smallest_resistance(
    white_box: MotorWhiteBox,
    samples: Array,
    current_a: Array,
    balance: _Balance | None,
    theta: Array,
) -> float:
    """Return the data's resistance: without back-EMF if speed is measured, else the impedance."""
    if balance is not None and balance.resistance > 0.0:
        return balance.resistance
    voltage_v = float(np.sqrt(np.mean(samples[VOLTAGE] ** 2)))
    signal = max(1.0 - _noise_share(current_a) ** 2, 0.0) * float(np.mean(current_a**2))
    impedance = voltage_v / max(math.sqrt(signal), 1e-300)
    names = white_box.context_nodes
    published = float(theta[names.index('resistance')]) if 'resistance' in names else math.inf
    return min(impedance, published)


def _doubts_of_back_emf(
    white_box: MotorWhiteBox, balance: _Balance, motor: MotorConfiguration
) -> tuple[Suspect, ...]:
    """Doubt the sign of the speed, and Kb where it is not among what is identified."""
    identified = KB in white_box.context_nodes
    kb = 0.0 if identified else float(white_box.known.get(KB, 0.0))
    if not balance.contradicts(kb):
        return ()
    findings = []
    if balance.kb < 0.0:
        text = (
            'speed.scale: -1.0 (or speed=-1*NAME among --columns): the back-EMF has the wrong sign'
        )
        findings.append(Suspect('speed_sign', balance.evidence, text))
    magnitude = abs(balance.kb)
    far = FAR_FROM_DEFAULT if kb == DEFAULT_KB else FAR
    away = max(magnitude, kb) > far * min(magnitude, kb)
    if not identified and away and magnitude > SURE * balance.std:
        text = f'{motor.name}.back_emf_constant: {magnitude:.4g} (it is {kb:g} V s/rad now)'
        findings.append(Suspect(KB, balance.evidence, text))
    return tuple(findings)


def _balance(white_box: MotorWhiteBox, samples: Array) -> _Balance | None:
    """Fit the integrated voltage balance with Kb free; None where Kb cannot be separated."""
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
    base_target = target - float(white_box.known.get(KB, 0.0)) * scale[-1] * back_emf
    configured = base_target - others @ np.linalg.lstsq(others, base_target, rcond=None)[0]
    freedom = max(target.size - theta.size, 1)
    names = white_box.context_nodes
    resistance = float(theta[names.index('resistance')]) if 'resistance' in names else math.nan
    return _Balance(
        kb=float(theta[-1]),
        resistance=resistance,
        std=math.sqrt(float(remainder @ remainder) / freedom / spread) / float(scale[-1]),
        voltage_v=float(np.sqrt(np.mean(target**2))),
        speed_rad_s=speed,
        gain=float(remainder @ remainder) / max(float(configured @ configured), 1e-300),
        windows=target.size,
    )


def _with_free_kb(white_box: MotorWhiteBox) -> MotorWhiteBox:
    """Return the white box with Kb last among what is unknown."""
    nodes = (*(name for name in white_box.context_nodes if name != KB), KB)
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
    noise = max(_noise_share(state), _noise_share(samples[SPEED])) / math.sqrt(length)
    return means, means_v, float(np.sqrt(np.mean(samples[SPEED] ** 2))), noise


def _noise_share(signal: Array) -> float:
    """Return the share of white noise in a signal, from robust second differences."""
    size = float(np.sqrt(np.mean(signal**2)))
    noise = float(np.median(np.abs(np.diff(signal, 2)))) / (NORMAL_MEDIAN * math.sqrt(6.0))
    return noise / max(size, 1e-300)


def _is_thousand(ratio: float) -> bool:
    low, high = THOUSAND
    return low < ratio < high


def _evidence(ratio: float, samples: int) -> float:
    """Weigh a magnitude beyond its limit: each sample counts by the logarithm of the excess."""
    return samples * abs(math.log(max(ratio, 1e-300)))
