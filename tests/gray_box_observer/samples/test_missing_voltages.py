"""A voltage that is missing: held on, overdue, or lost at a step."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from gray_box_observer.samples import Pairing, Rejection
from gray_box_observer.samples.pairing import MOST_PATIENT, PairingSettings

from .pairing_events import MS, Event, content, feed, steady


@pytest.mark.parametrize('back_ms', [0, 60, 400])
@pytest.mark.parametrize('hole_ms', [300, 450, 2000])
def test_what_the_voltage_did_while_both_were_silent_is_not_made_up(
    hole_ms: int, back_ms: int
) -> None:
    """Both come every 10 ms but for a hole until 3 s; voltage returns after torque."""
    voltages, torques = steady(400)
    expected = {
        s.stamp_ns: content([s])
        for s in feed(Pairing(), sorted(voltages + torques, key=lambda e: e[1]))
    }
    kept = [e for e in torques if not 3000 - hole_ms <= e[1] < 3000]
    kept += [e for e in voltages if not 3000 - hole_ms <= e[1] < 3000 + back_ms]
    pairing = Pairing()
    samples = feed(pairing, sorted(kept, key=lambda e: e[1])) + pairing.flush()
    begins = [s for s in samples if s.interval_s[0] == 0.0]
    assert [s.stamp_ns for s in begins] == [0, (3000 + back_ms) * MS]
    assert all(
        content([s]) == expected[s.stamp_ns]
        for s in samples
        if s not in begins and s.stamp_ns in expected
    )
    assert pairing.rejected == ({Rejection.NO_VOLTAGE: back_ms // 10} if back_ms else {})
    assert pairing.received_torque == pairing.used_count + pairing.rejected.total()


def test_a_voltage_that_comes_when_it_changes_is_in_force_until_it_does() -> None:
    volts: list[Event] = [('v', at, 1.0 + at % 3) for at in (*range(0, 100), 1500)]
    pairing = Pairing()
    events = sorted(
        [*volts, *(('t', at, 0.1) for at in range(0, 2000, 10))], key=lambda event: event[1]
    )
    samples = feed(pairing, events) + pairing.flush()
    assert len(samples) == 200
    assert pairing.rejected == {}
    assert [float(s.interval_s[0]) for s in samples[1:]] == [0.01] * 199


def test_there_is_no_newest_voltage_while_nobody_knows_what_it_does() -> None:
    voltages, torques = steady(100)
    pairing = Pairing()
    feed(pairing, sorted(voltages + torques, key=lambda e: e[1]))
    assert pairing.newest_voltage == (990 * MS, 1.0 + 99 % 7)
    feed(pairing, [('t', 3000, 1.0), ('t', 3300, 1.0)])
    assert pairing.rejected == {Rejection.NO_VOLTAGE: 1}
    assert pairing.newest_voltage is None
    feed(pairing, [('v', 3310, 2.0)])
    assert pairing.newest_voltage == (3310 * MS, 2.0)


@pytest.mark.parametrize(('delivered_late', 'outage_ms'), [(False, 1000), (True, 7000)])
def test_a_regular_voltage_that_is_overdue_is_not_taken_for_unchanged(
    delivered_late: bool, outage_ms: int
) -> None:
    """Torque goes on in an outage of the voltage, or comes long before it when both arrive late."""
    voltages, torques = steady(2100)
    end_ms = 12_000 + outage_ms
    out = [e for e in voltages if 12_000 <= e[1] < end_ms]
    comes = {e: float(end_ms if e in out else e[1]) for e in voltages + torques}
    events = sorted(
        [e for e in comes if delivered_late or e not in out], key=lambda e: (comes[e], e[1])
    )
    pairing = Pairing()
    samples = feed(pairing, events) + pairing.flush()
    expected = in_time(voltages + torques)
    learnt = [s for s in samples[1:] if s.interval_s[0] > 0.0 and s.stamp_ns <= 20_980 * MS]
    wrong = [s.stamp_ns // MS for s in learnt if content([s]) != expected[s.stamp_ns]]
    assert all(12_000 < at <= 12_200 for at in wrong), 'what is not yet overdue is taken to hold on'
    assert len([s for s in samples if s.interval_s[0] == 0.0]) == 2
    assert pairing.rejected[Rejection.NO_VOLTAGE] > 50
    assert pairing.received_torque == pairing.used_count + pairing.refusal_counts['torque'].total()


@pytest.mark.parametrize('first', ['t', 'v'])
@pytest.mark.parametrize('stall_ms', [400, 1400, 4900])
def test_a_reader_that_was_busy_uses_every_sample_whichever_topic_it_reads_first(
    stall_ms: int, first: str
) -> None:
    """Nothing is lost in a stall, but then one topic is read to its end before the other."""
    voltages, torques = steady(2000)
    pairing = Pairing()
    samples = feed(pairing, stalled(voltages + torques, 12_000, stall_ms, first)) + pairing.flush()
    assert [(s.stamp_ns, content([s])) for s in samples] == [*in_time(voltages + torques).items()]
    assert pairing.used_count == 2000
    assert pairing.rejected == {}


def test_what_a_reader_that_was_busy_has_paired_can_be_paired_anew() -> None:
    """At 1 kHz, torque first: raw signals and samples are those of messages in order."""
    events: list[Event] = [
        (signal, at, 1.0 + at % 7) for at in range(6000) for signal in ('v', 't')
    ]
    ordered = Pairing()
    busy = Pairing()
    feed(ordered, events)
    feed(busy, stalled(events, 4500, 1000, 't'))
    until_ns = 5900 * MS
    expected, found = (one.history.signals(until_ns, 0) for one in (ordered, busy))
    assert expected is not None
    assert found is not None
    np.testing.assert_array_equal(found.time_s, expected.time_s)
    np.testing.assert_array_equal(found.voltage_v, expected.voltage_v)
    again = [one.redelay(0.002, until_ns)[0] for one in (ordered, busy)]
    assert content(again[0]) == content(again[1])
    assert busy.used_count == ordered.used_count
    assert busy.waiting_count == ordered.waiting_count


def test_torque_waits_in_vain_but_once_for_a_voltage_that_has_ended() -> None:
    """It waits 5 s or for 1024 torques; from then on it is no later than it would have been."""
    for step_ms, most in ((10, 501), (1, MOST_PATIENT + 1)):
        pairing = Pairing()
        feed(pairing, [(s, k * step_ms, 1.0) for k in range(1100) for s in ('v', 't')])
        waiting = []
        for k in range(1100, 3000):
            feed(pairing, [('t', k * step_ms, 1.0)])
            waiting.append(pairing.waiting_count)
        assert most - 3 <= max(waiting) <= most
        assert max(waiting[max(most, 1100) :]) <= 250 // step_ms + 1
        assert pairing.rejected[Rejection.NO_VOLTAGE] > 500
        feed(pairing, [(s, k * step_ms, 2.0) for k in range(3000, 4100) for s in ('v', 't')])
        feed(pairing, [('t', k * step_ms, 1.0) for k in range(4100, 4100 + 300 // step_ms)])
        assert pairing.waiting_count > 300 // step_ms - 3, 'it has long come again'


def test_a_speed_that_has_ended_is_not_waited_for_like_a_voltage() -> None:
    pairing = Pairing(own_speed=True)
    for k in range(1500):
        feed(pairing, [('v', 10 * k, 1.0)])
        if k < 1200:
            pairing.speed(10 * k * MS, 1.0)
        feed(pairing, [('t', 10 * k, 1.0)])
        assert pairing.waiting_count <= 26


def stalled(events: list[Event], begin_ms: int, stall_ms: int, first: str) -> list[Event]:
    """Return events as a reader takes them that is busy for a while, then reads one topic first."""
    end_ms = begin_ms + stall_ms
    return sorted(
        events,
        key=lambda e: (end_ms - 1, e[0] != first, e[1]) if begin_ms <= e[1] < end_ms else (e[1],),
    )


def in_time(events: list[Event]) -> dict[int, object]:
    """Return the samples of events that come in the order of their stamps, by stamp in ns."""
    pairing = Pairing()
    samples = feed(pairing, sorted(events, key=lambda e: e[1])) + pairing.flush()
    return {s.stamp_ns: content([s]) for s in samples}


@pytest.mark.parametrize('ahead_ms', [0, 900])
@pytest.mark.parametrize('count', [20, 1000, 1021])
def test_a_voltage_that_drops_out_makes_no_sample_of_a_voltage_that_nobody_knows(
    count: int, ahead_ms: int
) -> None:
    """Torque goes on; voltage, in time or early, misses 1 to 129 samples after regular ones."""
    voltages, torques = steady(count + 200)
    for missing in (1, 18, 30, 46, 64, 129):
        back_ms = 10 * (count + missing)
        kept = [e for e in voltages if not 10 * count <= e[1] < back_ms]
        pairing = Pairing()
        events = sorted(
            kept + torques, key=lambda e: (e[1] - ahead_ms * (e[0] == 'v'), e[0] == 't')
        )
        samples = feed(pairing, events) + pairing.flush()
        assert all(math.isfinite(value) for sample in content(samples) for value in sample)
        used_ns = {s.stamp_ns for s in samples}
        refused = [at for _, at, _ in torques if at * MS not in used_ns]
        overdue_ms = 10 * (count - 1) + 195  # by its habit of 10 ms, followed to 2 %
        unknown = [at for _, at, _ in torques if overdue_ms < at < back_ms]
        assert refused in ((unknown, unknown[1:]) if count >= 1021 else ([],))
        assert pairing.rejected == ({Rejection.NO_VOLTAGE: len(refused)} if refused else {})
        assert pairing.received_torque == pairing.used_count + pairing.rejected.total()
        begins = [s.stamp_ns // MS for s in samples if s.interval_s[0] == 0.0]
        assert begins == ([0, back_ms] if refused else [0])


def test_a_voltage_that_comes_late_and_old_after_an_outage_leads_to_no_sample_across_it() -> None:
    """Torque has given the voltage up; what comes then is stamped where nothing was missing yet."""
    voltages, torques = steady(1500)
    pairing = Pairing(PairingSettings(gap_s=5.0))
    samples = feed(pairing, sorted(voltages + torques, key=lambda e: (e[1], e[0] == 't')))
    samples += feed(pairing, [('t', at, 0.1) for at in range(15_000, 15_500, 10)])
    samples += (
        feed(pairing, [('v', 15_180, 3.0), ('v', 15_300, 4.0), ('t', 15_500, 0.1)])
        + pairing.flush()
    )
    assert all(math.isfinite(value) for sample in content(samples) for value in sample)
    assert pairing.received_torque == pairing.used_count + pairing.rejected.total()


@pytest.mark.parametrize('every', [1, 3])
def test_of_a_group_no_motor_makes_a_sample_of_a_voltage_that_nobody_knows(every: int) -> None:
    """One motor's voltage is overdue while messages go on; torque as often, or three times."""
    pairing = Pairing(PairingSettings(hold_s=0.0), motors=3)
    samples = []
    for k in range(1250 * every):
        if k % every == 0:
            voltage_v = np.array([math.nan if k >= 1050 * every else 1.0, 2.0, 3.0])
            samples += pairing.voltage(10 * k * MS, voltage_v)
        samples += pairing.torque(10 * k * MS, np.full(3, 0.1))
        ahead = pairing.ahead(10 * (k + 1) * MS)
        assert ahead is None or np.all(np.isfinite(ahead[1]) | (ahead[0] == 0.0))
    for sample in samples + pairing.flush():
        present = np.ones(3, dtype=bool) if sample.present is None else sample.present
        for values in (sample.interval_s, sample.voltage_v, sample.torque_nm):
            assert np.all(np.isfinite(values[present]))
    for motor in range(3):
        counts = pairing.counts_for(motor)
        assert (
            counts.received_torque
            == counts.used_count + counts.refusal_counts['torque'].total() + counts.waiting_count
        )
    assert pairing.counts_for(0).refusal_counts['torque'][Rejection.NO_VOLTAGE] > 100
    assert pairing.counts_for(1).rejected == {}


