"""What goes out, and how often."""

from __future__ import annotations

import math
from array import array
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray, MultiArrayDimension

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimates
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.observer.motor_group import GroupResult
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.parameter_belief import ParameterBelief
from gray_box_observer.ros import topics
from gray_box_observer.ros.observer.latched import LatchedTopic
from gray_box_observer.ros.observer.message_templates import (
    JointMessages,
    MessageTemplate,
    NumberMessages,
)
from gray_box_observer.ros.observer.serialized_publisher import SerializedPublisher
from gray_box_observer.ros.observer.topic_outputs import Outputs
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox


class Publisher:
    """Stands in for a lifecycle publisher of an active node."""

    def __init__(self, sent: list, topic: str) -> None:
        self.is_activated = True
        self.handle = SimpleNamespace(publish_raw=lambda data: sent.append((topic, data)))

    def on_activate(self, _):
        """Let messages out."""
        self.is_activated = True

    def on_deactivate(self, _):
        """Hold them back."""
        self.is_activated = False


class Node:
    """Keeps what its publishers are given."""

    def __init__(self) -> None:
        self.sent = []
        self.destroyed = []

    def create_lifecycle_publisher(self, kind, topic, qos, **_):
        """Make one that only remembers."""
        return Publisher(self.sent, topic)

    def destroy_lifecycle_publisher(self, publisher):
        """Let one go."""
        self.destroyed.append(publisher)


def test_what_is_serialised_goes_out_while_the_node_is_active_and_the_topic_there() -> None:
    node = Node()
    publisher = SerializedPublisher(node, topics.PREDICTED_TORQUE, 'topic')
    publisher.deactivate()
    publisher(b'held back')
    assert not publisher.is_active
    publisher.activate()
    publisher(b'out')
    publisher.destroy()
    publisher(b'too late')
    assert node.sent == [('topic', b'out')]


def test_a_correction_leaves_an_inactive_topic_inactive_though_its_publisher_had_gone() -> None:
    node = Node()
    topic = LatchedTopic(node, topics.IDENTIFIED, motor='motor')
    topic(b'yes')
    topic.retract()
    assert not topic.holds_value
    topic(b'yes')
    topic._publisher.deactivate()
    topic.correct(b'no')
    assert topic.holds_value
    assert not topic.is_active
    assert [data for _, data in node.sent] == [b'yes', b'yes', b'no']


def predicted(node: Node) -> list[tuple[int, float]]:
    messages = [
        deserialize_message(data, JointState)
        for topic, data in node.sent
        if topic.endswith('predicted_torque')
    ]
    return [(m.header.stamp.nanosec, m.effort[0]) for m in messages]


def alarms(node: Node) -> list[bool]:
    return [
        deserialize_message(data, Bool).data for topic, data in node.sent if topic.endswith('alarm')
    ]


def result(stamp_ns: int, torque_nm: float, interval_s: float = 0.01):
    sample = SimpleNamespace(stamp_ns=stamp_ns, interval_s=np.array([interval_s]))
    prediction = SimpleNamespace(torque_nm=np.array([torque_nm]))
    group = SimpleNamespace(names=('motor',), observer=None)
    done = SimpleNamespace(alarm=np.array([False]), speed=None, speeds=None)
    return GroupResult(group, sample, prediction, np.array([], dtype=int), None, done)


def test_a_stamp_is_predicted_once_though_voltages_come_in_a_bunch_before_their_torques():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    for stamp_ns in (1, 2, 3, 3):
        outputs.prediction(('motor',), stamp_ns, np.array([0.1 * stamp_ns]))
    outputs.results([result(1, 1.0), result(2, 2.0)])
    outputs.results(
        [result(3, 3.0), result(4, 4.0)]
    )  # the voltage of the fourth came after its torque
    assert [stamp for stamp, _ in predicted(node)] == [1, 2, 3, 4]
    assert predicted(node)[-1] == (4, 4.0)


def test_stamps_that_come_again_after_a_clock_was_set_back_are_predicted_again():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    for _ in range(2):
        outputs.prediction(('motor',), 1, np.array([0.5]))
        outputs.results([result(1, 0.5)])
    assert [stamp for stamp, _ in predicted(node)] == [1, 1]


