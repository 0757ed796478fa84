"""The rule for a motor whose current and measured speed are both outputs of the whole motor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.estimate import VerdictSettings
from gray_box_observer.context_nodes.measured_speed.filter_fit import fit_lagging
from gray_box_observer.context_nodes.measured_speed.output_fit import (
    MOST_PLAIN_WORK,
    BestSoFar,
    FitBefore,
    OutputFit,
    fit_outputs,
    fit_outputs_again,
)
from gray_box_observer.context_nodes.pieces import SAVED, Pieces, bounded
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.rotor.history_unknowns import (
    CurrentSensor,
    SpeedOutput,
    Unknowns,
)
from gray_box_observer.context_nodes.rotor.logarithms import Fit, LogPrior
from gray_box_observer.context_nodes.rotor.rotor_estimator import RotorUpdate
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_learner import WindowLearner
from gray_box_observer.context_nodes.rotor.window_schedule import WINDOW
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays
from gray_box_observer.samples.replay_buffer import SPEED
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.sensor_lag import LONGEST_MEMORY
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

MOST_LAG_WORK = 6 * SAVED
"""The same of a search for a filter of the current."""

BEHIND_LAG = 2e-3
"""Share of every parameter that is open behind a lag: a filter is never quite of first order."""

LESS_LAG = 0.5
"""Share of a lag below which it is asked whether there is none any more."""

_SENSOR = 'current_sensor'

MOST_WORK = 6 * SAVED
"""Work of a search from anywhere: what explains a window is found with less. Of the motors that
nothing explains it is given up, and more samples are waited for."""


class OutputLearner(WindowLearner):
    """Context nodes of one motor with a rotor, learnt from windows of current and speed.

    Attributes:
        output_fit: of the newest window; None before the first fit, and where none was found.
        walk: of the load.
        unit_a_s: noise of the current over that of the speed; 0: not known.
        sensor: of the current, where it lags; None: it does not.
        finds_lag: whether a lag of the current sensor is looked for.
    """

    speed_measured = True

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        initial_relative_std: Array | None,
        drift_threshold: float,
    ) -> None:
        super().__init__(white_box, initial, initial_relative_std, drift_threshold)
        self.output_fit: OutputFit | None = None
        self.walk = self.unit_a_s = 0.0
        self.sensor: CurrentSensor | None = None
        self.finds_lag = True
        self._newest_fit: OutputFit | None = None  # of the fit under way
        self._tried_walk = 0.0

    def begin(self) -> None:
        """Begin to look for what explains a window."""
        self._newest_fit = None
        self._tried_walk = self.walk

    def end(self) -> None:
        """Keep what was found."""
        self.output_fit = self._newest_fit
        self.walk = self._tried_walk
        if self._newest_fit is not None:
            self.unit_a_s = self._newest_fit.noise.unit_a_s
            self.sensor = self._newest_fit.sensor

    @property
    def current_lag_s(self) -> float:
        """Lag of the current sensor in s, as it was found; 0: it does not lag."""
        if self.sensor is None:
            return 0.0
        values = self._white_box.values(self.theta)
        return self.sensor.sum_s - float(values['inductance'] / values['resistance'])

    def learn(self, window: Window, *, is_full: bool) -> Pieces[bool]:
        """Fit a window; tell whether a fit was found.

        Behind a sensor that lags the inductance is open: which of two times is the winding's does
        not show, nor a part of the lag that is a delay.
        """
        has_fit = yield from super().learn(window, is_full=is_full)
        if has_fit:
            self.covariance += self._open_behind_lag()
        return has_fit

    def _remember(self, covariance: Array) -> None:
        super()._remember(covariance + self._open_behind_lag())

    def _open_behind_lag(self) -> Array:
        """Return what a lag of the current leaves open, as a covariance of the logarithms."""
        spread = np.zeros((self.logarithms.size, self.logarithms.size))
        fit = self._newest_fit
        lag_s = 0.0 if fit is None else fit.current_lag_s
        if fit is not None and lag_s > 0.0:
            np.fill_diagonal(spread, BEHIND_LAG**2)
            place = self._white_box.context_nodes.index('inductance')
            spread[place, place] += (lag_s / fit.fit.runs.winding_s) ** 2
        return spread

    def window(self, samples: Array) -> Window:
        """Cut samples, shape (signal, n), into signal histories with their speed."""
        return Window.from_samples(self._white_box, samples, Unknowns(SpeedOutput(1.0)))

    def _fitted(
        self, window: Window, prior: LogPrior, starts: Sequence[Array]
    ) -> Pieces[Fit | None]:
        return (yield from self._fitted_from(window, prior, starts, BestSoFar()))

    def _fitted_from(
        self,
        window: Window,
        prior: LogPrior,
        starts: Sequence[Array],
        best: BestSoFar | None = None,
    ) -> Pieces[Fit | None]:
        """Search from some starts; where that takes too long, the best so far counts, if kept."""
        box = self._white_box
        search = fit_outputs(
            box, window, prior, starts, self._tried_walk, stops_at_lead=self.finds_lag, best=best
        )
        fit = yield from bounded(search, MOST_WORK)
        if fit is None and best is not None:
            fit = best.fit
        if fit is not None and self.finds_lag and fit.speed_leads:
            late_fit = yield from self._behind_lag(window, prior, fit)
            if late_fit is not None:
                return self._noted(late_fit)
            search = fit_outputs(
                box, window, prior, [fit.fit.theta], self._tried_walk, stops_at_lead=False
            )
            fit = yield from bounded(search, MOST_WORK)
        return self._noted(fit)

    def _fitted_whole(self, window: Window, newest: Fit) -> Pieces[Fit | None]:
        """Go on from the newest samples; these alone count where all of them take too long."""
        part_fit = self._newest_fit
        assert part_fit is not None
        before = FitBefore.from_fit(part_fit)
        search = fit_outputs_again(self._white_box, window, self._data_sheet, before)
        fit = yield from bounded(search, MOST_WORK)
        if fit is not None and fit.explains and not fit.speed_leads:
            return self._noted(fit)
        whole = yield from self._fitted_from(window, self._data_sheet, [newest.theta])
        return self._noted(part_fit) if whole is None else whole

    def _fitted_again(self, window: Window) -> Pieces[Fit | None]:
        before = FitBefore(self.theta, self.walk, self.unit_a_s, self.has_rivals, self.sensor)
        prior = self._prior()
        fit = None
        if self.walk > 0.0 and self.memory is None:
            fit = yield from self._without_walk(window, prior, before)
        if fit is None:
            fit = yield from fit_outputs_again(self._white_box, window, prior, before)
        if fit is not None and fit.current_lag_s < LESS_LAG * self.current_lag_s:
            before = replace(before, sensor=None)  # the filter may have been taken off
            plain = yield from fit_outputs_again(self._white_box, window, prior, before)
            fit = plain if plain is not None and plain.explains else fit
        is_open = fit is not None and (
            fit.speed_leads or (fit.current_lag_s > 0.0 and self.has_rivals)
        )
        if fit is not None and self.finds_lag and is_open:
            late_fit = yield from self._behind_lag(window, prior, fit)
            fit = fit if late_fit is None else late_fit
        return self._noted(None if fit is None else fit.of_known_motor)

    def _without_walk(
        self, window: Window, prior: LogPrior, before: FitBefore
    ) -> Pieces[OutputFit | None]:
        """Fit a window with a constant load; None where that does not explain it.

        A load that varies explains a few samples of any motor. Until there is a full window, more
        samples may tell that it was constant.
        """
        search = fit_outputs_again(self._white_box, window, prior, replace(before, walk=0.0))
        fit = yield from bounded(search, MOST_PLAIN_WORK)
        return fit if fit is not None and fit.explains else None

    def _behind_lag(
        self, window: Window, prior: LogPrior, lead: OutputFit
    ) -> Pieces[OutputFit | None]:
        """Fit a window with a current sensor that lags; None where that does not explain it.

        Args:
            window: the samples.
            prior: decides what they leave open.
            lead: a fit whose speed comes before the current, or whose lag has rivals.
        """
        search = fit_lagging(self._white_box, window, prior, lead)
        return (yield from bounded(search, MOST_LAG_WORK))

    def _noted(self, fit: OutputFit | None) -> Fit | None:
        self._newest_fit = fit
        if fit is None:
            return None
        self._tried_walk = fit.walk
        return fit.fit

    def _is_ambiguous(self, window: Window) -> bool:
        """Tell whether nothing has moved: with its speed known, one move of the voltage tells."""
        return window.moves == 0

    def _is_poor(self, fit: Fit) -> bool:
        return self._newest_fit is None or not self._newest_fit.explains

    def _is_hopeless(self, fit: Fit) -> bool:
        return self._is_poor(fit)


class OutputUpdate(RotorUpdate):
    """Context nodes of one motor with a rotor, learnt from current and speed window by window.

    Args:
        white_box: the physics, with the inertia among its context nodes.
        initial: shape (1, parameter): where to start, SI units.
        rules: settings of the rule.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (1, parameter): how well the initial values are known.
        finds_lag: whether a lag of the current sensor is looked for.
    """

    _learner_type = OutputLearner
    _learner: OutputLearner

    def __init__(
        self,
        white_box: MotorWhiteBox,
        initial: Array,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
        *,
        finds_lag: bool = True,
    ) -> None:
        super().__init__(white_box, initial, rules, verdict_rules, initial_relative_std)
        self._learner.finds_lag = finds_lag
        self._speed = np.zeros(1)

    @property
    def output_fit(self) -> OutputFit | None:
        """Fit of the newest window; None before the first one, and where none was found."""
        return self._learner.output_fit

    @property
    def is_in_doubt(self) -> bool:
        """Whether what explained the motor before does not explain the samples being fitted."""
        return self._learner.is_in_doubt

    def remember(self, sample: Sample) -> None:
        """Take one sample; without its speed the speed before holds on."""
        if math.isfinite(sample.speed_rad_s[0]):
            self._speed = sample.speed_rad_s
        else:
            sample = sample._replace(speed_rad_s=self._speed)
        super().remember(sample)

    def begin_with(self, content: Array, stamp_ns: int) -> None:
        """Remember samples of the past; nothing else may have been remembered before.

        Args:
            content: shape (signal, 1, n), as a replay buffer gives it.
            stamp_ns: of the newest of them.
        """
        self._stamp_ns = stamp_ns
        self.replay.refill(content)
        self._schedule.place = content.shape[2]
        self._speed = content[SPEED, :, -1].copy()

    @property
    def unfitted(self) -> Array:
        """Return the samples since the last full window, at most one, shape (signal, n)."""
        new_count = self._schedule.place - self._schedule.mark
        count = int(min(new_count, self.replay.remembered()[0], WINDOW))
        return self.replay.newest(count)[:, 0]

    def postpone(self) -> None:
        """Put the fit that is due off until half as many more samples have come."""
        self._schedule.postpone()

    def _fit(self, place: int, samples: Array) -> Pieces[bool]:
        self._learner.begin()
        has_changed = yield from super()._fit(place, samples)
        self._learner.end()
        return has_changed

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt, as plain values and arrays, for a checkpoint."""
        plain, arrays = super().state(motor)
        return plain, arrays | {
            'walk': np.array([self._learner.walk]),
            'unit': np.array([self._learner.unit_a_s]),
            **_sensor_arrays(self._learner.sensor),
        }

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave; see :meth:`RotorUpdate.restore`."""
        check_arrays(arrays, {'walk': ArrayRule((1,), 0.0)})
        self._learner.walk = float(arrays['walk'][0])
        self._learner.unit_a_s = 0.0
        if 'unit' in arrays:  # not in files of releases that did not remember it
            check_arrays(arrays, {'unit': ArrayRule((1,), 0.0)})
            self._learner.unit_a_s = float(arrays['unit'][0])
        sensor = _restored_sensor(arrays)
        self._learner.sensor = sensor if self._learner.finds_lag else None
        super().restore(plain, arrays, motor)
        self._learner.output_fit = None
        if self.replay.stored(0):
            self._speed = self.replay.newest(1)[SPEED, :, 0].copy()


def _sensor_arrays(sensor: CurrentSensor | None) -> dict[str, Array]:
    """Return a current sensor that lags as arrays of a state; none without one."""
    if sensor is None:
        return {}
    flags = (float(sensor.is_digital), float(sensor.is_sure))
    return {_SENSOR: np.array([sensor.sum_s, sensor.memory, *flags])}


def _restored_sensor(arrays: dict[str, Array]) -> CurrentSensor | None:
    """Return what :func:`_sensor_arrays` gave.

    Raises:
        CheckpointError: it is none that could have been found.
    """
    if _SENSOR not in arrays:
        return None
    check_arrays(arrays, {_SENSOR: ArrayRule((4,), 0.0)})
    sum_s, memory, is_digital, is_sure = arrays[_SENSOR].tolist()
    memory = min(memory, LONGEST_MEMORY)
    return CurrentSensor(sum_s, memory, bool(is_digital), bool(is_sure))
