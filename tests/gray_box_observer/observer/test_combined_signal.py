"""Signals that are expressions of inputs, and which messages of several topics belong together."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gray_box_observer.observer.input_alignment import InputAlignment
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration

MS = 1_000_000
DUTY = {
    'voltage.expression': 'duty * battery',
    'duty.topic': 'duty',
    'duty.type': 'sensor_msgs/msg/JointState',
    'duty.field': 'effort',
    'battery.topic': 'battery',
    'battery.type': 'sensor_msgs/msg/BatteryState',
    'battery.field': 'voltage',
    'battery.stale_s': 2.0,
}


class Recorded(Observer):
    """An observer that keeps what it is told."""

    def __init__(self, configuration: Configuration) -> None:
        super().__init__(configuration)
        self.told: list[tuple[str, int, dict[str, float]]] = []

    def ingest(
        self, signal: Any, names: Any, stamp_ns: Any, values: Any, speeds: Any = None
    ) -> Any:
        """Keep what a message says."""
        told = {name: round(float(v), 9) for name, v in zip(names, values, strict=True)}
        self.told.append((signal, stamp_ns // MS, told))
        return super().ingest(signal, names, stamp_ns, values, speeds)


def listening(given: dict[str, Any]) -> tuple[MessageInput, Recorded]:
    configuration = Configuration.from_flat(given)
    observer = Recorded(configuration)
    return MessageInput(observer, configuration), observer


def message(stamp_ms: int, **fields: Any) -> SimpleNamespace:
    seconds, nanoseconds = divmod(stamp_ms * MS, 1_000_000_000)
    stamp = SimpleNamespace(sec=seconds, nanosec=nanoseconds)
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), **fields)


def duty(stamp_ms: int, *values: float, names: tuple[str, ...] = ('motor',)) -> SimpleNamespace:
    return message(stamp_ms, name=list(names), effort=list(values), velocity=[], position=[])


def test_the_slower_topic_is_held() -> None:
    taker, observer = listening(DUTY)
    taker.ingest('voltage', message(1000, voltage=12.0), 0, 'battery')
    for k in range(60):
        taker.ingest('voltage', duty(1010 + 10 * k, 0.5), 0, 'duty')
        if k == 40:
            taker.ingest('voltage', message(1415, voltage=10.0), 0, 'battery')
    voltages = [told['motor'] for _, _, told in observer.told]
    stamps = [stamp for _, stamp, _ in observer.told]
    assert voltages[-5:] == [5.0] * 5
    assert stamps[-1] == 1600, 'a faster topic is not kept waiting'
    assert stamps == sorted(stamps)
    assert all(v == (6.0 if t < 1415 else 5.0) for v, t in zip(voltages, stamps, strict=True))
    assert len(stamps) >= 57
    assert observer.counts('motor').received_voltage == len(stamps)


def test_a_topic_that_is_named_first_does_not_lead_where_another_comes_more_often() -> None:
    taker, observer = listening(DUTY | {'voltage.expression': 'battery * duty'})
    for k in range(200):
        if k % 100 == 0:
            taker.ingest('voltage', message(1000 + 10 * k, voltage=12.0), 0, 'battery')
        taker.ingest('voltage', duty(1000 + 10 * k, 0.5), 0, 'duty')
    assert len(observer.told) >= 196


def test_topics_that_come_as_often_are_put_together_by_stamp() -> None:
    """The second one comes 3 ms after the first, with the same stamps."""
    taker, observer = listening(
        {
            'torque.expression': 'torque_constant * (left - right)',
            'left.topic': 'left',
            'right.topic': 'right',
        }
    )
    for k in range(20):
        taker.ingest('torque', SimpleNamespace(data=float(k)), (1000 + 10 * k) * MS, 'left')
        taker.ingest('torque', SimpleNamespace(data=-float(k)), (1000 + 10 * k) * MS, 'right')
    taker.flush()
    told = {stamp: values['motor'] for _, stamp, values in observer.told}
    late = {1000 + 10 * k: pytest.approx(0.01 * 2 * k) for k in range(3, 20)}
    assert {stamp: told[stamp] for stamp in late} == late


def test_a_battery_that_falls_silent_is_refused_and_named() -> None:
    taker, observer = listening(DUTY)
    taker.ingest('voltage', duty(990, 0.5), 0, 'duty')
    taker.ingest('voltage', duty(1000, 0.5), 0, 'duty')
    assert taker.rejection_counts['voltage'][Rejection.STALE_INPUT] >= 1
    assert taker.complaints['voltage'] == 'battery has brought nothing yet'
    taker.ingest('voltage', message(1000, voltage=12.0), 0, 'battery')
    for k in range(1, 500):
        taker.ingest('voltage', duty(1000 + 10 * k, 0.5), 0, 'duty')
    assert max(stamp for _, stamp, _ in observer.told) == 3000
    assert taker.rejection_counts['voltage'][Rejection.STALE_INPUT] >= 299
    assert taker.complaints['voltage'] == 'battery is 4.99 s old'
    taker.ingest('voltage', message(5995, voltage=11.0), 0, 'battery')
    taker.ingest('voltage', duty(6000, 0.5), 0, 'duty')
    assert observer.told[-1] == ('voltage', 6000, {'motor': 5.5})


def test_inputs_of_one_message_belong_together_and_serve_several_signals() -> None:
    given = {
        'voltage.expression': 'duty * bus',
        'torque.expression': 'torque_constant * current',
        'motor.torque_constant': 0.05,
        **{
            f'{name}.{key}': text
            for name, field in (('duty', 'duty_cycle'), ('bus', 'input'), ('current', 'current'))
            for key, text in (('topic', 'esc'), ('field', f'state.{field}'))
        },
    }
    taker, observer = listening(given)
    (feed,) = Configuration.from_flat(given).feeds
    assert feed.signals == ('voltage', 'torque')
    state = SimpleNamespace(duty_cycle=0.25, input=24.0, current=2.0)
    for signal in feed.signals:
        taker.ingest(signal, message(1000, state=state), 0, feed.topic)
    assert observer.told == [('voltage', 1000, {'motor': 6.0}), ('torque', 1000, {'motor': 0.1})]


def test_one_number_is_that_of_every_motor_and_each_has_its_own_torque_constant() -> None:
    given = {
        'motors': ['a', 'b'],
        'a.torque_constant': 0.1,
        'b.torque_constant': 0.2,
        'torque.expression': 'torque_constant * current * gain',
        'current.topic': 'states',
        'current.field': 'effort',
        'gain.topic': 'gain',
    }
    taker, observer = listening(given)
    taker.ingest('torque', SimpleNamespace(data=2.0), 1000 * MS, 'gain')
    for k in range(5):
        states = duty(1010 + 10 * k, 1.0, 5.0, 3.0, names=('b', 'arm', 'a'))
        taker.ingest('torque', states, 0, 'states')
    signal, _, told = observer.told[-1]
    assert signal == 'torque'
    assert math.isnan(told.pop('arm'))
    assert told == {'b': 0.4, 'a': 0.6}
    assert taker.signals['torque'].unknown_names['arm'] == 5


def test_speed_is_the_mean_rate_of_a_position() -> None:
    taker, observer = listening(
        {'speed.expression': 'diff(angle)', 'angle.topic': 'encoder', 'angle.scale': 0.5}
    )
    for stamp_ms, angle in ((1000, 1.0), (1010, 1.2), (1030, 0.6), (3000, 9.0), (3010, 9.5)):
        taker.ingest('speed', SimpleNamespace(data=angle), stamp_ms * MS, 'encoder')
    told = [(stamp, values['motor']) for _, stamp, values in observer.told]
    assert told == [(1010, 10.0), (1030, -15.0), (3010, 25.0)]


def test_a_moving_average_is_undone_but_where_a_value_of_it_was_lost() -> None:
    taker, observer = listening(
        {'torque.expression': 'unsmoothed(raw, 0.25)', 'raw.topic': 'states', 'raw.field': 'effort'}
    )
    currents = np.random.default_rng(1).normal(size=12)
    smooth = 0.0
    for k, current in enumerate(currents.tolist()):
        smooth = 0.25 * current + 0.75 * smooth
        if k not in (6, 8):
            taker.ingest('torque', duty(1000 + 10 * k, smooth), 0, 'states')
    told = {stamp: values['motor'] for _, stamp, values in observer.told}
    expected = {1000 + 10 * k: currents[k] for k in range(1, 12) if k not in (6, 7, 8, 9)}
    assert told == pytest.approx(expected)


def test_what_is_made_of_no_value_is_none_either() -> None:
    taker, observer = listening(
        {'speed.expression': 'diff(unsmoothed(angle, 0.5))', 'angle.topic': 'encoder'}
    )
    for k, angle in enumerate((1.0, 2.0, 3.0, 4.0)):
        taker.ingest('speed', SimpleNamespace(data=angle), (1000 + 10 * k) * MS, 'encoder')
    told = [values['motor'] for _, _, values in observer.told]
    assert math.isnan(told[0])
    assert told[1:] == pytest.approx([100.0, 100.0])


@pytest.mark.parametrize('quantity', ['torque', 'current'])
def test_offsets_are_added_after_the_scales_of_inputs_and_of_the_expression(
    quantity: str,
) -> None:
    """A current that has an offset of its own is made a torque after it."""
    taker, observer = listening(
        {
            'motor.torque_constant': 0.5,
            'torque.quantity': quantity,
            'torque.expression': 'raw * gain',
            'torque.scale': 2.0,
            'torque.offset': 1.0,
            'raw.topic': 'states',
            'raw.field': 'effort',
            'raw.scale': 10.0,
            'raw.offset': -5.0,
            'gain.topic': 'gain',
            'gain.offset': 1.0,
        }
    )
    taker.ingest('torque', SimpleNamespace(data=2.0), 1000 * MS, 'gain')
    taker.ingest('torque', duty(1000, 0.6), 0, 'states')
    taker.flush()
    reading = 2.0 * ((10.0 * 0.6 - 5.0) * (2.0 + 1.0)) + 1.0
    expected = reading * (0.5 if quantity == 'current' else 1.0)
    assert [told['motor'] for _, _, told in observer.told] == [pytest.approx(expected)]


def test_several_motors_and_one_number_are_refused() -> None:
    taker, _ = listening(
        {
            'motors': ['a', 'b'],
            'voltage.expression': '2 * duty',
            'duty.topic': 'duty',
        }
    )
    assert taker.ingest('voltage', SimpleNamespace(data=1.0), 5, 'duty').groups == []
    assert taker.rejection_counts['voltage'] == {Rejection.MALFORMED: 1}
    assert 'one number, but there are 2 motors' in taker.complaints['voltage']


def test_a_message_that_cannot_be_read_is_counted_and_nothing_is_lost() -> None:
    taker, observer = listening(DUTY)
    taker.ingest('voltage', message(1000, voltage=12.0), 0, 'battery')
    taker.ingest('voltage', duty(1010, 0.5, 0.6), 0, 'duty')
    taker.ingest('voltage', duty(1020, 0.5), 0, 'duty')
    taker.ingest('voltage', duty(1030, 0.5), 0, 'duty')
    assert taker.rejection_counts['voltage'] == {Rejection.MALFORMED: 1}
    assert {v['motor'] for _, _, v in observer.told} == {6.0}


def test_a_restarted_clock_starts_the_alignment_anew() -> None:
    alignment = InputAlignment({'a': 10**10, 'b': 10**10}, 10**9)
    for k in range(10):
        alignment.add('b', 10**11 + k * MS, 'old')
        alignment.add('a', 10**11 + k * MS, 'old')
    alignment.add('b', 5, 'new')
    whole = [*alignment.add('a', 6, 'new'), *alignment.flush()]
    assert [one.contents for one in whole] == [{'a': 'new', 'b': 'new'}]


def test_a_joint_stands_for_a_motor_of_another_name() -> None:
    taker, observer = listening(
        {'motors': ['left', 'right'], 'left.joint': 'left_wheel', 'right.joint': 'left'}
    )
    states = duty(1000, 1.0, 2.0, 3.0, names=('arm', 'left', 'left_wheel'))
    taker.ingest('voltage', states, 0)
    told = observer.told[-1][2]
    assert (told['left'], told['right']) == (3.0, 2.0)
    own = duty(1010, 4.0, 5.0, names=('right', 'left_wheel'))
    taker.ingest('voltage', own, 0)
    assert observer.told[-1][2] == {'right': 4.0, 'left': 5.0}
    assert observer.counts('left').received_voltage == 2


def test_a_current_is_a_torque_by_each_motors_constant() -> None:
    taker, observer = listening(
        {
            'motors': ['a', 'b'],
            'a.torque_constant': 0.1,
            'b.torque_constant': 0.2,
            'torque.quantity': 'current',
        }
    )
    taker.ingest('torque', duty(1000, 1.0, 9.0, 1.0, names=('a', 'arm', 'b')), 0)
    taker.ingest('torque', duty(1010, 2.0, names=('b',)), 0)
    assert [told for _, _, told in observer.told] == [{'a': 0.1, 'arm': 9.0, 'b': 0.2}, {'b': 0.4}]


def test_speed_beside_a_named_effort_is_that_of_the_same_joint() -> None:
    taker, observer = listening({'torque.field': 'effort[wheel]'})
    states = duty(1000, 1.0, 2.0, names=('arm', 'wheel'))
    states.velocity = [7.0, 8.0]
    speeds: list[Any] = []
    inner = observer.ingest
    observer.ingest = lambda *told: speeds.append(told[4]) or inner(*told)  # type: ignore[method-assign]
    taker.ingest('torque', states, 0)
    assert speeds == [(8.0,)]


def test_motors_with_joints_of_other_names_are_computed_together() -> None:
    names = [f'm{k}' for k in range(4)]
    given: dict[str, Any] = {'motors': names, 'group_from': 4, 'm0.joint': 'm1', 'm1.joint': 'm0'}
    taker, observer = listening(given | {f'm{k}.joint': f'wheel{k}' for k in (2, 3)})
    joints = ('arm', 'm2', 'm0', 'm1', 'wheel2', 'wheel3', 'm3')
    for k in range(40):
        values = [9.0, 9.0, 5.0 + k % 3, 6.0 + k % 3, 7.0 + k % 3, 8.0 + k % 3, 9.0]
        taker.ingest('voltage', duty(1000 + 10 * k, *values, names=joints), 0)
        taker.ingest('torque', duty(1000 + 10 * k, *values, names=joints), 0)
    assert len({id(observer.group_of(name)) for name in names}) == 1
    assert [observer.counts(name).used_count for name in names] == [40] * 4
    _, _, told = observer.told[-1]
    assert [told[name] for name in names] == [6.0, 5.0, 7.0, 8.0]
