"""Searches for a filter of the current, where a fit of both outputs has the speed come before it.

Of two time constants one is the winding's and one the filter's, and the filter is of either kind.
All of these are fitted; the likeliest counts (docs/METHOD.md, A filter of the current).
"""

from __future__ import annotations

from dataclasses import replace

from gray_box_observer.context_nodes.measured_speed.output_fit import (
    FitBefore,
    OutputFit,
    fit_outputs_again,
    is_same_end,
)
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.context_nodes.rotor.history_unknowns import CurrentSensor
from gray_box_observer.context_nodes.rotor.logarithms import RIVAL, LogPrior
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import with_rivals
from gray_box_observer.white_box.motor import MotorWhiteBox

SHARES = (0.7, 0.3)
"""Shares of what L/R is without a filter that are the winding's where a search begins."""

DELAYS = (0.8, 1.0)
"""Delays of the voltage that a filter is compared with, as shares of its time constant."""


def fit_lagging(
    white_box: MotorWhiteBox, window: Window, prior: LogPrior, plain: OutputFit
) -> Pieces[OutputFit | None]:
    """Fit with a current that passes a filter; None where that is not told.

    Of the two time constants, L/R and the filter's, either may be the longer one: the search begins
    with both orders. In the wrong one the speed may come before the current still, and it is none
    then. The filter may be analogue, or a moving average of the samples. The likeliest end counts,
    and others that are nearly as likely widen it.

    Args:
        white_box: of one motor with a rotor.
        window: samples with speed.
        prior: decides what the samples leave open.
        plain: the fit without a filter, or with the wrong one.
    """
    place = white_box.context_nodes.index('inductance')
    winding_s = plain.fit.runs.winding_s
    lag_s = plain.current_lag_s
    sum_s = winding_s + lag_s
    starts = []
    for share in (winding_s / sum_s, lag_s / sum_s) if lag_s else SHARES:
        theta = plain.fit.theta.copy()
        theta[place] *= share * sum_s / winding_s
        starts.append(theta)
    ends: list[OutputFit] = []
    for is_digital in (False, True):
        sensor = CurrentSensor(sum_s, is_digital=is_digital)
        own_ends: list[OutputFit] = []
        for theta in starts:
            before = FitBefore(theta, 0.0, plain.noise.unit_a_s, False, sensor)
            end = yield from fit_outputs_again(white_box, window, prior, before)
            if end is not None and not any(is_same_end(one.fit, end.fit) for one in own_ends):
                own_ends.append(end)
        ends += own_ends
        starts = [end.fit.theta for end in own_ends]
    ends = [end for end in ends if end.explains and not end.speed_leads]
    if not ends:
        return None
    best = min(ends, key=lambda end: end.cost)
    if not best.shows_lag:
        return None
    ends.remove(best)
    for share in DELAYS:
        late_window = window.delayed(share * best.current_lag_s)
        before = FitBefore(best.fit.theta, 0.0, best.noise.unit_a_s, False)
        late = yield from fit_outputs_again(white_box, late_window, prior, before)
        if late is None or not late.explains:
            continue
        if not late.speed_leads or late.cost < best.cost:  # the voltage is late, or the current
            return None
        ends.append(late)
    worse = [end.cost - best.cost for end in ends]
    own_sensor = best.window.unknowns.current_sensor
    is_sure = all(
        difference > RIVAL
        for end, difference in zip(ends, worse, strict=True)
        if _is_other_kind(end, best)
    )
    assert own_sensor is not None
    unknowns = replace(best.window.unknowns, current_sensor=replace(own_sensor, is_sure=is_sure))
    fit = with_rivals(best.fit, [end.fit for end in ends], worse, prior)
    return replace(best, fit=fit, window=replace(best.window, unknowns=unknowns))


def _is_other_kind(end: OutputFit, best: OutputFit) -> bool:
    """Tell whether two fits differ in what delays the current."""
    own = best.window.unknowns.current_sensor
    other = end.window.unknowns.current_sensor
    return own is None or other is None or own.is_digital != other.is_digital
