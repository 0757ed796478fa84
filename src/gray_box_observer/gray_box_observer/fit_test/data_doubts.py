"""Doubts about the data: a unit that is not SI, a wrong sign or Kb, a saturated sensor.

A white box fits a current in mA as well as one in A: only what a motor can be tells them apart.
Magnitudes tell the units. A fit of the voltage balance with Kb free (:mod:`back_emf_fit`) tells the
back-EMF.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gray_box_observer.expressions.unit_factors import unit_factors
from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.back_emf_fit import (
    DEFAULT_KB,
    SURE,
    BackEmfFit,
    fit_back_emf,
    noise_share,
)
from gray_box_observer.fit_test.encoder_doubts import doubt_of_encoder
from gray_box_observer.fit_test.residual_analysis import ResidualAnalysis
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median, quantile
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.samples.stamp_rounding import stamp_rounding
from gray_box_observer.settings.motor_configuration import BACK_EMF, MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

LOWEST_RESISTANCE_OHM = 0.02
"""No armature of a small motor has less, wires and driver in it."""

LARGE_CURRENT_A = 50.0
"""Peak current below which a small resistance is believed."""

FAR_FROM_SHEET, STDS_FROM_SHEET = 3.0, 5.0
"""Ratio and standard deviations beyond which no resistance is that of the data sheet: heat and wear
do not reach there, units do."""

LARGEST_VOLTAGE_V = 1000.0
"""No DC motor is driven by more."""

LONGEST_INTERVAL_S = 0.3
"""Between two samples; the electrical time constant of no motor is told by longer ones."""

SHORTEST_INTERVAL_S = 2e-6
"""No current sensor of a drive is sampled faster."""

THOUSAND = (300.0, 3000.0)
"""Ratios that are taken for a thousand, which a prefix of a unit makes."""

FEWEST_SAMPLES = 50
"""That are judged."""

FAR = 2.0
"""Ratio of a fitted to a stated Kb that is doubted: speed sensors and magnets are better than that.
"""

FAR_FROM_DEFAULT = 1.25
"""The same where Kb has its default, which says nothing of this motor."""

UNITS_OF_SPEED = {unit: unit_factors()[unit][1] for unit in ('deg/s', 'rpm', 'Hz')}
"""What one of a unit is in rad/s."""

NEAR = 0.15
"""Relative distance of a fitted from a stated Kb, in another unit, up to which it is that unit."""

LARGEST_DUTY = 1.0 + 1e-6
"""A voltage that never exceeds 1 may be a duty cycle."""

LEAST_BATTERY_V = 3.0
"""Of a battery behind a duty cycle, at least."""

DUTY_REMEDY = (
    'the voltage never exceeds 1 V: if it is a duty cycle, multiply it by the voltage of the '
    'battery (voltage.expression: duty * battery)'
)

CLIPPED = 0.01
"""Share of the readings that stand at their largest value where a sensor is at the end of its
range."""

SEVERAL_STEPS = 2.0
"""Steps of the readings that the noise must reach: what toggles between two levels looks like 1.2
steps of it."""

NOISELESS = 1e-4
"""Noise, as a share of the current's spread, of a simulation without any."""

LEAST_ROUNDED = 0.7
"""Share of the residual that rounding the stamps makes, from which it is named first."""

FEWEST_CLIPPED = 30
"""Readings that these are at least: noise brings a step's worth of readings to the largest value by
chance."""


@dataclass(frozen=True)
class Doubts:
    """Likely errors in one motor's data or declarations.

    Attributes:
        suspects: the surest first.
        balance: its voltage balance with Kb free; None where Kb cannot be told.
    """

    suspects: tuple[Suspect, ...]
    balance: BackEmfFit | None


def doubts(
    white_box: MotorWhiteBox, samples: Array, theta: Array, motor: MotorConfiguration
) -> Doubts:
    """Return likely errors in one motor's data or declarations.

    A doubt stands before every other suspect, and with one nothing of the motor may be called
    identified: wrong units leave no residual.

    Args:
        white_box: physics of this motor alone, its constants plain numbers.
        samples: shape (signal, n): interval in s, voltage in V, torque in N m and speed in rad/s,
            as :meth:`~gray_box_observer.samples.ReplayBuffer.newest` returns them of one motor.
        theta: shape (parameter,): the published values.
        motor: as configured.
    """
    needed_rows = samples if white_box.speed_measured else samples[:SPEED]
    samples = samples[:, np.isfinite(needed_rows).all(axis=0)]
    if samples.shape[1] < FEWEST_SAMPLES:
        return Doubts((), None)
    time = _doubt_of_time(samples, motor)
    balance = fit_back_emf(white_box, samples) if white_box.speed_measured else None
    voltage = _doubt_of_voltage(samples, balance, motor)
    current = None if voltage else _doubt_of_current(white_box, samples, balance, theta, motor)
    encoder = None
    if balance is not None and not (time or voltage):
        encoder = doubt_of_encoder(white_box, samples, balance, motor)
    findings = [one for one in (time, voltage, encoder, current) if one is not None]
    if balance is None or voltage or encoder:  # with the voltage in mV, Kb follows from it
        return Doubts(tuple(findings), balance)
    of_back_emf = _doubts_of_back_emf(white_box, balance, motor)
    return Doubts((*findings, *of_back_emf), balance)


