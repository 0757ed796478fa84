"""Fits a window whose measured speed is a second output of the motor, with noise and lag.

What one ampere of the current's residual counts for in speed is found by fitting again: the noise
of either output is what its own residual leaves. Where a constant load does not explain both
outputs, one that walks at random is tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.measured_speed.exact_speed import whiteness
from gray_box_observer.context_nodes.measured_speed.speed_start import (
    noisy_speed_start,
    speed_start,
)
from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.context_nodes.recursive.normal_equations import (
    OUTLIER,
    difference_noise,
    pooled_difference_noise,
)
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    LAG,
    CurrentSensor,
    SpeedOutput,
    Unknowns,
)
from gray_box_observer.context_nodes.rotor.load_walk import (
    ALIKE,
    WALKS,
    first_walk,
    load_over,
    walk_of_load,
)
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.noise_memory import SAME_MEMORY, memory_of
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import fit_window, search_from
from gray_box_observer.context_nodes.rotor.window_search import LEAST_NOISE as LEAST_CURRENT_NOISE
from gray_box_observer.samples.noise_floor import STEP_TO_STD, speed_step
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

LEAST_NOISE = 1e-3
"""Smallest noise of a speed that is believed, as a share of its spread: what friction near rest,
straight lines between samples and a filter of the sensor leave."""

ROUNDS = 6
"""Fits at most until the noise of either output agrees with its residual."""

LESS_THAN_STEP = 0.5
"""Share of what a step of the readings leaves that is always believed to be noise."""

AGREES = 1.1
"""Factor between two units of the outputs that are the same."""

NEARLY_AGREES = 1.25
"""The same beside noise of the voltage, where the samples are explained."""

POOR = 1.3
"""Residual over noise floor from which an output is not explained."""

BY_CHANCE = 5.0
"""How far beyond 1 it comes by chance, times the root of the samples, once in a thousand fits."""

COLOURED = 4.0
"""Whiteness of the current's residual from which it is not explained."""

SPEED_COLOURED = 25.0
"""Whiteness of the speed's residual from which the rotor is not explained: rounded readings of few
counts, a filter of the sensor or a gear that gives."""

CLOSE = 1.2
"""Residual over noise floor up to which no other start is searched from."""

MOST_PLAIN_WORK = 131072
"""Work of a search from linear equations without a load, which mostly is enough, at most."""

SEEN = 1.2
"""Noise of a speed, over the smallest that is believed, from which there is some."""

HOPELESS = 4.0
"""The same from which another unit of the outputs will not help."""

LEAD, LEAD_STDS = 0.05, 5.0
"""Sample intervals, and standard deviations, by which the speed comes before the current where the
sensor of the current lags: no speed is known before it is measured."""

LEAST_LAG = 0.03
"""Sample intervals from which a lag of the current is one."""

IDLE = 0.01
"""Squared distance, in standard deviations, of two ends that are the same."""


@dataclass(frozen=True)
class OutputNoise:
    """Noise of both outputs.

    Attributes:
        current_a: standard deviation of the current's.
        speed_rad_s: of the speed's.
        least_rad_s: smallest one of the speed's that is believed.
        step_rad_s: what the steps of the speed's readings leave; 0 where there are none.
    """

    current_a: float
    speed_rad_s: float
    least_rad_s: float
    step_rad_s: float = 0.0

    @property
    def unit_a_s(self) -> float:
        """Amperes that count for as much as one rad/s."""
        return self.current_a / self.speed_rad_s

    @property
    def shows_noise(self) -> bool:
        """Whether the speed has more noise than is always believed."""
        return self.speed_rad_s > SEEN * self.least_rad_s


