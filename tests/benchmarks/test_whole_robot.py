"""The benchmark of whole robots: its count of claims, and one robot through the observer."""

from __future__ import annotations

import pytest
import whole_robot
from common.robot_runs import RobotCase, RobotTrial, run_robot


def test_rows_and_figures_count_motors_and_claims() -> None:
    trials = [
        RobotTrial(known=12, near=12, misfits=0, claims=30, false=0, sample_us=100.0),
        RobotTrial(known=6, near=9, misfits=4, claims=10, false=4, sample_us=300.0),
    ]
    assert whole_robot.row('defaults', trials) == [
        'defaults', '24', '18', '21', '4', '40', '10.00', '200',
    ]  # fmt: skip
    figures = {figure.name: figure for figure in whole_robot.figures({'defaults': trials})}
    known = figures['defaults: R identified and right, in % of motors']
    assert known.value == 75.0
    assert not known.met
    assert figures['  false claims, in %'].value == 10.0


@pytest.mark.slow
@pytest.mark.parametrize('speed_noise', [None, 0.03])
def test_every_motor_of_a_robot_is_known_though_one_message_brings_all(
    speed_noise: float | None,
) -> None:
    case = RobotCase(4, 200.0, 3.0, speed_noise, None)
    trial = run_robot(case, seed=7)
    assert trial.false == 0
    assert trial.misfits == 0
    assert trial.known == case.motors