def may_be_duty(voltage_v: Array) -> bool:
    """Tell whether a voltage, shape (n,), never exceeds 1, so that it may be a duty cycle."""
    return float(np.max(np.abs(voltage_v))) <= LARGEST_DUTY


def doubt_of_range(current_a: Array, noise_a: float) -> Suspect | None:
    """Doubt the sensor's range: noisy readings that end at one and the same largest value.

    Args:
        current_a: shape (n,): readings.
        noise_a: standard deviation of their noise; of a step of the readings or less nothing can be
            told.
    """
    if noise_a <= NOISELESS * float(np.std(current_a)):
        return None
    for limit_a in (float(current_a.max()), float(current_a.min())):
        share = float(np.mean(current_a == limit_a))
        if share >= CLIPPED and share * current_a.size >= FEWEST_CLIPPED:
            if noise_a < SEVERAL_STEPS * float(quantisation_step(current_a[None])[0]):
                return None
            text = (
                'widen the range of the current sensor, or drive the motor less: '
                f'{100.0 * share:.2g} % of the '
                f'readings stand at {limit_a:.4g} A'
            )
            return Suspect('saturation', share * current_a.size, text)
    return None


def doubts_of_stamps(
    interval_s: Array, current_a: Array, analysis: ResidualAnalysis
) -> list[Suspect]:
    """Doubt stamps that are rounded to coarse steps, where that makes most of the residual.

    Args:
        interval_s: shape (n,): 0 where a signal history begins.
        current_a: shape (n,): readings.
        analysis: of the same samples.

    Returns:
        One suspect, or none.
    """
    begins = np.flatnonzero(interval_s <= 0.0)
    begin = int(begins[-1]) if begins.size else 0
    grid = stamp_rounding(interval_s[begin + 1 :])
    if grid is None:
        return []
    power = float(np.mean(np.diff(current_a[begin:]) ** 2)) - 2.0 * analysis.floor_a**2
    slope_a_s = math.sqrt(max(power, 0.0)) / grid.period_s
    error_a = slope_a_s * grid.step_s * STEP_TO_STD
    if not error_a >= LEAST_ROUNDED * analysis.ratio * analysis.floor_a:
        return []
    gain = analysis.samples * math.log(max(analysis.ratio, 1.0))
    text = (
        f'stamp samples more finely than to {1e3 * grid.step_s:.3g} ms, or evenly: they seem to '
        f'come every {1e3 * grid.period_s:.6g} ms (of a log: '
        f'sample_period_s={grid.period_s:.6g} instead of time)'
    )
    return [Suspect('coarse_stamps', gain, text)]


def _doubt_of_time(samples: Array, motor: MotorConfiguration) -> Suspect | None:
    """Doubt the unit of the stamps; never against an L from a data sheet, which would show it."""
    interval_s = samples[INTERVAL]
    follows = interval_s > 0.0
    if motor.values['initial_relative_std.inductance'] > 0.0 and follows.any():
        return None
    settles = motor.current_lag is not None and follows.any()  # each start takes some samples
    if np.mean(follows) < 0.5 and not settles:  # most samples begin a history anew
        text = (
            'no two samples are near enough in time: if the stamps are in ms, write '
            'time=NAME*1e-3 among --columns; '
            'if they are right, set gap_s to more than the interval'
        )
        return Suspect('units_of_time', float(samples.shape[1]), text)
    typical_s = float(median(interval_s[follows]))
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
    samples: Array, balance: BackEmfFit | None, motor: MotorConfiguration
) -> Suspect | None:
    """Doubt the unit of the voltage, by its size or by a Kb a thousand times the stated one."""
    peak_v = _peak(samples[VOLTAGE], LARGEST_VOLTAGE_V)
    kb = float(motor.values[BACK_EMF])
    by_kb = (
        balance is not None
        and kb > 0.0
        and kb != DEFAULT_KB
        and balance.contradicts(kb)
        and _is_thousand(balance.kb / kb)
        and balance.resistance > 1.0 / LOWEST_RESISTANCE_OHM
    )
    if balance is not None and balance.contradicts(kb) and kb != DEFAULT_KB:
        share = abs(balance.kb) / kb
        is_sure = abs(balance.kb) > SURE * balance.std
        if is_sure and may_be_duty(samples[VOLTAGE]) and share < 1.0 / LEAST_BATTERY_V:
            text = f'{DUTY_REMEDY}; by the Kb given that is near {1.0 / max(share, 1e-9):.3g} V'
            return Suspect('units_of_voltage', balance.evidence, text)
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
    balance: BackEmfFit | None,
    theta: Array,
    motor: MotorConfiguration,
) -> Suspect | None:
    """Doubt the unit of current or torque, unless a data sheet states so small a resistance."""
    current_a = white_box.state(samples[TORQUE])
    peak_a = _peak(current_a, LARGE_CURRENT_A)
    if peak_a < LARGE_CURRENT_A:
        return None
    resistance_ohm = _smallest_resistance(white_box, samples, current_a, balance, theta)
    if resistance_ohm >= min(LOWEST_RESISTANCE_OHM, _lowest_stated_ohm(motor)):
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