@dataclass(frozen=True, eq=False)
class OutputFit:
    """Where the fit of both outputs has ended.

    Attributes:
        fit: of the parameters.
        window: the samples.
        noise: of both outputs, by their residuals.
        floor: the least noise that the readings show.
        largest: residual over noise floor up to which it explains the samples.
    """

    fit: Fit
    window: Window
    noise: OutputNoise
    floor: OutputNoise
    largest: float = POOR

    @property
    def of_known_motor(self) -> OutputFit:
        """The same fit where that of fewer samples has led to it: chance is no other motor."""
        by_chance = 1.0 + BY_CHANCE / float(np.sqrt(self.window.current_a.size))
        return replace(self, largest=max(POOR, by_chance))

    @property
    def explains(self) -> bool:
        """Whether both residuals are noise, that of the current white."""
        noise_a = self.noise.current_a
        return self.is_within(self.largest) and self._whiteness(State.CURRENT, noise_a) < COLOURED

    @property
    def explains_rotor(self) -> bool:
        """Whether the residual of the speed is white enough for the rotor's parameters."""
        output = self.window.speed_output
        noise_a = self.noise.speed_rad_s * (0.0 if output is None else output.unit_a_s)
        return self._whiteness(State.SPEED, noise_a) < SPEED_COLOURED

    @property
    def shows_voltage_noise(self) -> bool:
        """Whether the voltage has noise that the current does not answer."""
        return self.fit.voltage_noise is not NO_NOISE

    def _whiteness(self, output: State, noise_a: float) -> float:
        """Return the whiteness of an output's residual, its outliers cut."""
        most_a = OUTLIER * noise_a
        return whiteness(np.clip(self.fit.runs.of_output(output), -most_a, most_a))

    @property
    def walk(self) -> float:
        """Variance that the load gains in a second, in (rad/s2)^2/s; 0 where it is constant."""
        load = self.window.unknowns.load
        return 0.0 if load is None else load.walk

    @property
    def unknowns(self) -> int:
        """How many unknowns there are, those of every history among them."""
        return int(self.fit.logarithms.size + self.fit.starts.size)

    @property
    def sensor(self) -> CurrentSensor | None:
        """The current sensor, where it lags, as it was found; None: it does not."""
        sensor = self.window.unknowns.current_sensor
        if sensor is None or not self.current_lag_s:
            return None
        return replace(sensor, sum_s=self.current_lag_s + self.fit.runs.winding_s)

    @property
    def shows_lag(self) -> bool:
        """Whether the current sensor lags, and by more than chance."""
        lag_s = self.current_lag_s
        place = self.window.unknowns.current_lag
        return lag_s > LEAST_LAG * self.window.interval_s and lag_s > LEAD_STDS * self._std(place)

    @property
    def smoothing_weight(self) -> float:
        """Weight of the newest value where the current is surely a moving average; else 0."""
        sensor = self.sensor
        if sensor is None or not (sensor.is_digital and sensor.is_sure):
            return 0.0
        return float(-np.expm1(-self.window.interval_s / self.current_lag_s))

    @property
    def memory(self) -> float:
        """Correlation of the current's noise at two samples in a row; 0 where there is none."""
        lag_s = self.current_lag_s
        if not lag_s:
            return 0.0
        return memory_of(self.fit.runs.misread_a, math.exp(-self.window.interval_s / lag_s))

    @property
    def cost(self) -> float:
        """Log-likelihood of the readings, times -2, but for a constant."""
        output = self.window.speed_output
        assert output is not None
        deviations = self.fit.noise_a**2 / output.unit_a_s  # product of those of both outputs
        return float(self.fit.chi_square + self.fit.runs.residual_a.size * np.log(deviations))

    @property
    def speed_leads(self) -> bool:
        """Whether the speed comes before the current, which then is the one that is late."""
        lead_s = -self._of_longest(LAG)
        return lead_s > LEAD * self.window.interval_s and lead_s > LEAD_STDS * self._std(LAG)

    @property
    def shows_noise(self) -> bool:
        """Whether the speed has more noise than is always believed."""
        return self.noise.shows_noise

    @property
    def shows_exact_speed(self) -> bool:
        """Whether it explains both outputs by a speed without noise."""
        return self.explains and not self.shows_noise

    def is_within(self, factor: float) -> bool:
        """Tell whether no residual is more than so many times its floor."""
        is_current_noise = self.noise.current_a <= factor * self.floor.current_a
        return is_current_noise and self.noise.speed_rad_s <= factor * self.floor.speed_rad_s

    def lag(self) -> tuple[float, float]:
        """Return the lag of the speed in the longest history in s, and its standard deviation."""
        return self._of_longest(LAG), self._std(LAG)

    @property
    def current_lag_s(self) -> float:
        """Lag of the current sensor in the longest history in s; 0 where it does not lag."""
        unknowns = self.window.unknowns
        if unknowns.current_sensor is None:
            return 0.0
        return max(self._of_longest(unknowns.current_lag), 0.0)

    @property
    def _longest(self) -> int:
        """Place of the longest history."""
        return int(np.argmax([history.current_a.size for history in self.window.histories]))

    def _of_longest(self, place: int) -> float:
        """Return an unknown of the longest history."""
        return float(self.fit.starts[self._longest, place])

    def _std(self, place: int) -> float:
        """Return the standard deviation of an unknown of the longest history."""
        of_history = self.fit.runs.derivatives[self._longest]
        by_unknown = of_history[:, place]
        others = np.delete(of_history, place, axis=1)
        others /= np.linalg.norm(others, axis=0) + 1e-300
        distinct = by_unknown - others @ np.linalg.lstsq(others, by_unknown, rcond=1e-12)[0]
        size = float(np.linalg.norm(distinct)) + 1e-300
        return float(self.fit.noise_a / size)


