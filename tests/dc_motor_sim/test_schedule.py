"""Scheduled changes of parameters."""

from __future__ import annotations

import pytest

from dc_motor_sim.errors import ScheduleError
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.schedule import Schedule, parse_change

MOTORS = {'motor': PlantParameters(), 'left': PlantParameters()}
SECOND_NS = 1_000_000_000


def schedule(*texts):
    return Schedule([parse_change(text, MOTORS) for text in texts])


def test_a_step_happens_once_at_its_time():
    steps = schedule('motor.resistance=1.3@60')
    assert steps.due_changes(60 * SECOND_NS - 1) == []
    assert steps.due_changes(60 * SECOND_NS) == [('motor', 'resistance', 1.3)]
    assert steps.due_changes(61 * SECOND_NS) == []


def test_a_ramp_runs_linearly_and_ends_on_its_last_value():
    ramp = schedule(' left . inductance = 0.5 .. 0.4 @ 10 .. 20 ')
    assert ramp.due_changes(9 * SECOND_NS) == []
    assert ramp.due_changes(10 * SECOND_NS) == [('left', 'inductance', 0.5)]
    assert ramp.due_changes(15 * SECOND_NS) == [('left', 'inductance', pytest.approx(0.45))]
    assert ramp.due_changes(27 * SECOND_NS) == [('left', 'inductance', 0.4)]
    assert ramp.due_changes(28 * SECOND_NS) == []


def test_of_two_at_once_the_one_that_began_later_comes_last():
    both = schedule('motor.resistance=5@3', 'motor.resistance=1..2@0..10')
    both.due_changes(0)
    assert [value for *_, value in both.due_changes(5 * SECOND_NS)] == [1.5, 5.0]


@pytest.mark.parametrize(
    ('text', 'what'),
    [
        ('motor.resistance', 'neither'),
        ('motor.resistance=1..2@5', 'neither'),
        ('motor.resistance=1@5..6', 'neither'),
        ('right.resistance=1@5', 'motors: motor, left'),
        ('motor.mass=1@5', 'parameters: inductance'),
        ('motor.resistance=-1@5', 'resistance must be'),
        ('motor.resistance=1..-2@5..6', 'resistance must be'),
        ('motor.resistance=1@-5', 'backwards'),
        ('motor.resistance=1..2@6..5', 'backwards'),
    ],
)
def test_an_entry_that_makes_no_sense_is_refused_on_one_line(text, what):
    with pytest.raises(ScheduleError, match=what) as caught:
        parse_change(text, MOTORS)
    assert text in str(caught.value)
    assert '\n' not in str(caught.value)