def test_what_was_refused_with_its_torque_is_seen_by_nobody() -> None:
    pairing = Pairing(motors=2)
    pairing.voltage(0, np.ones(2))
    (sample,) = pairing.torque(0, np.full(2, 0.1), np.array([1e12, 3.0]))
    assert sample.present is not None
    assert sample.present.tolist() == [False, True]
    assert np.isnan(sample.speed_rad_s[0])
    assert sample.speed_rad_s[1] == 3.0


def test_a_lost_message_is_no_silence() -> None:
    voltages, torques = steady(200)
    kept = [e for k, e in enumerate(voltages) if k % 3] + [
        e for k, e in enumerate(torques) if not 80 < k < 95
    ]
    samples = feed(pairing := Pairing(), sorted(kept, key=lambda event: event[1])) + pairing.flush()
    assert max(float(s.interval_s[0]) for s in samples) == 0.15


def _stepped(lost: Iterable[int], base_v: float = 0.0) -> list[tuple[int, Event]]:
    """Voltages every 10 ms with steps at 200 and 300, without those that were lost, and torques."""
    levels_v = base_v + np.repeat([1.0, 8.0, 2.0], [200, 100, 100])
    voltages = [(k, ('v', 10 * k, float(v))) for k, v in enumerate(levels_v) if k not in lost]
    torques: list[tuple[int, Event]] = [(k, ('t', 10 * k, 0.1)) for k in range(levels_v.size)]
    return sorted(voltages + torques)


