"""What friction or iron that is not quite that of the white box would do to an estimate.

The white box has a shaft that stands still until its friction breaks, and a friction of
``T_c + B |w|`` from then on. Real friction lets the shaft give before it breaks. It takes more to
break than to move (B. Armstrong-Helouvry et al., Automatica 30 (7), 1994). Fans and pumps add what
grows with the square of the speed. In iron the resistance grows with the speed. The residual shows
little of that, for the parameters take over most of it. How much there is, the data tell together
with what is likely beforehand.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.fit_test.effects import HYSTERESIS, interval_means
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.fit_test.rotor_free_run import HELD, RotorFreeRun
from gray_box_observer.samples.order_statistics import quantile
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

GIVE_RAD = 5e-3
"""Standard deviation of the angle of the motor's shaft that is taken for likely beforehand."""

RESTING = 1e-3
"""Share of a large speed below which a measured one is that of a shaft at rest."""

FAST = 0.99
"""Quantile of the speeds that is a large one: one wild reading is none."""

NOISY = 3.0
"""Standard deviations of the speed's noise that are rest too."""

NOISIEST = 5e-3
"""Largest noise that is taken for some, as a share of a large speed: a shaft that is sampled too
slowly has none."""

BREAKAWAY = 0.25
"""Standard deviation, over ``T_c``, of the friction that is there beside it where the shaft hardly
moves."""

SLOW = 0.02
"""Share of the largest speed at which most of that has gone."""

SURE = 2.0
"""Standard deviations from which a friction that grows with the square of the speed is believed to
be there, and hysteresis. Most motors have none."""

IRON = 0.1
"""Standard deviation of what hysteresis adds to R at the largest speed, as a share of it."""


def friction_doubts(white_box: WhiteBox, run: FreeRun, theta: Array) -> list[Doubt]:
    """Return what may be left out of a motor's friction.

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        theta: shape (parameter,): these.
    """
    assert isinstance(white_box, MotorWhiteBox)
    values = white_box.values(theta)
    doubts = _presliding(run, _is_held(white_box, run), values.get('back_emf_constant', 0.0))
    if isinstance(run, RotorFreeRun):
        doubts += _other_friction(run, values)
        if HYSTERESIS not in white_box.context_nodes:
            doubts += _iron(run, values)
    return doubts


def _presliding(run: FreeRun, is_held: Array, back_emf_constant: float) -> list[Doubt]:
    """A held shaft gives as bristles that bend (presliding displacement).

    C. Canudas de Wit et al., IEEE Trans. Automatic Control 40 (3), 1995. The angle follows the
    current, so the back-EMF follows its rate: ``Kb delta / i_held`` beside ``L``.
    """
    largest_a = float(np.abs(run.current_a[1:][is_held]).max(initial=0.0))
    if not largest_a > 0.0:
        return []
    interval_s = np.where(is_held, run.stretch.interval_s[0], 1.0)
    rate = np.where(is_held, np.diff(run.current_a) / interval_s, 0.0)
    back_emf_v = GIVE_RAD * back_emf_constant / largest_a * rate
    return [Doubt(run.response(-back_emf_v[None])[0])]


def _other_friction(run: RotorFreeRun, values: dict[str, float]) -> list[Doubt]:
    """More friction where the shaft hardly moves, and friction that grows faster than its speed."""
    speed_rad_s = interval_means(run.speed_rad_s)
    largest_rad_s = float(np.abs(run.speed_rad_s).max(initial=0.0))
    dry_nm = values.get('coulomb_friction', 0.0)
    most_nm = dry_nm + values.get('viscous_friction', 0.0) * largest_rad_s
    if not (largest_rad_s > 0.0 and most_nm > 0.0):
        return []
    share = speed_rad_s / largest_rad_s
    breakaway_nm = BREAKAWAY * dry_nm * np.sign(share) * np.exp(-((share / SLOW) ** 2))
    quadratic_nm = most_nm * share * np.abs(share)
    torques_nm = -np.stack([breakaway_nm, quadratic_nm])
    breakaway_a, quadratic_a = run.torque_response(torques_nm, values['inertia'])
    return [Doubt(breakaway_a), Doubt(quadratic_a, SURE)]


def _iron(run: RotorFreeRun, values: dict[str, float]) -> list[Doubt]:
    """A resistance that grows with the speed."""
    speed_rad_s = np.abs(interval_means(run.speed_rad_s))
    largest_rad_s = float(speed_rad_s.max(initial=0.0))
    if not largest_rad_s > 0.0:
        return []
    ohms = IRON * values['resistance'] * speed_rad_s / largest_rad_s
    lost_v = ohms * interval_means(run.current_a)
    return [Doubt(run.response(-lost_v[None])[0], SURE)]


def _is_held(white_box: WhiteBox, run: FreeRun) -> Array:
    """Tell of every interval whether friction holds the shaft through it, shape (k,)."""
    is_whole = run.is_whole
    if isinstance(run, RotorFreeRun):
        left = run.transitions[:, State.SPEED, State.SPEED]
        return np.asarray(is_whole & (np.abs(left) < HELD))
    if not white_box.speed_measured:
        return np.zeros_like(is_whole)
    speed = np.abs(run.stretch.speed_rad_s[0])
    large = float(quantile(speed, FAST)) or float(speed.max())
    noise = min(difference_noise(run.stretch.speed_rad_s[0]), NOISIEST * large)
    rests = speed < max(RESTING * large, NOISY * noise)
    return np.asarray(is_whole & rests[1:] & rests[:-1])
