from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest

from gray_box_observer.samples import Pairing, Rejection, Sample
from gray_box_observer.samples.pairing import PairingSettings

MS = 1_000_000
Event = tuple[str, int, float]


def feed(pairing: Pairing, events: Iterable[Event]) -> list[Sample]:
    samples: list[Sample] = []
    for kind, at_ms, value in events:
        samples += (pairing.voltage if kind == 'v' else pairing.torque)(round(at_ms * MS), value)
    return samples


def content(samples: list[Sample]) -> list[tuple[int, float, float, float]]:
    return [
        (s.stamp_ns, float(s.interval_s[0]), float(s.voltage_v[0]), float(s.torque_nm[0]))
        for s in samples
    ]


def steady(count: int, period_ms: int = 10) -> tuple[list[Event], list[Event]]:
    voltages: list[Event] = [('v', k * period_ms, 1.0 + k % 7) for k in range(count)]
    torques: list[Event] = [('t', k * period_ms, 0.1 * k) for k in range(count)]
    return voltages, torques


def test_a_voltage_sample_holds_until_the_next_one() -> None:
    samples = feed(
        Pairing(), [('v', 0, 5.0), ('t', 0, 0.1), ('v', 10, 7.0), ('t', 10, 0.2), ('v', 20, 9.0)]
    )
    samples += feed(Pairing(), [])
    assert content(samples)[1] == (10 * MS, 0.01, 5.0, 0.2)


def test_the_first_sample_only_says_where_the_motor_stands() -> None:
    first = feed(Pairing(), [('v', 0, 5.0), ('t', 0, 0.1)])
    assert [s.interval_s[0] for s in first] == [0.0]


@pytest.mark.parametrize(
    'arrival', ['voltage first', 'torque first', 'voltage a step ahead', 'torque two steps ahead']
)
def test_the_order_of_arrival_does_not_change_the_samples(arrival: str) -> None:
    voltages, torques = steady(60)
    shift = {
        'voltage first': 0.0,
        'torque first': 0.1,
        'voltage a step ahead': -10.0,
        'torque two steps ahead': 20.0,
    }
    late = shift[arrival]
    events = sorted(
        [(at + late, 'v', at, value) for _, at, value in voltages]
        + [(at + 0.05, 't', at, value) for _, at, value in torques]
    )
    pairing = Pairing()
    samples = feed(pairing, [(kind, at, value) for _, kind, at, value in events]) + pairing.flush()
    reference = Pairing()
    expected = (
        feed(reference, [e for pair in zip(voltages, torques, strict=True) for e in pair])
        + reference.flush()
    )
    assert content(samples) == content(expected)
    assert len(samples) == 60


def test_torque_waits_for_a_voltage_that_is_stamped_at_or_after_it() -> None:
    pairing = Pairing()
    assert feed(pairing, [('v', 0, 5.0), ('t', 0, 0.0), ('t', 10, 0.1)])[1:] == []
    assert pairing.waiting_count == 1
    assert content(feed(pairing, [('v', 10, 6.0)])) == [(10 * MS, 0.01, 5.0, 0.1)]
    assert pairing.waiting_count == 0


def test_a_voltage_that_changes_inside_the_interval_counts_for_its_share_of_it() -> None:
    samples = feed(
        Pairing(),
        [
            ('v', 0, 2.0),
            ('t', 0, 0.0),
            ('v', 3, 8.0),
            ('v', 7, 4.0),
            ('v', 10, 1.0),
            ('t', 10, 1.0),
        ],
    )
    assert samples[1].voltage_v[0] == pytest.approx((3 * 2.0 + 4 * 8.0 + 3 * 4.0) / 10, rel=1e-14)


def test_a_voltage_stamped_before_the_first_torque_is_in_force_from_there() -> None:
    samples = feed(
        Pairing(), [('v', 0, 2.0), ('v', 4, 6.0), ('t', 5, 0.0), ('v', 10, 9.0), ('t', 10, 1.0)]
    )
    assert samples[1].voltage_v[0] == 6.0


