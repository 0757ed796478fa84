"""A joint whose load varies, its speed unmeasured: R and L are found, the rotor stays open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, feed, observed, recorded_under, told

from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_form import ROTOR, VARYING_LOAD, FormKind
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 12000
MOTOR = replace(GEAR_MOTOR, inductance=6e-3)
LARGEST_LOAD_NM = 0.02
GEAR_RATIO = 50.0

ELECTRICAL = ('inductance', 'resistance')
MECHANICAL = ('inertia', 'viscous_friction', 'coulomb_friction')


@cache
def arm(samples: int = SAMPLES, seed: int = 1) -> Recording:
    """A gear motor that swings an arm: its load follows the sine of the arm's angle."""
    return recorded_under(
        MOTOR, lambda rad: LARGEST_LOAD_NM * float(np.sin(rad / GEAR_RATIO)), samples, seed
    )


@cache
def observer_of_arm() -> Observer:
    """An observer that has seen the arm."""
    return observed(arm())


@pytest.mark.slow
def test_a_load_that_varies_is_found_and_the_electrical_half_with_it() -> None:
    motor = observer_of_arm().motors['motor']
    assert motor.added_effects == (VARYING_LOAD,)
    assert motor.fit.verdict is FitVerdict.OK
    for name in ELECTRICAL:
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED
        assert abs(value - getattr(MOTOR, name)) < 4.0 * std
    assert told(motor, 'resistance')[0] == pytest.approx(MOTOR.resistance, rel=0.01)


@pytest.mark.slow
def test_of_its_rotor_nothing_is_identified() -> None:
    motor = observer_of_arm().motors['motor']
    for name in MECHANICAL:
        value, std, verdict = told(motor, name)
        assert verdict not in (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE)
        assert abs(value - getattr(MOTOR, name)) < 3.0 * std


def test_a_load_that_varies_has_a_constant_part() -> None:
    observer = Observer(Configuration.from_flat(CONSTANTS))
    feed(observer, [arm(10)])
    choice = observer.motors['motor'].observer.form_choice
    assert choice.may_take(FormKind(ROTOR, (VARYING_LOAD,)))
    assert not choice.may_take(FormKind(ROTOR, (VARYING_LOAD, 'load_torque')))
    assert not choice.may_take(FormKind('torque_constant', (VARYING_LOAD,)))


def test_beside_a_load_that_is_stated_none_is_added() -> None:
    stated = {'motor.speed_source': 'rotor', 'motor.known.load_torque': 0.01}
    observer = Observer(Configuration.from_flat({**CONSTANTS, **stated}))
    feed(observer, [arm(10)])
    choice = observer.motors['motor'].observer.form_choice
    assert not choice.may_take(FormKind(ROTOR, (VARYING_LOAD,)))
