from __future__ import annotations

import math
import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gray_box_observer.bag.joint_state import JointStateView, decode_joint_state, encode_joint_state
from gray_box_observer.errors import ConfigurationError, SampleError
from gray_box_observer.observer.message_input import (
    InputResult,
    MessageInput,
    Signal,
    names_of,
    stamp_of,
)
from gray_box_observer.observer.observer import Observer, Result
from gray_box_observer.samples import Rejection
from gray_box_observer.settings.configuration import Configuration


def view(stamp_ns: int, names: tuple[str, ...], effort: Any, velocity: Any = ()) -> JointStateView:
    return decode_joint_state(encode_joint_state(stamp_ns, names, effort=effort, velocity=velocity))


def wrench(stamp_s: int, value: float) -> SimpleNamespace:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=stamp_s, nanosec=5))
    return SimpleNamespace(
        header=header, wrench=SimpleNamespace(torque=SimpleNamespace(x=0.0, y=0.0, z=value))
    )


def message_input(**given: Any) -> tuple[MessageInput, Observer]:
    configuration = Configuration.from_flat(
        {name.replace('__', '.'): value for name, value in given.items()}
    )
    observer = Observer(configuration)
    return MessageInput(observer, configuration), observer


def signal(name: str = 'torque', **given: Any) -> Signal:
    return Signal(
        name, Configuration.from_flat({k.replace('__', '.'): v for k, v in given.items()})
    )


def results_of(taken: InputResult) -> list[Result]:
    """What a message has led to, motor by motor."""
    return [result for group in taken.groups for result in group]


def told(one: Signal, message: Any) -> list[tuple[str, float]]:
    """What a message tells of the configured motors."""
    return [
        pair
        for pair in zip(*one.read(message)[:2], strict=True)
        if pair[0] not in one.unknown_names
    ]


def test_a_joint_state_speaks_of_every_motor_it_names() -> None:
    one = signal(motors=['a', 'b'])
    assert told(one, view(0, ('b', 'x', 'a'), (1.0, 2.0, 3.0))) == [('b', 1.0), ('a', 3.0)]
    assert one.unknown_names == {'x': 1}


def test_a_motor_that_is_named_twice_makes_one_message_malformed_and_two_of_nothing() -> None:
    taker, observer = message_input(motors=['a', 'b'])
    assert taker.ingest('torque', view(0, ('a', 'b', 'a'), (1.0, 2.0, 3.0)), 0).names == ()
    assert taker.rejection_counts['torque'] == {Rejection.MALFORMED: 1}
    assert observer.counts('a').received_torque == 0


def test_a_joint_of_somebody_else_may_stand_before_our_motors_and_bring_a_speed() -> None:
    taker, observer = message_input(motors=['a', 'b'])
    for k in range(3):
        stamp_ns = (k + 1) * 10_000_000
        taker.ingest('voltage', view(stamp_ns, ('x', 'a', 'b'), (9.0, 1.0, 1.0)), 0)
        taker.ingest('torque', view(stamp_ns, ('x', 'a', 'b'), (9.0, 0.1, 0.1), (5.0, 1.0, 1.0)), 0)
        taker.ingest('torque', view(stamp_ns, (), ()), 0)
    assert observer.counts('a').used_count == observer.counts('b').used_count > 0


def test_messages_of_other_motors_are_counted_however_many_names_they_bring() -> None:
    taker, _ = message_input()
    for k in range(500):
        taker.ingest('voltage', view(k, (f'stranger {k}' + 'x' * k,), (1.0,)), 0)
    taker.ingest('voltage', view(500, (), ()), 0)
    assert taker.others == {'voltage': 501}
    assert len(taker.signals['voltage'].unknown_names) == 100
    assert max(map(len, taker.signals['voltage'].unknown_names)) <= 64


def test_a_nested_field_is_found_by_its_path() -> None:
    assert told(signal(torque__field='wrench.torque.z'), wrench(1, 0.25)) == [('motor', 0.25)]