def test_stamps_of_voltages_between_torques_are_predicted_again_after_a_clock_was_set_back():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    for _ in range(2):  # a recording that is played in a loop
        outputs.results([result(1, np.nan, interval_s=0.0)])
        for stamp_ns in (2, 3):
            outputs.prediction(('motor',), stamp_ns, np.array([0.1]))
        outputs.results([result(3, 0.1)])
    assert [stamp for stamp, _ in predicted(node)] == [2, 3, 2, 3]


NAN = math.nan


def speeds_result(stamp_ns: int, speed: list[float], std: list[float], present=None):
    sample = SimpleNamespace(stamp_ns=stamp_ns, interval_s=np.full(3, 0.01), present=present)
    group = SimpleNamespace(names=('a', 'b', 'c'), observer=None)
    speeds = SpeedEstimates(np.array(speed), np.array(std))
    done = SimpleNamespace(alarm=np.zeros(3, dtype=bool), speed=None, speeds=speeds)
    return GroupResult(group, sample, None, np.array([], dtype=int), None, done)


def stds_sent(node: Node, motor: str) -> list[float]:
    return sent_to(node, 'speed_std', Float64, motor)


def test_speeds_of_a_group_go_out_together_and_deviations_where_they_have_moved() -> None:
    node = Node()
    flat = {'motors': ['a', 'b', 'c'], 'predictor': False}
    for motor in flat['motors']:
        flat |= {f'{motor}.speed_source': 'rotor', f'{motor}.back_emf_constant': 0.02}
    outputs = Outputs(node, Configuration.from_flat(flat))
    outputs.results([speeds_result(1, [1.0, 2.0, NAN], [0.1, 0.2, NAN])])
    outputs.results([speeds_result(2, [1.5, 2.5, NAN], [0.105, 0.3, NAN])])
    data = [data for topic, data in node.sent if topic == '~/speed']
    told = [deserialize_message(one, JointState) for one in data]
    assert [list(one.name) for one in told] == [['a', 'b']] * 2
    assert list(told[1].velocity) == [1.5, 2.5]
    assert stds_sent(node, 'a') == [0.1]
    assert stds_sent(node, 'b') == [0.2, 0.3]
    away = np.array([True, False, True])
    outputs.results([speeds_result(3, [1.5, NAN, NAN], [0.1, NAN, NAN], away)])
    assert node.destroyed == []  # who is absent from a message is not forgotten
    outputs.results([speeds_result(4, [1.5, NAN, NAN], [0.1, NAN, NAN])])
    assert len(node.destroyed) == 1  # of b nothing is believed any more
    outputs.forget_published()
    outputs.results([speeds_result(5, [1.5, NAN, 7.0], [0.1, NAN, 0.7])])
    assert stds_sent(node, 'a') == [0.1, 0.1]
    assert stds_sent(node, 'c') == [0.7]
    outputs.retract_motor('a')
    outputs.results([speeds_result(6, [1.5, NAN, 7.0], [0.1, NAN, 0.7])])
    assert stds_sent(node, 'a') == [0.1, 0.1, 0.1]
    assert stds_sent(node, 'c') == [0.7]


def test_what_is_not_finite_is_no_prediction():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    outputs.prediction(('motor',), 1, np.array([np.nan]))
    outputs.results([result(1, np.nan), result(2, 0.2)])
    assert predicted(node) == [(2, 0.2)]


def test_bytes_that_are_used_again_are_the_message_that_would_be_built() -> None:
    torques = JointMessages()
    for names, stamp_ns, values in (
        (('motor',), 1_234_567_890_123, [0.25]),
        (('motor',), 7, [-1e-9]),
        (('a', 'longer name', ''), 2_000_000_000_999_999_999, [1.0, 2.0, 3.0]),
        (('motor',), 8, [1e300]),
    ):
        data = torques.render(names, stamp_ns, np.array(values))
        message = deserialize_message(data, JointState)
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(
            stamp_ns, 1_000_000_000
        )
        assert message.header.frame_id == ''
        assert (tuple(message.name), list(message.effort)) == (names, values)
        assert not message.position
        assert not message.velocity