def test_a_voltage_that_was_lost_at_a_step_is_not_known_and_one_between_steps_is() -> None:
    lost = {100, 200, 250, 299, 300}
    samples = feed(Pairing(), [event for _, event in _stepped(lost)])
    assert len(samples) == 400
    begins = [round(s.stamp_ns / MS) // 10 for s in samples if s.interval_s[0] == 0.0]
    assert begins == [0, 201, 300, 301]  # the second step came in one of two lost samples
    before, after = samples[200], samples[202]
    assert (float(before.voltage_v[0]), float(after.voltage_v[0])) == (1.0, 8.0)


def test_of_a_voltage_that_moves_all_the_time_a_lost_sample_is_held_over() -> None:
    voltages, torques = steady(400)
    lost = [event for k, event in enumerate(voltages) if k not in (150, 230, 310)]
    samples = feed(Pairing(), sorted(lost + torques, key=lambda event: (event[1], event[0])))
    assert sum(s.interval_s[0] == 0.0 for s in samples) == 1


def test_a_voltage_that_comes_when_it_changes_has_lost_nothing() -> None:
    rng = np.random.default_rng(3)
    at_ms = np.cumsum(rng.exponential(50.0, 300)) // 1 + np.arange(300)
    volts = np.where(rng.random(300) < 0.1, 10.0, 1.0) + 0.01 * rng.random(300)
    voltages: list[Event] = [('v', int(t), float(v)) for t, v in zip(at_ms, volts, strict=True)]
    torques: list[Event] = [('t', k, 0.1) for k in range(int(at_ms[0]), int(at_ms[-1]))]
    samples = feed(Pairing(), sorted(voltages + torques, key=lambda event: event[1]))
    assert sum(s.interval_s[0] == 0.0 for s in samples) < 0.01 * len(samples)


def test_of_a_group_only_the_motor_whose_voltage_moved_begins_anew() -> None:
    pairing = Pairing(motors=2)
    samples = []
    for k in range(300):
        if k != 200:
            voltage_v = np.array([1.0 if k < 200 else 8.0, 3.0])
            samples += pairing.voltage(10 * k * MS, voltage_v)
        samples += pairing.torque(10 * k * MS, np.array([0.1, 0.2]))
    begins = np.array([sample.interval_s == 0.0 for sample in samples])
    assert begins[1:].sum(axis=0).tolist() == [1, 0]


def test_of_a_motor_of_a_group_that_some_messages_do_not_tell_the_same_holds() -> None:
    pairing = Pairing(motors=2)
    samples = []
    for k in range(300):
        absent = np.array([k in (100, 200), False])
        voltage_v = np.array([1.0 if k < 200 else 8.0, 1.0 if k < 200 else 8.0])
        voltage_v = np.where(absent, np.nan, voltage_v)
        samples += pairing.voltage(10 * k * MS, voltage_v, absent if absent.any() else None)
        samples += pairing.torque(10 * k * MS, np.array([0.1, 0.2]))
    begins = np.array([sample.interval_s == 0.0 for sample in samples])
    assert begins[1:].sum(axis=0).tolist() == [1, 0]
    assert begins[201, 0]


@pytest.mark.parametrize(('lost', 'is_foreseen'), [(200, False), (150, True)])
def test_nothing_is_foreseen_over_a_voltage_that_was_lost_at_a_step(
    lost: int, is_foreseen: bool
) -> None:
    pairing = Pairing()
    feed(pairing, [event for k, event in _stepped({lost}) if k <= lost])
    next_ns = 10 * (lost + 1) * MS
    pairing.voltage(next_ns, 8.0 if lost == 200 else 1.0)
    assert (pairing.ahead(next_ns) is not None) == is_foreseen


def test_of_a_group_too_a_voltage_that_is_overdue_of_one_motor_is_not_taken_for_unchanged() -> None:
    group = Pairing(motors=2)
    alone = Pairing()
    told = []
    expected = []
    for k in range(1400):
        stamp_ns = 10 * k * MS
        volt = 1.0 + k % 7
        out = math.nan if 1200 <= k < 1300 else volt
        expected += alone.voltage(stamp_ns, out) + alone.torque(stamp_ns, 0.1)
        told += group.voltage(stamp_ns, np.array([out, volt])) + group.torque(
            stamp_ns, np.full(2, 0.1)
        )
        ahead = group.ahead(stamp_ns)
        assert ahead is None or not np.any(np.isnan(ahead[1]) & (ahead[0] > 0.0))
    expected += alone.flush()
    told += group.flush()
    mine = [s for s in told if s.present is None or s.present[0]]
    assert not any(np.isnan(s.voltage_v[0]) for s in mine)
    assert [s.stamp_ns // MS for s in mine if s.interval_s[0] == 0.0] == [0, 13_000]
    assert [s.stamp_ns // MS for s in expected if s.interval_s[0] == 0.0] == [0, 13_000]
    assert abs(len(mine) - len(expected)) <= 2
    assert group.counts_for(0).refusal_counts['torque'][Rejection.NO_VOLTAGE] > 70
    assert group.counts_for(1).rejected == {}
    assert group.counts_for(1).used_count == 1400