def test_an_element_of_an_array_is_found_by_its_index() -> None:
    assert told(signal(torque__field='data[2]'), SimpleNamespace(data=[1.0, 2.0, 3.0])) == [
        ('motor', 3.0)
    ]


def test_the_scale_turns_a_current_into_torque() -> None:
    one = signal(torque__field='data', torque__scale=0.05)
    assert told(one, SimpleNamespace(data=4)) == [('motor', pytest.approx(0.2))]


NAMED = ('motor',)


@pytest.mark.parametrize('name', ['voltage', 'torque', 'speed'])
@pytest.mark.parametrize(
    ('field', 'messages'),
    [
        ('data', [SimpleNamespace(data=4.0)] * 2),
        ('data', [SimpleNamespace(data=[4.0])] * 2),
        ('data[1]', [SimpleNamespace(data=[0.0, 4.0])] * 2),
        ('effort', [view(0, NAMED, (4.0,)), view(1, NAMED, (4.0,)), view(2, NAMED, (4.0,))]),
        ('effort', [view(0, ('x', *NAMED), (0.0, 4.0))] * 2),
        ('effort[motor]', [view(0, ('x', *NAMED), (0.0, 4.0))] * 2),
    ],
)
def test_the_offset_is_added_after_the_scale_whatever_holds_the_value(
    name: str, field: str, messages: list[Any]
) -> None:
    """The usual message, one name with one value, is read in another way from the second on."""
    given = {'field': field, 'scale': 0.5, 'offset': -0.25, 'topic': 'x'}
    one = signal(name, **{f'{name}__{key}': value for key, value in given.items()})
    for message in messages:
        assert dict(told(one, message))['motor'] == pytest.approx(1.75)


def test_the_offset_of_a_current_is_in_ampere() -> None:
    given = {'torque__quantity': 'current', 'torque__offset': 1.0, 'motor__torque_constant': 0.5}
    one = signal(torque__scale=2.0, **given)
    for k in range(2):
        assert told(one, view(k, NAMED, (3.0,))) == [('motor', pytest.approx(3.5))]
    assert told(one, view(2, ('x', *NAMED), (0.0, 3.0)))[-1] == ('motor', pytest.approx(3.5))
    scalar = signal(torque__field='data', **given)
    assert told(scalar, SimpleNamespace(data=3.0)) == [('motor', pytest.approx(2.0))]


@pytest.mark.parametrize(
    ('field', 'names'),
    [('effort', ('motor',)), ('effort', ('x', 'motor')), ('effort[motor]', ('x', 'motor'))],
)
def test_the_offset_of_a_speed_beside_the_torque_is_added_too(
    field: str, names: tuple[str, ...]
) -> None:
    taker, observer = message_input(torque__field=field, speed__scale=2.0, speed__offset=0.5)
    speeds: list[float] = []
    ingest = observer.ingest

    def keep(name: str, names: Any, stamp_ns: int, values: Any, speed_values: Any = None) -> Any:
        if speed_values is not None:
            speeds.append(float(speed_values[-1]))
        return ingest(name, names, stamp_ns, values, speed_values)

    observer.ingest = keep  # type: ignore[method-assign]
    efforts = [0.1] * len(names)
    for k in range(3):
        taker.ingest('torque', view(k, names, efforts, [7.0] * len(names)), 0)
    assert speeds == [14.5] * 3


def test_a_field_that_is_not_there_is_a_mistake_in_the_configuration_that_names_it() -> None:
    with pytest.raises(
        ConfigurationError,
        match=r"torque\.field 'wrench\.torque\.w' on motor/torque.*there are: x, y, z",
    ):
        signal(torque__field='wrench.torque.w').read(wrench(1, 0.25))


def test_a_field_path_that_is_none_is_refused_at_once() -> None:
    with pytest.raises(ConfigurationError, match='is no field path'):
        signal(torque__field='wrench..z')


