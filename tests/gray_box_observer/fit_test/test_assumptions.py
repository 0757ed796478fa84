"""What nobody has stated of a motor is said aloud, with the remedy; what was stated is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gray_box_observer.fit_test.assumptions import (
    CURRENT_IN_A,
    DEFAULT_KB,
    DEFAULT_KT,
    TORQUE_IN_NM,
    UNSEEN_ROTOR,
    assumptions,
)
from gray_box_observer.identify.offline_run import run
from gray_box_observer.observer.motor_view import MOST_JUDGED
from gray_box_observer.settings.configuration import Configuration

BAGS = Path(__file__).resolve().parents[3] / 'bags'


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


def of_sizes(volts: float, torque_nm: float, **given: Any) -> str:
    """What is said of a torque whose size may be absurd, beside a measured speed."""
    values = {'motor.torque_constant': 0.02, 'motor.back_emf_constant': 0.02}
    values |= {name.replace('__', '.'): value for name, value in given.items()}
    motor = Configuration.from_flat(values).motors['motor']
    signs = np.where(np.arange(400) % 80 < 40, 1.0, -1.0)
    samples = np.stack([np.full(400, 0.01), volts * signs, torque_nm * signs, np.zeros(400)])
    samples[:, 17] = np.nan
    samples[2, 18] = 1e9  # a spike is no size
    findings = assumptions(motor, motor.white_box(speed_measured=True), samples)
    return findings.get(CURRENT_IN_A if motor.reads_current else TORQUE_IN_NM, '')


def test_a_current_that_only_the_largest_drives_take_may_be_the_signal_itself() -> None:
    text = of_sizes(24.0, 24.0)
    assert '1.2e+03 A' in text
    assert 'set torque.quantity: current if the signal is a current' in text
    assert 'check motor.torque_constant or torque.scale' in text


def test_a_signal_that_is_read_as_a_current_already_may_be_in_other_units() -> None:
    text = of_sizes(24.0, 2400.0 * 0.02, torque__quantity='current')  # 2400 mA
    assert '2.4e+03 A' in text
    assert 'check torque.scale' in text
    assert 'quantity' not in text
    assert of_sizes(24.0, 2.4 * 0.02, torque__quantity='current') == ''


def test_a_current_next_to_nothing_is_told_but_not_taken_for_a_current_in_disguise() -> None:
    text = of_sizes(24.0, 1e-8)
    assert '5e-07 A at 24 V' in text
    assert 'quantity' not in text
    text = of_sizes(24.0, 1e-8, torque__quantity='current')
    assert 'set torque.quantity: torque if the signal is a torque' in text


@pytest.mark.parametrize(
    ('volts', 'torque_nm', 'given'),
    [
        (24.0, 0.04, {}),
        (48.0, 16.0, {}),  # 800 A of a fork-lift truck
        (400.0, 1e-4, {}),  # almost nothing at no load
        (1e-4, 0.1, {}),  # 5 A at no voltage: a rotor that is braked or turned
        (0.0, 0.1, {}),
        (24.0, 0.0, {}),  # unplugged
        (0.0, 0.0, {}),
        (24.0, 24.0, {'motor__initial_relative_std__resistance': 0.2}),
        (24.0, 24.0, {'motor__known__resistance': 0.02, 'motor__context_nodes': ['inductance']}),
    ],
)
def test_sizes_that_a_motor_may_have_or_whose_resistance_is_stated_are_no_matter(
    volts: float, torque_nm: float, given: dict[str, Any]
) -> None:
    assert of_sizes(volts, torque_nm, **given) == ''


@pytest.mark.slow
@pytest.mark.parametrize('name', ['drift', 'moderate', 'training_set'])
@pytest.mark.parametrize('params', [{}, {'motor.torque_constant': 0.01}])
def test_no_size_is_doubted_in_the_bags_that_are_shipped(name: str, params: dict[str, Any]) -> None:
    outcome = run([BAGS / name], Configuration.from_flat({'predictor': False, **params}), None)
    (motor,) = outcome.observer.motors.values()
    assert motor.newest(MOST_JUDGED).shape == (6, MOST_JUDGED)
    assert not {TORQUE_IN_NM, CURRENT_IN_A} & motor.assumptions.keys()


def test_a_configuration_tells_what_sets_it_apart() -> None:
    configuration = Configuration.from_flat({'gap_s': 0.7, 'motor.initial.resistance': 3.0})
    notable = configuration.notable()
    assert notable == {
        'gap_s': 0.7,
        'motor.torque_constant': 0.01,
        'motor.back_emf_constant': 0.01,
        'motor.initial.resistance': 3.0,
    }
