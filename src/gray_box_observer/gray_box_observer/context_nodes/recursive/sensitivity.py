"""Effect of an error in known constants on the estimate: change each, and fit again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.recursive.batch_fit import batch_fit
from gray_box_observer.context_nodes.recursive.belief import Prior
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box.flow import to_coordinates, to_parameters
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

CHANGE = 0.01
VAGUE = 2.0
FLOOR = 1e-5
FEWEST = 100
"""Samples below which a fit would tell more of the prior than of the constants."""


def sensitivity(
    white_box: MotorWhiteBox, replay: ReplayBuffer, theta: Array, *, reads_current: bool = False
) -> dict[str, dict[str, float]] | None:
    """Return the change of every parameter, in %, per one per cent of each known constant.

    Args:
        white_box: the physics with its constants.
        replay: the samples remembered, all of which are fitted.
        theta: shape (motor, parameter): where the fits start.
        reads_current: whether the torque was read as a current, which an error of Kt leaves as it
            is.

    Returns:
        By constant and parameter, of the first motor; None where too little is remembered to tell,
        and for a motor with a rotor.
    """
    if len(replay) < FEWEST or white_box.has_rotor:
        return None
    perturbed_models = {
        'torque_constant': replace(
            white_box, torque_constant=(1.0 + CHANGE) * white_box.torque_constant
        )
    }
    for name, value in white_box.known.items():
        if name in white_box.context_nodes:
            continue
        perturbed_models[name] = replace(
            white_box, known={**white_box.known, name: (1.0 + CHANGE) * value}
        )
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
        stretch = SampleWindow.newest(white_box, replay, len(replay))
        nominal = _fit(white_box, stretch, theta)
        stretches = dict.fromkeys(perturbed_models, stretch)
        if not reads_current:
            other = perturbed_models['torque_constant']
            stretches['torque_constant'] = SampleWindow.newest(other, replay, len(replay))
        ratios = {
            name: _fit(other, stretches[name], theta) / nominal - 1.0
            for name, other in perturbed_models.items()
        }
    if not all(np.all(np.isfinite(ratio)) for ratio in ratios.values()):
        return None
    names = [parameter.name for parameter in white_box.parameters]
    return {
        constant: {name: float(r) / CHANGE for name, r in zip(names, ratio[0], strict=True)}
        for constant, ratio in ratios.items()
    }


def _fit(white_box: MotorWhiteBox, stretch: SampleWindow, theta: Array) -> Array:
    start = to_coordinates(theta)
    return to_parameters(
        batch_fit(white_box, stretch, start, Prior.vague(start, VAGUE), FLOOR).belief.p
    )