@pytest.mark.parametrize(
    ('field', 'good', 'complaint'),
    [
        ('data[2]', [1.0, 2.0, 3.0], 'data has {} values, so there is no [2]'),
        ('data', [1.0], 'torque.field data holds {} values without names: add an index'),
    ],
)
def test_an_array_of_another_length_is_malformed_not_fatal_be_it_the_first_message(
    field: str, good: list[float], complaint: str
) -> None:
    taker, observer = message_input(torque__field=field)
    short: tuple[list[float], ...] = ([], [1.0, 2.0])
    for count, data in enumerate((*short, good, *short), 1):
        taken = taker.ingest('torque', SimpleNamespace(data=data), count)
        assert taken.names == (('motor',) if data is good else ())
        if data is not good:
            assert complaint.format(len(data)) in taker.complaints['torque']
    assert taker.rejection_counts['torque'] == {Rejection.MALFORMED: 4}
    assert observer.counts('motor').received_torque == 1


@pytest.mark.parametrize(
    'message',
    [
        view(0, ('motor',), ()),
        view(0, (), (1.0,)),
        SimpleNamespace(name=['motor'], effort=['many']),
        SimpleNamespace(name=['motor'], effort=None),
        SimpleNamespace(name=['motor'], effort=[0.1], velocity=['fast']),
    ],
)
def test_a_message_whose_values_do_not_fit_its_names_is_counted(message: Any) -> None:
    taker, observer = message_input()
    assert taker.ingest('torque', message, 0) == (0, (), [])
    assert taker.rejection_counts['torque'] == {Rejection.MALFORMED: 1}
    assert observer.counts('motor').received_torque == 0


def test_a_number_without_a_name_cannot_belong_to_several_motors() -> None:
    with pytest.raises(SampleError, match=r'is one number.* but there are 2 motors'):
        signal(torque__field='data', motors=['a', 'b']).read(SimpleNamespace(data=1.0))


def test_several_numbers_without_names_need_an_index() -> None:
    with pytest.raises(SampleError, match='holds 3 values without names: add an index'):
        signal(torque__field='data').read(SimpleNamespace(data=[1.0, 2.0, 3.0]))
    assert told(signal(torque__field='data'), SimpleNamespace(data=[7.0])) == [('motor', 7.0)]


def test_the_stamp_is_that_of_the_header_and_else_that_of_arrival() -> None:
    assert stamp_of(view(123_456_789_012, ('m',), (0.0,)), 7) == 123_456_789_012
    assert stamp_of(wrench(3, 0.0), 7) == 3_000_000_005
    assert stamp_of(SimpleNamespace(data=1.0), 7) == 7


@pytest.mark.parametrize('arrival_ns', [2**62, 2**63, 2**64 - 1, -(2**63)])
def test_a_time_that_64_bits_do_not_bear_makes_a_message_without_header_malformed(
    arrival_ns: int,
) -> None:
    taker, observer = message_input(torque__field='data', torque__type='std_msgs/msg/Float64')
    assert taker.ingest('torque', SimpleNamespace(data=1.0), 5).names == ('motor',)
    assert taker.ingest('torque', SimpleNamespace(data=1.0), arrival_ns).names == ()
    assert taker.rejection_counts['torque'] == {Rejection.MALFORMED: 1}
    assert observer.counts('motor').received_torque == 1


@pytest.mark.parametrize(
    'stamp', [SimpleNamespace(sec=2**40, nanosec=0), SimpleNamespace(sec=math.inf, nanosec=0), 3]
)
def test_a_header_of_another_form_makes_a_message_malformed(stamp: Any) -> None:
    taker, _ = message_input(torque__field='data', torque__type='std_msgs/msg/Float64')
    assert (
        taker.ingest(
            'torque', SimpleNamespace(header=SimpleNamespace(stamp=stamp), data=1.0), 5
        ).names
        == ()
    )
    assert taker.rejection_counts['torque'] == {Rejection.MALFORMED: 1}


