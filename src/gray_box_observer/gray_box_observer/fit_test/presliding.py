"""What a shaft that gives before its friction breaks would do to an estimate.

Friction that holds a shaft lets it give by a small angle, as bristles that bend (presliding
displacement; C. Canudas de Wit et al., IEEE Trans. Automatic Control 40 (3), 1995). At rest the
angle follows the current, so the back-EMF follows its rate: ``Kb delta / i_hold`` beside ``L``. The
white box has a shaft that stands still. Its inductance then leans on rests that are none.
"""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import swapped_logarithms
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

GIVE_RAD = 5e-3
"""Standard deviation of the angle of the motor's shaft that is taken for likely beforehand."""

HELD = 1e-3
"""Share of its speed that an interval leaves of a shaft that friction holds; and share of the
largest speed below which a measured one stands."""


def presliding_shifts(white_box: WhiteBox, run: FreeRun, theta: Array, noise_a: float) -> Array:
    """Return how far the logarithms of the parameters may be off by a shaft that gives.

    The data tell the angle, too; it and what is likely beforehand are taken together.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
        noise_a: standard deviation of the residual.

    Returns:
        Shape (1, parameter); without a row where the shaft does not rest.
    """
    assert isinstance(white_box, MotorWhiteBox)
    nothing = np.empty((0, theta.size))
    is_held = _is_held(white_box, run)
    largest_a = float(np.abs(run.current_a[1:][is_held]).max(initial=0.0))
    if not (largest_a > 0.0 and noise_a > 0.0):
        return nothing
    interval_s = np.where(is_held, run.stretch.interval_s[0], 1.0)
    rate = np.where(is_held, np.diff(run.current_a) / interval_s, 0.0)
    back_emf = white_box.values(theta)['back_emf_constant']
    response = run.response((-back_emf / largest_a * rate)[None])[0]
    slopes = swapped_logarithms(run.jacobian[:, 1:])
    if not (np.isfinite(slopes).all() and np.isfinite(response).all()):
        return nothing
    amounts, rest = run.explain(response, slopes)
    own = rest / noise_a  # what the parameters cannot take over
    precision = float(own @ own) + GIVE_RAD**-2
    angle_rad = float(own @ (run.residual_a * np.sqrt(run.weight))) / noise_a / precision
    shift: Array = math.hypot(angle_rad, precision**-0.5) * amounts
    return shift[None]


def _is_held(white_box: WhiteBox, run: FreeRun) -> Array:
    """Tell of every interval whether friction holds the shaft through it, shape (k,)."""
    is_whole = ~run.stretch.restart[0] & (run.stretch.interval_s[0] > 0.0)
    if isinstance(run, RotorFreeRun):
        left = run.transitions[:, State.SPEED, State.SPEED]
        return np.asarray(is_whole & (np.abs(left) < HELD))
    if not white_box.speed_measured:
        return np.zeros_like(is_whole)
    speed = np.abs(run.stretch.speed_rad_s[0])
    rests = speed < HELD * float(speed.max())
    return np.asarray(is_whole & rests[1:] & rests[:-1])
