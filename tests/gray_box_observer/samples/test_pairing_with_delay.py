"""Voltage that acts later than it is stamped; what is remembered, paired anew."""

from __future__ import annotations

import pytest

from gray_box_observer.samples import Pairing, Rejection

from .pairing_events import MS, Event, content, feed, steady


@pytest.mark.parametrize('delay_ms', [53, 7, -20, -400])
@pytest.mark.parametrize('torque_late', [0, 1, -1])
def test_a_declared_delay_gives_the_samples_of_a_recording_without_one(
    delay_ms: int, torque_late: int
) -> None:
    voltages, torques = steady(120)
    clean = Pairing()
    shifted = Pairing(delay_s=delay_ms / 1000)
    expected = (
        feed(clean, sorted(voltages + torques, key=lambda e: (e[1], e[0] == 't'))) + clean.flush()
    )
    early: list[Event] = [('v', at - delay_ms, value) for _, at, value in voltages]
    order = sorted(
        early + torques, key=lambda e: (e[1] + 10 * torque_late * (e[0] == 't'), e[0] == 't')
    )
    assert content(feed(shifted, order) + shifted.flush()) == content(expected)
    assert shifted.rejected == clean.rejected


def test_with_a_delay_the_torque_at_a_voltage_stamp_is_foreseen_from_earlier_voltages() -> None:
    pairing = Pairing(delay_s=0.02)
    feed(pairing, [(kind, 10 * k, float(k)) for k in range(6) for kind in 'vt'])
    feed(pairing, [('v', 60, 6.0)])
    assert pairing.ahead(60 * MS) == (0.01, 3.0)
    assert content(feed(pairing, [('t', 60, 0.0)])) == [(60 * MS, 0.01, 3.0, 0.0)]


@pytest.mark.parametrize('delay_ms', [23, -15, 0])
def test_pairing_anew_makes_the_samples_that_the_delay_would_have_made_from_the_start(
    delay_ms: int,
) -> None:
    voltages, torques = steady(80)
    events = [e for pair in zip(voltages, torques, strict=True) for e in pair]
    fresh = Pairing(delay_s=delay_ms / 1000)
    changed = Pairing(delay_s=0.005)
    expected = feed(fresh, events) + fresh.flush()
    before = feed(changed, events[:100])
    known, rest = changed.redelay(delay_ms / 1000, before[-1].stamp_ns)
    after = feed(changed, events[100:]) + changed.flush()
    assert content(known + rest + after) == content(expected)
    assert known[-1].stamp_ns <= before[-1].stamp_ns
    new = [sample for sample in rest + after if not changed.repeats(sample)]
    assert [s.stamp_ns for s in before + new] == [
        at * MS for _, at, _ in torques if at * MS >= before[0].stamp_ns
    ]
    assert (
        changed.received_torque
        == changed.used_count + changed.rejected.total() + changed.waiting_count
    )
    assert changed.received_voltage == 80


def test_a_clock_that_is_set_back_ends_what_can_be_paired_anew() -> None:
    pairing = Pairing()
    voltages, torques = steady(300)
    events = [e for pair in zip(voltages, torques, strict=True) for e in pair]
    feed(pairing, [(kind, at + 5000, value) for kind, at, value in events])
    feed(pairing, events[:40])
    known, rest = pairing.redelay(0.01, 190 * MS)
    assert [s.stamp_ns // MS for s in known + rest] == list(range(10, 200, 10))
    assert pairing.restarts == 1


def test_pairing_anew_makes_no_habit_of_what_came_once() -> None:
    """A voltage regular for 900 samples is not less so for having been gone through twice."""
    voltages, torques = steady(900)
    later: list[Event] = [('t', at, 0.1) for at in range(9000, 12_000, 10)]
    fresh = Pairing(delay_s=0.02)
    changed = Pairing()
    events = [e for pair in zip(voltages, torques, strict=True) for e in pair]
    expected = feed(fresh, events + later) + fresh.flush()
    before = feed(changed, events)
    known, rest = changed.redelay(0.02, before[-1].stamp_ns)
    assert content(known + rest + feed(changed, later) + changed.flush()) == content(expected)
    assert changed.rejected == {}
    assert fresh.rejected == {Rejection.NO_VOLTAGE: 2}
