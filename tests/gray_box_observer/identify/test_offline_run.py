from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dc_motor_sim.simulation import Recording
from gray_box_observer.bag.joint_state import encode_joint_state
from gray_box_observer.errors import BagError, ConfigurationError
from gray_box_observer.identify.offline_run import Outcome, match_topics, run
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.settings.configuration import Configuration

Messages = list[tuple[str, int, bytes]]


def observe(*bags: Path, training: Any = None, **given: Any) -> Outcome:
    small = {'training.hidden': 3, 'training.context': 8, 'training.steps': 3}
    predicts = {'predictor': training is not None}
    return run(bags, Configuration.from_flat({**small, **predicts, **given}), training)


@pytest.fixture(scope='module')
def messages(record: Callable[..., Recording], messages_of: Callable[..., Messages]) -> Messages:
    return messages_of(record('R[5,15]D[0.2,2]', 10.0))


@pytest.mark.slow
def test_a_bag_identifies_the_motor_it_was_recorded_of(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> None:
    outcome = observe(write_bag(tmp_path / 'bag', messages_of(record())))
    np.testing.assert_allclose(
        outcome.observer.estimates()['motor'].value, [[0.5, 1.0, 10.0]], rtol=0.02
    )
    assert outcome.observer.counts('motor').used_count == 6000
    course = outcome.courses['motor']
    assert (course.first_ns, course.last_ns) == (10**9, 10**9 + 59_990_000_000)
    assert outcome.warnings == []


@pytest.mark.slow
def test_the_same_bag_gives_the_same_digest(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    first, second = (observe(bag, training=InlineTraining).digest for _ in range(2))
    assert first == second
    assert len(first) == 64
    shorter = write_bag(tmp_path / 'shorter', messages[: len(messages) // 2])
    assert observe(shorter).digest != first


@pytest.mark.slow
def test_the_predictor_has_no_say_in_the_estimates(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    assert (
        observe(bag, predictor=True).digest
        == observe(bag, training=InlineTraining).digest
        == observe(bag, predictor=False).digest
    )


@pytest.mark.parametrize('order', ['torque first', 'voltage ahead', 'torque ahead', 'bursts'])
def test_the_order_in_which_messages_came_does_not_change_the_digest(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages, order: str
) -> None:
    random = np.random.default_rng(1)
    late = {
        'torque first': {'/motor/voltage': 1_000_000, '/motor/torque': 0},
        'voltage ahead': {'/motor/voltage': 0, '/motor/torque': 15_000_000},
        'torque ahead': {'/motor/voltage': 45_000_000, '/motor/torque': 0},
    }
    if order == 'bursts':  # each topic in its own order, but delivered in lumps
        newest = {'/motor/voltage': 0, '/motor/torque': 0}
        delayed = []
        for topic, at, data in messages:
            newest[topic] = max(newest[topic], at + int(random.integers(0, 80_000_000)))
            delayed.append((topic, newest[topic], data))
    else:
        delayed = [(topic, at + late[order][topic], data) for topic, at, data in messages]
    delayed.sort(key=lambda message: message[1])
    straight = write_bag(tmp_path / 'a', messages)
    crooked = write_bag(tmp_path / 'b', delayed)
    assert [m[0] for m in delayed] != [m[0] for m in messages]
    assert observe(straight).digest == observe(crooked).digest


def test_a_bag_in_two_parts_continues_where_the_first_ended(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    whole = observe(write_bag(tmp_path / 'whole', messages))
    half = len(messages) // 2
    parts = [
        write_bag(tmp_path / 'one', messages[:half]),
        write_bag(tmp_path / 'two', messages[half:]),
    ]
    assert observe(*parts).digest == whole.digest


def test_an_older_bag_after_a_newer_one_restarts_the_history_and_keeps_the_estimate(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    outcome = observe(bag, bag)
    assert outcome.observer.counts('motor').restarts >= 1
    assert outcome.observer.counts('motor').used_count == 2000
    np.testing.assert_allclose(
        outcome.observer.estimates()['motor'].value, [[0.5, 1.0, 10.0]], rtol=0.02
    )


def test_broken_messages_are_counted_and_skipped(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    broken = [*messages]
    for k in (101, 301, 501):
        broken[k] = (broken[k][0], broken[k][1], broken[k][2][:30])
    outcome = observe(write_bag(tmp_path / 'bag', broken))
    assert {
        name: counts.total() for name, counts in outcome.message_input.rejection_counts.items()
    } == {
        'voltage': 0,
        'torque': 3,
        'speed': 0,
    }
    assert outcome.observer.counts('motor').used_count == 997


@pytest.mark.parametrize(
    ('wanted', 'available', 'found'),
    [
        ('motor/torque', ['/motor/torque', '/robot/motor/torque'], ['/motor/torque']),
        ('motor/torque', ['/robot/motor/torque', '/x'], ['/robot/motor/torque']),
        ('/motor/torque', ['/robot/motor/torque'], []),
        (
            'motor/torque',
            ['/a/motor/torque', '/b/motor/torque'],
            ['/a/motor/torque', '/b/motor/torque'],
        ),
        ('torque', ['/pretorque'], []),
    ],
)
def test_a_topic_is_found_behind_a_namespace(
    wanted: str, available: list[str], found: list[str]
) -> None:
    assert match_topics(wanted, available) == found


def test_a_missing_topic_is_named_with_what_there_is(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    only = [message for message in messages if message[0] == '/motor/voltage']
    bag = write_bag(tmp_path / 'bag', only, ('/motor/voltage',))
    with pytest.raises(
        BagError, match=r'has no topic motor/torque; it has: /motor/voltage.*torque\.topic'
    ):
        observe(bag)


def test_a_topic_that_could_be_several_is_not_guessed(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    both = [(f'/{side}{topic}', at, data) for topic, at, data in messages for side in 'ab']
    bag = write_bag(tmp_path / 'bag', both, tuple({message[0] for message in both}))
    with pytest.raises(BagError, match='has 2 topics that could be motor/voltage'):
        observe(bag)
    assert observe(
        bag, **{'voltage.topic': '/a/motor/voltage', 'torque.topic': '/b/motor/torque'}
    ).digest


def test_torque_without_any_voltage_is_no_usable_sample(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(
        tmp_path / 'bag', [message for message in messages if message[0] == '/motor/torque']
    )
    with pytest.raises(BagError, match=r'no usable sample.*no_voltage'):
        observe(bag)


def test_a_bag_of_other_motors_says_whose_it_is(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    with pytest.raises(
        BagError, match='no usable sample of motor left; the messages speak of motor'
    ):
        observe(bag, motors=['left'])


def test_a_field_that_the_messages_do_not_have_is_an_error_that_names_it(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    with pytest.raises(ConfigurationError, match=r"torque\.field 'wrench\.torque\.z'"):
        observe(bag, **{'torque.field': 'wrench.torque.z'})


def test_a_type_that_the_node_would_not_hear_is_a_warning(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    (warning,) = observe(bag, **{'torque.type': 'geometry_msgs/msg/WrenchStamped'}).warnings
    assert (
        '/motor/torque is of type sensor_msgs/msg/JointState, but torque.type is '
        'geometry_msgs/msg/Wrench' in warning
    )
    assert observe(bag, **{'torque.type': 'sensor_msgs/JointState'}).warnings == []


def test_one_topic_may_carry_voltage_and_torque(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages: Messages,
) -> None:
    recording = record('R[5,15]D[0.2,2]', 10.0)
    signals = zip(
        recording.stamp_ns + 10**9, recording.voltage_v[0], recording.torque_nm[0], strict=True
    )
    both = [
        (
            '/both',
            int(at),
            encode_joint_state(int(at), ('motor',), position=(voltage,), effort=(torque,)),
        )
        for at, voltage, torque in signals
    ]
    given = {'voltage.topic': 'both', 'voltage.field': 'position', 'torque.topic': 'both'}
    together = observe(write_bag(tmp_path / 'together', both, ('/both',)), **given)
    assert together.digest == observe(write_bag(tmp_path / 'apart', messages)).digest


@pytest.mark.slow
@pytest.mark.parametrize('rule', ['recursive', 'gradient'])
def test_a_motor_whose_resistance_is_known_gives_the_rest(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
    rule: str,
) -> None:
    bag = write_bag(
        tmp_path / 'bag', messages_of(record('R[5,15]D[0.2,2]', 40.0, torque_noise_std=2.2e-5))
    )
    nodes = ['inductance', 'hysteresis']
    given = {'context_update': rule, 'motor.context_nodes': nodes, 'motor.known.resistance': 1.0}
    estimate = observe(bag, **given).observer.estimates()['motor']
    assert [parameter.name for parameter in estimate.parameters] == nodes
    np.testing.assert_allclose(
        estimate.value, [[0.5, 10.0]], rtol=0.01 if rule == 'recursive' else 0.05
    )
    without = observe(bag, **{**given, 'motor.known.resistance': 0.0}).observer.estimates()['motor']
    assert without.value[0, 1] > 12.0  # K_HS has to stand for the resistance too


def test_progress_counts_every_message(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    counted = []
    run([bag], Configuration.from_flat({}), None, None, counted.append)
    assert sum(counted) == len(messages)


@pytest.mark.slow
def test_two_motors_in_one_bag_are_both_identified(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> None:
    recording = record('R[5,15]D[0.2,3]', 30.0, 2, ('a', 'b'))
    outcome = observe(write_bag(tmp_path / 'bag', messages_of(recording)), motors=['a', 'b'])
    for motor, resistance in (('a', 1.0), ('b', 1.5)):
        assert outcome.observer.estimates()[motor].value[0, 1] == pytest.approx(
            resistance, rel=0.02
        )


def test_a_scaled_current_is_as_good_as_torque(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    record: Callable[..., Recording],
    messages_of: Callable[..., Messages],
) -> None:
    recording = record('R[5,15]D[0.2,2]', 10.0)
    current = [
        (topic, at, data)
        if topic == '/motor/voltage'
        else (
            topic,
            at,
            encode_joint_state(at, ('motor',), effort=recording.torque_nm[:, k // 2] / 0.01),
        )
        for k, (topic, at, data) in enumerate(messages_of(recording))
    ]
    outcome = observe(write_bag(tmp_path / 'bag', current), **{'torque.scale': 0.01})
    np.testing.assert_allclose(
        outcome.observer.estimates()['motor'].value, [[0.5, 1.0, 10.0]], rtol=0.05
    )


def test_a_bag_of_which_no_message_has_the_length_for_the_field_says_so(
    tmp_path: Path, write_bag: Callable[..., Path], messages: Messages
) -> None:
    bag = write_bag(tmp_path / 'bag', messages)
    with pytest.raises(
        BagError, match=r'no usable sample.*effort has 1 values, so there is no \[3\]'
    ):
        observe(bag, **{'torque.field': 'effort[3]'})