def test_sparse_voltage_is_held_once_torque_has_run_ahead_by_the_patience() -> None:
    pairing = Pairing(PairingSettings(hold_s=0.05))
    samples = feed(pairing, [('v', 0, 3.0), *(('t', 10 * k, 0.1 * k) for k in range(10))])
    assert [s.stamp_ns // MS for s in samples] == [0, 10, 20, 30, 40]
    assert all(s.voltage_v[0] == 3.0 for s in samples[1:])
    assert pairing.waiting_count == 5
    late = feed(
        pairing, [('v', 55, 7.0)]
    )  # within patience: the change still lands where it belongs
    assert [s.stamp_ns // MS for s in late] == [50]
    assert feed(pairing, [('v', 60, 7.0)])[0].voltage_v[0] == pytest.approx(5.0)


def test_a_gap_never_becomes_a_derivative() -> None:
    pairing = Pairing(PairingSettings(gap_s=0.5))
    samples = feed(
        pairing,
        [
            ('v', 0, 5.0),
            ('t', 0, 0.0),
            ('v', 600, 5.0),
            ('t', 600, 9.0),
            ('v', 610, 5.0),
            ('t', 610, 9.1),
        ],
    )
    assert [float(s.interval_s[0]) for s in samples] == [0.0, 0.0, 0.01]
    assert pairing.rejected == {}


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


@pytest.mark.parametrize('delivered_late', [False, True])
def test_a_regular_voltage_that_is_overdue_is_not_taken_for_unchanged(delivered_late: bool) -> None:
    """Torque goes on in an outage of the voltage, or comes first when both arrive later."""
    voltages, torques = steady(1500)
    out = [e for e in voltages if 12_000 <= e[1] < 13_000]
    comes = {e: 13_000.0 if e in out else float(e[1]) for e in voltages + torques}
    events = sorted(
        [e for e in comes if delivered_late or e not in out], key=lambda e: (comes[e], e[1])
    )
    pairing = Pairing()
    samples = feed(pairing, events) + pairing.flush()
    expected = {
        s.stamp_ns: content([s])
        for s in feed(Pairing(), sorted(voltages + torques, key=lambda e: e[1]))
    }
    learnt = [s for s in samples[1:] if s.interval_s[0] > 0.0 and s.stamp_ns <= 14_980 * MS]
    wrong = [s.stamp_ns // MS for s in learnt if content([s]) != expected[s.stamp_ns]]
    assert all(12_000 < at <= 12_200 for at in wrong), 'what is not yet overdue is taken to hold on'
    assert len([s for s in samples if s.interval_s[0] == 0.0]) == 2
    assert pairing.rejected[Rejection.NO_VOLTAGE] > 50
    assert pairing.received_torque == pairing.used_count + pairing.refusal_counts['torque'].total()


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


def test_a_silence_of_just_the_gap_is_still_an_interval() -> None:
    samples = feed(
        Pairing(PairingSettings(gap_s=0.5)),
        [('v', 0, 5.0), ('t', 0, 0.0), ('v', 500, 5.0), ('t', 500, 1.0)],
    )
    assert samples[1].interval_s[0] == 0.5


def test_torque_before_any_voltage_is_counted_and_teaches_nothing() -> None:
    pairing = Pairing()
    samples = feed(pairing, [*(('t', 10 * k, 1.0) for k in range(5)), ('v', 100, 5.0)])
    assert samples == []
    assert pairing.rejected == {Rejection.NO_VOLTAGE: 5}


def test_torque_whose_voltage_never_came_is_no_sample_at_the_end_of_a_bag() -> None:
    pairing = Pairing()
    assert feed(pairing, [('t', 10 * k, 1.0) for k in range(20)]) + pairing.flush() == []
    assert pairing.rejected == {Rejection.NO_VOLTAGE: 20}


@pytest.mark.parametrize(
    ('value', 'reason'),
    [
        (math.nan, Rejection.NON_FINITE),
        (math.inf, Rejection.NON_FINITE),
        (-math.inf, Rejection.NON_FINITE),
        (2e9, Rejection.ABSURD),
        (-2e9, Rejection.ABSURD),
    ],
)
@pytest.mark.parametrize('kind', ['v', 't'])
def test_a_value_that_no_motor_has_is_counted_and_leaves_no_trace(
    kind: str, value: float, reason: Rejection
) -> None:
    clean = [
        ('v', 0, 5.0),
        ('t', 0, 0.0),
        ('v', 10, 6.0),
        ('t', 10, 0.1),
        ('v', 20, 6.0),
        ('t', 20, 0.1),
    ]
    pairing = Pairing()
    reference = Pairing()
    samples = feed(pairing, [*clean[:4], (kind, 15, value), *clean[4:]])
    assert content(samples) == content(feed(reference, clean))
    assert pairing.rejected == {reason: 1}


def test_a_speed_that_is_not_finite_refuses_the_torque_but_no_speed_does_not() -> None:
    pairing = Pairing()
    pairing.voltage(0, 5.0)
    assert pairing.torque(0, 0.1, math.inf) == []
    assert pairing.rejected == {Rejection.NON_FINITE: 1}
    assert len(pairing.torque(0, 0.1, math.nan)) == 1


@pytest.mark.parametrize('kind', ['v', 't'])
def test_duplicates_and_messages_out_of_order_are_told_apart(kind: str) -> None:
    pairing = Pairing()
    feed(pairing, [('v', 0, 5.0), ('t', 0, 0.0), ('v', 10, 5.0), ('t', 10, 0.1)])
    assert feed(pairing, [(kind, 10, 9.0), (kind, 5, 9.0)]) == []
    assert pairing.rejected == {Rejection.DUPLICATE: 1, Rejection.OUT_OF_ORDER: 1}


@pytest.mark.parametrize('kind', ['v', 't'])
def test_a_jump_of_the_clock_restarts_the_history_and_loses_nothing_that_waited(kind: str) -> None:
    pairing = Pairing(PairingSettings(jump_back_s=1.0))
    before = feed(pairing, [('v', 5000, 5.0), ('t', 5000, 0.0), ('t', 5010, 0.1)])
    assert [s.stamp_ns // MS for s in before] == [5000]
    at_jump = feed(pairing, [(kind, 3000, 0.5)])
    assert [(s.stamp_ns // MS, float(s.voltage_v[0])) for s in at_jump] == [(5010, 5.0)]
    assert pairing.restarts == 1
    after = feed(pairing, [('v', 3005, 1.0), ('t', 3010, 0.2), ('v', 3020, 2.0), ('t', 3020, 0.3)])
    intervals = [float(s.interval_s[0]) for s in after]
    assert intervals[0] == 0.0
    assert intervals[-1] == 0.01
    assert after[-1].voltage_v[0] == 1.0


def test_the_voltage_before_a_jump_of_the_clock_does_not_hold_on_behind_it() -> None:
    pairing = Pairing()
    feed(pairing, [('v', 5000, 99.0), ('t', 5000, 0.0), ('t', 1000, 0.1), ('t', 1010, 0.2)])
    assert pairing.flush() == []
    assert pairing.rejected == {Rejection.NO_VOLTAGE: 2}


def test_flush_completes_what_waits_with_the_last_voltage() -> None:
    pairing = Pairing()
    feed(pairing, [('v', 0, 5.0), ('t', 0, 0.0), ('t', 10, 0.1), ('t', 20, 0.2)])
    assert content(pairing.flush()) == [(10 * MS, 0.01, 5.0, 0.1), (20 * MS, 0.01, 5.0, 0.2)]
    assert pairing.flush() == []


def test_ahead_equals_the_pair_that_is_made_later() -> None:
    random = np.random.default_rng(3)
    pairing = Pairing()
    checked = 0
    for k in range(300):
        stamp = k * 10 * MS
        if random.random() < 0.7:
            pairing.voltage(stamp - round(4 * MS * random.random()), float(random.normal()))
        pairing.voltage(stamp, float(random.normal()))
        foreseen = pairing.ahead(stamp)
        made = pairing.torque(stamp, 0.0)
        if foreseen is not None:
            checked += 1
            assert foreseen == (float(made[0].interval_s[0]), float(made[0].voltage_v[0]))
    assert checked == 299


def test_ahead_changes_nothing() -> None:
    voltages, torques = steady(30)
    asked = Pairing()
    silent = Pairing()
    expected = feed(silent, [e for pair in zip(voltages, torques, strict=True) for e in pair])
    samples = []
    for pair in zip(voltages, torques, strict=True):
        for event in pair:
            asked.ahead(pair[0][1] * MS)
            samples += feed(asked, [event])
    assert content(samples) == content(expected)


def test_nothing_is_foreseen_without_history_or_voltage_or_across_a_gap() -> None:
    pairing = Pairing(PairingSettings(gap_s=0.5))
    assert pairing.ahead(0) is None
    feed(pairing, [('v', 0, 5.0), ('t', 0, 0.0)])
    assert pairing.ahead(10 * MS) is None  # the voltage is not known that far
    feed(pairing, [('v', 10, 5.0)])
    assert pairing.ahead(10 * MS) == (0.01, 5.0)
    assert pairing.ahead(0) is None  # its torque has come
    feed(pairing, [('v', 900, 5.0)])
    assert pairing.ahead(900 * MS) is None


def test_what_is_refused_is_told_by_the_signal_it_was_of() -> None:
    pairing = Pairing()
    feed(
        pairing,
        [
            ('v', 0, 5.0),
            ('v', 0, 5.0),
            ('t', 0, 0.1),
            ('t', 10, math.nan),
            ('v', 20, 1e12),
            ('v', 30, 5.0),
        ],
    )
    assert pairing.refusal_counts['voltage'] == {Rejection.DUPLICATE: 1, Rejection.ABSURD: 1}
    assert pairing.refusal_counts['torque'] == {Rejection.NON_FINITE: 1}
    assert pairing.rejected.total() == 3
    assert (pairing.received_voltage, pairing.taken_voltage) == (4, 2)


def test_everything_received_is_used_or_rejected_or_waits() -> None:
    random = np.random.default_rng(11)
    pairing = Pairing(PairingSettings(hold_s=0.05))
    produced = 0
    stamp = 0
    for _ in range(4000):
        stamp += round(MS * random.choice([1, 5, 10, 10, 10, 700]))
        if random.random() < 0.6:
            produced += len(pairing.voltage(stamp, float(random.normal())))
        late = round(MS * random.choice([0, 0, 0, 0, 3, 10, 1500]))
        value = float(
            random.choice([0.1, 0.2, math.nan, math.inf, 1e12], p=[0.45, 0.45, 0.04, 0.03, 0.03])
        )
        voltage_rejections = pairing.rejected.total()
        produced += len(pairing.torque(max(stamp - late, 0), value))
        assert pairing.rejected.total() - voltage_rejections <= 20
        assert (
            pairing.received_torque
            == pairing.used_count + pairing.rejected.total() + pairing.waiting_count
        )
        assert pairing.received_voltage == pairing.taken_voltage
    assert produced == pairing.used_count
    assert pairing.restarts > 10
    assert {
        Rejection.NON_FINITE,
        Rejection.ABSURD,
        Rejection.OUT_OF_ORDER,
        Rejection.NO_VOLTAGE,
    } <= set(pairing.rejected)
    produced += len(pairing.flush())
    assert pairing.waiting_count == 0
    assert pairing.received_torque == produced + pairing.rejected.total()


def test_a_silent_torque_sensor_does_not_let_memory_grow() -> None:
    pairing = Pairing()
    for k in range(25_000):
        pairing.voltage(k * MS, float(k))
    assert len(pairing._voltages) <= 10_000
    pairing.torque(24_999 * MS, 0.0)
    pairing.voltage(25_009 * MS, 0.0)
    made = pairing.torque(25_009 * MS, 0.1)
    assert made[0].voltage_v[0] == 24_999.0


@pytest.mark.parametrize('order', [('speed', 'torque', 'voltage'), ('torque', 'voltage', 'speed')])
def test_speed_of_its_own_topic_is_joined_by_stamp_whatever_comes_first(
    order: tuple[str, ...],
) -> None:
    pairing = Pairing(own_speed=True)
    samples = []
    for k in range(20):
        stamp_ns = k * 10_000_000
        for signal in order:
            if signal == 'speed':
                samples += pairing.speed(stamp_ns, 3.0 * k)
            elif signal == 'torque':
                samples += pairing.torque(stamp_ns + 5_000_000, 0.1)
            else:
                samples += pairing.voltage(stamp_ns, 1.0)
    speeds = [sample.speed_rad_s[0] for sample in samples]
    np.testing.assert_allclose(speeds, [3.0 * k + 1.5 for k in range(len(speeds))])
    assert len(speeds) >= 18


def test_torque_without_speed_is_refused_where_speed_is_needed_and_the_interval_goes_on() -> None:
    pairing = Pairing()
    pairing.needs_speed = True
    samples = []
    for k in range(5):
        samples += pairing.voltage(k * 10_000_000, float(k))
        samples += pairing.torque(k * 10_000_000, 0.1, math.nan if k == 2 else 1.0)
    assert pairing.rejected == {Rejection.NO_SPEED: 1}
    assert [round(sample.interval_s[0], 3) for sample in samples] == [0.0, 0.01, 0.02, 0.01]
    assert samples[2].voltage_v[0] == pytest.approx(1.5)


def test_a_torque_without_speed_is_refused_too_where_it_waited_with_the_first_that_has_one() -> (
    None
):
    for uses_speed in (True, False):
        pairing = Pairing(uses_speed=uses_speed)
        pairing.voltage(-MS, 1.0)
        for k in range(3):
            assert pairing.torque(10 * k * MS, 0.1, math.nan if k == 1 else 2.0) == []
        samples = pairing.voltage(20 * MS, 1.0)
        assert [s.stamp_ns // MS for s in samples] == ([0, 20] if uses_speed else [0, 10, 20])
        assert pairing.rejected == ({Rejection.NO_SPEED: 1} if uses_speed else {})


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


@pytest.mark.slow
def test_of_every_motor_of_a_group_what_came_is_used_or_refused_or_waits() -> None:
    """Whatever a message lacks or becomes: no motor is charged for what was not its own."""
    random = np.random.default_rng(7)
    motors = 4
    pairing = Pairing(PairingSettings(hold_s=0.05), motors)
    told = {signal: np.zeros(motors, int) for signal in 'vt'}
    stamp_ns = 0
    for _ in range(3000):
        stamp_ns += round(MS * random.choice([0, 1, 10, 10, 10, 700]))
        late_ns = round(MS * random.choice([0, 0, 0, 0, 0, 3, 10, 1500]))
        signal = str(random.choice(['v', 't']))
        missing = random.random(motors) < 0.2
        values = random.choice([0.1, 0.2, math.nan, 1e12], motors, p=[0.45, 0.45, 0.05, 0.05])
        told[signal] += ~missing
        take = pairing.voltage if signal == 'v' else pairing.torque
        take(max(stamp_ns - late_ns, 0), np.where(missing, math.nan, values), absent=missing)
        for motor in range(motors):
            counts = pairing.counts_for(motor)
            assert counts.received_torque == told['t'][motor]
            assert (
                counts.received_torque
                == counts.used_count
                + counts.refusal_counts['torque'].total()
                + counts.waiting_count
            )
            assert counts.received_voltage == told['v'][motor]
            assert (
                counts.received_voltage
                == counts.taken_voltage + counts.refusal_counts['voltage'].total()
            )
    assert {Rejection.DUPLICATE, Rejection.OUT_OF_ORDER, Rejection.NO_VOLTAGE} <= set(
        pairing.counts_for(0).rejected
    )
    assert pairing.counts_for(0).used_count > 500


def test_torque_waits_for_the_first_voltage_before_the_time_of_zero_too() -> None:
    pairing = Pairing()
    events = [(kind, at, 1.0) for at in range(-100, 100, 10) for kind in 'tv']
    samples = feed(pairing, events) + pairing.flush()
    assert [s.stamp_ns // MS for s in samples] == list(range(-100, 100, 10))
    assert pairing.rejected == {}


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