class BestSoFar:
    """Keeps what a search has found, for it may take more work than it is given.

    Attributes:
        fit: one that explains its samples, else the newest; None: nothing was found.
    """

    def __init__(self) -> None:
        self.fit: OutputFit | None = None

    def keep(self, fit: OutputFit) -> None:
        """Keep a fit, unless one that explains its samples was found before."""
        if self.fit is None or fit.explains or not self.fit.explains:
            self.fit = fit


def fit_outputs(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    walk: float = 0.0,
    *,
    stops_at_lead: bool = True,
    best: BestSoFar | None = None,
) -> Pieces[OutputFit | None]:
    """Fit the context nodes to current and speed; None where no start can be run.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from.
        walk: variance that the load has gained in a second before; 0: it was constant.
        stops_at_lead: whether to end as soon as the speed comes before the current, as it does
            where the sensor of the current lags (``filter_fit``).
        best: keeps what is found with a constant load on the way; None: nothing does.
    """
    floor = _floor(window)
    if walk > 0.0:
        walk_fit = yield from _loaded(white_box, window, prior, starts[0], floor, walk)
        if walk_fit is not None and walk_fit.explains:
            return walk_fit
    linear = speed_start(white_box, window, starts[0])
    plain = None
    if floor.shows_noise:  # late alone it leads astray
        plain = noisy_speed_start(white_box, window, starts[0], floor.speed_rad_s)
    steady = None
    if plain is not None:
        search = _settled(
            white_box, window, prior, [plain], floor, stops_at_lead=stops_at_lead, best=best
        )
        steady = yield from bounded(search, MOST_PLAIN_WORK)
    if steady is None or not steady.is_within(CLOSE):
        every_start = [*starts] if linear is None else [*starts, linear]
        other = yield from _settled(
            white_box, window, prior, every_start, floor, stops_at_lead=stops_at_lead, best=best
        )
        steady = _likelier(steady, other)
    if linear is None or steady is None or steady.explains:
        return steady
    if stops_at_lead and steady.speed_leads:
        return steady
    walk_fit = yield from _loaded(
        white_box, window, prior, linear, floor, first_walk(white_box, window, linear)
    )
    return walk_fit if walk_fit is not None and walk_fit.explains else steady


def _likelier(one: OutputFit | None, other: OutputFit | None) -> OutputFit | None:
    """Return the likelier of two fits of the same samples; None where there is none."""
    if one is None or other is None:
        return one or other
    return min(one, other, key=lambda fit: fit.cost)


@dataclass(frozen=True, eq=False)
class FitBefore:
    """What a fit of the window before has left.

    Attributes:
        theta: shape (parameter,).
        walk: variance that the load gains in a second; 0 where it is constant.
        unit_a_s: amperes of residual that count for as much as one rad/s; 0: not known.
        has_rivals: whether other ends were as likely.
        sensor: of the current, where it lags; None: it does not.
    """

    theta: Array
    walk: float
    unit_a_s: float
    has_rivals: bool
    sensor: CurrentSensor | None = None

    @classmethod
    def from_fit(cls, fit: OutputFit) -> FitBefore:
        """Return what a fit of a part of the window has left."""
        has_rivals = bool(fit.fit.spread.any())
        return cls(fit.fit.theta, fit.walk, fit.noise.unit_a_s, has_rivals, fit.sensor)


def fit_outputs_again(
    white_box: MotorWhiteBox, window: Window, prior: LogPrior, before: FitBefore
) -> Pieces[OutputFit | None]:
    """Fit a further window from where the one before has ended, and from nowhere else.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        prior: decides what the samples leave open.
        before: what is known of the motor.
    """
    floor = _floor(window)
    if before.walk > 0.0:
        walk_fit = yield from _loaded(white_box, window, prior, before.theta, floor, before.walk)
        if walk_fit is not None and walk_fit.explains:
            return walk_fit
    return (yield from _settled(white_box, window, prior, [before.theta], floor, before))


