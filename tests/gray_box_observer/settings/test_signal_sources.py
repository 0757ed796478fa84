"""Parameters of expressions and their inputs: what is refused, and by what name."""

from __future__ import annotations

from typing import Any

import pytest

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.settings.configuration import Configuration

DUTY = {
    'voltage.expression': 'duty * battery',
    'duty.topic': 'duty',
    'battery.topic': 'battery',
}


def test_inputs_have_a_group_of_their_own() -> None:
    configuration = Configuration.from_flat(DUTY | {'battery.scale': 2, 'battery.stale_s': 60.0})
    assert configuration['battery.scale'] == 2.0
    assert configuration['duty.field'] == 'data'
    assert configuration.unknown == ()
    assert configuration.notable().keys() >= {'duty.topic', 'battery.scale', 'voltage.expression'}
    again = configuration.with_values({'gap_s': 2.0})
    assert again['battery.scale'] == 2.0
    assert again.feeds == configuration.feeds
    assert [feed.topic for feed in configuration.feeds] == ['motor/torque', 'duty', 'battery']


@pytest.mark.parametrize(
    ('given', 'complaint'),
    [
        ({'voltage.expression': 'duty * batery'}, 'batery.topic is not given: did you mean batt'),
        ({'voltage.expression': 'duty *'}, r"voltage.expression: 'duty \*' is no arithmetic"),
        ({'voltage.expression': '12'}, 'names no input'),
        ({'voltage.expression': 'duty * $2'}, "'2' is no name of an input"),
        ({'voltage.expression': "duty * 'a b'"}, "'a b' is no name of an input"),
        ({'voltage.expression': 'duty * motor'}, 'motor is the name of a motor or of parameters'),
        ({'voltage.expression': 'duty * speed'}, 'speed is the name of a motor or of parameters'),
        ({'torque.expression': 'Kt * duty'}, 'Kt.topic is not given: did you mean torque_constant'),
        ({'duty.topic': ''}, 'duty.topic is empty'),
        ({'duty.type': 'Float64'}, 'duty.type must be a message type'),
        ({'duty.scale': 0.0}, 'duty.scale must be a finite number other than 0'),
        ({'duty.field': 'a..b'}, 'duty.field: .* is no field path'),
        ({'duty.stale_s': -1.0}, 'duty.stale_s must be in'),
        ({'voltage.topic': 'somewhere'}, 'voltage.topic is given beside voltage.expression'),
        (
            {'battery.topic': 'duty', 'battery.type': 'std_msgs/msg/Float32'},
            'duty.type and battery.type differ',
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(given: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigurationError, match=complaint) as caught:
        Configuration.from_flat(DUTY | given)
    assert '\n' not in str(caught.value)


def test_a_slip_in_the_group_of_an_input_is_named_with_what_was_meant() -> None:
    configuration = Configuration.from_flat(DUTY | {'battery.stale': 3.0})
    assert configuration.unknown == ('battery.stale',)
    assert 'battery.stale_s' in configuration.alike('battery.stale')


def test_two_motors_cannot_have_one_joint() -> None:
    given = {'motors': ['a', 'b'], 'a.joint': 'wheel', 'b.joint': 'wheel'}
    with pytest.raises(ConfigurationError, match="two motors have the joint 'wheel'"):
        Configuration.from_flat(given)