@pytest.mark.parametrize('numbers', [np.zeros(1), np.zeros(3), np.zeros(2, dtype=np.float32)])
def test_numbers_that_do_not_fit_a_form_leave_it_what_it_was(numbers: np.ndarray) -> None:
    template = MessageTemplate(lambda marks: Float64MultiArray(data=marks), 2)
    with pytest.raises(ValueError):
        template.render(numbers)
    assert list(
        deserialize_message(template.render(np.array([1.0, 2.0])), Float64MultiArray).data
    ) == [
        1.0,
        2.0,
    ]


def test_what_was_given_out_stays_what_it_was_when_the_form_is_used_again() -> None:
    template = NumberMessages()
    torques = JointMessages()
    values = [template.render(value) for value in (1.0, 2.0)]
    assert [deserialize_message(data, Float64).data for data in values] == [1.0, 2.0]
    messages = [
        torques.render(('motor',), stamp_ns, np.array([0.1 * stamp_ns])) for stamp_ns in (1, 2)
    ]
    read = [deserialize_message(data, JointState) for data in messages]
    assert [(one.header.stamp.nanosec, one.effort[0]) for one in read] == [(1, 0.1), (2, 0.2)]


def test_an_estimate_goes_out_as_the_messages_that_would_be_built() -> None:
    node = Node()
    parameters = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {}).parameters
    outputs = Outputs(node, Configuration.from_flat({}))
    n = len(parameters)
    size = len(parameters) ** 2
    for scale in (1.0, -2e-300):
        node.sent.clear()
        value = scale * np.arange(1.0, n + 1.0)
        covariance = scale * np.arange(float(size))
        estimate = SimpleNamespace(
            parameters=parameters,
            value=value[None],
            covariance=covariance.reshape(1, n, n),
            identified=lambda motor, scale=scale: scale > 0.0,
        )
        outputs.estimate('motor', estimate)
        wanted = Float64MultiArray(data=array('d', covariance))
        label = ','.join(p.name for p in parameters)
        wanted.layout.dim = [
            MultiArrayDimension(label=label, size=n, stride=stride) for stride in (size, n)
        ]
        messages = [Float64(data=one) for one in value.tolist()] + [wanted, Bool(data=scale > 0.0)]
        assert [topic for topic, _ in node.sent] == [
            *(f'~/motor/{p.name}' for p in parameters), '~/motor/covariance', '~/motor/identified'
        ]  # fmt: skip
        sent = [
            deserialize_message(data, type(m))
            for (_, data), m in zip(node.sent, messages, strict=True)
        ]
        assert sent == messages


def sent_to(node: Node, name: str, kind: type, motor: str = 'motor') -> list[object]:
    return [
        deserialize_message(data, kind).data
        for topic, data in node.sent
        if topic == f'~/{motor}/{name}'
    ]


def test_a_fit_goes_out_once_tested_and_when_it_changes_and_is_0_where_it_is_known_no_more() -> (
    None
):
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    for ratio in (math.nan, 1.25, 1.25, math.inf, 7.5):
        outputs.fit('motor', FitAssessment(FitVerdict.OK, ratio))
    assert sent_to(node, 'fit', Float64) == [1.25, 7.5]
    outputs.fit('stranger', FitAssessment(FitVerdict.OK, 2.0))
    outputs.forget_published()
    for _ in range(2):
        outputs.fit('motor', FitAssessment())
    assert sent_to(node, 'fit', Float64) == [1.25, 7.5, 0.0]
    outputs.fit('motor', FitAssessment(FitVerdict.OK, 7.5))
    outputs.retract()
    outputs.retract_motor('motor')
    assert sent_to(node, 'fit', Float64) == [1.25, 7.5, 0.0, 7.5, 0.0]


def test_identified_parameters_go_out_on_change_and_again_when_nobody_may_have_heard() -> None:
    node = Node()
    parameters = MotorWhiteBox(('inductance', 'resistance', 'hysteresis'), 0.01, {}).parameters
    outputs = Outputs(node, Configuration.from_flat({}))
    for known in (
        (False, False, False),
        (False, True, False),
        (False, True, False),
        (True, True, True),
    ):
        outputs.parameters_identified('motor', parameters, known)
    assert sent_to(node, 'inductance/identified', Bool) == [False, True]
    assert sent_to(node, 'resistance/identified', Bool) == [False, True]
    outputs.forget_published()
    outputs.parameters_identified('motor', parameters, (True, True, True))
    assert sent_to(node, 'inductance/identified', Bool) == [False, True, True]


