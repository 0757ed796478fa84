"""What an estimate claims of a motor, and whether that is right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from common.motion import FloatArray
from common.rotor.runs import FALSE_SHARE, FALSE_STDS
from common.trust.motors import Motor
from dc_motor_sim.plant import PlantParameters
from gray_box_observer.context_nodes import Estimate, Verdict

JUDGED = ('inductance', 'resistance')
"""Parameters whose claims are judged: those that a robot's controller is tuned for."""

Counts = np.ndarray[tuple[int], np.dtype[np.int_]]


def claims(
    estimate: Estimate, motor: Motor | PlantParameters, nodes: Sequence[str] = JUDGED
) -> Counts:
    """Return how many parameters are identified, and how many of them are false.

    Args:
        estimate: of one motor.
        motor: the truth.
        nodes: the parameters.
    """
    counts: Counts = np.zeros(2, dtype=int)
    for node in nodes:
        place = _place(estimate, node)
        if estimate.verdicts[0][place] is not Verdict.IDENTIFIED:
            continue
        truth = float(getattr(motor, node))
        off = abs(estimate.value[0, place] - truth)
        is_false = off > max(FALSE_STDS * estimate.std[0, place], FALSE_SHARE * truth)
        counts += np.array([1, int(is_false)])
    return counts


def is_known(estimate: Estimate, motor: Motor) -> bool:
    """Tell whether R is identified and right."""
    return bool((claims(estimate, motor, ('resistance',)) == [1, 0]).all())


def is_near(estimate: Estimate, motor: Motor) -> bool:
    """Tell whether R is right, whatever its verdict."""
    value = float(estimate.value[0, _place(estimate, 'resistance')])
    return abs(value / motor.resistance - 1.0) <= FALSE_SHARE


def noisy_readings(
    speed_rad_s: FloatArray, noise: float | None, rng: np.random.Generator
) -> FloatArray | None:
    """Return measured speeds, shape (motor, sample); None where there are none.

    Args:
        speed_rad_s: shape (motor, sample): true ones.
        noise: as a share of the spread of each; None: the speed is not measured.
        rng: draws it.
    """
    if noise is None:
        return None
    std = noise * speed_rad_s.std(axis=1, keepdims=True)
    result: FloatArray = speed_rad_s + std * rng.normal(size=speed_rad_s.shape)
    return result


def _place(estimate: Estimate, node: str) -> int:
    return [parameter.name for parameter in estimate.parameters].index(node)
