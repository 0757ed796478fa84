"""What nobody has stated of a motor is said aloud, with the remedy; what was stated is not."""

from __future__ import annotations

from typing import Any

import pytest

from gray_box_observer.fit_test.assumptions import (
    DEFAULT_KB,
    DEFAULT_KT,
    UNSEEN_ROTOR,
    assumptions,
)
from gray_box_observer.settings.configuration import Configuration


def assumed(*, measured: bool = False, **given: Any) -> dict[str, str]:
    values = {f'motor.{name.replace("__", ".")}': value for name, value in given.items()}
    motor = Configuration.from_flat(values).motors['motor']
    return assumptions(motor, motor.white_box(speed_measured=measured))


def test_what_is_not_stated_of_a_motor_is_assumed_and_the_remedy_is_named() -> None:
    found = assumed()
    assert list(found) == [UNSEEN_ROTOR, DEFAULT_KT, DEFAULT_KB]
    assert 'set motor.torque_constant' in found[DEFAULT_KT]
    assert 'motor.speed_source: torque_constant' in found[UNSEEN_ROTOR]
    assert 'set motor.back_emf_constant' in found[DEFAULT_KB]


def test_a_measured_speed_leaves_kt_and_kb() -> None:
    assert list(assumed(measured=True)) == [DEFAULT_KT, DEFAULT_KB]


@pytest.mark.parametrize(
    'given',
    [
        {'speed_source': 'torque_constant'},
        {'initial_relative_std__resistance': 0.1},
        {'context_nodes': ['inductance', 'hysteresis'], 'known__resistance': 4.0},
    ],
)
def test_who_says_that_the_speed_follows_the_current_or_has_a_data_sheet_is_not_asked(
    given: dict[str, Any],
) -> None:
    assert list(assumed(**given)) == [DEFAULT_KT, DEFAULT_KB]


def test_a_kt_that_is_stated_counts_even_where_it_is_the_default() -> None:
    assert DEFAULT_KT not in assumed(torque_constant=0.01)


@pytest.mark.parametrize(
    'reading',
    [
        {'torque.quantity': 'current'},
        {
            'torque.expression': 'torque_constant * current',
            'current.topic': '/current',
        },
    ],
)
def test_where_a_current_is_read_kt_scales_no_resistance(reading: dict[str, Any]) -> None:
    motor = Configuration.from_flat(reading).motors['motor']
    assert motor.reads_current
    found = assumptions(motor, motor.white_box(speed_measured=True))
    assert list(found) == [DEFAULT_KB]


def test_a_kb_that_is_stated_counts_even_where_it_is_the_default() -> None:
    assert DEFAULT_KB not in assumed(back_emf_constant=0.01)


def test_what_is_stated_for_all_motors_counts_for_each_and_outlasts_a_change() -> None:
    given = {
        'motors': ['a', 'b'],
        'defaults.back_emf_constant': 0.01,
        'b.speed_source': 'torque_constant',
    }
    configuration = Configuration.from_flat(given).with_values({'gap_s': 0.7})
    assert configuration.motors['a'].stated_names == {'back_emf_constant'}
    assert configuration.motors['b'].stated_names == {'back_emf_constant', 'speed_source'}


def test_a_configuration_tells_what_sets_it_apart() -> None:
    configuration = Configuration.from_flat({'gap_s': 0.7, 'motor.initial.resistance': 3.0})
    notable = configuration.notable()
    assert notable == {
        'gap_s': 0.7,
        'motor.torque_constant': 0.01,
        'motor.back_emf_constant': 0.01,
        'motor.initial.resistance': 3.0,
    }