def test_what_is_not_finite_of_an_estimate_does_not_go_out() -> None:
    node = Node()
    parameters = MotorWhiteBox(('inductance', 'resistance'), 0.01, {}).parameters
    outputs = Outputs(
        node, Configuration.from_flat({'motor.context_nodes': ['inductance', 'resistance']})
    )
    covariance = np.array([[[np.nan, 0.0], [0.0, 1.0]]])
    verdicts = ((Verdict.CONVERGING, Verdict.IDENTIFIED),)
    estimate = Estimate(1, parameters, np.array([[np.inf, 2.0]]), covariance, verdicts)
    outputs.estimate('motor', estimate)
    assert [topic for topic, _ in node.sent] == ['~/motor/resistance', '~/motor/identified']
    outputs.all_estimates(['motor', 'other'], [(('motor',), estimate)])
    table = deserialize_message(node.sent[-1][1], Float64MultiArray)
    assert list(table.data) == [0.0, -1.0, 2.0, 1.0, 0.0, -1.0, 0.0, -1.0]


def test_motors_of_which_nothing_is_predicted_are_left_out_of_the_message() -> None:
    torques = JointMessages()
    message = deserialize_message(
        torques.render(('a', 'b', 'c'), 1, np.array([0.1, np.nan, 0.3])), JointState
    )
    assert (message.name, list(message.effort)) == (['a', 'c'], [0.1, 0.3])
    assert torques.render(('a',), 1, np.array([np.nan])) is None


def test_an_alarm_goes_out_when_it_changes_and_only_then():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    for raised in (False, False, True, True, False):
        one = result(1, 1.0)
        one.update.alarm = np.array([raised])
        outputs.alarms([one])
    assert alarms(node) == [False, True, False]


def test_an_alarm_that_was_announced_in_between_is_told_again_where_samples_say_otherwise():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({}))
    one = result(1, 1.0)
    one.update.alarm = np.array([True])
    outputs.alarms([one])
    outputs.alarm('motor', False)  # a checkpoint was loaded in which it did not stand
    outputs.alarms([one])
    outputs.alarm('motor', True)
    outputs.alarms([one])
    assert alarms(node) == [True, False, True, True]


def test_of_a_time_beyond_what_a_stamp_can_tell_nothing_goes_out_and_nobody_falls():
    node = Node()
    outputs = Outputs(node, Configuration.from_flat({'horizon_s': 1.0}))
    last_ns = 2**31 * 1_000_000_000 - 1
    for stamp_ns in (last_ns, last_ns + 1, -(2**31) * 1_000_000_000 - 1):
        outputs.prediction(('motor',), stamp_ns, np.array([0.5]))
        outputs.forecast(('motor',), stamp_ns, np.array([0.5]))
    stamps = [deserialize_message(data, JointState).header.stamp for _, data in node.sent]
    assert [(stamp.sec, stamp.nanosec) for stamp in stamps] == [(2**31 - 1, 999_999_999)] * 2


def test_a_test_of_the_fit_publishes_no_estimate_that_is_not_finite(monkeypatch) -> None:
    node = Node()
    configuration = Configuration.from_flat({'predictor': False})
    outputs = Outputs(node, configuration)
    observer = Observer(configuration)
    observer.voltage('motor', 1, 5.0)
    observer.torque('motor', 1, 0.1)
    group = observer.group_of('motor')
    real = ParameterBelief.published
    monkeypatch.setattr(
        ParameterBelief,
        'published',
        lambda *given: replace(real(*given), value=np.full((1, 3), np.nan)),
    )
    monkeypatch.setattr(MotorObserver, 'retested', lambda self: {0: True})
    observer.contain(group, partial(outputs.publish_tested, group))
    assert 'not finite' in observer.incidents['motor'].reason
    assert not sent_to(node, 'resistance', Float64)
    assert not sent_to(node, 'covariance', Float64MultiArray)
