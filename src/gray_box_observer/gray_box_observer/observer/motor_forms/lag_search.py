"""Looks for the lag of the current that a form needs, and for the filter that it comes from.

A lag changes the voltage that the white box takes. The samples are fit with that of the fit before,
until a fit moves it no more (docs/METHOD.md, Which effects).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.pieces import Pieces, bounded
from gray_box_observer.context_nodes.rotor.noise_memory import SAME_MEMORY
from gray_box_observer.context_nodes.rotor.window import delayed_voltage
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.current_lag import lag_step
from gray_box_observer.fit_test.effects import LATE
from gray_box_observer.fit_test.twin_effects import TOLD_APART
from gray_box_observer.observer.motor_forms.form_fit import (
    FormFit,
    FormFitter,
    is_no_better,
    likelihood_gain,
    log_likelihood,
    settled_count,
)
from gray_box_observer.observer.motor_forms.motor_form import ROTOR, WORK_A_SAMPLE
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.voltage_path import SETTLED
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.samples.replay_buffer import INTERVAL, VOLTAGE, forget_moves
from gray_box_observer.settings.motor_configuration import CURRENT_LAG
from gray_box_observer.settings.sensor_lag import (
    LARGEST_CHANGE,
    LONGEST_MEMORY,
    CurrentLag,
    FilterKind,
)
from gray_box_observer.white_box.interface import Array

MOST_LAGS = 6
"""Fits of a form with a lag, after the first."""

LONGEST_STEP = 3.0
"""Factor by which a fit makes a lag longer or shorter at most."""

FIRST_LAG = 1.0
"""The longest lag after the first fit, in sample intervals."""

DELAYS = (0.8, 1.0)
"""Delays that a lag is compared with, as shares of it: so long are those that look like one."""

FEWEST = 64
"""Samples by which two orders are compared."""

LARGEST_SHARE = 0.5
"""Share of the samples that a lag may take to settle."""

SWINGING = 0.5
"""Share of a step that is taken where it leads back: the voltage is made with the winding of the
fit before, so that lag and winding may swing about where they agree."""

STEADY = 0.3
"""Share of a lag by which a fit moves it at most where the residual tells the memory of the noise:
a wrong lag leaves a residual that looks like such noise."""

MEAN_LAGS = (0.2, 0.8)
"""Lags, in sample intervals, as which readings show that are means of their intervals: these are
late by half of one."""

MOST_LAG_WORK = 3072
"""Work of the search for a lag, for each sample, at most: what is no lag is searched for long."""

MOST_KIND_WORK = 524288
"""Work of the question whether a filter is of another kind, at most."""

SURELY_APART = 3.0 * TOLD_APART
"""Log-likelihood by which every fit on the way has to be worse where it was not enough."""

UNASKED = 0.05
"""Change of every parameter that counts where nothing is told then."""

SURE_LAG = 5.0
"""Standard deviations that the first lag must be long; what it explains tells the rest."""

NEAR_WINDING = 0.05
"""Share of L/R by which the last fit moves it at most."""

NEAR_LAG, NEAR_STDS = 1e-3, 0.5
"""The same of a lag, and standard deviations of it that are as near."""


class LagSearch:
    """Fits forms of one motor with a lag of the current.

    Args:
        fitter: of the forms.
        open_forms: that the motor may take.
    """

    def __init__(self, fitter: FormFitter, open_forms: OpenForms) -> None:
        self._fitter = fitter
        self._open = open_forms

    def settled(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Fit a form again, until its dead zone and its lag stay; other forms stay as they are.

        Where what it leaves looks like a lag first of all, it gets one.

        Args:
            fit: of the form.
            content: shape (signal, 1, n): the samples.
        """
        fit = yield from self._fitter.with_settled_zone(fit, content)
        plain = fit
        if self._is_late(fit):
            fit = replace(fit, kind=fit.kind.with_effect(CURRENT_LAG))
        if CURRENT_LAG not in fit.kind.effects:
            return fit
        most_work = MOST_LAG_WORK * content.shape[2]
        late = yield from bounded(self._with_known_lag(fit, content), most_work)
        if late is None or (late.kind.lag is None and CURRENT_LAG not in plain.kind.effects):
            return plain
        return late

    def _is_late(self, fit: FormFit) -> bool:
        """Tell whether what a form leaves looks like a lag of the current, first of all."""
        assessment = fit.form.fit.assessment(0)
        suspects = assessment.suspects
        kind = fit.kind
        is_likeliest = bool(suspects) and suspects[0].effect in LATE
        if kind.source == ROTOR and not suspects:  # what a rotor leaves then tells nothing
            is_likeliest = assessment.verdict is FitVerdict.WARNING
        is_new = CURRENT_LAG not in kind.effects
        return is_likeliest and is_new and self._open.contains(kind.with_effect(CURRENT_LAG))

    def _with_known_lag(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Fit a form again until its lag, and the filter that it comes from, stay."""
        fit = yield from self._with_settled_lag(fit, content)
        fit = yield from self._with_likelier_filter(fit, content)
        lag = fit.kind.lag
        if lag is not None and fit.is_misfit and not lag.is_mean:  # it began with the shorter lag
            other = yield from self._fitter.again(replace(fit.kind, lag=lag.turned), fit, content)
            other = yield from self._with_settled_lag(other, content)
            return fit if other.is_misfit else other
        return fit

    def _with_settled_lag(
        self, fit: FormFit, content: Array, fits: list[FormFit] | None = None
    ) -> Pieces[FormFit]:
        """Fit a form again, until its lag of the current stays; it has none where none is seen.

        Args:
            fit: of the form.
            content: shape (signal, 1, n): the samples.
            fits: takes every fit on the way, the first one too; None: nobody asks for them.
        """
        interval_s = content[INTERVAL, 0]
        if not (interval_s > 0.0).any():
            return fit
        usual_s = usual_interval(content[INTERVAL])
        limit_s = LARGEST_SHARE * float(interval_s.sum()) / SETTLED
        newest_step_s = 0.0
        for _ in range(MOST_LAGS):
            if fits is not None:
                fits.append(fit)
            form = fit.form
            before = fit.kind.lag
            lag_s = 0.0 if before is None else before.lag_s
            theta = fit.estimate.value
            step = lag_step(form.white_box, theta, form.driven(content), before)
            yield WORK_A_SAMPLE * content.shape[2]
            if before is None and not step.step_s > SURE_LAG * step.std_s:
                break
            values = form.white_box.values(theta[0])
            winding_s = values['inductance'] / values['resistance']
            step_s = step.step_s if abs(step.step_s) > step.std_s else 0.0
            if before is not None and step_s * newest_step_s < 0.0:  # it swings
                step_s *= SWINGING
                winding_s = before.winding_s + SWINGING * (winding_s - before.winding_s)
            newest_step_s = step_s
            longest_s = LONGEST_STEP * lag_s or FIRST_LAG * usual_s
            next_s = min(max(lag_s + step_s, lag_s / LONGEST_STEP), longest_s, limit_s)
            if before is not None and before.is_mean:  # it has none to be found
                next_s = lag_s
            filter_kind = FilterKind.FIRST_ORDER if before is None else before.filter_kind
            is_steady = abs(step.step_s) <= STEADY * lag_s
            memory = step.memory if is_steady else (0.0 if before is None else before.memory)
            lag = CurrentLag(next_s, winding_s, (), memory, filter_kind)
            if not lag.is_possible or (before is not None and _is_near(lag, before, step.std_s)):
                if before is not None and before.is_average:  # no voltage is made with its L/R
                    lag = before._replace(winding_s=winding_s)
                    fit = replace(fit, kind=replace(fit.kind, lag=lag))
                break
            other = yield from self._fitter.again(replace(fit.kind, lag=lag), fit, content)
            is_first = before is None and fit.kind.source == ROTOR
            if is_first and is_no_better(other, fit, content):  # it is no lag
                break
            fit = other
        return fit

    def _with_likelier_filter(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Take the lag of a rotor's current for that of another filter, where that is likelier.

        Noise passes a moving average. So that is asked for where the residual is correlated. What
        was taken for the winding may be the filter: the slower of both is taken first. Where it is
        more correlated than the lag explains, that may stand in the wrong order. Readings that are
        means have white noise.

        Args:
            fit: of the form, with a lag that was settled, or with none.
            content: shape (signal, 1, n): the samples.
        """
        lag = fit.kind.lag
        if lag is None or fit.kind.source != ROTOR:
            return fit
        correlation = yield from self._correlation(fit, content)
        if correlation and not lag.is_average:
            slower = lag if lag.lag_s > lag.winding_s else lag.turned
            other = yield from self._if_likelier(fit, slower, FilterKind.MOVING_AVERAGE, content)
            if other is not None:
                return other
        if fit.is_misfit and not lag.is_mean and _may_be_mean(lag, content):
            other = yield from self._if_likelier(fit, lag, FilterKind.INTERVAL_MEAN, content)
            if other is not None:
                return other
        if correlation <= max(lag.memory, 0.0) + SAME_MEMORY:  # it is what the filter leaves
            return fit
        other = yield from self._if_likelier(fit, lag.turned, FilterKind.FIRST_ORDER, content)
        return other or fit

    def _if_likelier(
        self, fit: FormFit, lag: CurrentLag, filter_kind: FilterKind, content: Array
    ) -> Pieces[FormFit | None]:
        """Fit a form with a filter of a kind, within bounds of work; None where it is no likelier.

        Args:
            fit: of the form with another filter.
            lag: where the search begins.
            filter_kind: what it is to come from.
            content: shape (signal, 1, n): the samples.
        """
        other = yield from bounded(self._of_kind(fit, lag, filter_kind, content), MOST_KIND_WORK)
        is_likelier = other is not None and _evidence(fit, other, content) < 0.0
        return other if is_likelier else None

    def is_delay(self, fit: FormFit, content: Array) -> Pieces[bool]:
        """Ask whether a delay of the voltage explains the samples as well as a lag does.

        Beside a rotor it is not asked: the fit of the whole motor tells them apart.

        Args:
            fit: of the form with the lag.
            content: shape (signal, 1, n): the samples.
        """
        lag = fit.kind.lag
        if lag is None or fit.kind.source == ROTOR:
            return False
        plain = fit.kind.without(CURRENT_LAG)
        other_a = math.inf
        for share in DELAYS:
            late_content = _delayed(content, share * lag.lag_s)
            other = yield from self._fitter.first(plain, late_content)
            other_a = min(other_a, other.form.residual(late_content, fit.settle_s))
        left_a = fit.form.residual(content, fit.settle_s)
        count = settled_count(content, fit.settle_s)
        return not log_likelihood(count, other_a, left_a) > TOLD_APART

    def weighed(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Ask for other explanations of a lag, and let those count that the data leave open.

        Args:
            fit: of the form.
            content: shape (signal, 1, n): the samples.
        """
        fit = yield from self._ordered(fit, content)
        return (yield from self._of_sure_kind(fit, content))

    def _ordered(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Ask whether the winding may be the sensor, and the sensor the winding.

        Two lags in a row look the same in either order, but for what is not linear: friction,
        hysteresis. The likelier order counts. Where the other one is not ruled out, it leaves open
        what leans on the order.
        """
        lag = fit.kind.lag
        if lag is None or lag.is_mean:
            return fit
        start = yield from self._fitter.again(replace(fit.kind, lag=lag.turned), fit, content)
        other = yield from self._with_settled_lag(start, content)
        if _has_turned_back(other.kind.lag, lag):
            other = start
        yield WORK_A_SAMPLE * content.shape[2]
        gain = _evidence(fit, other, content)
        if gain < 0.0:
            fit, other = other, fit
        lag = fit.kind.lag
        assert lag is not None
        if not abs(gain) < TOLD_APART:
            return fit
        shift = _changes(fit, other)
        place = fit.form.white_box.context_nodes.index('inductance')
        exchange = float(np.clip(lag.lag_s / lag.winding_s - 1.0, -1.0, LARGEST_CHANGE))
        shift[place] = max(shift[place], exchange, key=abs)
        lag = lag._replace(other_order=tuple(shift))
        return (yield from self._fitter.again(replace(fit.kind, lag=lag), fit, content))

    def _of_sure_kind(self, fit: FormFit, content: Array) -> Pieces[FormFit]:
        """Ask whether the filter of a rotor's current may be of another kind.

        Of a filter of first order a moving average is the rival where the noise is correlated, and
        the mean of the interval where it is not.
        """
        lag = fit.kind.lag
        if lag is None or fit.kind.source != ROTOR:
            return fit
        rival = FilterKind.FIRST_ORDER
        if lag.filter_kind is rival:
            correlation = yield from self._correlation(fit, content)
            rival = FilterKind.MOVING_AVERAGE if correlation else FilterKind.INTERVAL_MEAN
        if rival is FilterKind.INTERVAL_MEAN and not _may_be_mean(lag, content):
            return fit
        fits: list[FormFit] = []
        pieces = self._of_kind(fit, lag, rival, content, fits)
        other = yield from bounded(pieces, MOST_KIND_WORK)
        changes = [UNASKED] * len(fit.estimate.parameters)
        if other is None:  # a misfit where it was asked for, which costs most
            is_apart = bool(fits)
            for one in fits:
                is_apart = is_apart and _evidence(fit, one, content) > SURELY_APART
                yield WORK_A_SAMPLE * content.shape[2]
            if is_apart:
                return fit
        else:
            gain = _evidence(fit, other, content)
            if gain < 0.0:
                fit, other = other, fit
                if abs(gain) >= TOLD_APART:
                    return (yield from self._ordered(fit, content))
            if abs(gain) >= TOLD_APART:
                return fit
            changes = _changes(fit, other)
        own_lag = fit.kind.lag
        assert own_lag is not None
        lag = own_lag._replace(other_order=lag.other_order, other_kind=tuple(changes))
        return (yield from self._fitter.again(replace(fit.kind, lag=lag), fit, content))

    def _correlation(self, fit: FormFit, content: Array) -> Pieces[float]:
        """Return the correlation of the residual of a rotor behind a filter; 0 by chance."""
        form = fit.form
        driven_content = form.driven(content)
        step = lag_step(form.white_box, fit.estimate.value, driven_content, fit.kind.lag)
        yield WORK_A_SAMPLE * content.shape[2]
        return step.correlation

    def _of_kind(
        self,
        fit: FormFit,
        lag: CurrentLag,
        filter_kind: FilterKind,
        content: Array,
        fits: list[FormFit] | None = None,
    ) -> Pieces[FormFit]:
        """Fit a form with a filter of a kind.

        Args:
            fit: of the form with another filter.
            lag: where the search begins, whatever it comes from.
            filter_kind: what it is to come from.
            content: shape (signal, 1, n): the samples.
            fits: takes every fit on the way; None: nobody asks for them.
        """
        usual_s = usual_interval(content[INTERVAL])
        lag_s = 0.5 * usual_s if filter_kind is FilterKind.INTERVAL_MEAN else lag.lag_s
        was_average = lag.is_average and filter_kind is FilterKind.FIRST_ORDER
        memory = min(math.exp(-usual_s / lag_s), LONGEST_MEMORY) if was_average else 0.0
        start = CurrentLag(lag_s, lag.winding_s, (), memory, filter_kind)
        other = yield from self._fitter.again(replace(fit.kind, lag=start), fit, content)
        other = yield from self._with_settled_lag(other, content, fits)
        yield WORK_A_SAMPLE * content.shape[2]
        return other


def _delayed(content: Array, delay_s: float) -> Array:
    """Return samples, shape (signal, 1, n), whose voltage acts later: means over their intervals.

    Args:
        content: the samples.
        delay_s: by how much.
    """
    interval_s = content[INTERVAL, 0]
    is_whole = interval_s > 0.0
    late_v = delayed_voltage(content[VOLTAGE, 0], interval_s, delay_s)
    result = content.copy()
    result[VOLTAGE, 0, is_whole] = late_v[is_whole]
    forget_moves(result)
    return result


def _may_be_mean(lag: CurrentLag, content: Array) -> bool:
    """Tell whether a lag may be that of readings which are means of their intervals."""
    low, high = MEAN_LAGS
    return low < lag.lag_s / usual_interval(content[INTERVAL]) < high


def _changes(fit: FormFit, other: FormFit) -> list[float]:
    """Return by how much the parameters of another fit differ, relative to them."""
    change = other.estimate.value[0] / fit.estimate.value[0] - 1.0
    change = np.where(np.isfinite(change), change, 0.0)
    changes: list[float] = np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE).tolist()
    return changes


def _evidence(fit: FormFit, other: FormFit, content: Array) -> float:
    """Return :func:`likelihood_gain`; 0 where too little has settled, or across gaps.

    Args:
        fit: of the one.
        other: of the other one.
        content: shape (signal, 1, n): the samples.
    """
    settle_s = max(fit.settle_s, other.settle_s)
    has_gaps = bool((content[INTERVAL, 0, 1:] <= 0.0).any())  # what begins anew may decide there
    if settled_count(content, settle_s) < FEWEST or has_gaps:
        return 0.0
    return likelihood_gain(fit, other, content)


def _has_turned_back(lag: CurrentLag | None, before: CurrentLag) -> bool:
    """Tell whether a search that began with the other order has ended with the same one."""
    if lag is None:
        return True
    here = abs(math.log(lag.lag_s / before.lag_s))
    return here < abs(math.log(lag.lag_s / before.winding_s))


def _is_near(lag: CurrentLag, before: CurrentLag, std_s: float) -> bool:
    """Tell whether a fit has hardly moved a lag, nor the winding that it was taken with.

    Args:
        lag: as the fit has it.
        before: as it was taken for the fit.
        std_s: standard deviation of the lag in s.
    """
    nearest_s = max(NEAR_LAG * before.lag_s, NEAR_STDS * std_s)
    winding_share = abs(lag.winding_s / before.winding_s - 1.0)
    is_same_noise = abs(lag.memory - before.memory) < SAME_MEMORY
    is_same_lag = abs(lag.lag_s - before.lag_s) <= nearest_s
    # of an average that is undone the winding makes no voltage
    is_same_winding = lag.is_average or winding_share <= NEAR_WINDING
    return is_same_lag and is_same_noise and is_same_winding