def _settled(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    starts: Sequence[Array],
    floor: OutputNoise,
    last_fit: FitBefore | None = None,
    *,
    stops_at_lead: bool = False,
    best: BestSoFar | None = None,
) -> Pieces[OutputFit | None]:
    """Fit with a constant load until the noise of either output agrees with its residual.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        prior: decides what the samples leave open.
        starts: shape (parameter,) each: where to search from.
        floor: the least noise that the readings show.
        last_fit: what is known of the motor, with the sensor of the current; None: nothing is.
        stops_at_lead: whether to end as soon as the speed comes before the current.
        best: keeps every fit; None: nothing does.
    """
    result = None
    is_known = last_fit is not None and last_fit.unit_a_s > 0.0
    output = SpeedOutput(last_fit.unit_a_s if last_fit is not None and is_known else floor.unit_a_s)
    tries_others = last_fit is None or last_fit.has_rivals
    sensor = None if last_fit is None else last_fit.sensor
    for _ in range(ROUNDS):
        window = replace(window, unknowns=Unknowns(output, current_sensor=sensor))
        fit = yield from fit_window(white_box, window, prior, starts, tries_others=tries_others)
        if fit is None:
            return result
        before = result
        result = _result(fit, window, floor)
        if best is not None:
            best.keep(result)
        if not result.is_within(HOPELESS) or (stops_at_lead and result.speed_leads):
            return result
        ratio = result.noise.unit_a_s / output.unit_a_s
        is_settled = 1.0 / AGREES < ratio < AGREES
        if sensor is not None:
            memory = result.memory
            is_settled &= abs(memory - sensor.memory) < SAME_MEMORY
            sensor = replace(sensor, memory=memory)
        if is_settled and (is_known or (before is not None and is_same_end(before.fit, fit))):
            break
        is_near = 1.0 / NEARLY_AGREES < ratio < NEARLY_AGREES
        if is_near and result.shows_voltage_noise and result.explains:
            break  # its size differs a little from search to search, and so do their ends
        if is_settled:
            ratio = 1.0
        output = replace(output, unit_a_s=ratio * output.unit_a_s)
        starts = [fit.theta]
        tries_others = bool(fit.spread.any())  # rivals need another unit too
    return result


def _loaded(
    white_box: MotorWhiteBox,
    window: Window,
    prior: LogPrior,
    start: Array,
    floor: OutputNoise,
    walk: float,
) -> Pieces[OutputFit | None]:
    """Fit with a load that walks at random, as fast as its knots turn out to."""
    output = SpeedOutput(floor.unit_a_s)
    load = load_over(window, walk)
    result = None
    for _ in range(WALKS):
        window = replace(window, unknowns=Unknowns(output, load))
        fit = yield from search_from(white_box, window, prior, start)
        if fit is None:
            return result
        result = _result(fit, window, floor)
        walk = walk_of_load(fit.runs, fit.noise_a)
        unit = result.noise.unit_a_s
        is_settled = 1.0 / ALIKE < walk / load.walk < ALIKE
        if is_settled and 1.0 / ALIKE < unit / output.unit_a_s < ALIKE:
            break
        output = SpeedOutput(unit)
        load = replace(load, walk=walk)
        start = fit.theta
    return result


def _result(fit: Fit, window: Window, floor: OutputNoise) -> OutputFit:
    output = window.speed_output
    assert output is not None
    noise = _residual_noise(fit, output, floor)
    return OutputFit(fit, window, noise, _floor_of_residual(fit, floor))


def is_same_end(before: Fit, after: Fit) -> bool:
    """Tell whether a search from where another ended has gone nowhere."""
    apart = after.logarithms - before.logarithms
    return bool(apart @ after.information @ apart < IDLE)


def _floor(window: Window) -> OutputNoise:
    """Least noise that the readings of both outputs show."""
    histories = [one for one in window.histories if one.speed_rad_s is not None]
    speeds = [np.asarray(one.speed_rad_s) for one in histories]
    speed = np.concatenate(speeds)
    current_a = max(
        pooled_difference_noise([one.current_a for one in histories]),
        window.quantisation_std_a,
        LEAST_CURRENT_NOISE * window.spread_a,
        1e-12,
    )
    step = speed_step(speed) * STEP_TO_STD
    least = LEAST_NOISE * float(np.std(speed)) + 1e-12
    noise = pooled_difference_noise(speeds)
    return OutputNoise(current_a, max(noise, step, least), max(LESS_THAN_STEP * step, least), step)


def _residual_noise(fit: Fit, output: SpeedOutput, floor: OutputNoise) -> OutputNoise:
    """Noise of both outputs by the medians of their residuals.

    Of an encoder that mostly rests the median tells nothing, for nothing is rounded off there.
    """
    current = MAD_TO_STD * float(median(np.abs(fit.runs.of_output(State.CURRENT))))
    speed = fit.runs.of_output(State.SPEED) / output.unit_a_s
    speed_std = MAD_TO_STD * float(median(np.abs(speed)))
    if speed_std < floor.step_rad_s:
        most = OUTLIER * floor.step_rad_s
        speed_std = max(speed_std, float(np.sqrt(np.mean(np.clip(speed, -most, most) ** 2))))
    noise_rad_s = max(speed_std, floor.least_rad_s)
    return replace(floor, current_a=max(current, fit.least_noise_a), speed_rad_s=noise_rad_s)


def _floor_of_residual(fit: Fit, floor: OutputNoise) -> OutputNoise:
    """The floor again by the residuals' second differences, free of the signals' own bends."""
    current = difference_noise(fit.runs.of_output(State.CURRENT))
    return replace(floor, current_a=max(current, fit.least_noise_a))
