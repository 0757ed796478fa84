"""What data tell of the parameters beside a lost voltage and an offset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from rotor_records import GEAR_MOTOR, driven

from dc_motor_sim.plant import PlantParameters
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.loss_information import LossInformation
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

NODES = ('inductance', 'resistance', 'back_emf_constant')
LOST_V = 0.5
THETA = np.array([[GEAR_MOTOR.inductance, GEAR_MOTOR.resistance, GEAR_MOTOR.back_emf_constant]])
TIME_S = np.arange(600) * 1e-3
SWITCHED = np.where((TIME_S // 0.1) % 2 == 0.0, 1.0, -1.0)


def content_of(plant: PlantParameters, volts: Array) -> Array:
    """Return a record as a replay buffer gives it, shape (signal, 1, n)."""
    record = driven(plant, volts)
    held_v = np.concatenate([[0.0], record.voltage_v[0, :-1]])
    interval_s = np.full(volts.size, 1e-3)
    return np.stack([interval_s, held_v, record.torque_nm[0], record.speed_rad_s[0]])[:, None]


def gathered(content: Array, white_box: MotorWhiteBox | None = None, parts: int = 1) -> Any:
    """Return what a record tells, taken in by parts."""
    white_box = white_box or MotorWhiteBox(NODES, 0.02, {}, True)
    information = LossInformation(white_box, LOST_V)
    edges = np.linspace(0, content.shape[2] - 1, parts + 1).astype(int)
    for begin, end in pairwise(edges.tolist()):
        information.add(THETA, content[:, :, begin : end + 1])
    return information


def deviations(information: Any) -> Array:
    """Return the deviations that loss and offset add, shape (parameter,)."""
    return np.sqrt(np.diagonal(information.spread()))


@pytest.mark.parametrize(
    ('volts', 'is_open'),
    [
        (np.full(600, 6.0), True),
        (6.0 * SWITCHED, True),
        (np.where(TIME_S < 0.1, 0.0, 6.0), True),
        (6.5 + 1.5 * SWITCHED, False),
        (np.repeat([11.0, -8.0, 3.0, -2.0, 6.0, -5.0], 100), False),
    ],
)
def test_levels_that_tell_a_loss_and_levels_that_do_not(volts: Array, is_open: bool) -> None:
    of_resistance = deviations(gathered(content_of(GEAR_MOTOR, volts)))[1]
    assert of_resistance > 0.05 if is_open else of_resistance < 0.01


def test_parts_tell_what_the_whole_tells() -> None:
    content = content_of(GEAR_MOTOR, np.repeat([11.0, -8.0, 3.0, -2.0, 6.0, -5.0], 100))
    whole, parts = (deviations(gathered(content, parts=count)) for count in (1, 3))
    assert parts == pytest.approx(whole, rel=0.3)


def test_a_loss_that_data_tell_counts_though_it_is_known_well() -> None:
    volts = 6.5 + 1.5 * SWITCHED
    lossy = replace(GEAR_MOTOR, brush_drop=0.6)
    without, with_loss = (deviations(gathered(content_of(m, volts))) for m in (GEAR_MOTOR, lossy))
    assert with_loss[1] > 0.03
    assert without[1] < 0.01


def test_effects_that_a_white_box_has_are_no_question() -> None:
    known = {'brush_drop': 0.6, 'voltage_offset': -5.0}
    content = content_of(GEAR_MOTOR, np.full(600, 6.0))
    white_box = MotorWhiteBox(NODES, 0.02, known, True)
    assert not gathered(content, white_box).spread().any()


def test_absurd_samples_tell_nothing() -> None:
    content = content_of(GEAR_MOTOR, 6.0 * SWITCHED)
    information = gathered(content)
    before = information.spread()
    content = content.copy()
    content[2:] = np.nan
    with np.errstate(all='ignore'):
        information.add(THETA, content)
    assert information.spread().tobytes() == before.tobytes()


def test_a_state_holds_everything() -> None:
    content = content_of(GEAR_MOTOR, 6.0 * SWITCHED)
    one = gathered(content)
    other = LossInformation(MotorWhiteBox(NODES, 0.02, {}, True), LOST_V)
    other.restore(one.state())
    for information in (one, other):
        information.add(THETA, content)
    assert one.spread().tobytes() == other.spread().tobytes()


def _without(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda plain: {key: value for key, value in plain.items() if key != name}


@pytest.mark.parametrize(
    'spoilt',
    [
        _without('root'),
        lambda plain: {**plain, 'root': [[1.0]]},
        lambda plain: {**plain, 'about': ['x', 0.0, 0.0]},
        lambda plain: {**plain, 'about': [float('nan')] * 3},
        lambda plain: {**plain, 'intervals': -1},
        lambda plain: {**plain, 'power': {}},
    ],
)
def test_a_state_that_there_cannot_have_been_is_refused(spoilt: Any) -> None:
    information = gathered(content_of(GEAR_MOTOR, 6.0 * SWITCHED))
    with pytest.raises(CheckpointError):
        information.restore(spoilt(information.state()))
