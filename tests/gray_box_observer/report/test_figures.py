"""Figures hold the numbers of the history, and ranges that show where the run ended."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from gray_box_observer.report import MotorHistory, ParameterHistory
from gray_box_observer.report.run.history import FitHistory
from gray_box_observer.report.run.parameter_figure import parameter_figure, rate_of_change
from gray_box_observer.report.run.rejection_figure import rejection_figure
from gray_box_observer.report.run.residual_figure import residual_figure
from gray_box_observer.report.run.signal_figure import signal_figure


def trace_of(figure, name):
    return next(trace for trace in figure.data if trace['name'] == name)


def test_the_rate_of_change_of_a_ramp_is_its_slope_whatever_the_sample_rate():
    times = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 30_000))
    at_s, rate = rate_of_change(times, 2.0 + 0.3 * times)
    assert rate == pytest.approx(0.3)
    assert 900 <= len(rate) <= 1_000
    assert np.all(np.diff(at_s) > 0.0)


@pytest.mark.parametrize('times', [[], [1.0], [1.0, 1.0]])
def test_no_rate_comes_of_less_than_two_instants(times):
    times = np.array(times)
    assert len(rate_of_change(times, times)[1]) == 0


def test_the_settled_range_shows_the_end_and_the_truth_but_not_the_wild_start(make_motor):
    parameter = make_motor().parameters[0]
    figure = parameter_figure(parameter, (0.0, 60.0))
    low, high = figure.layout['yaxis']['range']
    assert low < 500.0 < high
    assert low < parameter.value[-1] * 1e3 < high
    assert high < 0.5 * parameter.value[0] * 1e3


def test_a_truth_that_steps_is_drawn_to_the_end_of_the_run(make_motor):
    truth = trace_of(parameter_figure(make_motor().parameters[1], (0.0, 61.0)), 'truth')
    assert truth['x'] == [0.0, 30.0, 61.0]
    assert truth['y'] == [1.0, 1.08, 1.08]
    assert truth['line']['shape'] == 'hv'


def test_the_band_lies_one_deviation_about_the_estimate_and_is_absent_where_none_is_known():
    values = np.array([2.0, 2.0, 2.0])
    history = ParameterHistory(
        'r', 'ohm', np.arange(3.0), values, np.array([0.5, np.nan, 0.1]), ['converging'] * 3
    )
    figure = parameter_figure(history, (0.0, 2.0))
    assert trace_of(figure, 'lower edge')['y'] == [1.5, 2.0, 1.9]
    assert figure.data[1]['y'] == [2.5, 2.0, 2.1]


def test_the_strip_shows_each_verdict_for_as_long_as_it_held(make_motor):
    strip = trace_of(parameter_figure(make_motor().parameters[0], (0.0, 60.0)), 'verdict')
    assert strip['marker']['color'] == ['@unexcited', '@converging', '@identified']
    assert sum(strip['x']) == pytest.approx(60.0)


def test_a_parameter_that_goes_below_zero_has_no_log_view(make_motor):
    parameter = make_motor().parameters[0]
    views = parameter_figure(parameter, (0.0, 60.0)).views[0]
    assert [view['label'] for view in views] == ['Settled', 'Full', 'Log']
    below = dataclasses.replace(parameter, value=parameter.value - 1.0)
    assert [view['label'] for view in parameter_figure(below, (0.0, 60.0)).views[0]] == [
        'Settled',
        'Full',
    ]


def test_signals_of_a_run_without_predictions_leave_out_the_error_row_and_say_so(make_motor):
    motor = make_motor()
    none = np.full(len(motor.time_s), np.nan)
    figure = signal_figure(
        dataclasses.replace(motor, predicted_torque_nm=none, white_box_torque_nm=none)
    )
    assert [trace['name'] for trace in figure.data] == ['voltage', 'measured']
    assert 'No predicted torque' in figure.caption
    assert 'yaxis3' not in figure.layout


def test_measured_speed_gets_a_row_of_its_own(make_motor):
    motor = make_motor()
    figure = signal_figure(dataclasses.replace(motor, speed_rad_s=motor.torque_nm))
    assert trace_of(figure, 'speed')['yaxis'] == 'y4'
    assert figure.layout['xaxis']['anchor'] == 'y4'


def test_a_series_that_was_thinned_says_how_far(make_motor):
    assert 'Thinned' not in signal_figure(make_motor()).caption
    long = make_motor(samples=25_000)
    figure = signal_figure(long)
    assert 'Thinned' in figure.caption
    assert '25,000' in figure.caption
    drawn = trace_of(figure, 'measured')['y']
    assert len(drawn) < 10_000
    assert max(drawn) == pytest.approx(long.torque_nm.max() * 1e3, rel=1e-6)


def test_rejected_samples_have_a_bar_by_reason_and_a_mark_for_each_time(make_motor):
    figure = rejection_figure(make_motor())
    bars, marks = figure.data
    assert dict(zip(bars['y'], bars['x'], strict=True)) == {
        'non finite': 3,
        'out of order': 14,
        'outlier': 41,
    }
    assert len(marks['x']) == 58
    assert (
        rejection_figure(
            dataclasses.replace(make_motor(), rejection_counts={'late': 0}, rejected_time_s={})
        )
        is None
    )


def test_rejected_samples_without_a_time_are_told(make_motor):
    figure = rejection_figure(
        dataclasses.replace(make_motor(), rejection_counts={'late': 7}, rejected_time_s={})
    )
    assert figure.data[0]['x'] == [7]
    assert '7 rejected samples have no time' in figure.caption


def test_the_residual_figure_draws_every_lag_and_the_band_and_says_how_many_lie_outside() -> None:
    assert residual_figure(FitHistory()) is None
    drawn = residual_figure(FitHistory('ok', 'fine', 99.0, np.array([0.5, 0.01, -0.02]), 0.04))
    assert drawn is not None
    low, high, bars = drawn.data
    assert (low['y'], high['y'], bars['y']) == ([-0.04, -0.04], [0.04, 0.04], [0.5, 0.01, -0.02])
    assert drawn.caption.startswith('1 of 3 lags lie outside the band.')


def test_free_run_current_and_changes_are_drawn_with_the_signals(
    make_motor: Callable[..., MotorHistory],
) -> None:
    motor = make_motor()
    motor = dataclasses.replace(
        motor,
        free_run_torque_nm=motor.torque_nm,
        current_a=100.0 * motor.torque_nm,
        changes_s=(30.0,),
    )
    drawn = signal_figure(motor)
    names = [trace['name'] for trace in drawn.data]
    assert {'free run', 'current'} <= set(names)
    assert [shape['x0'] for shape in drawn.layout['shapes']] == [30.0]
    bare = dataclasses.replace(
        motor,
        predicted_torque_nm=np.full_like(motor.torque_nm, np.nan),
        white_box_torque_nm=np.full_like(motor.torque_nm, np.nan),
    )
    assert 'free run' in [trace['name'] for trace in signal_figure(bare).data]
