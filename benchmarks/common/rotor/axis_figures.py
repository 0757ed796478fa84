"""Figures of the EMPS axis, read as a motor: mass for L, viscous friction for R, dry for a drop.

Its speed takes the place of the current, and nothing else is measured. The authors state what the
axis has (Janot, Gautier, Brunot: "Data set and reference models of EMPS", 2019). Friction of real
guides is not of that form, so what is asked of frictions is what a batch fit of the same form says.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from common.figures import Figure, number, table
from common.motion import FloatArray
from common.trust.real_logs import axis_log, run_real_log

NODES = ('inductance', 'resistance', 'brush_drop')
NAMES = ('mass', 'viscous friction', 'dry friction')
MASS, VISCOUS, DRY = range(3)
STATED = np.array([95.1089, 203.5034, 20.3935])
"""In kg, N s/m and N."""

FORCE_PER_VOLT = 35.15065
MASS_GOAL_PERCENT = 0.5
BATCH_GOAL = 3.0
HALVES_GOAL = 1.5


def axis_figures(data: Path) -> list[Figure]:
    """Identify the axis by the whole record and its halves, beside a batch fit.

    Args:
        data: folder with emps.
    """
    log = axis_log(data)
    if not log.case.path.is_file():
        return [Figure('EMPS axis: mass off, %', None, MASS_GOAL_PERCENT)]
    (axis,) = run_real_log(log)
    parts = [axis.whole, *axis.halves]
    value = FORCE_PER_VOLT * np.array([[part[node][0] for node in NODES] for part in parts])
    std = FORCE_PER_VOLT * np.array([[part[node][1] for node in NODES] for part in parts])
    batch = batch_fit(*np.array([line.split(',') for line in log.lines()[1:]], dtype=float).T)
    rows = [
        [name, *(f'{v:.4g} +- {s:.2g}' for v, s in zip(*row, strict=True))]
        for name, *row in zip(('whole', 'first half', 'second half'), value, std, strict=True)
    ]
    rows += [['batch fit', *map(number, batch)], ['stated', *map(number, STATED)]]
    print(f'\n{table(["EMPS axis", *NAMES], rows)}')
    off_percent = abs(100.0 * (value[0, MASS] / STATED[MASS] - 1.0))
    off_batch = np.abs(value[0] - batch) / std[0]
    apart = np.abs(value[1] - value[2]) / np.hypot(std[1], std[2])
    return [
        Figure('EMPS axis: mass off, %', float(off_percent), MASS_GOAL_PERCENT),
        *(
            Figure(f'EMPS axis: {NAMES[j]} off a batch fit, std', float(off_batch[j]), BATCH_GOAL)
            for j in (VISCOUS, DRY)
        ),
        Figure('EMPS axis: halves apart, std', float(apart.max()), HALVES_GOAL),
    ]


def batch_fit(time_s: FloatArray, volt: FloatArray, speed: FloatArray) -> FloatArray:
    """Fit the free-running model to the whole record by least squares, from what is stated.

    Args:
        time_s: shape (sample,): equally spaced.
        volt: shape (sample,): of the drive.
        speed: shape (sample,): in m/s.

    Returns:
        Mass, viscous and dry friction in kg, N s/m and N.
    """
    force = (FORCE_PER_VOLT * volt).tolist()
    step_s = float(np.median(np.diff(time_s)))

    def residual(unknowns: FloatArray) -> FloatArray:
        mass, viscous, dry, start = unknowns.tolist()
        return _free_run(force, mass, viscous, dry, start, step_s) - speed

    fit = least_squares(residual, [*STATED, float(speed[0])], x_scale=[1.0, 10.0, 1.0, 0.01])
    values: FloatArray = fit.x[:3]
    return values


def _free_run(
    force: Sequence[float], mass: float, viscous: float, dry: float, start: float, step_s: float
) -> FloatArray:
    """Return the speed under forces that are held, friction stopping the axis where it can."""
    speed = start
    run = np.empty(len(force))
    for k, push in enumerate(force):
        run[k] = speed
        left_s = step_s
        while left_s > 0.0:
            if speed == 0.0 and abs(push) <= dry:
                break
            sign = math.copysign(1.0, speed if speed != 0.0 else push)
            final = (push - dry * sign) / viscous
            until_s = math.inf
            if speed * final < 0.0:  # it comes to rest before the force turns it round
                until_s = mass / viscous * math.log(1.0 - speed / final)
            if until_s <= left_s:
                speed = 0.0
                left_s -= until_s
            else:
                speed = final + (speed - final) * math.exp(-viscous / mass * left_s)
                left_s = 0.0
    return run
