"""A motor with a rotor that changes between two of its fits is soon believed no more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from rotor_records import CONSTANTS, GEAR_MOTOR, LIVELY, feed, recorded

from dc_motor_sim.plant import PlantParameters
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.fit_schedule import RECENT_WAIT
from gray_box_observer.fit_test.window_test import RECENT
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

pytestmark = pytest.mark.slow

RATE_HZ = 250.0
# between the fits at 1370 and 2060 samples
LEARNT_S = 5.6
FOLLOWED_S = 2.4
RIGHT_AFTER_S = 8.24
"""At the fit at 2055 samples a test is due."""

HOT = replace(GEAR_MOTOR, resistance=1.15 * GEAR_MOTOR.resistance)
CONFIGURATION = Configuration.from_flat(
    {**CONSTANTS, 'motor.speed_source': 'rotor', 'motor.stamps_exact': True}
)


def learnt() -> Observer:
    """Return an observer that has learnt a healthy motor."""
    observer = Observer(CONFIGURATION)
    feed(observer, [recorded(GEAR_MOTOR, LIVELY, LEARNT_S, 1, RATE_HZ)])
    return observer


def followed(plant: PlantParameters) -> Observer:
    """Return an observer of a healthy motor that goes on as another one."""
    observer = learnt()
    motor = observer.motors['motor']
    assert motor.identified
    before = motor.estimate.value.copy()
    begin_ns = round((LEARNT_S + 1.0 / RATE_HZ) * 1e9)
    feed(observer, [recorded(plant, LIVELY, FOLLOWED_S, 2, RATE_HZ)], begin_ns)
    assert (motor.estimate.value == before).all(), 'no fit has come since'
    return observer


def test_a_winding_that_gets_hot_at_once_makes_a_misfit_before_the_next_fit() -> None:
    assert 2 * RECENT_WAIT < FOLLOWED_S * RATE_HZ < RECENT + RECENT_WAIT
    motor = followed(HOT).motors['motor']
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert motor.fit.suspects[0].effect == 'change'
    assert not motor.identified


def test_so_does_one_that_gets_hot_right_after_a_fit_and_its_test() -> None:
    observer = Observer(CONFIGURATION)
    feed(observer, [recorded(GEAR_MOTOR, LIVELY, RIGHT_AFTER_S, 1, RATE_HZ)])
    motor = observer.motors['motor']
    assert motor.identified
    fit = motor.observer.state()[0]['fit']
    assert fit['tested_at'] == -7, 'tested at once: the next estimate is a thousand samples away'
    assert 'later' not in fit
    begin_ns = round((RIGHT_AFTER_S + 1.0 / RATE_HZ) * 1e9)
    feed(observer, [recorded(HOT, LIVELY, FOLLOWED_S, 2, RATE_HZ)], begin_ns)
    assert motor.fit.verdict is FitVerdict.MISFIT
    assert not motor.identified


def test_a_motor_that_stays_as_it_is_stays_believed() -> None:
    motor = followed(GEAR_MOTOR).motors['motor']
    assert motor.fit.verdict is FitVerdict.OK
    assert motor.identified


def test_a_restored_motor_is_tested_at_the_same_sample(tmp_path: Path) -> None:
    observer = learnt()
    checkpoint.save(observer, tmp_path / 'state.safetensors')
    again = Observer(CONFIGURATION)
    checkpoint.load(again, tmp_path / 'state.safetensors')
    states = [
        one.motors['motor'].observer.state()[0]['fit']['tested_at'] for one in (observer, again)
    ]
    assert states[0] == states[1] < 0
