"""Figures of the robots' motors: R from voltage and current alone, and the torque foretold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from real_motors import DEAD_CURRENT_SENSOR, ROBOT_TORQUE_CONSTANT, Case, cases, identify

from common.figures import Figure, number, table
from common.rotor.robot_prediction import PREDICTORS, robot_errors, robot_logs
from common.rotor.trial_tables import WITHIN_STDS
from gray_box_observer.context_nodes import Verdict

ROBOT_OHM = 4.25
ROBOT_REACH_OHM = 0.3


def robot_figures(data: Path) -> list[Figure]:
    """Identify the robots' motors from voltage and current alone."""
    present = [
        case for case in cases(data) if case.name.startswith('robot') and case.path.is_file()
    ]
    rows = []
    healthy = []
    false = 0
    for case in present:
        for motor, estimate in identify(without_speed(case)).estimates().items():
            resistance = float(estimate.value[0, 1])
            std = float(estimate.std[0, 1])
            verdict = estimate.verdicts[0][1]
            rows.append([f'{case.name} {motor}', number(resistance), number(std), verdict.value])
            if (case.name.split()[1], motor) == DEAD_CURRENT_SENSOR:
                continue
            healthy.append(resistance)
            wrong = abs(resistance - ROBOT_OHM) > max(WITHIN_STDS * std, ROBOT_REACH_OHM)
            false += verdict is Verdict.IDENTIFIED and wrong
    if rows:
        print(f'\n{table(["voltage and current only", "R, ohm", "std", "verdict"], rows)}')
    band = (ROBOT_OHM - ROBOT_REACH_OHM, ROBOT_OHM + ROBOT_REACH_OHM)
    return [
        Figure('robots: lowest R, ohm', min(healthy, default=None), band),
        Figure('robots: highest R, ohm', max(healthy, default=None), band),
        Figure('robots: identified and wrong', float(false) if healthy else None, 0.0),
    ]


def without_speed(case: Case) -> Case:
    """Return a robot's log without its speed, its motors with a rotor."""
    parameters: dict[str, object] = {'motors': ['left', 'right']}
    for side in ('left', 'right'):
        constant = case.parameters[f'{side}.torque_constant']
        parameters |= {
            f'{side}.torque_constant': constant,
            f'{side}.back_emf_constant': constant,
            f'{side}.speed_source': 'rotor',
        }
    columns = tuple(column for column in case.columns if '.speed=' not in column)
    return replace(case, columns=columns, parameters=parameters)


def prediction_figures(data: Path, *, quick: bool) -> list[Figure]:
    """Predict the torque of robots that taught nothing, from their voltage alone.

    Args:
        data: folder with regbot_rev2b.
        quick: one robot is asked of.
    """
    logs = robot_logs(data / 'regbot_rev2b')
    robots = sorted({log.robot for log in logs})[: 1 if quick else None]
    found = [
        errors
        for robot in robots
        for errors in robot_errors(logs, robot, ROBOT_TORQUE_CONSTANT)
        if len(robots) > 1 or quick
    ]
    if not found:
        return [Figure('robots never seen: error of the torque', None, 0.24)]
    rows = [
        [name, *(number(errors[one]) for one in PREDICTORS), f'{100.0 * scored:.0f} %']
        for name, errors, scored in found
    ]
    medians = {one: float(np.median([errors[one] for _, errors, _ in found])) for one in PREDICTORS}
    rows.append(['median', *(number(medians[one]) for one in PREDICTORS), ''])
    print(f'\n{table(["free run of the torque", *PREDICTORS, "scored"], rows)}')
    rivals = PREDICTORS[2:]
    return [
        Figure('robots never seen: error of the torque', medians['observer'], 0.24, not quick),
        *(
            Figure(
                f'robots never seen: error over {rival}',
                medians['observer'] / medians[rival],
                1.0,
                not quick,
            )
            for rival in rivals
        ),
    ]