def test_names_are_found_in_views_and_in_messages_alike() -> None:
    assert names_of(view(0, ('a',), (1.0,))) == ('a',)
    assert names_of(SimpleNamespace(name=['a'])) == ['a']
    assert names_of(SimpleNamespace(name='a')) is None
    assert names_of(SimpleNamespace(data=1.0)) is None


def test_what_a_message_held_comes_back_with_what_it_has_led_to() -> None:
    taker, _ = message_input(motors=['a', 'b'])
    taker.ingest('torque', view(5, ('b', 'x'), (0.1, 0.2)), 0)
    taken = taker.ingest('voltage', view(5, ('x', 'b', 'a'), (1.0, 2.0, 3.0)), 0)
    assert (taken.stamp_ns, taken.names) == (5, ('x', 'b', 'a'))
    assert [(r.motor, r.sample.torque_nm[0]) for r in results_of(taken)] == [('b', 0.1)]


@pytest.mark.slow
@pytest.mark.parametrize(('count', 'length'), [(1, 2_000_000), (50_000, 30)])
def test_ever_new_names_do_not_fill_the_memory(count: int, length: int) -> None:
    taker, _ = message_input()
    tracemalloc.start()
    try:
        for k in range(6):
            names = tuple(f'{k}_{j}'.ljust(length) for j in range(count))
            taker.ingest('voltage', view(k, names, (1.0,) * count), 0)
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert taker.others['voltage'] == 6
    assert kept < 2 * count * (length + 60), 'one message and what it is read from take more'


def test_a_message_is_read_once() -> None:
    class Counting:
        """A message that counts how often its values are asked for."""

        name = ('motor',)
        reads = 0

        @property
        def effort(self) -> tuple[float, ...]:
            self.reads += 1
            return (1.0,)

    taker, _ = message_input()
    message = Counting()
    assert taker.ingest('voltage', message, 3).names == ('motor',)
    assert message.reads == 1


def test_speed_comes_with_torque_where_the_message_has_it() -> None:
    taker, _ = message_input()
    taker.ingest('voltage', view(0, ('motor',), (5.0,)), 0)
    with_speed = results_of(taker.ingest('torque', view(0, ('motor',), (0.1,), (3.0,)), 0))
    assert with_speed[0].sample.speed_rad_s[0] == 3.0


def test_speed_may_have_a_topic_of_its_own() -> None:
    taker, _ = message_input(speed__topic='joint_states', speed__field='velocity', speed__scale=2.0)
    taker.ingest('speed', view(0, ('motor',), (), (3.0,)), 0)
    taker.ingest('voltage', view(0, ('motor',), (5.0,)), 0)
    results = results_of(taker.ingest('torque', view(0, ('motor',), (0.1,), (99.0,)), 0))
    assert results[0].sample.speed_rad_s[0] == 6.0


def test_without_speed_the_sample_says_so() -> None:
    taker, observer = message_input()
    taker.ingest('voltage', view(0, ('motor',), (5.0,)), 0)
    results = results_of(taker.ingest('torque', view(0, ('motor',), (0.1,)), 0))
    assert math.isnan(results[0].sample.speed_rad_s[0])
    assert not observer.motors['motor'].white_box.speed_measured


def test_every_message_is_accounted_for() -> None:
    taker, observer = message_input()
    random = np.random.default_rng(1)
    torques = 0
    for k in range(500):
        taker.ingest('voltage', view(k * 10_000_000, ('motor',), (5.0,)), 0)
        kind = random.integers(4)
        torques += 1
        if kind == 0:
            taker.ingest('torque', view(k * 10_000_000, ('motor',), ()), 0)
        else:
            taker.ingest(
                'torque', view(k * 10_000_000, ('motor',), (math.nan if kind == 1 else 0.1,)), 0
            )
    pairing = observer.counts('motor')
    malformed = taker.rejection_counts['torque'].total()
    assert malformed > 50
    assert pairing.rejected[Rejection.NON_FINITE] > 50
    assert (
        torques == malformed + pairing.used_count + pairing.rejected.total() + pairing.waiting_count
    )
