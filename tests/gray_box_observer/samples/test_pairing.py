"""Voltage and torque become samples by their stamps."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gray_box_observer.samples import Pairing, Rejection, Sample
from gray_box_observer.samples.pairing import PairingSettings

from .pairing_events import MS, content, feed, steady


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


def test_a_sample_tells_the_voltage_in_force_just_before_its_stamp() -> None:
    events = [
        ('v', 0, 2.0),
        ('t', 0, 0.0),
        ('v', 7, 4.0),
        ('t', 10, 1.0),
        ('v', 20, 6.0),
        ('t', 20, 1.0),
        ('v', 30, 8.0),
        ('t', 30, 1.0),
        ('v', 40, 8.0),
    ]
    samples = feed(Pairing(), events)
    assert [float(one.held_v[0]) for one in samples] == [2.0, 4.0, 4.0, 6.0]
    moments = [float(one.moment_v[0]) for one in samples]
    assert moments == pytest.approx([0.0, 0.5 * 0.7 * 0.3 * 2.0, 0.0, 0.0])


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


@pytest.mark.parametrize('late_ms', [300, 4900])
def test_torque_waits_longer_for_the_first_voltage_which_its_reader_may_find_later(
    late_ms: int,
) -> None:
    pairing = Pairing()
    torques = [('t', at, 0.1) for at in range(0, late_ms, 10)]
    assert feed(pairing, torques) == []
    samples = feed(pairing, [('v', at, 1.0) for at in range(0, late_ms, 10)])
    assert len(samples) == len(torques)
    assert pairing.rejected == {}


def test_torque_waits_as_long_for_the_first_speed_of_a_topic_of_its_own() -> None:
    pairing = Pairing(own_speed=True)
    assert feed(pairing, [(kind, at, 1.0) for at in range(0, 3000, 10) for kind in 'vt']) == []
    samples = [one for at in range(0, 3000, 10) for one in pairing.speed(at * MS, 2.0)]
    assert len(samples) == 300
    assert pairing.rejected == {}


def test_torque_is_refused_where_no_voltage_comes_for_five_seconds() -> None:
    pairing = Pairing()
    assert feed(pairing, [('t', at, 0.1) for at in range(0, 6000, 10)]) == []
    assert pairing.waiting_count <= 26
    assert pairing.rejected == {Rejection.NO_VOLTAGE: 600 - pairing.waiting_count}


def test_a_speed_that_never_comes_is_waited_for_once() -> None:
    pairing = Pairing(own_speed=True)
    feed(pairing, [(kind, at, 1.0) for at in range(0, 6000, 10) for kind in 'vt'])
    assert pairing.waiting_count <= 26
    feed(pairing, [(kind, at, 1.0) for at in range(6000, 9000, 10) for kind in 'vt'])
    assert pairing.waiting_count <= 26


def test_how_a_voltage_moves_is_told_of_a_motor_in_a_group_as_of_one_alone() -> None:
    motors = 3
    rng = np.random.default_rng(7)
    together = Pairing(motors=motors)
    alone = [Pairing() for _ in range(motors)]
    samples: list[list[tuple[float, ...]]] = [[] for _ in range(motors)]
    singles: list[list[tuple[float, ...]]] = [[] for _ in range(motors)]
    stamp_ns = 0
    for _ in range(400):
        stamp_ns += int(rng.integers(1, 4)) * MS
        signal = ('voltage', 'torque')[int(rng.integers(2))]
        values = np.where(rng.random(motors) < 0.1, np.nan, rng.normal(size=motors))
        for sample in together.ingest_signal[signal](stamp_ns, values):
            present = np.ones(motors, bool) if sample.present is None else sample.present
            for motor in np.flatnonzero(present).tolist():
                samples[motor].append(_told(sample, motor))
        for motor, single in enumerate(alone):
            for sample in single.ingest_signal[signal](stamp_ns, float(values[motor])):
                singles[motor].append(_told(sample, 0))
    for motor in range(motors):
        count = min(len(samples[motor]), len(singles[motor]))
        assert count > 100
        mine, own = (np.array(part[:count]) for part in (samples[motor], singles[motor]))
        np.testing.assert_allclose(mine, own, rtol=1e-9, atol=1e-12)
        assert np.count_nonzero(np.abs(own[:, 5]) > 1e-3) > 20


def test_motors_that_need_it_not_are_not_told_how_the_voltage_moves() -> None:
    pairing = Pairing(motors=2, tells_moves=False)
    values = np.ones(2)
    samples = [one for k in range(3) for one in pairing.voltage(k * MS, values)]
    samples += [one for k in range(2) for one in pairing.torque(k * MS, values)]
    assert [one.held_v for one in samples] == [None, None]
    assert [one.moment_v for one in samples] == [None, None]


def _told(sample: Sample, motor: int) -> tuple[float, ...]:
    """Return stamp, interval, voltages and torque of one motor's sample, and how it moves."""
    assert sample.held_v is not None
    assert sample.moment_v is not None
    signals = (
        *(sample.interval_s, sample.voltage_v, sample.torque_nm),
        *(sample.held_v, sample.moment_v),
    )
    return (float(sample.stamp_ns), *(float(signal[motor]) for signal in signals))
