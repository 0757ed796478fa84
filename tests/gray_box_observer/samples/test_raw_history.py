from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.samples import RawHistory
from gray_box_observer.samples.raw_history import SLACK, TORQUES, VOLTAGES, RawSignals

MS = 1_000_000


def history(count: int, period_ms: int = 10) -> RawHistory:
    made = RawHistory()
    for k in range(count):
        made.voltage(k * period_ms * MS, float(k))
        made.torque(k * period_ms * MS, 0.1 * k)
    return made


def test_only_what_is_certain_to_have_come_is_read_out() -> None:
    signals = history(50).signals(200 * MS, 30 * MS)
    assert signals is not None
    np.testing.assert_allclose(signals.time_s, np.arange(-0.2, 0.001, 0.01), atol=1e-12)
    assert signals.voltage_time_s[-1] == pytest.approx(-0.03)
    np.testing.assert_allclose(signals.torque_nm[-1], 2.0)


def test_too_little_is_no_signal() -> None:
    assert history(1).signals(0, 0) is None
    assert history(9).signals(-1, 0) is None
    assert history(9).signals(80 * MS, 200 * MS) is None  # no voltage is known by then


def test_where_the_signals_begin_does_not_depend_on_what_has_come_beyond_their_end() -> None:
    early = history(TORQUES + 50)
    late = history(TORQUES + 50 + SLACK // 2)
    until = (TORQUES + 40) * 10 * MS
    first = early.signals(until, 0)
    second = late.signals(until, 0)
    assert first is not None
    assert second is not None
    assert first.time_s.size == TORQUES
    for name in RawSignals.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_memory_is_bounded() -> None:
    assert len(history(VOLTAGES + 5000, 1)) == VOLTAGES + TORQUES + 2 * SLACK


def test_what_is_remembered_is_what_came_to_the_last_bit_however_much_was_forgotten() -> None:
    values = np.random.default_rng(3).standard_normal((3 * (TORQUES + SLACK) + 77, 2))
    made = RawHistory()
    for k, (torque, speed) in enumerate(values.tolist()):
        made.torque(k * MS, torque, speed)
        assert len(made) == min(k + 1, TORQUES + SLACK)
    made.voltage(0, 1.0)
    signals = made.signals((len(values) - 1) * MS, 0)
    assert signals is not None
    np.testing.assert_array_equal(signals.torque_nm, values[-TORQUES:, 0])
    np.testing.assert_array_equal(signals.speed_rad_s, values[-TORQUES:, 1])
    events = [
        (stamp // MS, *given) for signal, stamp, given in made.events(0) if signal == 'torque'
    ]
    first = len(values) - TORQUES - SLACK
    assert events == [(first + k, *row) for k, row in enumerate(values[first:].tolist())]


def test_the_integral_of_the_voltage_is_that_of_its_steps() -> None:
    times = np.array([-1.0, -0.7, -0.2])
    volts = np.array([2.0, 5.0, -1.0])
    blank = np.zeros(1)
    signals = RawSignals(blank, blank, blank, times, volts)
    at = np.array([-1.1, -1.0, -0.85, -0.7, -0.4, -0.2, 0.0])
    fine = np.linspace(-1.5, 0.0, 150_001)
    held = volts[np.maximum(np.searchsorted(times, fine, side='right') - 1, 0)]
    total = np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(fine))])
    expected = np.interp(at, fine, total)
    found = signals.voltage_integral(at)
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=1e-4)


def test_events_come_in_the_order_of_their_stamps_as_the_delay_has_it() -> None:
    made = history(5)
    made.speed(15 * MS, 3.0)
    order = [(signal, stamp // MS) for signal, stamp, _ in made.events(-25 * MS)]
    assert order[:4] == [('voltage', 0), ('voltage', 10), ('voltage', 20), ('torque', 0)]
    assert order.index(('speed', 15)) == order.index(('torque', 10)) + 2


def test_speed_of_its_own_is_read_at_the_torques() -> None:
    made = history(20)
    for k in range(10):
        made.speed((5 + 20 * k) * MS, float(k))
    signals = made.signals(100 * MS, 0)
    assert signals is not None
    assert signals.speed_rad_s[-1] == pytest.approx(4.0)  # the speed at 105 ms is not known yet
    assert signals.speed_rad_s[5] == pytest.approx(2.25)


def test_what_is_remembered_is_the_newest_however_much_has_come() -> None:
    for count in (TORQUES, TORQUES + SLACK, 2 * (TORQUES + SLACK) + 7, 5 * TORQUES + 3):
        made = history(count)
        torques = [
            (stamp, values) for signal, stamp, values in made.events(0) if signal == 'torque'
        ]
        expected = range(max(0, count - TORQUES - SLACK), count)
        assert [stamp for stamp, _ in torques] == [k * 10 * MS for k in expected]
        assert [values[0] for _, values in torques] == [0.1 * k for k in expected]
        signals = made.signals((count - 3) * 10 * MS, 0)
        assert signals is not None
        assert signals.torque_nm[-1] == 0.1 * (count - 3)
        assert signals.torque_nm.size == min(TORQUES, count - 2)


def test_what_was_read_out_stays_when_more_comes() -> None:
    made = history(50)
    signals = made.signals(200 * MS, 0)
    assert signals is not None
    before = signals.torque_nm.copy()
    for k in range(50, 4 * TORQUES):
        made.torque(k * 10 * MS, -1.0)
    np.testing.assert_array_equal(signals.torque_nm, before)


def test_a_group_tells_the_signals_of_each_motor_and_none_of_its_own() -> None:
    group = RawHistory(2)
    for k in range(5):
        group.voltage(k * MS, np.array([1.0, 2.0]))
        group.torque(k * MS, np.array([0.1, np.nan if k == 3 else 0.2]))
    signals = group.select_motor(1).signals(4 * MS, 0)
    assert signals is not None
    assert signals.torque_nm.tolist() == [0.2] * 4
    assert signals.voltage_v.tolist() == [2.0] * 5
    with pytest.raises(GrayBoxError, match=r'select_motor\(motor\)'):
        group.signals(4 * MS, 0)


def test_of_each_motor_of_a_group_just_what_it_has_is_remembered_and_goes_on() -> None:
    group = RawHistory(3)
    alone = RawHistory()
    random = np.random.default_rng(0)
    forgotten = 100
    for k in range(TORQUES + SLACK + forgotten):
        volts, torques, speeds = np.where(
            random.uniform(size=(3, 3)) < 0.1, np.nan, random.standard_normal((3, 3))
        )
        group.voltage(k * MS, volts)
        group.torque(k * MS, torques, speeds)
        if np.isfinite(volts[1]):
            alone.voltage(k * MS, volts[1])
        if np.isfinite(torques[1]) and k >= forgotten:
            alone.torque(k * MS, torques[1], speeds[1])
    one = group.select_motor(1)
    for history_of_one in (one, alone):
        history_of_one.torque(10**6 * MS, 1.0)
    found, expected = (
        [repr(event) for event in which.events(0)] for which in (one, alone)
    )  # a NaN is equal to none
    assert found == expected
    assert len(one) > TORQUES + SLACK
    assert len(RawHistory(3).select_motor(2)) == 0
    with pytest.raises(GrayBoxError, match=r'expected \.signals'):
        alone.select_motor(0)