def _peak(signal: Array, limit: float) -> float:
    """Return what 99 % of a signal stay below, or its largest size where that is below a limit."""
    size = np.abs(signal)
    largest = float(size.max())
    return largest if largest < limit else float(quantile(size, 0.99))


def _lowest_stated_ohm(motor: MotorConfiguration) -> float:
    """Return the least resistance that what is stated of a motor allows; infinite where nothing is.

    It is a third of what is given, or less by five of its standard deviations.
    """
    known_ohm = float(motor.values['known.resistance'])
    if known_ohm > 0.0:
        return known_ohm / FAR_FROM_SHEET
    relative_std = float(motor.values['initial_relative_std.resistance'])
    if relative_std == 0.0:
        return math.inf
    factor = max(FAR_FROM_SHEET, math.exp(STDS_FROM_SHEET * relative_std))
    return float(motor.values['initial.resistance']) / factor


def _smallest_resistance(
    white_box: MotorWhiteBox,
    samples: Array,
    current_a: Array,
    balance: BackEmfFit | None,
    theta: Array,
) -> float:
    """Return the data's resistance: without back-EMF if speed is measured, else the impedance."""
    if balance is not None and balance.resistance > 0.0:
        return balance.resistance
    voltage_v = float(np.sqrt(np.mean(samples[VOLTAGE] ** 2)))
    signal = max(1.0 - noise_share(current_a) ** 2, 0.0) * float(np.mean(current_a**2))
    impedance = voltage_v / max(math.sqrt(signal), 1e-300)
    names = white_box.context_nodes
    published_ohm = float(theta[names.index('resistance')]) if 'resistance' in names else math.inf
    return min(impedance, published_ohm)


def _doubts_of_back_emf(
    white_box: MotorWhiteBox, balance: BackEmfFit, motor: MotorConfiguration
) -> Iterator[Suspect]:
    """Doubt a sign, the unit of the speed, and Kb where it is not among what is identified."""
    is_identified = BACK_EMF in white_box.context_nodes
    kb = 0.0 if is_identified else float(white_box.known.get(BACK_EMF, 0.0))
    is_contradicted = balance.contradicts(kb)
    sign = _doubt_of_sign(balance, is_contradicted)
    if sign is not None:
        yield sign
    if not is_contradicted or is_identified:
        return
    magnitude = abs(balance.kb)
    far = FAR_FROM_DEFAULT if kb == DEFAULT_KB else FAR
    if max(magnitude, kb) <= far * min(magnitude, kb) or magnitude <= SURE * balance.std:
        return
    unit = _unit_of_speed(magnitude / kb) if BACK_EMF in motor.stated_names and kb > 0.0 else None
    if unit is not None:
        factor = UNITS_OF_SPEED[unit]
        text = (
            f'speed.scale: {factor:.4g}  # or speed=NAME[{unit}] among --columns: by the Kb given, '
            f'the speed is in {unit}'
        )
        yield Suspect('units_of_speed', balance.evidence, text)
    text = f'{motor.name}.back_emf_constant: {magnitude:.4g}  # it is {kb:g} V s/rad now'
    yield Suspect(BACK_EMF, balance.evidence, text)


def _doubt_of_sign(balance: BackEmfFit, is_contradicted: bool) -> Suspect | None:
    """Doubt a sign: of the voltage where R and Kb are negative, of torque or speed where one is."""
    is_negative = balance.kb < 0.0 and is_contradicted
    residual_share = max(balance.residual_share, 1e-300)
    evidence = max(balance.evidence, 0.5 * balance.windows * -math.log(residual_share))
    if balance.has_negative_resistance:
        signal, column = ('voltage', 'voltage') if is_negative else ('torque', 'current')
        cause = 'R and back-EMF have' if is_negative else 'R has'
        text = (
            f'{signal}.scale: -1.0  # or {column}=-1*NAME among --columns: {cause} the wrong sign'
        )
        return Suspect(f'{signal}_sign', evidence, text)
    if not is_negative:
        return None
    text = 'speed.scale: -1.0  # or speed=-1*NAME among --columns: the back-EMF has the wrong sign'
    return Suspect('speed_sign', balance.evidence, text)


def _unit_of_speed(ratio: float) -> str | None:
    """Return the unit of a speed by the ratio of the Kb found to the Kb given; None: no such."""
    return next(
        (unit for unit, factor in UNITS_OF_SPEED.items() if abs(ratio / factor - 1.0) < NEAR), None
    )


def _is_thousand(ratio: float) -> bool:
    low, high = THOUSAND
    return low < ratio < high


def _evidence(ratio: float, samples: int) -> float:
    """Weigh a magnitude beyond its limit: each sample counts by the logarithm of the excess."""
    return samples * abs(math.log(max(ratio, 1e-300)))
