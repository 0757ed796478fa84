"""What the noise of a measured speed does to an estimate that takes it for exact.

The noise enters the voltage balance as a voltage ``Kb n``. The current of the model answers it;
that of the motor does not. Least squares make this answer small, so they make the inductance large:
the bias of errors in variables (T. Soderstrom, "Errors-in-variables methods in system
identification", Automatica 43 (6), 2007).

White noise of standard deviation ``s`` counts in an interval as the mean of its two ends. The
answer to it has the variance ``(Kb s / R)^2 (1 - a) / 2``. Here ``a = exp(-h R / L)`` is what an
interval of length ``h`` leaves of the current.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.white_box.flow import swapped_logarithms
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

BACK_EMF_CONSTANT, INDUCTANCE, RESISTANCE = 'back_emf_constant', 'inductance', 'resistance'


def speed_noise_shift(white_box: WhiteBox, run: FreeRun, theta: Array) -> Array:
    """Return by how much the noise of a measured speed moves the logarithms of the parameters.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.

    Returns:
        Shape (1, parameter); without a row where no speed is measured.
    """
    assert isinstance(white_box, MotorWhiteBox)
    nothing = np.empty((0, theta.size))
    if not white_box.speed_measured:
        return nothing
    speed_rad_s = run.stretch.speed_rad_s
    step_rad_s = float(quantisation_step(speed_rad_s)[0])
    std_rad_s = max(difference_noise(speed_rad_s[0]), step_rad_s * STEP_TO_STD)
    slope = std_rad_s**2 * _variance_slope(white_box, run, theta)
    columns = np.column_stack([run.jacobian[:, 0], swapped_logarithms(run.jacobian[:, 1:])])
    columns *= np.sqrt(run.weight)[:, None]
    scale = np.linalg.norm(columns, axis=0) + 1e-300
    information = (columns / scale).T @ (columns / scale)
    if not (np.isfinite(information).all() and np.isfinite(slope).all()):
        return nothing
    right = np.concatenate([np.zeros(1), -0.5 * slope]) / scale
    shift: Array = np.linalg.pinv(information, rcond=1e-12, hermitian=True) @ right / scale
    return shift[None, 1:]


def _variance_slope(white_box: MotorWhiteBox, run: FreeRun, theta: Array) -> Array:
    """Differentiate the sum of the answer's variances by the logarithms, shape (parameter,).

    The sum is for noise of the speed of 1 rad/s.
    """
    is_whole = ~run.stretch.restart[0] & (run.stretch.interval_s[0] > 0.0)
    stays = np.clip(run.decay[is_whole], 1e-12, 1.0 - 1e-12)
    gain = run.reach_s[is_whole] / run.inductance_h  # (1 - a) / R
    back_emf = white_box.values(theta).get(BACK_EMF_CONSTANT, 0.0)
    variance = (back_emf * gain) ** 2 / (2.0 * (1.0 - stays))
    by_inductance = float((variance * stays * np.log(stays) / (1.0 - stays)).sum())
    slopes = {
        INDUCTANCE: by_inductance,
        RESISTANCE: -by_inductance - 2.0 * float(variance.sum()),
        BACK_EMF_CONSTANT: 2.0 * float(variance.sum()),
    }
    return np.array([slopes.get(parameter.name, 0.0) for parameter in white_box.parameters])
